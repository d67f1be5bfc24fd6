"""Camera tracks, bare of calibration: 400 frames a second, 0.2 or 1 mm of noise, the decimals that a program prints."""

import pytest

from fitting.judge.evidence import constant_friction_limit
from processing.smoothing import smooth

from ..frames import cut, in_frame


@pytest.fixture
def track(belt_rig, tmp_path):
    """Give a function that imports a camera track: ``track(law, noise, seed, decimals)``."""

    def of(law, noise, seed=1, decimals=5, **changes):
        time, position = belt_rig.camera(law, noise, seed, **changes)
        return belt_rig.imported(tmp_path / "track.csv", time, position, decimals)

    return of


def test_a_start_at_rest_is_seen_and_no_ripple_under_a_millimetre_of_noise(track):
    # Noise in the velocity hid the rest, and the best of many frequencies passed for a ripple of the belt.
    run = cut(smooth(track(5, 1e-3)))
    assert run.cut.starts_at_rest
    assert run.ripple is None


def test_constant_friction_is_judged_by_noise_where_noise_hides_the_step(track):
    limits = [constant_friction_limit(in_frame(smooth(track(2, 2e-4, decimals=decimals)))) for decimals in (4, 6)]
    assert limits[0] == pytest.approx(limits[1], rel=0.05)
    assert max(limits) < 1.4 * 2e-4
