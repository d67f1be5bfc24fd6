"""Fit of a ring-down: omega0, damping and friction of a mass that was displaced and released, with the belt at rest.

Model, with v = dx/dt and beta = zeta omega0::

    x'' = -omega0^2 (x - rest) - 2 beta v - omega0^2 a sgn(v) / (1 + g |v|)

Viscous damping reduces the swings by a ratio, friction of the contact by a length (4 a per period); both are fitted
together, because either alone would absorb the other.  ``a`` is the friction as a length, F/k, and ``g`` how fast it
weakens with speed; ``g`` is fitted only when it lowers chi square enough
(`LEAST_GAIN`).  Friction that changes in proportion to the speed
cannot be distinguished from damping: its slope is part of the damping found.

The mass is followed from shortly after its release to its last turning point before it rests.  Counts are taken in the
middle of their cell, (n + 1/2).  Standard deviations are those of least squares, times the root of the integrated
autocorrelation time (in samples) of the residuals, so that model errors widen them, and half a count at
the first and at the last turning point, which many samples share.

Not modelled: a spring that is not linear, a belt that moves, friction that differs between the two directions.
"""

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from daq.calibration import swing_kernel
from stickslip.compute.arrays import autocorrelation_time
from stickslip.compute.compile import compiled
from stickslip.errors import DataError
from stickslip.units import Measured

KERNELS = ("daq.calibration.swing_kernel",)
FEWEST_SWINGS = 3  # half-swings; with fewer, friction and damping cannot be separated
RELEASED = 0.97  # share of the first amplitude: below it the mass is taken as released; chosen by judgement, not swept
STEP = 0.03  # rad, between nodes; where friction weakens the error falls as its square
STEP_ERROR = 1e-5  # relative error of omega, where friction weakens within a step
MOST_NODES = 400_000
MOST_SAMPLES = 6000  # fitted; more take time in proportion and add little
LEAST_GAIN = 12.0  # fall of chi square by adding g: a likelihood ratio test, chi2 with 1 degree of freedom at 0.05 %
NOISE_FLOOR = 0.32  # counts: 1 / sqrt(12) is what counting alone leaves
POOR_FIT = 0.002  # residual rms over first amplitude, above which the model is rejected; chosen by judgement, not swept


@dataclass(frozen=True)
class RingDown:
    """Result of a ring-down; lengths in the unit of the positions given, here called u."""

    omega0: Measured  # undamped angular frequency, rad/s
    zeta: Measured  # damping over critical damping
    friction: Measured  # friction at low speed over stiffness, u
    velocity_weakening: Measured | None  # g, s/u; None where constant friction describes the motion
    equilibrium: Measured  # the spring's rest position, u
    rms: float  # of the residuals, u
    amplitude: float  # at the release, u
    swings: int  # Half-swings fitted
    samples: int  # samples fitted
    poor: bool  # whether the model does not describe the motion: the values mean little then


