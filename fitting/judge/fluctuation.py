"""Break-away levels above the level of slip (ageing), and random friction within slips.

No window of the fit contains the break-aways, so a law can fit although the contact ages. Source: J. H. Dieterich, Pure
Appl. Geophys. 116 (1978) 790 (static friction grows with the logarithm of the time at rest). Not modelled: if no law
fits, the level depends on the law, and the ratio is meaningless.

Random friction acts on the fitted motion, and all unknowns are fitted again, to first order in it. Its correlation time
is chosen such that the remaining residual, with the noise, has the correlation time of the record's residual.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from fitting.judge.departures import Base, median_rms
from fitting.judge.parameters import BreakAway
from fitting.model.forces import Forcing
from fitting.model.problem import rest_calibration
from fitting.search.fit import Fit
from processing.record.motion import Finding
from stickslip.compute.arrays import Array, autocorrelation_time
from stickslip.units import Measured

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


DRAWS, SEED = 6, 5  # the same draws for every record; the size is then accurate to a factor of two or three
HARMONICS = 64  # sines in one draw
# Correlation times of the friction over that of the residual, which is longer, since inertia smooths a force.
TIMES_TRIED = (1.0, 0.5, 0.25, 0.125, 0.0625)


def fluctuation_share(
    base: Base, repeated: float, count_repeated: Callable[[Array], Array], noise: float
) -> float | None:
    """Return the standard deviation of random friction over the friction at rest.

    None if a larger share of the residual (``repeated``) repeats from slip to slip than under random friction, or if
    the motion is unstable.
    """
    linear, path = base.linear, base.path
    excess = median_rms(linear.residual, linear.rows) ** 2 - noise**2
    if not excess > 0:
        return None
    rng = np.random.default_rng(SEED)
    white = noise * rng.standard_normal((linear.residual.size, DRAWS))
    friction = np.where(path.stuck, 0.0, path.friction)[:, None]
    steps = np.diff(path.windows.time)
    correlation = _correlation_time(linear.residual, base)
    sizes: list[tuple[float, float]] = []
    repeat = -math.inf
    for share in TIMES_TRIED:
        time = share * correlation * float(np.median(steps[steps > 0])) / math.sqrt(2 * math.pi)
        response = base.respond([Forcing(acceleration=friction * _draw_correlated(path.time, time, rng))])
        refitted = linear.refit_columns(response)
        unit_rms = float(np.median([median_rms(draw, linear.rows) for draw in refitted.T]))
        if math.isfinite(unit_rms) and unit_rms > 0:
            size = math.sqrt(excess) / unit_rms
            simulated = size * refitted + white
            times = [_correlation_time(draw, base) for draw in simulated.T]
            sizes.append((abs(math.log(float(np.median(times)) / correlation)), size))
            repeat = max(repeat, float(np.max(count_repeated(simulated))))
    if not sizes or repeated > repeat:
        return None
    return min(sizes)[1] * base.fit.values.F / _friction_at_rest(base.fit)


def _friction_at_rest(fit: Fit) -> float:
    """Return friction at the break-aways, m/s^2, from the spring's stretch: the level of a wrong law is arbitrary."""
    rows_of_first_run = [rows for rows, run in zip(fit.rows, fit.windows.run, strict=True) if run == 0]
    highest = float(np.mean([np.max(fit.windows.position[rows]) for rows in rows_of_first_run]))
    return fit.values.K * (highest - rest_calibration(fit.problem.runs[0]).value)


def _correlation_time(residual: Array, base: Base) -> float:
    """Return the correlation time in samples."""
    return autocorrelation_time([residual[rows] for rows in base.linear.rows])


def _draw_correlated(time: Array, correlation: float, rng: np.random.Generator) -> Array:
    """Return random numbers (M, DRAWS) of unit variance at times, s, with a Gaussian correlation."""
    rate = rng.standard_normal((HARMONICS, DRAWS)) / correlation
    phase = rng.uniform(0.0, 2 * math.pi, (HARMONICS, DRAWS))
    total = np.zeros((time.size, DRAWS))
    for frequency, shift in zip(rate, phase, strict=True):
        total += np.cos(time[:, None] * frequency + shift)
    return math.sqrt(2 / HARMONICS) * total
