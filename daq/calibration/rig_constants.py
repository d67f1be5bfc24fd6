"""Constants of a rig, with standard deviations, from a known distance and a ring-down.

Count zero is the position at which the counters are zero: that of the mass when the board was powered up or reset,
which an Arduino does whenever its port is opened.  The datum determined here is that of the mark at which the mass was
then; it is valid for every recording that is opened with the mass at the same mark.

Not measured here: the mass, which a balance measures better, and the belt's speed, which follows from every stick.
"""

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from daq.calibration.ring_down import RingDown
from daq.runfile.recording import Recording
from daq.runfile.rig import Rig
from stickslip.errors import DataError
from stickslip.units import Measured

STILL_S = 0.5  # the mass must be at rest for so long at either end of a known distance
STILL_COUNTS = 4
CELL = 1 / math.sqrt(12)  # counts: standard deviation of the position of a mass within its count


def measure_pitch(run: Recording, distance: Measured) -> Measured:
    """Return metres per count from a recording in which the mass was moved by a known distance and then rested.

    If it did not rest before (`stands_at_first`), the distance counts from the first sample.  ``run`` has one segment;
    ``distance`` is towards +x, m, negative towards -x.  Raises DataError if the mass did not rest at the end, or hardly
    moved.
    """
    count = _connected_counts(run)
    n = max(1, round(STILL_S * run.rate_hz))
    if count.size < 4 * n:
        raise DataError("the recording is too short", "distance", f"record at least {4 * STILL_S:g} s")
    end = count[-n:]
    if np.ptp(end) > STILL_COUNTS:
        what = f"the mass moved by {np.ptp(end)} counts within the last {STILL_S:g} s"
        raise DataError(what, "distance", "keep it at rest there, and allow more time (--move)")
    start = count[:n] if stands_at_first(run) else count[:1]
    moved = float(np.mean(end) - np.mean(start))
    if abs(moved) < 10:
        what = f"the mass moved by only {moved:.3g} counts"
        raise DataError(what, "distance", "move it farther, and see 'daq check' for the encoder")
    value = distance.value / moved
    return Measured(value, abs(value) * math.hypot(distance.sd / distance.value, math.sqrt(2) * CELL / moved))


def stands_at_first(run: Recording) -> bool:
    return bool(np.ptp(_connected_counts(run)[: max(1, round(STILL_S * run.rate_hz))]) <= STILL_COUNTS)


def fit_ring_down(run: Recording) -> RingDown:
    """Return the ring-down in a recording, lengths in counts; DataError if there is none."""
    from daq.calibration import ring_down

    return ring_down.fit_ring_down(run.time, _connected_counts(run).astype(np.float64) + 0.5, 1.0)


def calibrate_rig(rig: Rig, pitch: Measured | None, ring: RingDown | None, mass: Measured | None) -> Rig:
    """Return a rig with everything that was measured, and the quantities that follow from it, replaced.

    Stiffness and damping need a mass, the datum metres per count; without it they are not changed.  A belt speed of 0
    is dropped: the belt stands still only for the calibration.
    """
    rig = replace(rig, mass=mass or rig.mass, belt_speed=None if belt_stands(rig) else rig.belt_speed)
    if pitch is not None:
        rig = replace(rig, metres_per_count=pitch)
    if ring is None:
        return rig
    if rig.mass is not None:
        rig = replace(rig, stiffness=compute_stiffness(ring, rig.mass), damping=compute_damping(ring, rig.mass))
    if rig.metres_per_count is not None:
        rig = replace(rig, datum=compute_datum(ring, rig.metres_per_count), x0=None)
    return rig


def belt_stands(rig: Rig) -> bool:
    """Return whether a rig's belt speed is known to be zero."""
    return rig.belt_speed is not None and rig.belt_speed.value == 0


def compute_stiffness(ring: RingDown, mass: Measured) -> Measured:
    """Return k = m omega0^2, N/m."""
    w = ring.omega0
    value = mass.value * w.value**2
    return Measured(value, value * math.hypot(mass.sd / mass.value, 2 * w.sd / w.value))


def compute_damping(ring: RingDown, mass: Measured) -> Measured:
    """Return c = 2 zeta omega0 m, N s/m."""
    w, zeta, m = ring.omega0, ring.zeta, mass
    value = 2 * zeta.value * w.value * m.value
    sd = math.hypot(2 * zeta.sd * w.value * m.value, value * math.hypot(w.sd / w.value, m.sd / m.value))
    return Measured(value, sd)


def compute_datum(ring: RingDown, pitch: Measured) -> Measured:
    """Return the position of count zero relative to the spring's rest position, m."""
    value = -ring.equilibrium.value * pitch.value
    return Measured(value, math.hypot(ring.equilibrium.sd * pitch.value, ring.equilibrium.value * pitch.sd))


def _connected_counts(run: Recording) -> NDArray[np.int64]:
    if run.count is None:
        raise DataError("has no counts", str(run.source), "record from an encoder board")
    if run.segment[-1] > 0:
        raise DataError(
            "the port was lost during the measurement, so counts before and after it are not comparable",
            str(run.source),
            "try again",
        )
    return run.count
