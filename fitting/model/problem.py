"""Starting values: the smoothed acceleration of the slips regressed on position and slip speed.

    a = -K (x - b) + f(s),   s = v_dr - v > 0,   K = k/m,   f = F/m

Samples within half a smoothing window of a corner are omitted.  Smoothing rounds the corners: with them, gamma is 7 %
too low at a window of 61 samples and half its value at 201.  The result is accurate enough for a start only.

The constants of a law's fit are its starting values, its bounds, and the calibrations as priors.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fitting.laws import Law
from fitting.least_squares.elimination import least_squares
from fitting.model import unknowns
from fitting.model.unknowns import PER_RUN, Global, PerCycle, Values
from fitting.model.windows import ShootingWindows, Thinning
from fitting.record.cycles import Cycle, CycleSegmentation
from fitting.record.motion import REST_SD, MeasuredMotion
from fitting.record.ripple import Ripple
from rig_sim.friction.curve import CONSTANT, HYPERBOLIC, LINEAR, magnitude
from rig_sim.friction.law import Law as Kind
from stickslip.compute.arrays import Array
from stickslip.units import Measured

LOOSE_REST = 0.05  # error of a rest position over the travel, above which the rest position is also fitted
STEEPEST_LINE = 0.8  # largest fall of a linear curve over its level, up to the fastest slip, in a start
LEAST_SHAPE = 1e-3  # smallest shape times the fastest slip: nearly constant
BREAK_AWAY_MARGIN = 0.1  # distance over the travel by which the level at rest may exceed the observed break-aways
OVERTAKING_LEVEL = 0.9  # level over the load at landing: the friction level where the mass overtakes the belt
LEAST_LEVEL = 0.2  # smallest value of that level, over Fs
STICK_SLOPE = 0.12  # slips: shortest stick whose slope is fitted


@dataclass(frozen=True, eq=False)
class SlipSamples:
    """The trimmed slip samples: position x (m), slip speed s (m/s), acceleration a (m/s^2), each (n,)."""

    x: Array
    s: Array
    a: Array


def slip_samples(motion: MeasuredMotion, cut: CycleSegmentation) -> SlipSamples:
    """Collect the samples of every slip, half a smoothing window away from its corners.

    If the window is as long as all slips, collect the middle half.
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
    inliers = np.abs(v - middle) < 0.5 * motion.belt_speed
    (level, slope), _ = least_squares(np.c_[np.ones_like(x[inliers]), x[inliers]], v[inliers])
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

    A hyperbola constrains a poorly known ``datum`` (m), since it falls towards zero. ``drag`` maps velocities
    (n,) to the acceleration of a unit, m/s^2.
    """
    samples = slip_samples(motion, cut)
    level, slope = stick_velocity_line(motion, cut)
    free_rest = datum.sd > LOOSE_REST * motion.travel
    drag_in_slip, drag_in_stick = np.empty((samples.x.size, 0)), np.empty(0)
    if drag is not None:
        drag_in_slip = drag(motion.belt_speed - samples.s)[:, np.newaxis]
        drag_in_stick = drag(np.array([motion.belt_speed]))
    v_dr, d, rest = motion.belt_speed, 0.0, datum.value
    if free_rest and curve == LINEAR:
        rest = _rest_by_scatter(motion, cut, rest)
    x_slip = break_away_position(motion, cut) + BREAK_AWAY_MARGIN * motion.travel
    friction = _Slips(samples, drag_in_slip, drag_in_stick, x_slip)
    K, F, shape, rest, size = _fit_slip_curve(friction, curve, rest, d, v_dr, free_rest)
    if ramp:
        v_dr = level + slope * rest
        belt_slope = 0.0 if motion.compliance is None else motion.compliance.value
        d = float(np.clip((-slope - belt_slope) * F / K, 2e-3 * motion.belt_speed, 0.6 * motion.belt_speed))
        K, F, shape, rest, size = _fit_slip_curve(friction, curve, rest, d, v_dr, free_rest)
    return Values(K, F, v_dr, shape, d, rest), size


def cycle_starts(
    windows: ShootingWindows, motions: Sequence[MeasuredMotion], cycles: Sequence[Cycle], u: Array
) -> Array:
    """Return starts (cycles, 6) of the cycles' own unknowns at the smoothed motion, for shared ones u (13 runs,).

    If the mass overtakes the belt, the new level is below the load at landing.
    """
    local = windows.starting_values(motions)
    for k, (cycle, run) in enumerate(zip(cycles, windows.run, strict=True)):
        if cycle.overtakes:
            motion, u_of_run = motions[run], u[PER_RUN * run :]
            landing = float(np.interp(cycle.landing, motion.time, motion.position))
            load = u_of_run[Global.K] * (u_of_run[Global.DATUM] - landing)
            level = max(OVERTAKING_LEVEL * load / math.exp(u_of_run[Global.LOG_F]), LEAST_LEVEL)
            local[k, PerCycle.NEXT_LEVEL] = math.log(level)
    return local


def matched_curve(curve: int, other: int, F: float, shape: float, fastest: float) -> tuple[float, float]:
    """Return (F, shape) of a curve equal to another at a quarter and three quarters of ``fastest``, m/s."""
    s = np.array([0.25, 0.75]) * fastest
    slow, fast = magnitude(other, s, F, shape * F, shape)
    if curve == CONSTANT or not slow > fast > 0:
        return max(0.5 * float(slow + fast), 1e-3 * F), LEAST_SHAPE / fastest
    if curve == LINEAR:
        slope = (slow - fast) / (s[1] - s[0])
        level = slow + slope * s[0]
        return float(level), float(min(slope / level, STEEPEST_LINE / fastest))
    gamma = (slow - fast) / max(fast * s[1] - slow * s[0], 1e-2 * slow * s[0])
    return float(slow * (1 + gamma * s[0])), float(gamma)


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

    ``drag_in_slip`` (n, k), k of 0 or 1, are accelerations of a drag, ``drag_in_stick`` (k,) those on the belt; the
    mass leaves the belt before ``x_slip``, m.
    """

    samples: SlipSamples
    drag_in_slip: Array
    drag_in_stick: Array
    x_slip: float


