"""The time and load of each break-away and the friction in the slip after it; the fitted motion at any times.

The smoothed corner gives the load at break-away 6 to 7 % too low or high.  So the time is searched at which a slip
under the fitted law must start to pass through the measured positions around the corner.

No window of the fit contains the break-aways, so a law can fit although the contact ages. Source: J. H. Dieterich, Pure
Appl. Geophys. 116 (1978) 790 (static friction grows with the logarithm of the time at rest). Not modelled: if no law
fits, the level depends on the law, and the ratio is meaningless.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from fitting.judge.parameters import BreakAway
from fitting.model.path import follow
from fitting.model.unknowns import PER_CYCLE, Global, PerCycle
from fitting.model.windows import ShootingWindows
from fitting.record.cycles import BEFORE_BREAK_AWAY, CycleSegmentation
from fitting.record.motion import MeasuredMotion
from fitting.record.ripple import Ripple
from fitting.search.fit import Fit
from processing.record.motion import Finding
from stickslip.compute.arrays import Array
from stickslip.units import Measured

# Times in slips (`MeasuredMotion.slip_s`).
SEARCH_RANGE, SEARCH_STEP = 0.3, 2e-4  # about the smoothed break-away
JUDGED_SLIP = 0.1  # duration of the slip after it that is compared
SEARCH_ROUNDS, TRIALS = 3, 21  # rounds, and trials of each; the next round refines the interval about the best trial
POOR_CYCLE = 3.0  # error of a cycle over the median, above which its break-away is flagged as rough


def find_break_aways(fit: Fit, motion: MeasuredMotion, cut: CycleSegmentation) -> tuple[BreakAway, ...]:
    times, loads = _break_aways(fit, motion)
    usual_rms = float(np.median(fit.cycle_rms))
    index_of = {cycle.number: k for k, cycle in enumerate(fit.cycles)}
    rows = []
    for cycle in cut.cycles:
        k = index_of.get(cycle.number)
        if k is None:
            rows.append(BreakAway(cycle.number, cycle.break_away, math.nan, math.nan, cycle.flag))
            continue
        rough = fit.cycle_rms[k] > POOR_CYCLE * max(usual_rms, motion.resolution)
        scale = math.exp(float(fit.local[k, PerCycle.LEVEL]))
        rows.append(BreakAway(cycle.number, float(times[k]), float(loads[k]), scale, "rough" if rough else ""))
    return tuple(rows)


def find_stick_starts(fit: Fit, cut: CycleSegmentation) -> dict[int, float]:
    """Return the time at which the mass comes to stick after each slip, s, by the number of the cycle; NaN if unknown.

    A mass that overtakes the belt reaches its speed twice, and sticks the second time, which the fitted motion shows.
    Of a cycle that is not fitted only the first time is measured.
    """
    starts = {cycle.number: math.nan if cycle.overtakes else cycle.landing for cycle in cut.cycles}
    curve = fit.curve_on_path
    path = None if curve is None else follow(fit.windows, curve, fit.u, fit.local)
    if path is None:
        raise RuntimeError("the motion of a fit can be followed")
    for row, (k, stick) in enumerate(fit.windows.table[:, :2].tolist()):
        if not stick:
            points = slice(*path.first_point[row : row + 2])
            slipping, time = np.flatnonzero(path.slips[points]), path.time[points]
            comes = 0 < slipping.size and slipping[-1] + 1 < time.size
            starts[fit.cycles[k].number] = float(time[slipping[-1] + 1]) if comes else math.nan
    return starts


def _break_aways(fit: Fit, motion: MeasuredMotion) -> tuple[Array, Array]:
    """Return times, s, and friction over Fs/m; the search begins where the load reaches the next slip's level.

    Under a law with memory a slip begins gradually, so the times of the smoothed motion are used.
    """
    count = len(fit.cycles)
    if fit.law.rate:
        best = np.array([cycle.break_away for cycle in fit.cycles])
        return best, _friction(fit, best, np.interp(best, motion.time, motion.position)) / fit.values.F
    earliest = np.array([_reaches_level(fit, motion, k) for k in range(count)])
    latest = np.array([float(motion.time[cycle.slip[0]]) for cycle in fit.cycles])
    low, high = earliest, np.maximum(latest, earliest)
    best = earliest
    for _ in range(SEARCH_ROUNDS):
        trials = low[:, None] + (high - low)[:, None] * np.linspace(0, 1, TRIALS)
        best = trials[np.arange(count), np.argmin(_misfit(fit, motion, trials), axis=1)]
        step = (high - low) / (TRIALS - 1)
        low, high = np.maximum(best - step, earliest), best + step
    position = np.array([_in_stick(fit, motion, k, best[k : k + 1])[0] for k in range(count)])
    return best, _friction(fit, best, position) / fit.values.F


def _belt_ripple(fit: Fit, time: Array) -> tuple[Array, Array, Array]:
    p = fit.values
    return Ripple(p.cosine, p.sine, p.omega).belt_motion(time)


def _edge_speed(fit: Fit, time: Array) -> Array:
    return np.asarray(fit.values.v_dr - _width(fit) + _belt_ripple(fit, time)[1])


def _width(fit: Fit) -> float:
    """Return the velocity below the free belt's at break-away, m/s: ramp and belt compliance together."""
    p = fit.values
    return (p.d if fit.problem.ramp else 0.0) + p.compliance / p.K * p.F


