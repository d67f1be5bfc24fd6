"""Fit of a ring-down: omega0, damping and friction of a mass that was displaced and released, with the belt at rest.

Model, with v = dx/dt and beta = zeta omega0::

    x'' = -omega0^2 (x - rest) - 2 beta v - omega0^2 a sgn(v) / (1 + g |v|)

Viscous damping reduces the swings by a ratio, friction of the contact by a length (4 a per period); both are fitted
together, because either alone would absorb the other.  ``a`` is the friction as a length, F/k, and ``g`` its rate of
weakening with speed; ``g`` is fitted only if it lowers chi square enough (`LEAST_GAIN`).  Friction proportional to the
speed cannot be distinguished from damping: its slope is part of the fitted damping.

The fit extends from shortly after the release of the mass to its last turning point before it rests.  A count is the
middle of its cell, (n + 1/2).  Standard deviations are those of least squares, times the root of the integrated
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
RELEASED = 0.97  # share of the first amplitude below which the mass is taken as released; chosen by judgement
STEP = 0.03  # rad, between nodes; where friction weakens the error falls as its square
STEP_ERROR = 1e-5  # relative error of omega, where friction weakens within a step
MOST_NODES = 400_000
MOST_SAMPLES = 6000  # fitted; more add little
LEAST_GAIN = 12.0  # fall of chi square by adding g: a likelihood ratio test, chi2 with 1 degree of freedom at 0.05 %
NOISE_FLOOR = 0.32  # counts: the residual of counting alone is 1 / sqrt(12)
POOR_FIT = 0.002  # residual rms over first amplitude, above which the model is rejected; chosen by judgement


@dataclass(frozen=True)
class RingDown:
    """Result of a ring-down; lengths in the unit of the positions, here called u."""

    omega0: Measured  # undamped angular frequency, rad/s
    zeta: Measured  # damping over critical damping
    friction: Measured  # friction at low speed over stiffness, u
    velocity_weakening: Measured | None  # g, s/u; None if constant friction describes the motion
    equilibrium: Measured  # the spring's rest position, u
    rms: float  # of the residuals, u
    amplitude: float  # at the release, u
    swings: int  # half-swings fitted
    samples: int  # samples fitted
    poor: bool  # whether the model does not describe the motion, so that the values mean little


def fit_ring_down(time: NDArray[np.float64], position: NDArray[np.float64], resolution: float) -> RingDown:
    """Fit the model to a recording with one ring-down.

    ``time`` and ``position``, (n,), are in s and u.  Before the release the mass may be moved or held; after it has
    come to rest it must not be touched.  ``resolution`` is one count, u.  Raises DataError if the record contains no
    ring-down, or too few swings of one.
    """
    free, centre, crossings = _find_free_part(time, position, resolution)
    thin = max(1, (free.stop - free.start) // MOST_SAMPLES)
    t, x = (time[free] - time[free.start])[::thin], position[free][::thin]
    start = _estimate_start(t, x, centre, crossings - time[free.start])
    best = first = _fit_least_squares(t, x, [start], resolution, weakening=False)
    # Friction that weakens is fitted from both starts, at speeds near and far below the fastest; with g it must start
    # larger, so that the loss over a swing stays about the same.
    fastest = start[0] * float(np.max(np.abs(x - centre)))
    trials = [(guess, g, fastest) for g in (2.0, 20.0, 0.2) for guess in (first.theta, start)]
    starts = [guess * (1, 1, 1 + g / 2, 1, 1, 1, 0) + (0, 0, 0, 0, 0, 0, g / unit) for guess, g, unit in trials]
    second = _fit_least_squares(t, x, starts, resolution, weakening=True)
    gain = (first.rms / max(second.rms, 1e-3 * resolution)) ** 2 - 1
    if gain * len(t) / second.autocorrelation_time > LEAST_GAIN and second.theta[6] > 2 * second.sd[6]:
        best = second
    amplitude = float(np.max(np.abs(x - centre)))
    half_count = 0.5 * resolution / len(crossings)  # error of a loss per swing from half a count at either end
    share = half_count / amplitude / math.pi
    stepping = 0.0 if best is first else STEP_ERROR
    least = np.array([math.hypot(share, stepping) * best.theta[0], share, half_count, 0.5 * half_count, 0.0, 0.0, 0.0])
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


def predict_motion(
    t: NDArray[np.float64], omega0: float, zeta: float, a: float, rest: float, x: float, v: float, g: float = 0.0
) -> NDArray[np.float64]:
    """Return the model's positions at times ``t`` (increasing from 0), from x and v at time 0; it may come to rest.

    Between nodes friction is constant and the flow exact: for g = 0 there is no error, otherwise it falls as `STEP`^2.
    """
    times, xs, vs = np.empty((3, MOST_NODES))
    times[0], xs[0], vs[0] = 0.0, x, v
    run = compiled(swing_kernel.follow, KERNELS)
    nodes = run(float(t[-1]), STEP / omega0, omega0, zeta, a, g, rest, times, xs, vs)
    return _interpolate_hermite(t, times[:nodes], xs[:nodes], vs[:nodes])


def _interpolate_hermite(
    t: NDArray[np.float64], times: NDArray[np.float64], xs: NDArray[np.float64], vs: NDArray[np.float64]
) -> NDArray[np.float64]:
    node = np.clip(np.searchsorted(times, t, side="right") - 1, 0, len(times) - 2)
    h = times[node + 1] - times[node]
    u = (t - times[node]) / h
    x0, x1, v0, v1 = xs[node], xs[node + 1], vs[node] * h, vs[node + 1] * h
    return np.asarray(x0 + u * (v0 + u * (3 * (x1 - x0) - 2 * v0 - v1 + u * (2 * (x0 - x1) + v0 + v1))))


def _find_free_part(
    time: NDArray[np.float64], position: NDArray[np.float64], resolution: float
) -> tuple[slice, float, NDArray[np.float64]]:
    """Return the slice of samples that swing freely, the centre of the swing, and the times of crossing it."""
    tail = position[-max(1, len(position) // 10) :]
    centre = float((tail.max() + tail.min()) / 2)
    deviation = position - centre
    farthest = int(np.argmax(np.abs(deviation)))
    reach = abs(deviation[farthest])
    if reach < 20 * resolution:
        raise DataError("the mass was not moved", "ring-down", "displace the mass by a few millimetres and release it")
    sides = np.sign(deviation) * (np.abs(deviation) > max(2 * resolution, 0.002 * reach))
    after = sides[farthest:]
    nonzero = np.flatnonzero(after)
    side_changes = nonzero[1:][np.diff(after[nonzero]) != 0] + farthest
    if len(side_changes) < FEWEST_SWINGS:
        what = f"{len(side_changes)} half-swings are too few to separate friction from damping"
        raise DataError(
            what, "ring-down", "displace the mass farther, lift it off the belt, or record longer (--duration)"
        )
    let_go = farthest + int(np.flatnonzero(np.abs(deviation[farthest : side_changes[0]]) >= RELEASED * reach)[-1])
    crossings = np.array([_find_crossing(time, deviation, int(flip)) for flip in side_changes])
    # The last swing is fitted to its turning point: on the way to rest friction is no longer that of sliding.
    moving = np.flatnonzero(np.diff(position))[-1] + 1
    last = side_changes[-1] + int(np.argmax(np.abs(deviation[side_changes[-1] : moving + 1])))
    stop = min(int(last) + 1, len(position))
    return slice(let_go, stop), centre, crossings


def _find_crossing(time: NDArray[np.float64], deviation: NDArray[np.float64], after: int) -> float:
    """Return when the centre was crossed before sample ``after``, by linear interpolation."""
    before = after - 1
    while before > 0 and deviation[before] * deviation[after] > 0:
        before -= 1
    share = deviation[before] / (deviation[before] - deviation[after]) if deviation[before] != deviation[after] else 0.0
    return float(time[before] + share * (time[after] - time[before]))


def _estimate_start(
    t: NDArray[np.float64], x: NDArray[np.float64], centre: float, crossings: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return a start for the fit: omega from the crossings, damping and friction from the decrease of the peaks."""
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
    beginning = slice(0, max(4, int(0.1 / w / max(1e-9, float(np.median(np.diff(t)))))))
    v, x0 = np.polyfit(t[beginning], x[beginning], 1)
    return np.array([w, zeta, a, centre, x0, v, 0.0])