def _fit_slip_curve(
    slips: _Slips, curve: int, datum: float, d: float, v_dr: float, free_rest: bool
) -> tuple[float, float, float, float, float]:
    """Return (K, F, shape, datum) of a slip curve and the size of the drag, or an estimate if that is not physical."""
    samples, drag_in_slip = slips.samples, slips.drag_in_slip
    x, s, a = samples.x - datum, np.maximum(samples.s - d, 0.0), samples.a
    ones = np.ones_like(x)
    shape, shift = 0.0, 0.0
    if curve == LINEAR:
        (K, F, G, *_), _ = _solve(np.c_[-x, ones, -s, drag_in_slip], a)
        shape = float(np.clip(G / F if F > 0 else np.inf, 1e-3 / v_dr, STEEPEST_LINE / float(s.max())))
        (K, F, *size), _ = _solve(np.c_[-x, 1 - shape * s, drag_in_slip], a)
    elif curve == HYPERBOLIC:
        best = np.inf
        K = F = -1.0
        size = [0.0]
        for gamma in np.geomspace(0.03, 300, 41) / v_dr:
            columns = np.c_[-x, 1 / (1 + gamma * s), drag_in_slip]
            solution, error = _solve(np.c_[columns, ones] if free_rest else columns, a)
            if not (solution[0] > 0 and solution[1] > 0):
                continue
            drag = solution[2 : 2 + drag_in_slip.shape[1]]
            level = solution[1] + (solution[-1] if free_rest else 0.0) + float(np.sum(drag * slips.drag_in_stick))
            beyond_break_away = datum + level / solution[0] > slips.x_slip
            if beyond_break_away and best < np.inf:  # if all are beyond, the smallest gamma is used
                break
            if error < best:
                best, K, F, shape, size = error, float(solution[0]), float(solution[1]), float(gamma), list(drag)
                shift = float(solution[-1]) / K if free_rest else 0.0
    else:
        (K, F, *size), _ = _solve(np.c_[-x, ones, drag_in_slip], a)
    if not (K > 0 and F > 0 and math.isfinite(K + F)):
        # The regression with a wrong curve is not physical: take the spring from the largest deceleration instead.
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
        slips = slip_samples(motion, replace(cut, cycles=(cycle,)))
        if slips.x.size > 20:
            (K, p, q), _ = _solve(np.c_[-slips.x, np.ones_like(slips.x), -slips.s], slips.a)
            if K > 0 and q > 0:
                rows.append((K, p, q))
    if len(rows) < 3:
        return otherwise
    K, p, q = np.array(rows).T
    # both have errors: the slope is the ratio of their spreads
    rest = float((np.mean(p) - np.std(p) / max(float(np.std(q)), 1e-300) * np.mean(q)) / np.mean(K))
    return rest if abs(rest - otherwise) < 2 * motion.travel else otherwise


