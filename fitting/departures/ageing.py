"""Ageing: a break-away level above the level of slip, and whether it grows with the time of the stick before.

The break-aways lie in no window of the fit, so a law can be right and its contact age.  Source: J. H. Dieterich, Pure
Appl. Geophys. 116 (1978) 790 (static friction grows with the logarithm of the time at rest).

Not modelled: levels that differ from law to law where none of them fits; then the ratio says nothing.
"""

import math
from collections.abc import Sequence

import numpy as np

from fitting.data.cycles import CycleSegmentation
from fitting.estimation.result import BreakAway
from processing.record.finding import Finding
from stickslip.compute.arrays import Array
from stickslip.units import Measured

FEWEST_BREAK_AWAYS = 6  # break-aways of which a scatter is taken
# Excess of the break-away level, over the level of slip.  Under the six laws the ratio errs by up to 0.7 % (36 records,
# counts of 50 um and 8 % scatter among them): the break-away is read from a corner that lies in no window.
LEAST_EXCESS = 0.02
ERRORS_SHOWN = 5.0  # standard errors by which an excess, or a growth, is shown
# The growth with time is compared with its own scatter; it comes out at half to three quarters of the truth, because a
# high level also makes the stick before it longer.


def find_other_break_away(
    events: Sequence[BreakAway], cut: CycleSegmentation, rest: Measured, unit: str
) -> list[Finding]:
    """Return that the break-aways disagree with the law's friction at rest; none where they agree, or too few show it.

    events: Of a law that describes the record.
    rest: Friction at rest, with the error that all cycles share: of rest position and Fs
        (`fitting.estimation.derived.break_away_level_error`).
    """
    landing = {cycle.number + 1: cycle.landing for cycle in cut.cycles}
    good = [event for event in events if not event.flag and math.isfinite(event.break_away_level)]
    if len(good) < FEWEST_BREAK_AWAYS:
        return []
    ratio = np.array([event.break_away_level / event.kinetic_scale for event in good])
    mean = float(ratio.mean())
    error = math.hypot(float(ratio.std(ddof=1)) / math.sqrt(ratio.size), rest.sd / rest.value)
    known = math.hypot(error, LEAST_EXCESS / ERRORS_SHOWN)
    if abs(mean - 1) < ERRORS_SHOWN * known:
        return []
    measured = mean * rest.value
    text = (
        f"break-away: friction at the measured break-aways is {measured:.4g} +- {error * rest.value:.2g} {unit}, that "
        f"of the law at rest {rest.value:.4g} {unit}"
    )
    stick = np.array([event.t - landing.get(event.number, math.nan) for event in good])
    growth = _growth(stick, ratio)
    if growth is not None and growth.value > ERRORS_SHOWN * growth.sd:
        text += f"; it grows by about {100 * growth.value:.2g} % for every e-fold of the time at rest"
    return [Finding("break-away", text, measured, rest.value, abs(mean - 1) / known)]


def _growth(stick: Array, ratio: Array) -> Measured | None:
    """Return the slope of the log ratio over the log stick time, with a standard error robust to outliers."""
    good = np.isfinite(stick) & (stick > 0)
    if good.sum() < FEWEST_BREAK_AWAYS:
        return None
    x, y = np.log(stick[good]), np.log(ratio[good])
    x, y = x - x.mean(), y - y.mean()
    square = float(np.sum(x**2))
    if square == 0:
        return None
    slope = float(np.sum(x * y)) / square
    rest = y - slope * x
    # each point's own residual, raised by its leverage (HC3: J. MacKinnon, H. White, J. Econometrics 29 (1985) 305)
    raised = x * rest / (1 - x**2 / square - 1 / x.size)
    return Measured(slope, math.sqrt(float(np.sum(raised**2))) / square)
