"""Corners of a record, and the pieces that they belong to."""

import numpy as np
import pytest

from processing.kalman.stick_slip import LEAVE, MEET, SLIP, STICK
from processing.record.series import Series
from processing.stick_slip.corners import SwitchingTimes, split_stretches
from processing.stick_slip.smoother import _shift_times


@pytest.mark.parametrize("shift", [-1.0, 1.0])
def test_a_corner_moved_by_its_uncertainty_stays_in_its_piece(shift):
    """A break-away 2 samples behind the start of a block was moved before it: seconds of sliding became a line."""
    time = np.arange(200.0)
    pieces = (slice(0, 100), slice(100, 200))
    series = Series(time, np.zeros(200), origin=0.0, pitch=1.0, interval=1.0, pieces=pieces)
    at, kind = np.array([1.6, 98.5, 101.5]), np.array([LEAVE, MEET, LEAVE], np.uint8)
    times = SwitchingTimes(at, np.full(3, 5.0), kind, (STICK, STICK), 20.0)
    moved = _shift_times(series, times, shift)
    assert [own.corners for own in split_stretches(series, moved)] == [slice(0, 2), slice(2, 3)]
    assert SLIP not in moved.first
    assert (np.diff(moved.time) > 0).all()