def _solve(matrix: Array, target: Array) -> tuple[Array, float]:
    solution, residual = least_squares(matrix, target)
    return solution, float(np.sum(residual**2))


# Samples a slip of a thinned record, used for searches and scans since residuals are correlated over many samples.
# With half as many the shortest wavelengths blur, twice as many take twice the time.  A stick has no more samples: one
# 10 times as long as its slip took nearly all the time.
COARSE_SAMPLES = 62.5
DEFAULT_DAMPING_SD = 0.01  # standard deviation of the damping over the critical one, when no ring-down was recorded
LEAST_LINEAR_FRICTION = 0.97  # largest fall of the linear curve at the fastest slip, over the level
RIPPLE_AMPLITUDE_SD = 0.2  # error over the amplitude, as estimated from the sticks
RIPPLE_FREQUENCY_SD = 0.1  # periods in the time that it was estimated from: further away are other minima
LARGEST_LOG_DROP = 30.0  # log: below this there is no friction, and the exponential does not underflow
LARGEST_STATIC = 5.0  # break-away level over Fs: dry contacts have 1 to 2
# Scatter of the levels' prior over their scatter, without a datum.  A narrower prior would bias the datum, since a
# larger Fs makes the relative scatter smaller.  On camera tracks with 1 mm of noise d of law 4 is 1 to 2 standard
# errors too large.  Twice the limit halves that, but then, as at 25, some levels of a ramp end in another minimum.
LOOSE_LEVELS = 5.0
FIRST_RAMP = 1e-4  # width over the belt's speed, of a ramp law that starts from its jump law
NARROWEST_RAMP = 1e-6  # smallest width over the belt's speed


HELD_SD = 1e-6  # standard deviation of a fixed unknown, over its size


class UserValue(NamedTuple):
    """The user's bounds, equal where it is fixed, and first value of a shared unknown."""

    slot: Global
    low: float
    high: float
    start: float | None


@dataclass(frozen=True, eq=False)
class Run:
    """One record in the fit's frame, its cycles (unflagged ones are fitted), its ripple, the user's values by law."""

    motion: MeasuredMotion
    cut: CycleSegmentation
    ripple: Ripple | None = None
    user_values: Mapping[str, tuple[UserValue, ...]] = field(default_factory=dict)

    @cached_property
    def windows(self) -> ShootingWindows:
        """The windows of every sample: all laws have the same."""
        return ShootingWindows.from_cycles(self.motion, self.cut.used)


