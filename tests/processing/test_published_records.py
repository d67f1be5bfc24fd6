"""Published force records of paper on paper (2 kHz, 18 spikes a second), against a detector that shares no model."""

import numpy as np
import pytest

from daq.runfile import store
from processing import smoothing

DROPS, DROPS_IN_A_MINUTE = 207, 33  # of k168Nm_v42, by `drops`
BELTS = {"k168Nm_v42": 42, "k168Nm_v1100": 1100, "k168Nm_v4300": 4300}  # um/s

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def file(published, tmp_path_factory):
    path = tmp_path_factory.mktemp("published") / "v42.h5"
    store.write(path, published("k168Nm_v42"))
    return path


@pytest.fixture(scope="module")
def whole(file, smoothing_kernels):
    """Return the summary of the whole record, smoothed as the command does."""
    return smoothing.smooth_file(file)


def drops(position, fall=0.02, rise=0.01):
    """Count falls of more than ``fall`` from the last maximum, each after a rise of ``rise``; medians of 5 samples."""
    smooth = np.median(np.lib.stride_tricks.sliding_window_view(position, 5), axis=1)
    count, falling, extreme = 0, False, smooth[0]
    for value in smooth.tolist():
        if falling:
            extreme = min(extreme, value)
            if value - extreme > rise:
                falling, extreme = False, value
        else:
            extreme = max(extreme, value)
            if extreme - value > fall:
                falling, extreme, count = True, value, count + 1
    return count


def test_slips_of_a_minute_are_the_drops_of_a_plain_detector(file):
    minute = store.load(file, slice(0, 120_000))
    assert drops(minute.position) == DROPS_IN_A_MINUTE
    assert len(smoothing.smooth(minute).slips) == pytest.approx(DROPS_IN_A_MINUTE, rel=0.15)


def test_slips_of_a_long_record_are_the_drops_of_a_plain_detector(file, whole):
    assert drops(store.load(file).position) == DROPS
    assert len(whole.slips) == pytest.approx(DROPS, rel=0.15)


def test_slips_last_as_long_as_the_force_falls(published, whole):
    # Creep and the smear of the filter counted as slip (0.16 s), and of 15 slips a second three in all were found.
    lasting = np.median([slip.duration for slip in whole.slips])
    assert 0.02 < lasting < 0.04
    assert 30 <= len(smoothing.smooth(published("k168Nm_v4300")).slips) <= 53


def test_belt_slopes_are_in_the_ratio_of_the_belt_speeds(published, whole):
    # The force grows with the stretch of the spring: its slope in the sticks is the belt's speed, times one constant.
    slope = {name: smoothing.smooth(published(name)).belt_speed for name in list(BELTS)[1:]}
    slope["k168Nm_v42"] = whole.belt_speed
    scale = [slope[name] / speed for name, speed in BELTS.items()]
    assert np.array(scale) == pytest.approx(np.full(3, scale[0]), rel=0.05)
