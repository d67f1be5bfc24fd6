"""The contract that every method is held to, whatever it does inside."""

from dataclasses import replace

import numpy as np
import pytest

from processing import methods
from processing.methods import METHODS
from processing.record import series
from processing.record.motion import Motion
from processing.record.setting import Setting
from stickslip.errors import InputError

FIELDS = [name for name in Motion.__dataclass_fields__ if name not in ("window", "order", "method", "corners")]


@pytest.fixture(params=METHODS)
def method(request):
    return request.param


@pytest.fixture(params=["even", "uneven"])
def time(request):
    grid = np.arange(307) * 1e-3
    return grid if request.param == "even" else grid + 2e-4 * np.random.default_rng(5).uniform(-1, 1, grid.size)


def run(method, recording, setting=None):
    return methods.estimate(method, series.from_recording(recording), setting or Setting())


def test_shapes_are_kept_and_errors_are_positive(method, time, imported):
    noise = 1e-5 * np.random.default_rng(1).standard_normal(time.size)
    motion = run(method, imported(time, 0.1 * np.sin(9 * time) + noise))
    for name in FIELDS:
        values = getattr(motion, name)
        assert values.shape == time.shape
        assert np.isfinite(values).all()
        if name.endswith("errors"):
            assert (values > 0).all()


@pytest.mark.parametrize(("start", "speed"), [(0.0, 0.0), (0.3, -0.22)])
def test_a_straight_line_comes_back_exactly_and_zero_as_zero(method, time, imported, start, speed):
    motion = run(method, imported(time, start + speed * time))
    assert motion.position == pytest.approx(start + speed * time, abs=1e-13 * bool(start))
    assert motion.velocity == pytest.approx(np.full(time.size, speed), abs=1e-9 * bool(start))
    assert np.abs(motion.acceleration).max() <= 1e-6 * bool(start)


@pytest.mark.parametrize("gap", [500, 0])
def test_nothing_crosses_a_gap_or_a_segment(method, imported, gap):
    """Either between two halves that are a metre apart: half a second without samples, or a new segment."""
    second = np.arange(400) >= 200
    recording = imported((np.arange(400) + gap * second) * 1e-3, second.astype(float))
    if not gap:
        recording = replace(recording, segment=second.astype(np.uint16))
    motion = run(method, recording, Setting(41, 4) if method == "sg" else None)
    assert np.abs(motion.velocity).max() < 1e-9
    assert motion.position == pytest.approx(second.astype(float), abs=1e-12)


def test_a_lone_sample_between_gaps_has_an_unknown_velocity(method, imported):
    time = np.concatenate((np.arange(100), [200], 300 + np.arange(100))) * 1e-3
    motion = run(method, imported(time, 0.1 * time), Setting(21, 2) if method == "sg" else None)
    assert motion.velocity[100] == 0.0
    assert np.isinf(motion.velocity_errors[100])
    assert np.isfinite(motion.position_errors[100])
    assert np.isfinite(motion.velocity_errors[:100]).all()


@pytest.mark.parametrize(
    ("field", "sample", "value", "message"),
    [
        ("position", 123, np.nan, "position is nan at sample 123"),
        ("position", 123, np.inf, "position is inf at sample 123"),
        ("time", 77, 0.076, "time repeats at sample 77"),
        ("time", 77, 0.074, "time decreases at sample 77"),
        ("time", slice(4, None), None, "has 4 samples, but smoothing needs 5"),
    ],
)
def test_bad_samples_are_refused_by_their_index(method, imported, field, sample, value, message):
    columns = {"time": np.arange(307) * 1e-3, "position": np.sin(np.arange(307) * 1e-3)}
    if value is None:
        columns = {name: np.delete(column, sample) for name, column in columns.items()}
    else:
        columns[field][sample] = value
    with pytest.raises(InputError, match=message):
        run(method, imported(**columns))


def test_the_mirror_image_has_the_mirrored_motion(method, motion, recorded):
    true = motion(5, 3.0)
    run_ = recorded(true)
    mirrored = replace(run_, count=-run_.count, position=-run_.position)
    one, two = run(method, run_), run(method, mirrored)
    assert np.abs(one.velocity + two.velocity).max() < 1e-12
    assert np.abs(one.acceleration + two.acceleration).max() < 1e-9


def test_an_offset_of_2_to_the_60_counts_changes_nothing(method, motion, recorded):
    run_ = recorded(motion(5, 3.0))
    shifted = replace(run_, count=run_.count + 2**60)
    one, two = run(method, run_), run(method, shifted)
    assert np.array_equal(one.velocity, two.velocity)
    assert np.array_equal(one.acceleration, two.acceleration)