@dataclass(frozen=True, eq=False)
class EstimationProblem:
    """Constants of a law's passes; arrays over the unknowns of all runs unless said otherwise."""

    law: Law
    runs: tuple[Run, ...]
    active: tuple[int, ...]
    start: Array
    lower: Array
    upper: Array
    prior: Array
    precision: Array

    @classmethod
    def build(cls, law: Law, runs: Sequence[Run]) -> "EstimationProblem":
        """Regress the start and turn the calibrations into priors.

        Several runs start from the median regression of the contact.
        """
        kind = law.kind
        motions = tuple(run.motion for run in runs)
        first, _ = _regress_runs(kind, runs)
        K, first_shape = first[0].K, first[0].shape
        omega = math.sqrt(K)
        damping = damping_calibration(motions[0], K)
        speed = min(motion.belt_speed for motion in motions)
        steepest = np.inf
        if kind.curve == "linear":  # beyond Fs/G_slip friction would be negative
            steepest = LEAST_LINEAR_FRICTION / max(float(np.max(m.belt_speed - m.velocity)) for m in motions)
        start, lower, upper, prior, precision = np.zeros((5, len(runs), PER_RUN))
        lower[:], upper[:] = -np.inf, np.inf
        upper[:, Global.SHAPE] = steepest
        for r, (run, regression) in enumerate(zip(runs, first, strict=True)):
            motion, ripple, v = run.motion, run.ripple, run.motion.belt_speed
            datum, belt, compliance = rest_calibration(run), motion.belt_prior, motion.compliance
            # Constant friction constrains only datum + Fs/k: the scatter of levels must not separate the two.
            datum_sd = 0.0 if kind.curve == "constant" else datum.sd
            calibrations = {
                Global.DATUM: (datum.value, _precision(datum_sd, 1e-6 * motion.travel)),
                Global.DAMPING: (damping.value, _precision(damping.sd, 1e-6 * omega)),
            }
            begin = regression._replace(shape=min(first_shape, steepest), damping=damping.value)
            if belt is not None and belt.sd > 0:
                calibrations[Global.V_DR] = belt.value, _precision(belt.sd, 0.0)
            if kind.curve == "constant" and not run.cut.shows_belt:  # slips do not depend on them
                calibrations[Global.D] = 0.0, v**-2
                calibrations.setdefault(Global.V_DR, (v, v**-2))
            if compliance is not None:
                begin = begin._replace(compliance=compliance.value)
                calibrations[Global.COMPLIANCE] = compliance.value, _precision(compliance.sd, 0.0)
            if ripple is not None:
                begin = begin._replace(cosine=ripple.cosine, sine=ripple.sine, omega=ripple.omega)
                spread = (RIPPLE_AMPLITUDE_SD * ripple.amplitude) ** -2
                calibrations[Global.COSINE], calibrations[Global.SINE] = (ripple.cosine, spread), (ripple.sine, spread)
                calibrations[Global.OMEGA] = ripple.omega, (RIPPLE_FREQUENCY_SD * 2 * math.pi / ripple.seen_s) ** -2
            for slot, (value, weight) in calibrations.items():
                prior[r, slot], precision[r, slot] = value, weight
            start[r] = unknowns.to_array(begin)
            lowest = start[r, Global.LOG_F] - LARGEST_LOG_DROP
            lower[r, : Global.DATUM] = 1e-6 * K, lowest, 0.05 * v, 0, NARROWEST_RAMP * speed
            lower[r, [Global.DAMPING, Global.OMEGA]] = 0.0
            lower[r, Global.STATIC], upper[r, Global.STATIC] = 1.0, LARGEST_STATIC
            lower[r, Global.COMPLIANCE] = NARROWEST_RAMP * v / motion.travel
        return cls(
            law=law,
            runs=tuple(runs),
            active=unknowns.active_places(
                kind, [motion.compliance is not None for motion in motions], [run.ripple is not None for run in runs]
            ),
            start=start.ravel(),
            lower=lower.ravel(),
            upper=upper.ravel(),
            prior=prior.ravel(),
            precision=precision.ravel(),
        ).with_user_values()

    def with_user_values(self) -> "EstimationProblem":
        """Return the problem with the user's values of its law's shared unknowns."""
        if not any(run.user_values.get(self.law.name) for run in self.runs):
            return self
        start, lower, upper, prior, precision = (
            array.copy() for array in (self.start, self.lower, self.upper, self.prior, self.precision)
        )
        for number, run in enumerate(self.runs):
            sizes = _sizes(run.motion, float(self.start[PER_RUN * number + Global.K]))
            for value in run.user_values.get(self.law.name, ()):
                place = PER_RUN * number + value.slot
                lower[place], upper[place] = max(lower[place], value.low), min(upper[place], value.high)
                first = start[place] if value.start is None else value.start
                if value.low == value.high:
                    lower[place] = upper[place] = first = prior[place] = value.low
                    precision[place] = (HELD_SD * sizes[value.slot]) ** -2.0
                start[place] = min(max(first, lower[place]), upper[place])
        return replace(self, start=start, lower=lower, upper=upper, prior=prior, precision=precision)

    @property
    def fixed(self) -> NDArray[np.bool_]:
        """The fixed unknowns of all runs."""
        return np.asarray(self.lower == self.upper)

    def with_overtaking(self, overtaking: NDArray[np.bool_]) -> "EstimationProblem":
        """Return the problem with these cycles (cycles,) marked as overtaking the belt after landing."""
        flags = iter(overtaking)
        runs = []
        for run in self.runs:
            cycles = [
                cycle if cycle.flag else replace(cycle, overtakes=bool(next(flags)) or cycle.overtakes)
                for cycle in run.cut.cycles
            ]
            runs.append(replace(run, cut=replace(run.cut, cycles=tuple(cycles))))
        return replace(self, runs=tuple(runs))

    def start_with_drag(self, drag: Callable[[Array], Array]) -> tuple[Array, float]:
        """Return other starting values (13 runs,), regressed together with a drag, and its size."""
        first, size = _regress_runs(self.law.kind, self.runs, drag)
        start = self.start.copy()
        for u_of_run, p in zip(start.reshape(-1, PER_RUN), first, strict=True):
            u_of_run[: Global.DATUM + 1] = unknowns.to_array(p)[: Global.DATUM + 1]
        return np.clip(start, self.lower, self.upper), size

    def start_near(self, other: Law, u: Array) -> Array:
        """Return the unknowns (13 runs,) of this law that are nearest to the fit u of another law.

        A new ramp is very narrow; another curve has the same friction at two slip speeds.
        """
        start, kind, other_kind = u.copy(), self.law.kind, other.kind
        if kind.ramp and not other_kind.ramp:
            start[Global.D :: PER_RUN] = FIRST_RAMP * min(motion.belt_speed for motion in self.motions)
            start[Global.STATIC :: PER_RUN] = 1.0
        elif other_kind.ramp and not kind.ramp:
            start[Global.D :: PER_RUN], start[Global.STATIC :: PER_RUN] = self.start[Global.D :: PER_RUN], 1.0
        if kind.curve_code != other_kind.curve_code:
            fastest = max(float(np.max(motion.belt_speed - motion.velocity)) for motion in self.motions)
            p = unknowns.values(u[:PER_RUN])
            F, shape = matched_curve(kind.curve_code, other_kind.curve_code, p.F, p.shape, fastest)
            start[Global.LOG_F :: PER_RUN], start[Global.SHAPE :: PER_RUN] = math.log(F), shape
        return np.where(self.fixed, self.start, start)

    def windows(self, *, thinned: bool) -> ShootingWindows:
        """Return the windows of all runs, of every sample or thinned (`thinned_to`)."""
        if not thinned:
            return ShootingWindows.join([run.windows for run in self.runs])
        return ShootingWindows.join(
            [
                ShootingWindows.from_cycles(run.motion, run.cut.used, thinning)
                for run, thinning in zip(self.runs, self.thinning, strict=True)
            ]
        )

    @property
    def thinning(self) -> list[Thinning]:
        return [choose_thinning(run) for run in self.runs]

    @property
    def ramp(self) -> bool:
        return self.law.ramp

    @property
    def level_prior(self) -> float:
        """Standard deviation of the prior of the friction levels, in standard deviations of their scatter.

        Under constant friction the datum is fixed, so that levels cannot bias it.
        """
        guessed = any(motion.datum_prior is None for motion in self.motions)
        return LOOSE_LEVELS if guessed and self.law.kind.curve != "constant" else 1.0

    @property
    def motions(self) -> tuple[MeasuredMotion, ...]:
        return tuple(run.motion for run in self.runs)

    @property
    def cycles(self) -> tuple[Cycle, ...]:
        return tuple(cycle for run in self.runs for cycle in run.cut.used)


