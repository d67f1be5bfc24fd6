"""The belt's speed from the plateaus of the velocity: their common speed, and which speed is reported.

The mass may creep against the belt inside a plateau (friction with a ramp): the plateau's speed is then not the
belt's, and where the belt's own was measured, that one is reported.
"""

import math

import numpy as np

from daq.compute.arrays import Array
from daq.runfile.rig import Measured
from processing.record.motion import Motion

# Of the belt's speed: the most that a plateau may differ from it.  Under friction with a ramp the mass creeps by up to
# the ramp's half-width d, so sticks are found for d up to 0.4 belt speeds and missed above.
SAME_SPEED = 0.4


def common_speed(motion: Motion, plateaus: list[tuple[int, int]]) -> float:
    """Return the plateaus' common speed, m/s: the half-sample mode, then the mean of what lies about it; else NaN."""
    if not plateaus:
        return math.nan
    velocity = np.concatenate([motion.velocity[i : j + 1] for i, j in plateaus])
    error = median_value(np.concatenate([motion.velocity_errors[i : j + 1] for i, j in plateaus]))
    mode = half_sample_mode(velocity[:: max(velocity.size // 2**12, 1)])
    about = np.abs(velocity - mode) <= 3 * error
    return float(velocity[about].mean()) if about.any() else mode


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
    some = values[:: max(values.size // 2**8, 1)]
    return float(np.partition(some, some.size // 2)[some.size // 2])


def reported_speed(stated: float | None, measured: Measured | None, common: float, stuck: bool) -> float:
    """Return the belt speed to report, m/s; NaN when unknown.

    Parameters
    ----------
    stated, measured : float or Measured, optional
        What a person stated, and what the rig's calibration holds.
    common : float
        Common speed of the plateaus.
    stuck : bool
        Whether the record shows a stick.
    """
    if stated is not None:
        return stated
    if measured is None:
        return common if stuck else math.nan
    if stuck and abs(common - measured.value) <= max(4 * measured.sd, 0.02 * abs(measured.value)):
        return common
    return measured.value
