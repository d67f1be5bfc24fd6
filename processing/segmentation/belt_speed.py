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

SAME_SPEED = 0.4  # of the belt's speed: largest difference of a plateau, which a ramp can cause by its half-width
QUARTER = 8  # samples in a quarter of a stick, at least
FEWEST = 8  # sticks that are needed to detect creep
CREEP = 0.02  # of the belt's speed: least loss of the last quarter of a stick; an even belt loses less than 0.001
LEVEL = 1 / 3  # of that loss: largest difference of the first two quarters; 1/2 under friction with a ramp


def common_speed(motion: Motion, plateaus: list[tuple[int, int]]) -> float:
    """Return the common speed of the plateaus, m/s: the mean near the half-sample mode, or NaN."""
    if not plateaus:
        return math.nan
    velocity = np.concatenate([motion.velocity[i : j + 1] for i, j in plateaus])
    error = median_value(np.concatenate([motion.velocity_errors[i : j + 1] for i, j in plateaus]))
    mode = half_sample_mode(velocity[:: max(velocity.size // 2**12, 1)])
    near_mode = np.abs(velocity - mode) <= 3 * error
    return float(velocity[near_mode].mean()) if near_mode.any() else mode


def speed_before_creep(velocity: list[Array], window: int, common: float) -> float:
    """Return the speed of the first halves of the sticks where the mass creeps before break-away, else ``common``.

    Paper, rubber and polymers slide ever faster before they break away, and the mean speed of a stick is then below the
    belt's.  Creep is detected in the median speeds of the quarters: the last is slower than the second, and the first
    two differ by far less.  (Under friction with a ramp the speed falls evenly through a stick.)  A quarter must be
    longer than two ``window`` lengths of the smoother, else it contains motion outside the stick.
    """
    sticks = [stick for stick in velocity if stick.size >= 4 * max(2 * window, QUARTER)]
    if len(sticks) < FEWEST:
        return common
    quarters = np.array([_median_quarters(stick) for stick in sticks]) / common
    first, second, _, last = np.median(quarters, axis=0)
    scatter = float(np.median(np.abs(quarters[:, 1] - quarters[:, 3] - (second - last)))) / 0.6745
    if second - last < max(CREEP, 4 * scatter / math.sqrt(len(sticks))) or abs(first - second) > LEVEL * (
        second - last
    ):
        return common
    return float(common * (first + second) / 2)


def _median_quarters(values: Array) -> list[float]:
    """Return the medians of four parts of equal length, to one value."""
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
        first = int(np.argmin(widths))
        x = x[first : first + half]
    if x.size == 3:
        x = x[:2] if x[1] - x[0] <= x[2] - x[1] else x[1:]
    return float(x.mean())


def median_value(values: Array) -> float:
    """Return the median; of very many values, that of some spread over them."""
    thinned = values[:: max(values.size // 2**8, 1)].copy()
    thinned.partition(thinned.size // 2)
    return float(thinned[thinned.size // 2])


def reported_speed(stated: float | None, measured: Measured | None, stick_speed: float, stuck: bool) -> float:
    """Return the belt speed to report, m/s; NaN when unknown.

    A speed ``stated`` by a person comes first, then one ``measured`` in the rig's calibration, unless the sticks
    contradict it.
    """
    if stated is not None:
        return stated
    if measured is None or (stuck and not is_possible_speed(measured, stick_speed)):
        return stick_speed if stuck else math.nan
    if stuck and abs(stick_speed - measured.value) <= max(4 * measured.sd, 0.02 * abs(measured.value)):
        return stick_speed
    return measured.value
