"""The belt's speed from the plateaus of the velocity: their common speed, and which speed is reported.

The mass may creep against the belt inside a plateau (friction with a ramp): the plateau's speed is then not the
belt's, and where the belt's own was measured, that one is reported.
"""

import math
from itertools import pairwise

import numpy as np

from processing.record.motion import Motion
from processing.record.setting import is_possible_speed
from stickslip.compute.arrays import Array
from stickslip.units import Measured

# Of the belt's speed: the most that a plateau may differ from it.  Under friction with a ramp the mass creeps by up to
# the ramp's half-width d, so sticks are found for d up to 0.4 belt speeds and missed above.
SAME_SPEED = 0.4
QUARTER = 8  # samples in a quarter of a stick, at least
FEWEST = 8  # sticks that creep is judged by
CREEP = 0.02  # of the belt's speed: what the last quarter of a stick must lose; an even belt loses less than 0.001
LEVEL = 1 / 3  # of that loss: the most that the first two quarters may differ by; 1/2 under friction with a ramp


def common_speed(motion: Motion, plateaus: list[tuple[int, int]]) -> float:
    """Return the plateaus' common speed, m/s: the half-sample mode, then the mean of what lies about it; else NaN."""
    if not plateaus:
        return math.nan
    velocity = np.concatenate([motion.velocity[i : j + 1] for i, j in plateaus])
    error = median_value(np.concatenate([motion.velocity_errors[i : j + 1] for i, j in plateaus]))
    mode = half_sample_mode(velocity[:: max(velocity.size // 2**12, 1)])
    about = np.abs(velocity - mode) <= 3 * error
    return float(velocity[about].mean()) if about.any() else mode


def speed_before_creep(velocity: list[Array], window: int, common: float) -> float:
    """Return the speed of the first halves of the sticks where the mass creeps before break-away, else ``common``.

    Paper, rubber and polymers slide ever faster before they break away, and a stick's mean speed is then below the
    belt's.  In every quarter of a stick the median speed is taken, and of the sticks the median: creep shows where the
    last quarter is slower than the second, and the first two differ by far less.  (Under friction with a ramp the
    speed falls evenly through all of a stick.)

    velocity: Velocities in each stick, m/s.
    window: Samples that the velocity is smoothed over: a quarter of less than two shows what lies beside the stick,
        too.
    common: Their common speed, m/s.
    """
    long = [own for own in velocity if own.size >= 4 * max(2 * window, QUARTER)]
    if len(long) < FEWEST:
        return common
    quarters = np.array([_medians_of_quarters(own) for own in long]) / common
    first, second, _, last = np.median(quarters, axis=0)
    scatter = float(np.median(np.abs(quarters[:, 1] - quarters[:, 3] - (second - last)))) / 0.6745
    if second - last < max(CREEP, 4 * scatter / math.sqrt(len(long))) or abs(first - second) > LEVEL * (second - last):
        return common
    return float(common * (first + second) / 2)


def _medians_of_quarters(values: Array) -> list[float]:
    """Return the median values of four parts as long, but for a value."""
    least, more = divmod(values.size, 4)
    edges = [k * least + min(k, more) for k in range(5)]
    return [median_value(values[i:j]) for i, j in pairwise(edges)]


def half_sample_mode(values: Array) -> float:
    """Return the mode of a sample: the shortest interval that holds half of it, halved again until two are left.

    Source: D. R. Bickel and R. Fruehwirth, Comput. Stat. Data Anal. 50 (2006) 3500.
    """
    x = np.sort(values)
    while x.size > 3:
        half = (x.size + 1) // 2
        widths = x[half - 1 :] - x[: x.size - half + 1]
        at = int(np.argmin(widths))
        x = x[at : at + half]
    if x.size == 3:
        x = x[:2] if x[1] - x[0] <= x[2] - x[1] else x[1:]
    return float(x.mean())


def median_value(values: Array) -> float:
    """Return the middle one of the values; of very many, of some spread over them."""
    some = values[:: max(values.size // 2**8, 1)].copy()
    some.partition(some.size // 2)
    return float(some[some.size // 2])


def reported_speed(stated: float | None, measured: Measured | None, common: float, stuck: bool) -> float:
    """Return the belt speed to report, m/s; NaN when unknown.

    stated, measured: What a person stated, and what the rig's calibration holds.
    common: Common speed of the plateaus.
    stuck: Whether the record shows a stick.

    Notes
    -----
    A calibrated speed that the sticks contradict is not used.
    """
    if stated is not None:
        return stated
    if measured is None or (stuck and not is_possible_speed(measured, common)):
        return common if stuck else math.nan
    if stuck and abs(common - measured.value) <= max(4 * measured.sd, 0.02 * abs(measured.value)):
        return common
    return measured.value
