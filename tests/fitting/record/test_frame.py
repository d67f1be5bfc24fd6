"""How long slips last, as the fit's frame sees it."""

from functools import cache

import numpy as np
import pytest

import processing
from daq.runfile.rig import Rig
from fitting.record import motion

RATES, DURATION = (11.0, 12.0, 16.0, 25.0, 100.0), 40.0


def times(rate):
    return np.arange(round(DURATION * rate)) / rate


@pytest.fixture(scope="module")
def followed(belt_rig):
    """Give a function that follows a contact on a belt: times of all rates, positions, and how long a slip lasts, s."""

    @cache
    def of(belt):
        time = np.unique(np.concatenate([times(rate) for rate in RATES]))
        true = belt_rig.follow(belt_rig.Contact(duration=DURATION, belt=belt), time)
        slips = true.landings[1:] - true.break_aways[1 : true.landings.size]
        return time, true.position, float(np.median(slips))

    return of


@pytest.mark.parametrize("rate", RATES)
@pytest.mark.parametrize("belt", [0.08, 0.22, 0.3])
def test_a_slip_lasts_from_break_away_to_landing(followed, belt_rig, tmp_path, rate, belt):
    """A slip was as long as the mass is slower than half the belt's speed: down to 0.6 of that."""
    time, position, lasts = followed(belt)
    own = np.searchsorted(time, times(rate))
    record = belt_rig.imported(tmp_path / "track.csv", time[own], position[own], decimals=9)
    found = motion.from_kinematics(processing.smooth(record), Rig(), None).samples_per_slip
    assert found == pytest.approx(lasts * rate, rel=0.2)
