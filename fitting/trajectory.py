"""One law fitted to the measured positions of every window at once: multiple shooting on the exact flow.

Shared by all windows: k/m, Fs/m, belt speed, the curve's shape, the ramp's half-width, the spring's rest position,
the damping, how fast the contact wears, and how much the belt gives under load.  Each cycle has six unknowns of its
own: where its slip window starts (x, v), its kinetic level, the level after the next landing, and where its stick
window starts (x, v).  The levels are factors whose logarithms have mean 0; their prior carries their own scatter, so
that Fs/m means the mean level and its interval the error of that mean.

The noise of a position is not white: a law that is slightly wrong errs for many samples in a row.  Residuals therefore
count with sigma^2 = mean square x correlation time, found from the fit before, and a cycle that fits far worse than
the others (a kick, lost counts) counts less.
"""

import math
import time as clock
from dataclasses import dataclass, replace

import numpy as np

from daq.rig import Measured
from fitting import regression, schur
from fitting.motion import Array, Motion
from fitting.prediction import Windows, evaluator
from fitting.windows import Cut, Cycle
from rig_sim.friction.law import LAWS

# Order of the shared unknowns, and of a cycle's own.
K, LOG_F, V_DR, SHAPE, D, DATUM, DAMPING, WEAR, GIVE = range(9)
UNKNOWNS = 9
X_SLIP, V_SLIP, LEVEL, NEXT_LEVEL, X_STICK, V_STICK = range(6)

UNKNOWN_DAMPING = 0.01  # of the critical one: one standard deviation when no ring-down was recorded
FIRST_SCATTER = 0.1  # standard deviation of the levels before the fit has seen them
OVERTAKING_LEVEL = 0.9  # of the load at landing: the first guess of the level where the mass overtakes the belt
FIRST_SIGMA = 10.0  # of the resolution: nearly any misfit outweighs the calibrations in the first pass
STILL_FRICTION = 0.97  # of the fastest slip: how close the linear curve may come to zero
NO_RAMP = 1e-6  # of the belt's speed: a narrower ramp is a jump
NARROW = 0.02  # of the belt's speed: the second start of a ramp law
COARSE_HZ = 125.0  # residuals are correlated over many samples: the search runs on a thinned record
PASSES = ((30, 1e-3), (15, 1e-4), (10, 1e-4))  # most steps of each, and the gain at which it stops
LONG_PASSES = ((200, 1e-5), (30, 1e-4), (10, 1e-4))  # without a datum: down a long bent valley, datum against Fs
WEAR_PASS = (15, 1e-4)
FINE_PASS = (5, 1e-5)


@dataclass(frozen=True, eq=False)
class Fit:
    """One law fitted to one record, per unit mass and in the fit's frame.

    Attributes
    ----------
    law : int
    u : (9,) f8
        K = k/m (1/s^2), log of F = Fs/m (m/s^2), v_dr (m/s), shape (gamma or G_slip/Fs, s/m), d (m/s), datum (m),
        c/m (1/s), wear (fraction of the level lost per second), give (belt speed lost
        per metre of spring stretch, 1/s).
    active : tuple of int
        Which of them this law has.
    local : (cycles, 6) f8
    residual : (N,) f8
        Model minus measurement, m, cycle by cycle.
    rows : tuple of slice
        The residuals of each cycle.
    cycle_rms : (cycles,) f8
        m.
    sigma : float
        Effective standard deviation of one residual, m: rms x sqrt(correlation time in samples).
    deviations : (p,) f8
        How far the active unknowns are from their calibrations, in standard deviations; 0 where there is none.
    solution : Solution
        In the active unknowns only.
    precision : (p,) f8
        1/sd^2 of the calibrations, for the active unknowns.
    windows : Windows
    cycles : tuple of Cycle
    state : State
        Where the last pass ended.
    outcome : str
    cpu_s : float
    """

    law: int
    u: Array
    active: tuple[int, ...]
    local: Array
    residual: Array
    rows: tuple[slice, ...]
    cycle_rms: Array
    sigma: float
    deviations: Array
    solution: schur.Solution
    precision: Array
    windows: Windows
    cycles: tuple[Cycle, ...]
    state: "State"
    outcome: str
    cpu_s: float

    @property
    def rms(self) -> float:
        """Root mean square of all residuals, m."""
        return float(np.sqrt(np.mean(self.residual**2)))

    @property
    def free(self) -> int:
        """Number of the law's own shared unknowns; what every law has besides (datum, damping, wear, give) not."""
        return sum(index not in (DATUM, DAMPING, WEAR, GIVE) for index in self.active)