def fit(time: NDArray[np.float64], position: NDArray[np.float64], resolution: float) -> RingDown:
    """Fit the model to a recording that holds one ring-down.

    time, position: (n,) s; u.  Before the release the mass may be moved or held; after it has come to rest it must be
        left alone.
    resolution: One count, u.
    Raises DataError: the record holds no ring-down, or too few swings of one.
    """
    here, centre, crossings = _free_part(time, position, resolution)
    thin = max(1, (here.stop - here.start) // MOST_SAMPLES)
    t, x = (time[here] - time[here.start])[::thin], position[here][::thin]
    start = _guess(t, x, centre, crossings - time[here.start])
    best = first = _solve(t, x, [start], resolution, weakening=False)
    # Friction that weakens is sought from both starts, at speeds about and far below the fastest; with g it must begin
    # larger, so that the loss over a swing stays about the same.
    fastest = start[0] * float(np.max(np.abs(x - centre)))
    tries = [(guess, g, fastest) for g in (2.0, 20.0, 0.2) for guess in (first.theta, start)]
    begins = [guess * (1, 1, 1 + g / 2, 1, 1, 1, 0) + (0, 0, 0, 0, 0, 0, g / unit) for guess, g, unit in tries]
    second = _solve(t, x, begins, resolution, weakening=True)
    gain = (first.rms / max(second.rms, 1e-3 * resolution)) ** 2 - 1
    if gain * len(t) / second.autocorrelation_time > LEAST_GAIN and second.theta[6] > 2 * second.sd[6]:
        best = second
    amplitude = float(np.max(np.abs(x - centre)))
    half = 0.5 * resolution / len(crossings)  # what half a count at either end makes of a loss per swing
    share = half / amplitude / math.pi
    stepping = 0.0 if best is first else STEP_ERROR
    least = np.array([math.hypot(share, stepping) * best.theta[0], share, half, 0.5 * half, 0.0, 0.0, 0.0])
    sds = np.hypot(best.sd, least)
    w, zeta, a, rest, _, _, g = (Measured(float(v), float(sd)) for v, sd in zip(best.theta, sds, strict=True))
    return RingDown(
        omega0=w,
        zeta=zeta,
        friction=a,
        velocity_weakening=g if best is not first else None,
        equilibrium=rest,
        rms=best.rms,
        amplitude=amplitude,
        swings=len(crossings),
        samples=len(t),
        poor=best.rms > POOR_FIT * amplitude + resolution,
    )


def motion(
    t: NDArray[np.float64], omega0: float, zeta: float, a: float, rest: float, x: float, v: float, g: float = 0.0
) -> NDArray[np.float64]:
    """Return the model's positions at times ``t`` (increasing from 0), from x and v at time 0; it may come to rest.

    Between nodes friction is constant and the flow exact: for g = 0 there is no error, else it falls as `STEP`^2.
    """
    times, xs, vs = np.empty((3, MOST_NODES))
    times[0], xs[0], vs[0] = 0.0, x, v
    run = compiled(swing_kernel.follow, KERNELS)
    nodes = run(float(t[-1]), STEP / omega0, omega0, zeta, a, g, rest, times, xs, vs)
    return _hermite(t, times[:nodes], xs[:nodes], vs[:nodes])


def _hermite(
    t: NDArray[np.float64], times: NDArray[np.float64], xs: NDArray[np.float64], vs: NDArray[np.float64]
) -> NDArray[np.float64]:
    left = np.clip(np.searchsorted(times, t, side="right") - 1, 0, len(times) - 2)
    h = times[left + 1] - times[left]
    u = (t - times[left]) / h
    x0, x1, v0, v1 = xs[left], xs[left + 1], vs[left] * h, vs[left + 1] * h
    return np.asarray(x0 + u * (v0 + u * (3 * (x1 - x0) - 2 * v0 - v1 + u * (2 * (x0 - x1) + v0 + v1))))


def _free_part(
    time: NDArray[np.float64], position: NDArray[np.float64], resolution: float
) -> tuple[slice, float, NDArray[np.float64]]:
    """Return which samples swing freely, the centre they swing about, and when they cross it."""
    tail = position[-max(1, len(position) // 10) :]
    centre = float((tail.max() + tail.min()) / 2)
    off = position - centre
    far = int(np.argmax(np.abs(off)))
    reach = abs(off[far])
    if reach < 20 * resolution:
        raise DataError("the mass was not moved", "ring-down", "displace it by a few millimetres and release it")
    sides = np.sign(off) * (np.abs(off) > max(2 * resolution, 0.002 * reach))
    after = sides[far:]
    known = np.flatnonzero(after)
    flips = known[1:][np.diff(after[known]) != 0] + far
    if len(flips) < FEWEST_SWINGS:
        what = f"{len(flips)} half-swings are too few to separate friction from damping"
        raise DataError(what, "ring-down", "displace it farther, lift it off the belt, or record longer (--duration)")
    let_go = far + int(np.flatnonzero(np.abs(off[far : flips[0]]) >= RELEASED * reach)[-1])
    crossings = np.array([_crossing(time, off, int(flip)) for flip in flips])
    # The last swing is fitted to its turning point: on the way to rest friction is no longer that of sliding.
    moving = np.flatnonzero(np.diff(position))[-1] + 1
    last = flips[-1] + int(np.argmax(np.abs(off[flips[-1] : moving + 1])))
    stop = min(int(last) + 1, len(position))
    return slice(let_go, stop), centre, crossings


def _crossing(time: NDArray[np.float64], off: NDArray[np.float64], flip: int) -> float:
    """Return when the centre was crossed before sample ``flip``, by the line between the samples beside it."""
    before = flip - 1
    while before > 0 and off[before] * off[flip] > 0:
        before -= 1
    share = off[before] / (off[before] - off[flip]) if off[before] != off[flip] else 0.0
    return float(time[before] + share * (time[flip] - time[before]))


def _guess(
    t: NDArray[np.float64], x: NDArray[np.float64], centre: float, crossings: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return a start for the fit: omega from the crossings, damping and friction from how the peaks shrink."""
    w = math.pi / float(np.median(np.diff(crossings)))
    edges = np.searchsorted(t, [0.0, *crossings, t[-1] + 1])
    peaks = np.array([np.max(np.abs(x[i:j] - centre)) for i, j in pairwise(edges.tolist()) if j > i])
    ratio, loss = 1.0, 0.0
    if len(peaks) >= 3:
        # peak' = r peak - a (1 + r), for each half-swing
        ratio, loss = np.polyfit(peaks[:-1], peaks[1:], 1)
    if not 0.3 < ratio <= 1.0:
        ratio, loss = 1.0, -float(np.mean(-np.diff(peaks)))
    zeta = max(1e-5, -math.log(ratio) / math.pi)
    a = max(1e-6 * peaks[0], -loss / (1 + ratio))
    few = slice(0, max(4, int(0.1 / w / max(1e-9, float(np.median(np.diff(t)))))))
    v, at = np.polyfit(t[few], x[few], 1)
    return np.array([w, zeta, a, centre, at, v, 0.0])


@dataclass(frozen=True)
class _Solved:
    theta: NDArray[np.float64]
    sd: NDArray[np.float64]
    rms: float
    autocorrelation_time: float


def _solve(
    t: NDArray[np.float64],
    x: NDArray[np.float64],
    starts: list[NDArray[np.float64]],
    resolution: float,
    weakening: bool,
) -> _Solved:
    """Least squares, with ``weakening`` also of g, from one start after the other until one reaches the noise."""
    from scipy.optimize import least_squares

    start = starts[0]
    reach = float(np.max(np.abs(x - start[3])))
    scale = np.array([start[0] * 1e-2, 1e-2, 1e-2 * reach, 1e-2 * reach, 1e-2 * reach, 1e-2 * reach * start[0], 1.0])
    scale[6] = 1.0 / (reach * start[0])
    free = 7 if weakening else 6

    def model(theta: NDArray[np.float64]) -> NDArray[np.float64]:
        w, zeta, a, rest, x0, v0 = theta[:6]
        g = abs(theta[6]) if weakening else 0.0
        return motion(t, abs(w), min(abs(zeta), 0.9), abs(a), rest, x0, v0, g)

    def misfit(p: NDArray[np.float64]) -> NDArray[np.float64]:
        return model(np.concatenate((p * scale[:free], np.zeros(7 - free)))) - x

    best = None
    n = len(x)
    for begin in starts:
        solution = least_squares(misfit, (begin / scale)[:free], method="lm", diff_step=[1e-4], max_nfev=25 * free)
        if best is None or solution.cost < best.cost:
            best = solution
        if 2 * best.cost < n * (NOISE_FLOOR * resolution) ** 2:
            break
    if best is None:
        raise ValueError("no start was given")
    theta = np.concatenate((best.x * scale[:free], np.zeros(7 - free)))
    theta[[0, 1, 2, 6]] = np.abs(theta[[0, 1, 2, 6]])
    residual = best.fun
    tau = autocorrelation_time([residual - residual.mean()])
    variance = float(residual @ residual) / max(1, n - free) * tau
    jacobian = np.asarray(best.jac, dtype=np.float64)
    covariance = np.linalg.pinv(jacobian.T @ jacobian) * variance
    sd = np.concatenate((np.sqrt(np.diag(covariance)) * scale[:free], np.zeros(7 - free)))
    return _Solved(theta, sd, math.sqrt(float(residual @ residual) / n), tau)