@dataclass(frozen=True)
class _Solution:
    theta: NDArray[np.float64]
    sd: NDArray[np.float64]
    rms: float
    autocorrelation_time: float


def _fit_least_squares(
    t: NDArray[np.float64],
    x: NDArray[np.float64],
    starts: list[NDArray[np.float64]],
    resolution: float,
    weakening: bool,
) -> _Solution:
    """Fit by least squares, with ``weakening`` also g, from each start until one reaches the noise."""
    from scipy.optimize import least_squares

    start = starts[0]
    reach = float(np.max(np.abs(x - start[3])))
    scale = np.array([start[0] * 1e-2, 1e-2, 1e-2 * reach, 1e-2 * reach, 1e-2 * reach, 1e-2 * reach * start[0], 1.0])
    scale[6] = 1.0 / (reach * start[0])
    free = 7 if weakening else 6

    def model(theta: NDArray[np.float64]) -> NDArray[np.float64]:
        w, zeta, a, rest, x0, v0 = theta[:6]
        g = abs(theta[6]) if weakening else 0.0
        return predict_motion(t, abs(w), min(abs(zeta), 0.9), abs(a), rest, x0, v0, g)

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
        raise ValueError("no initial values were given")
    theta = np.concatenate((best.x * scale[:free], np.zeros(7 - free)))
    theta[[0, 1, 2, 6]] = np.abs(theta[[0, 1, 2, 6]])
    residual = best.fun
    tau = autocorrelation_time([residual - residual.mean()])
    variance = float(residual @ residual) / max(1, n - free) * tau
    jacobian = np.asarray(best.jac, dtype=np.float64)
    covariance = np.linalg.pinv(jacobian.T @ jacobian) * variance
    sd = np.concatenate((np.sqrt(np.diag(covariance)) * scale[:free], np.zeros(7 - free)))
    return _Solution(theta, sd, math.sqrt(float(residual @ residual) / n), tau)
