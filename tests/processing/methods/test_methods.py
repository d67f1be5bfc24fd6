"""The contract that every method is held to, whatever it does inside."""

from dataclasses import replace

import numpy as np
import pytest

from processing.methods import registry
from processing.methods.registry import METHODS
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
    return registry.estimate(method, series.from_recording(recording), setting or Setting())


def test_shapes_are_kept_and_errors_are_positive(method, time, imported):
    noise = 1e-5 * np.random.default_rng(1).standard_normal(time.size)
    motion = run(method, imported(time, 0.1 * np.sin(9 * time) + noise))
    for name in FIELDS:
        values = getattr(motion, name)
        assert values.shape == time.shape
        assert np.isfinite(values).all()
        if name.endswith("errors"):
            assert (values > 0).all()


def test_zero_gives_zero(method, time, imported):
    motion = run(method, imported(time, np.zeros(time.size)))
    assert not motion.position.any()
    assert not motion.velocity.any()
    assert not motion.acceleration.any()


def test_a_straight_line_comes_back_exactly(method, time, imported):
    motion = run(method, imported(time, 0.3 - 0.22 * time))
    assert motion.position == pytest.approx(0.3 - 0.22 * time, abs=1e-13)
    assert motion.velocity == pytest.approx(np.full(time.size, -0.22), abs=1e-9)
    assert np.abs(motion.acceleration).max() < 1e-6


@pytest.mark.parametrize(("window", "order"), [(7, 3), (31, 4), (41, 6), (51, 12)])
def test_savitzky_golay_reproduces_polynomials_up_to_its_order(time, imported, window, order):
    s = time / time[-1]
    weights = np.random.default_rng(2).standard_normal(order + 1)
    true = [np.polynomial.Polynomial(weights).deriv(d)(s) / time[-1] ** d for d in range(3)]
    motion = run("sg", imported(time, true[0]), Setting(window, order))
    scale = [max(1.0, np.abs(values).max()) for values in true]
    spread = np.array([1.0, 1e3, 1e6])  # a derivative divides the rounding of x by dt and dt^2
    for found, exact, size, per in zip(
        (motion.position, motion.velocity, motion.acceleration), true, scale, spread, strict=True
    ):
        inner = slice(window // 2, -(window // 2))
        assert np.abs(found - exact)[inner].max() < 1e-12 * max(size, per)
        assert np.abs(found - exact).max() < 1e-11 * max(size, per)  # one-sided at the ends


def test_position_is_told_in_the_recordings_own_coordinates(method, motion, recorded):
    run_ = recorded(motion(5, 3.0))
    found = run(method, run_)
    assert np.abs(found.position - run_.position).max() < 1e-4


def test_nothing_crosses_a_gap(method, imported):
    time = np.concatenate((np.arange(200), 700 + np.arange(200))) * 1e-3
    step = np.where(time < 0.5, 0.0, 1.0)
    motion = run(method, imported(time, step), Setting(41, 4) if method == "sg" else None)
    assert np.abs(motion.velocity).max() < 1e-9
    assert motion.position == pytest.approx(step, abs=1e-12)


def test_nothing_crosses_a_segment(method, imported):
    time = np.arange(400) * 1e-3
    step = np.where(np.arange(400) < 200, 0.0, 1.0)
    segment = (np.arange(400) >= 200).astype(np.uint16)
    motion = run(method, replace(imported(time, step), segment=segment), Setting(41, 4) if method == "sg" else None)
    assert np.abs(motion.velocity).max() < 1e-9


def test_a_lone_sample_between_gaps_has_an_unknown_velocity(method, imported):
    time = np.concatenate((np.arange(100), [200], 300 + np.arange(100))) * 1e-3
    motion = run(method, imported(time, 0.1 * time), Setting(21, 2) if method == "sg" else None)
    assert motion.velocity[100] == 0.0
    assert np.isinf(motion.velocity_errors[100])
    assert np.isfinite(motion.position_errors[100])
    assert np.isfinite(motion.velocity_errors[:100]).all()


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_number_that_is_not_finite_is_refused_by_its_index(method, time, imported, bad):
    position = np.sin(time)
    position[123] = bad
    with pytest.raises(InputError, match=r"position is (nan|inf) at sample 123"):
        run(method, imported(time, position))


def test_a_repeated_time_is_refused_by_its_index(method, time, imported):
    time = time.copy()
    time[77] = time[76]
    with pytest.raises(InputError, match="time repeats at sample 77"):
        run(method, imported(time, np.sin(time)))


def test_a_decreasing_time_is_refused_by_its_index(method, time, imported):
    time = time.copy()
    time[77] = time[74]
    with pytest.raises(InputError, match="time decreases at sample 77"):
        run(method, imported(time, np.sin(time)))


def test_too_few_samples_are_refused(method, imported):
    with pytest.raises(InputError, match="holds 4 samples; smoothing needs 5"):
        run(method, imported(np.arange(4.0), np.arange(4.0)))


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


def test_an_unknown_method_names_the_known_ones():
    with pytest.raises(InputError, match="method is 'spline'; known: auto, segment, rts, sg, fd"):
        registry.check_method("spline")


def test_finite_differences_have_no_window(imported):
    with pytest.raises(InputError, match="finite differences have no window"):
        run("fd", imported(np.arange(9.0), np.arange(9.0)), Setting(5, 2))