def active_unknowns(law: int, give: Measured | None = None) -> tuple[int, ...]:
    """Return the shared unknowns that a law has on a belt that gives way, or on a stiff one (None)."""
    kind = LAWS[law]
    shape = () if kind.curve == "constant" else (SHAPE,)
    ramp = () if kind.contact == "jump" else (D,)
    return (K, LOG_F, V_DR, *shape, *ramp, DATUM, DAMPING, WEAR, *(() if give is None else (GIVE,)))


def datum_guess(motion: Motion) -> Measured:
    """Return what is known of the spring's rest position: the calibration, or the middle of the motion give or take it.

    Without a datum laws 1 and 3 know only datum + Fs/k; the wide prior keeps the fit finite and its interval wide.
    """
    if motion.datum_prior is not None:
        return motion.datum_prior
    middle = 0.5 * float(motion.position.max() + motion.position.min())
    return Measured(middle, 0.5 * motion.travel)


def search(law: int, motion: Motion, cut: Cut, near: Fit | None = None) -> Fit | None:
    """Fit one law to the thinned record.

    Parameters
    ----------
    law : int
        1 to 6.
    motion, cut : Motion, Cut
        The record in the fit's frame and its cycles; those without a flag are fitted.
    near : Fit, optional
        The law of the same curve with the other contact, searched before: a second start.  A ramp law takes it with a
        narrow ramp, so that it never ends up worse than the law it contains; a jump law without the ramp.

    Returns
    -------
    Fit or None
        None when the flow cannot be followed from any starting value: the law then has no place in the ranking.
    """
    begun = clock.process_time()
    setting = Setting.of(law, motion, cut)
    windows = Windows.of(motion, cut.used, max(1, round(motion.time.size / motion.span / COARSE_HZ)))
    starts = [_begin(setting, windows, cut.used)]
    if near is not None:
        u = near.u.copy()
        u[D] = NARROW * motion.belt_speed if setting.ramp else starts[0].u[D]
        starts.append(replace(starts[0], u=u, local=near.local))
    found = [state for state in (_settle(setting, windows, first) for first in starts) if state is not None]
    if not found:
        return None
    best = min(found, key=lambda state: float(np.mean(np.log(state.cycle_rms))))
    return _fit(law, setting, windows, best, cut, clock.process_time() - begun)


def polish(fit: Fit, motion: Motion, cut: Cut) -> Fit:
    """Fit the whole record, wear included, from where the search on the thinned one ended.

    The search's own fit is returned when that leads nowhere.
    """
    begun = clock.process_time()
    setting = Setting.of(fit.law, motion, cut)
    first = replace(fit.state, trend=_trend(fit.windows, fit.local))
    last = _pass(setting, fit.windows, first, *WEAR_PASS)
    windows = Windows.of(motion, cut.used)
    if last is not None and windows.time.size > fit.windows.time.size:
        last = _pass(setting, windows, _assume(last, fit.windows, motion, first=False), *FINE_PASS)
    else:
        windows = fit.windows
    if last is None:
        return fit
    return _fit(fit.law, setting, windows, last, cut, fit.cpu_s + clock.process_time() - begun)


def _fit(law: int, setting: "Setting", windows: Windows, state: "State", cut: Cut, cpu_s: float) -> Fit:
    active = tuple(k for k in setting.active if k != WEAR or state.trend is not None)
    index = list(active)
    solution = state.solution
    if solution is None or state.precision is None:
        raise RuntimeError("a state without a solution is a start, not a fit")
    return Fit(
        law=law,
        u=state.u,
        active=active,
        local=state.local,
        residual=solution.residual,
        rows=windows.rows,
        cycle_rms=state.cycle_rms,
        sigma=state.sigma,
        deviations=(state.u[index] - setting.prior[index]) * np.sqrt(setting.precision[index]),
        solution=solution,
        precision=state.precision[index],
        windows=windows,
        cycles=cut.used,
        state=state,
        outcome=solution.outcome,
        cpu_s=cpu_s,
    )