def _friction(fit: Fit, time: Array, x: Array) -> Array:
    """Return friction per unit mass just before the break-away, corrected for the deceleration on a ramp."""
    p, speed = fit.values, _edge_speed(fit, time)
    load = p.K * (x - p.datum) + p.damping * speed + _belt_ripple(fit, time)[2]
    slowing = _width(fit) / p.static * p.K * speed / p.F
    return np.asarray(load - slowing)


def _reaches_level(fit: Fit, motion: MeasuredMotion, k: int) -> float:
    """Return the time at which friction in stick reaches the level of the next slip, s."""
    smoothed = fit.cycles[k].break_away
    reach = SEARCH_RANGE * motion.slip_s
    time = np.arange(smoothed - reach, smoothed + reach, SEARCH_STEP * motion.slip_s)
    level = math.exp(float(fit.u[Global.LOG_F] + fit.local[k, PerCycle.LEVEL]))
    reached = _friction(fit, time, _in_stick(fit, motion, k, time)) >= level
    return float(time[np.argmax(reached)]) if reached.any() else smoothed


def _misfit(fit: Fit, motion: MeasuredMotion, trials: Array) -> Array:
    """Return the squared error, m^2, around the corner of break-aways at ``trials`` (cycles, m)."""
    errors = np.full(trials.shape, np.inf)
    table: list[tuple[int, ...]] = []
    owner: list[tuple[int, ...]] = []
    time: list[Array] = []
    local: list[Array] = []
    total = 0
    for k, cycle in enumerate(fit.cycles):
        first = int(np.searchsorted(motion.time, trials[k].min() - BEFORE_BREAK_AWAY * motion.slip_s))
        last = int(np.searchsorted(motion.time, motion.time[cycle.slip[0]] + JUDGED_SLIP * motion.slip_s))
        rows = np.zeros((trials.shape[1], PER_CYCLE))
        rows[:, PerCycle.LEVEL] = rows[:, PerCycle.NEXT_LEVEL] = fit.local[k, PerCycle.LEVEL]
        rows[:, PerCycle.X_SLIP] = _in_stick(fit, motion, k, trials[k])
        rows[:, PerCycle.V_SLIP] = _edge_speed(fit, trials[k]) - 1e-9 * fit.u[Global.V_DR]
        after = np.maximum(np.searchsorted(motion.time, trials[k], side="right"), first)
        sticking = _in_stick(fit, motion, k, motion.time[first:last]) - motion.measured[first:last]
        before = np.concatenate([[0.0], np.cumsum(sticking**2)])
        for j in np.flatnonzero(after < last).tolist():
            errors[k, j] = before[after[j] - first]
            table.append((len(local), 0, total, 1 + last - int(after[j]), 0, 0))
            time += [trials[k, j : j + 1], motion.time[after[j] : last]]
            local.append(rows[j])
            owner.append((k, j, int(after[j]), last, total))
            total += 1 + last - int(after[j])
    if not table:
        return errors
    windows = ShootingWindows(
        table=np.array(table, np.int64),
        level_epoch=np.array([fit.cycles[row[0]].break_away for row in owner]),
        earliest_landing=np.full(len(table), np.inf),
        time=np.concatenate(time),
        position=np.zeros(total),
        source=np.zeros(total, np.int64),
        rows=(),
    )
    model = fit.residual_in(windows, np.array(local))
    if model is None:
        return np.full(trials.shape, np.inf)
    for k, j, start, last, first_row in owner:
        slipping = model[first_row + 1 : first_row + 1 + last - start] - motion.measured[start:last]
        errors[k, j] += float(np.sum(slipping**2))
    return errors


