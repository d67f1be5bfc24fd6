"""Starting values: the smoothed acceleration of the slips regressed on position and slip speed.

    a = -K (x - b) + f(s),   s = v_dr - v > 0,   K = k/m,   f = F/m

Samples within half a smoothing window of a corner are left out: smoothing rounds the corners, and with them in, gamma
comes out 7 % low at a window of 61 samples and half its value at 201.  Good enough to start from, not to judge by.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fitting.data.cycles import Cycle, CycleSegmentation
from fitting.data.frame import MeasuredMotion
from fitting.least_squares.linear import least_squares
from fitting.model.parameters import PER_RUN, Global, PerCycle, Values
from fitting.model.windows import ShootingWindows
from rig_sim.friction.curve import CONSTANT, HYPERBOLIC, LINEAR, magnitude
from stickslip.compute.arrays import Array
from stickslip.units import Measured

LOOSE_REST = 0.05  # error of a rest position over the travel: with a larger one it is also fitted
STEEPEST_LINE = 0.8  # fall over the level: a linear curve starts with friction left at the fastest slip
LEAST_SHAPE = 1e-3  # shape times the fastest slip: next to a constant
BREAK_AWAY_MARGIN = 0.1  # how far beyond the observed break-aways the level at rest may lie, over the travel
OVERTAKING_LEVEL = 0.9  # level over the load at landing: the friction level where the mass overtakes the belt
LEAST_LEVEL = 0.2  # least of that level, over Fs
STICK_SLOPE = 0.12  # slips: shortest stretch of stick whose slope is worth a fit


@dataclass(frozen=True, eq=False)
class SlipSamples:
    """The trimmed slip samples: position x (m), slip speed s (m/s), acceleration a (m/s^2), each (n,)."""

    x: Array
    s: Array
    a: Array


def slip_samples(motion: MeasuredMotion, cut: CycleSegmentation) -> SlipSamples:
    """Collect the samples of every slip, half a smoothing window away from its corners.

    Where the window is as long as all slips, the middle half.
    """
    s = motion.belt_speed - motion.velocity
    slips = s > 0.02 * motion.belt_speed
    begin = np.array([motion.time[cycle.slip[0]] for cycle in cut.used])
    landing = np.array([cycle.landing for cycle in cut.used])
    for margin in (np.full(begin.size, motion.half_window), (landing - begin) / 4):
        inside = np.zeros(motion.time.size, bool)
        for first, last in zip(begin + margin, landing - margin, strict=True):
            inside[slice(*np.searchsorted(motion.time, (first, last)))] = True
        keep = inside & slips
        if keep.any():
            break
    return SlipSamples(motion.position[keep], s[keep], motion.acceleration[keep])


def stick_velocity_line(motion: MeasuredMotion, cut: CycleSegmentation) -> tuple[float, float]:
    """Return velocity at the record's zero, m/s, and slope dv/dx, 1/s, of the plateaus.

    A jump contact sticks at the belt's speed (slope 0); on a ramp the slope is -d K/F. Without a plateau the slope is 0
    and the speed is the belt's first value.
    """
    rows: list[Array] = []
    for cycle in cut.used:
        i, j = cycle.stick
        if j - i and motion.time[j - 1] - motion.time[i] >= STICK_SLOPE * motion.slip_s:
            rows.append(np.c_[motion.position[i:j], motion.velocity[i:j]])
    if not rows:
        return motion.belt_speed, 0.0
    x, v = np.concatenate(rows).T
    middle = np.median(v)
    calm = np.abs(v - middle) < 0.5 * motion.belt_speed
    (level, slope), _ = least_squares(np.c_[np.ones_like(x[calm]), x[calm]], v[calm])
    return float(level), float(slope)


def break_away_position(motion: MeasuredMotion, cut: CycleSegmentation) -> float:
    """Return the median position at which the mass leaves the belt, m: an upper bound of datum + Fs/k."""
    return float(np.median(np.interp([cycle.break_away for cycle in cut.used], motion.time, motion.position)))


def regress_start(
    motion: MeasuredMotion,
    cut: CycleSegmentation,
    curve: int,
    ramp: bool,
    datum: Measured,
    drag: Callable[[Array], Array] | None = None,
) -> tuple[Values, float]:
    """Regress one law's starting values, and the size of a drag; damping, fade and belt variations are 0.

    A hyperbola determines a poorly known ``datum`` (m) by itself, since it falls towards zero. ``drag`` maps velocities
    (n,) to the acceleration of a unit, m/s^2.
    """
    samples = slip_samples(motion, cut)
    level, slope = stick_velocity_line(motion, cut)
    loose = datum.sd > LOOSE_REST * motion.travel
    besides, while_stuck = np.empty((samples.x.size, 0)), np.empty(0)
    if drag is not None:
        besides = drag(motion.belt_speed - samples.s)[:, np.newaxis]
        while_stuck = drag(np.array([motion.belt_speed]))
    v_dr, d, rest = motion.belt_speed, 0.0, datum.value
    if loose and curve == LINEAR:
        rest = _rest_by_scatter(motion, cut, rest)
    x_slip = break_away_position(motion, cut) + BREAK_AWAY_MARGIN * motion.travel
    friction = _Slips(samples, besides, while_stuck, x_slip)
    K, F, shape, rest, size = _curve(friction, curve, rest, d, v_dr, loose)
    if ramp:
        v_dr = level + slope * rest
        belt_slope = 0.0 if motion.compliance is None else motion.compliance.value
        d = float(np.clip((-slope - belt_slope) * F / K, 2e-3 * motion.belt_speed, 0.6 * motion.belt_speed))
        K, F, shape, rest, size = _curve(friction, curve, rest, d, v_dr, loose)
    return Values(K, F, v_dr, shape, d, rest), size


def cycle_starts(
    windows: ShootingWindows, motions: Sequence[MeasuredMotion], cycles: Sequence[Cycle], u: Array
) -> Array:
    """Return starts (cycles, 6) of the cycles' own unknowns at the smoothed motion, for shared ones u (13 runs,).

    Where the mass overtakes the belt, the new level is below the load at landing.
    """
    local = windows.starting_values(motions)
    for k, (cycle, run) in enumerate(zip(cycles, windows.run, strict=True)):
        if cycle.overtakes:
            motion, own = motions[run], u[PER_RUN * run :]
            load = own[Global.K] * (own[Global.DATUM] - float(np.interp(cycle.landing, motion.time, motion.position)))
            level = max(OVERTAKING_LEVEL * load / math.exp(own[Global.LOG_F]), LEAST_LEVEL)
            local[k, PerCycle.NEXT_LEVEL] = math.log(level)
    return local


def matched_curve(curve: int, other: int, F: float, shape: float, fastest: float) -> tuple[float, float]:
    """Return (F, shape) of a curve that equals another at a quarter and three quarters of ``fastest``, m/s."""
    s = np.array([0.25, 0.75]) * fastest
    near, far = magnitude(other, s, F, shape * F, shape)
    if curve == CONSTANT or not near > far > 0:
        return max(0.5 * float(near + far), 1e-3 * F), LEAST_SHAPE / fastest
    if curve == LINEAR:
        slope = (near - far) / (s[1] - s[0])
        level = near + slope * s[0]
        return float(level), float(min(slope / level, STEEPEST_LINE / fastest))
    gamma = (near - far) / max(far * s[1] - near * s[0], 1e-2 * near * s[0])
    return float(near * (1 + gamma * s[0])), float(gamma)


def with_static(curve: int, p: Values, static: float) -> Values:
    """Return a ramp law with another break-away level over Fs but the same friction in slip and slope in stick."""
    # With f the new F over the old and r the new static over the old, the slope in stick asks for d = r f p.d, and the
    # same friction in slip for f = 1 - shape (d - p.d), or 1/(1 + shape (d - p.d)).
    wide, steep = p.d * static / p.static, p.shape * p.d
    if curve == LINEAR:
        d = wide * (1 + steep) / (1 + p.shape * wide)
    elif curve == HYPERBOLIC:
        d = 2 * wide / (1 - steep + math.sqrt((1 - steep) ** 2 + 4 * p.shape * wide))
    else:
        d = wide
    f = d / wide
    F, shape = p.F * f, p.shape * (f if curve == HYPERBOLIC else 1 / f)
    return p._replace(F=F, shape=shape, d=d, static=static)


@dataclass(frozen=True, eq=False)
class _Slips:
    """The data of a regression.

    ``besides`` (n, k), k of 0 or 1, are accelerations of a drag, ``while_stuck`` (k,) those on the belt; the mass
    leaves the belt before ``x_slip``, m.
    """

    samples: SlipSamples
    besides: Array
    while_stuck: Array
    x_slip: float


def _curve(
    slips: _Slips, curve: int, datum: float, d: float, v_dr: float, loose: bool
) -> tuple[float, float, float, float, float]:
    """Return (K, F, shape, datum) of one slip curve and the size of the drag, or the kinematics' if absurd."""
    samples, besides = slips.samples, slips.besides
    x, s, a = samples.x - datum, np.maximum(samples.s - d, 0.0), samples.a
    one = np.ones_like(x)
    shape, shift = 0.0, 0.0
    if curve == LINEAR:
        (K, F, G, *_), _ = _solve(np.c_[-x, one, -s, besides], a)
        shape = float(np.clip(G / F if F > 0 else np.inf, 1e-3 / v_dr, STEEPEST_LINE / float(s.max())))
        (K, F, *size), _ = _solve(np.c_[-x, 1 - shape * s, besides], a)
    elif curve == HYPERBOLIC:
        best = np.inf
        K = F = -1.0
        size = [0.0]
        for gamma in np.geomspace(0.03, 300, 41) / v_dr:
            columns = np.c_[-x, 1 / (1 + gamma * s), besides]
            found, error = _solve(np.c_[columns, one] if loose else columns, a)
            if not (found[0] > 0 and found[1] > 0):
                continue
            own = found[2 : 2 + besides.shape[1]]
            level = found[1] + (found[-1] if loose else 0.0) + float(np.sum(own * slips.while_stuck))
            beyond = datum + level / found[0] > slips.x_slip
            if beyond and best < np.inf:  # the smallest gamma is kept if all are
                break
            if error < best:
                best, K, F, shape, size = error, float(found[0]), float(found[1]), float(gamma), list(own)
                shift = float(found[-1]) / K if loose else 0.0
    else:
        (K, F, *size), _ = _solve(np.c_[-x, one, besides], a)
    if not (K > 0 and F > 0 and math.isfinite(K + F)):
        # A regression pulled to nonsense by a wrong curve: take the spring from the largest deceleration instead.
        K = float(np.max(np.abs(a)) / max(np.ptp(x), 1e-12))
        F = max(K * float(np.max(x)), 1e-3 * float(np.max(np.abs(a))))
        size = [0.0]
    return float(K), float(F), float(shape), datum + shift, float(sum(size))


def _rest_by_scatter(motion: MeasuredMotion, cut: CycleSegmentation, otherwise: float) -> float:
    """Return the spring's rest position from the scatter of the levels, m.

    Cycle by cycle a = -K x + p - q s with p = level F + K b and q = level G: p against q is a line that meets q = 0 at
    K b. Needs three cycles whose levels differ; otherwise returns ``otherwise``.
    """
    rows = []
    for cycle in cut.used:
        one = slip_samples(motion, replace(cut, cycles=(cycle,)))
        if one.x.size > 20:
            (K, p, q), _ = _solve(np.c_[-one.x, np.ones_like(one.x), -one.s], one.a)
            if K > 0 and q > 0:
                rows.append((K, p, q))
    if len(rows) < 3:
        return otherwise
    K, p, q = np.array(rows).T
    # both have errors: the slope is the ratio of their spreads
    found = float((np.mean(p) - np.std(p) / max(float(np.std(q)), 1e-300) * np.mean(q)) / np.mean(K))
    return found if abs(found - otherwise) < 2 * motion.travel else otherwise


def _solve(matrix: Array, target: Array) -> tuple[Array, float]:
    found, residual = least_squares(matrix, target)
    return found, float(np.sum(residual**2))
