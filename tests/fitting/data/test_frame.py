"""How long slips last, as the fit's frame sees it."""

import numpy as np
import pytest

import processing
from daq.runfile.rig import Rig
from fitting.data import frame


@pytest.mark.parametrize("rate", [11.0, 12.0, 16.0, 25.0, 100.0])
@pytest.mark.parametrize("belt", [0.08, 0.22, 0.3])
def test_a_slip_lasts_from_break_away_to_landing(belt_rig, tmp_path, rate, belt):
    """A slip was as long as the mass is slower than half the belt's speed: down to 0.6 of that."""
    contact = belt_rig.Contact(duration=40.0, belt=belt)
    time, position = belt_rig.recorded(contact, rate=rate, count=0.0)
    true = belt_rig.follow(contact, time)
    expected = float(np.median(true.landings[1:] - true.break_aways[1 : true.landings.size])) * rate
    record = belt_rig.imported(tmp_path / "track.csv", time, position, decimals=9)
    found = frame.from_kinematics(processing.smooth(record), Rig(), None).samples_per_slip
    assert found == pytest.approx(expected, rel=0.2)