def _in_stick(fit: Fit, motion: MeasuredMotion, k: int, time: Array) -> Array:
    """Return the position of a mass that still sticks to the belt, m."""
    first, end = fit.cycles[k].stick
    if _width(fit) > 0 or end <= first:
        return np.interp(time, motion.time, motion.position)
    began = motion.time[first : first + 1]
    ripple = _belt_ripple(fit, time)[0] - _belt_ripple(fit, began)[0]
    return np.asarray(fit.local[k, PerCycle.X_STICK] + fit.values.v_dr * (time - began) + ripple)


def motion_at(fit: Fit, time: Array) -> tuple[Array, Array]:
    """Return position, m, and velocity, m/s, of one run's fit at times of its record, s, in the fit's frame.

    From a cycle's stick window to its slip window the stick is continued; outside the fitted cycles it is NaN.
    """
    windows, requested = fit.windows, np.asarray(time, np.float64)
    flat, count = requested.ravel(), windows.table[:, 3]
    begin, end = _spans(windows)
    order = np.argsort(begin)
    owner = order[np.maximum(np.searchsorted(begin[order], flat, side="right") - 1, 0)]
    inside = (begin[owner] <= flat) & (flat <= end[owner])
    # with the window's samples: the steps between those are short enough for the integration
    times = np.concatenate([windows.time, flat[inside]])
    owners = np.concatenate([np.repeat(np.arange(count.size), count), owner[inside]])
    order = np.lexsort((times, owners))
    table = windows.table.copy()
    table[:, 3] = np.bincount(owners, minlength=count.size)
    table[:, 2] = np.cumsum(table[:, 3]) - table[:, 3]
    zeros = np.zeros(times.size)
    requested_windows = replace(
        windows, table=table, time=times[order], position=zeros, source=zeros.astype(np.int64), rows=(), parts=()
    )
    motion = fit.motion_in(requested_windows)
    if motion is None:
        raise RuntimeError("the motion of a fit can be followed")
    unsorted = np.empty(times.size, np.int64)
    unsorted[order] = np.arange(times.size)
    motion_of_run = np.full((2, flat.size), np.nan)
    motion_of_run[:, inside] = motion[:, unsorted[windows.time.size :]]
    return motion_of_run[0].reshape(requested.shape), motion_of_run[1].reshape(requested.shape)


def _spans(windows: ShootingWindows) -> tuple[Array, Array]:
    """Return start and end of each window, s; a stick ends where its slip begins, others a sample after their last."""
    table = windows.table
    begin, last = windows.time[table[:, 2]], windows.time[table[:, 2] + table[:, 3] - 1]
    end = last + float(np.median(np.diff(windows.time)))
    breaks = np.flatnonzero((table[1:, 0] == table[:-1, 0]) & (table[:-1, 1] == 1) & (table[1:, 1] == 0))
    end[breaks] = begin[breaks + 1]
    return begin, end


FEWEST_BREAK_AWAYS = 6  # break-aways needed to estimate a scatter
LEAST_EXCESS = 0.02  # of the break-away level over that of slip; under the six laws the ratio is up to 0.7 % off
ERRORS_SHOWN = 5.0  # standard errors above which an excess, or a growth, is reported


class BreakAways(NamedTuple):
    """The break-aways of one run."""

    events: Sequence[BreakAway]
    stick_starts: Mapping[int, float]  # s, after the slip of each cycle, by its number; NaN if unknown
    error: float  # common standard deviation of their levels, over the level