@dataclass(frozen=True, eq=False)
class Setting:
    """What stays the same through a law's passes; arrays over the 9 shared unknowns unless said otherwise."""

    motion: Motion
    curve: int
    ramp: bool
    active: tuple[int, ...]
    start: regression.Start
    damping: float
    scale: Array
    lower: Array
    upper: Array
    prior: Array
    precision: Array
    local_scale: Array  # (6,)

    @classmethod
    def of(cls, law: int, motion: Motion, cut: Cut) -> "Setting":
        """Regress the start and turn the calibration into priors."""
        kind = LAWS[law]
        datum = datum_guess(motion)
        start = regression.start(motion, cut, kind.curve_code, bool(kind.ramp), datum)
        omega = math.sqrt(start.K)
        damping = damping_guess(motion, start.K)
        shape = max(abs(start.shape), 1e-3 / motion.belt_speed)
        speed, travel = motion.belt_speed, motion.travel
        lower = np.array([1e-6 * start.K, -np.inf, 0.05 * speed, 0.0, NO_RAMP * speed, -np.inf, 0.0, -np.inf, 0.0])
        lower[GIVE] = NO_RAMP * speed / travel
        upper = np.full(UNKNOWNS, np.inf)
        if kind.curve == "linear":  # beyond Fs/G_slip the curve would push: that far it is no friction
            upper[SHAPE] = STILL_FRICTION / float(np.max(speed - motion.velocity))
        prior, precision = np.zeros(UNKNOWNS), np.zeros(UNKNOWNS)
        prior[DATUM], precision[DATUM] = datum.value, _precision(datum.sd, 1e-6 * travel)
        prior[DAMPING], precision[DAMPING] = damping.value, _precision(damping.sd, 1e-6 * omega)
        belt = motion.belt_prior
        if belt is not None and belt.sd > 0:
            prior[V_DR], precision[V_DR] = belt.value, _precision(belt.sd, 0.0)
        if motion.give is not None:
            prior[GIVE], precision[GIVE] = motion.give.value, _precision(motion.give.sd, 0.0)
        return cls(
            motion=motion,
            curve=kind.curve_code,
            ramp=bool(kind.ramp),
            active=active_unknowns(law, motion.give),
            start=start,
            damping=damping.value,
            scale=np.array([start.K, 1.0, speed, shape, speed, travel, omega, omega, speed / travel]),
            lower=lower,
            upper=upper,
            prior=prior,
            precision=precision,
            local_scale=np.array([travel, speed, 1.0, 1.0, travel, speed]),
        )


@dataclass(frozen=True, eq=False)
class State:
    """Where a pass ended: all 9 shared unknowns, the cycles' own, and what the next pass is to assume of the noise."""

    u: Array
    local: Array
    sigma: float
    scatter: float
    weights: Array
    cycle_rms: Array
    solution: schur.Solution | None
    trend: Measured | None = None  # wear as the levels' trend shows it, 1/s
    prior: Array | None = None
    precision: Array | None = None


def _begin(setting: Setting, windows: Windows, cycles: tuple[Cycle, ...]) -> State:
    """Return the regression's start, with no noise known yet.

    Where the mass overtakes the belt, the new level must be below the load it landed with, or it would not.
    """
    start, motion = setting.start, setting.motion
    local = windows.first_locals(motion)
    for k, cycle in enumerate(cycles):
        if cycle.overtakes:
            load = start.K * (start.datum - float(np.interp(cycle.landing, motion.time, motion.position)))
            local[k, NEXT_LEVEL] = math.log(max(OVERTAKING_LEVEL * load / start.F, 0.2))
    shape = min(start.shape, float(setting.upper[SHAPE]))
    give = 0.0 if motion.give is None else motion.give.value
    return State(
        u=np.array([start.K, math.log(start.F), start.v_dr, shape, start.d, start.datum, setting.damping, 0.0, give]),
        local=local,
        sigma=FIRST_SIGMA * motion.resolution,
        scatter=FIRST_SCATTER,
        weights=np.ones(len(windows.rows)),
        cycle_rms=np.ones(len(windows.rows)),
        solution=None,
    )


def _settle(setting: Setting, windows: Windows, start: State) -> State | None:
    """Fit from one start, in passes that settle noise level, weights and scatter."""
    state: State | None = start
    for number, (steps, gain) in enumerate(PASSES if setting.motion.datum_prior is not None else LONG_PASSES):
        if state is None:
            return None
        state = _pass(setting, windows, state, steps, gain)
        if state is not None:
            state = _assume(state, windows, setting.motion, first=number == 0)
    return state