def _regress_runs(
    kind: Kind, runs: Sequence[Run], drag: Callable[[Array], Array] | None = None
) -> tuple[list[unknowns.Values], float]:
    """Return each run's regression, with the medians of the contact, and the median size of a drag."""
    fits = [
        regress_start(run.motion, run.cut, kind.curve_code, bool(kind.ramp), rest_calibration(run), drag)
        for run in runs
    ]
    contact = {name: float(np.median([getattr(start, name) for start, _ in fits])) for name in ("K", "F", "shape", "d")}
    return [start._replace(**contact) for start, _ in fits], float(np.median([size for _, size in fits]))


def choose_thinning(run: Run) -> Thinning:
    """Return the thinning of a run: `COARSE_SAMPLES` a slip, also in a stick unless its belt ripples."""
    motion = run.motion
    stride = max(1, round(motion.time.size / motion.span * motion.slip_s / COARSE_SAMPLES))
    return Thinning(stride, COARSE_SAMPLES if run.ripple is None else math.inf)


def rest_calibration(run: Run, sd: float = REST_SD) -> Measured:
    """Return the spring's rest position, m; without a calibration an assumed one, to ``sd`` travels.

    The assumed one is the first position of a record that begins at rest below the middle of the motion, else the
    lowest position: friction is then nowhere negative.  Laws 1 and 3 constrain only datum + Fs/k, so a prior is needed.
    """
    motion = run.motion
    if motion.datum_prior is not None:
        return motion.datum_prior
    lowest, highest = float(motion.position.min()), float(motion.position.max())
    first = float(motion.position[0])
    released = run.cut.starts_at_rest and first < 0.5 * (lowest + highest)
    return Measured(first if released else lowest, sd * motion.travel)


def damping_calibration(motion: MeasuredMotion, K: float) -> Measured:
    """Return c/m, 1/s: from the ring-down, or 0 +- a hundredth of the critical damping."""
    stated = motion.damping_prior
    mass = motion.mass.value if motion.mass else motion.stiffness.value / K if motion.stiffness else None
    if stated is None or mass is None:
        return Measured(0.0, DEFAULT_DAMPING_SD * 2 * math.sqrt(K))
    return Measured(stated.value / mass, stated.sd / mass)


def _sizes(motion: MeasuredMotion, K: float) -> dict[Global, float]:
    """Return the natural sizes of the unknowns."""
    v, omega = motion.belt_speed, math.sqrt(K)
    sizes = {Global.K: K, Global.LOG_F: 1.0, Global.V_DR: v, Global.SHAPE: 1 / v, Global.D: v, Global.STATIC: 1.0}
    return sizes | {Global.DATUM: motion.travel, Global.DAMPING: omega}


def _precision(sd: float, exact: float) -> float:
    """Return 1/sd^2; a calibration without an error has the error ``exact``."""
    return 1 / max(sd, exact) ** 2 if max(sd, exact) > 0 else 0.0