def find_other_break_away(runs: Sequence[BreakAways], level: float, unit: str) -> list[Finding]:
    """Return a finding if the break-away levels of the runs disagree with friction at rest (``level``)."""
    each = [_levels(run) for run in runs]
    ratio = np.concatenate([ratios for ratios, _ in each])
    if ratio.size < FEWEST_BREAK_AWAYS:
        return []
    mean = float(ratio.mean())
    error = math.hypot(float(ratio.std(ddof=1)) / math.sqrt(ratio.size), max(run.error for run in runs))
    sd = math.hypot(error, LEAST_EXCESS / ERRORS_SHOWN)
    if abs(mean - 1) < ERRORS_SHOWN * sd:
        return []
    measured = mean * level
    text = (
        f"break-away: the measured friction at break-away is {measured:.4g} +- {error * level:.2g} {unit}, "
        f"but the law gives {level:.4g} {unit} at rest"
    )
    growth = _growth([(*levels, run.error) for levels, run in zip(each, runs, strict=True)])
    if growth is not None and len(runs) > 1:
        size = f"{100 * growth.value:.2g} +- {100 * growth.sd:.1g} %"
        text += f". From run to run it grows by {size} when the time at rest grows e-fold"
    elif growth is not None and growth.value > ERRORS_SHOWN * growth.sd:
        text += f". It grows by about {100 * growth.value:.2g} % when the time at rest grows e-fold"
    return [Finding("break-away", text, measured, level, abs(mean - 1) / sd)]


def _levels(run: BreakAways) -> tuple[Array, Array]:
    """Return the break-away levels of a run over that at rest, and the stick times before them, s (NaN if unknown)."""
    usable = [event for event in run.events if not event.flag and math.isfinite(event.break_away_level)]
    ratio = np.array([event.break_away_level / event.kinetic_scale for event in usable])
    return ratio, np.array([event.t - run.stick_starts.get(event.number - 1, math.nan) for event in usable])


def _growth(runs: Sequence[tuple[Array, Array, float]]) -> Measured | None:
    """Return the slope of the ratio against the log stick time; for several runs, the slope of their means.

    Within a run the slope can be half or twice the true one: a level that is high by chance also makes the stick
    longer.  That does not bias the means, whose errors are those of the scatter about the slope.
    """
    logs = []
    for ratio, stick, error in runs:
        usable = np.isfinite(stick) & (stick > 0)
        if usable.sum() >= FEWEST_BREAK_AWAYS:
            logs.append((np.log(stick[usable]), ratio[usable], error))
    if len(runs) == 1:
        return _slope_within(*logs[0][:2]) if logs else None
    if len(logs) < 2:
        return None
    growth = _slope_of_means(logs, 0.0)
    return None if growth is None else _slope_of_means(logs, growth.value)


def _slope_of_means(runs: Sequence[tuple[Array, Array, float]], slope: float) -> Measured | None:
    """Return the slope of the means of y over those of x, weighted by the scatter of y about ``slope``."""
    x = np.array([one.mean() for one, _, _ in runs])
    y = np.array([one.mean() for _, one, _ in runs])
    variance = np.array([(b - slope * a).var(ddof=1) / a.size + error**2 for a, b, error in runs])
    x = x - np.average(x, weights=1 / variance)
    square = float(np.sum(x**2 / variance))
    return Measured(float(np.sum(x * y / variance)) / square, 1 / math.sqrt(square)) if square > 0 else None


def _slope_within(x: Array, y: Array) -> Measured | None:
    """Return the slope of y (n,) over x (n,), with a standard error robust to outliers."""
    x, y = x - x.mean(), y - y.mean()
    square = float(np.sum(x**2))
    if square == 0:
        return None
    slope = float(np.sum(x * y)) / square
    # each point's own residual, raised by its leverage (HC3: J. MacKinnon, H. White, J. Econometrics 29 (1985) 305)
    scores = x * (y - slope * x) / (1 - x**2 / square - 1 / x.size)
    return Measured(slope, math.sqrt(float(np.sum(scores**2))) / square)
