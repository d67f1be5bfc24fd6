"""How long a slip lasts, as a record shows it, beside the events of a simulator that shares nothing with ours."""

from functools import cache

import numpy as np
import pytest

from fitting.record.motion import harmonic_share
from processing.smoothing import smooth

from ..frames import in_frame


def test_the_harmonic_share_is_that_of_a_harmonic_motion():
    for share in (0.1, 0.5, 1.0):
        slow = np.pi + 2 * np.arcsin(share / 2)  # of amplitude 1 and frequency 1, slower than half the belt
        assert harmonic_share(share * slow / 2) == pytest.approx(share, abs=1e-6)


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
    found = in_frame(smooth(record)).samples_per_slip
    assert found == pytest.approx(lasts * rate, rel=0.2)