def _pass(setting: Setting, windows: Windows, state: State, max_steps: int, tolerance: float) -> State | None:
    """Minimise once with the noise assumed so far."""
    motion = setting.motion
    # Wear is fitted last: the levels must be known first, whose trend says about how fast they fall.
    index = [k for k in setting.active if k != WEAR or state.trend is not None]
    prior, precision = setting.prior.copy(), setting.precision.copy()
    if state.trend is not None:
        prior[WEAR], precision[WEAR] = state.trend.value, 1 / state.trend.sd**2
    wide = 0.1 * motion.travel
    local_sd = np.array([wide, motion.belt_speed, state.scatter, state.scatter, wide, motion.belt_speed])
    problem = schur.Problem(
        evaluate=evaluator(setting.curve, setting.ramp, windows, state.u, index, setting.scale, setting.local_scale),
        rows=windows.rows,
        weights=state.weights / state.sigma**2,
        lower=setting.lower[index],
        upper=setting.upper[index],
        prior=prior[index],
        precision=precision[index],
        local_prior=windows.first_locals(motion),
        local_precision=np.broadcast_to(1 / local_sd**2, state.local.shape),
    )
    solution = schur.minimise(problem, state.u[index], state.local, max_steps=max_steps, tolerance=tolerance)
    if solution is None:
        return None
    u = state.u.copy()
    u[index] = solution.u
    rms = np.array([math.sqrt(float(np.mean(solution.residual[rows] ** 2))) for rows in windows.rows])
    return replace(state, u=u, local=solution.local, cycle_rms=rms, solution=solution, prior=prior, precision=precision)


def _assume(state: State, windows: Windows, motion: Motion, *, first: bool) -> State:
    """Take noise level, weights and scatter from the residuals of the pass before."""
    middle = max(float(np.median(state.cycle_rms)), motion.resolution)
    weights = np.minimum(2 / (1 + (state.cycle_rms / middle) ** 2), 1.0)
    if state.solution is None:
        return state
    calm = [rows for rows, weight in zip(windows.rows, weights, strict=True) if weight > 0.5]
    seen = effective_sigma(state.solution.residual, calm)
    # Only downwards after the first pass: a wrong law must not talk itself into noise that excuses it.
    sigma = max(seen if first else min(seen, state.sigma), motion.resolution)
    scatter = float(np.clip(np.std(state.local[:, LEVEL]), 0.01, 0.5))
    return replace(state, weights=weights, sigma=sigma, scatter=scatter)


def _trend(windows: Windows, local: Array) -> Measured:
    """Return how fast the levels fall, 1/s, by a straight line through their logarithms."""
    slips = windows.table[:, 1] == 0
    level = local[windows.table[slips, 0], LEVEL]
    t = windows.epoch[slips] - windows.epoch[slips].mean()
    square = float(t @ t)
    slope = float(t @ (level - level.mean())) / square
    rest = level - level.mean() - slope * t
    sd = math.sqrt(float(rest @ rest) / max(level.size - 2, 1) / square)
    return Measured(-slope, max(sd, 1e-6))


def _precision(sd: float, exact: float) -> float:
    """Return 1/sd^2; a calibration stated without an error counts as known to ``exact``."""
    return 1 / max(sd, exact) ** 2 if max(sd, exact) > 0 else 0.0


def damping_guess(motion: Motion, K: float) -> Measured:
    """Return c/m, 1/s: the ring-down's, or 0 give or take a hundredth of the critical damping."""
    known = motion.damping_prior
    mass = motion.mass.value if motion.mass else motion.stiffness.value / K if motion.stiffness else None
    if known is None or mass is None:
        return Measured(0.0, UNKNOWN_DAMPING * 2 * math.sqrt(K))
    return Measured(known.value / mass, known.sd / mass)


def effective_sigma(residual: Array, rows: list[slice]) -> float:
    """Return rms x sqrt(tau), tau the integrated correlation time of the residuals in samples (at least 1).

    The autocorrelation is summed up to its first zero, pooled over the cycles.
    """
    square, count = 0.0, 0
    longest = max((rows_.stop - rows_.start for rows_ in rows), default=0)
    lags = np.zeros(longest)
    for part in rows:
        r = residual[part]
        size = 1 << (2 * r.size - 1).bit_length()
        spectrum = np.fft.rfft(r, size)
        lags[: r.size] += np.fft.irfft(spectrum * np.conj(spectrum), size)[: r.size]
        square += float(r @ r)
        count += r.size
    if square <= 0 or count == 0:
        return 0.0
    rho = lags / lags[0]
    end = int(np.argmax(rho < 0)) if np.any(rho < 0) else longest
    tau = 1 + 2 * float(np.sum(rho[1:end]))
    return math.sqrt(square / count * max(tau, 1.0))
