"""Arrays in: a run of them is that of the file they came from, and a wrong array is named with what to do."""

import re
from typing import Any

import numpy as np
import pytest

import daq
import processing
from daq.runfile.in_memory import find_last_decimal
from stickslip.errors import InputError
from stickslip.units import Measured

TIME = np.arange(1500) / 500
X = 0.01 * np.sin(6 * TIME)


def run(**changes: Any) -> daq.Recording:
    return daq.Recording.from_arrays(TIME, X, **changes)


def test_arrays_are_kept_to_the_last_bit_and_times_begin_with_0():
    found = daq.Recording.from_arrays(TIME + 100, X)
    np.testing.assert_array_equal(found.position, X)
    np.testing.assert_array_equal(found.time, TIME + 100 - 100.0)
    assert (found.unit, found.count, found.rate_hz) == ("m", None, pytest.approx(500, abs=1e-9))


@pytest.mark.parametrize(
    "columns",
    [
        (TIME.tolist(), X.tolist()),
        (tuple(TIME), X.astype(object)),
        (__import__("pandas").Series(TIME), __import__("pandas").Series(X)),
        (__import__("xarray").DataArray(TIME), __import__("xarray").DataArray(X)),
        (np.ma.array(TIME), X[::-1][::-1]),
    ],
    ids=["lists", "tuple and objects", "pandas", "xarray", "views"],
)
def test_any_sequence_of_numbers_is_an_array(columns):
    found = daq.Recording.from_arrays(*columns)
    np.testing.assert_array_equal(found.position, X)
    np.testing.assert_array_equal(found.time, TIME)


@pytest.mark.parametrize("value", [0.5, (0.5, 0.001), "500 g +- 1 g", "0.5", np.float32(0.5), Measured(0.5, 0.1), 1])
def test_a_quantity_is_a_number_a_pair_or_a_text_with_a_unit(value):
    mass = run(mass=value).rig.mass
    assert mass.value == (1 if value == 1 else 0.5)
    assert mass.sd == {str: 0.001, tuple: 0.001, Measured: 0.1}.get(type(value), 0.0) * (value != "0.5")


def test_every_quantity_reaches_the_rig_in_si():
    rig = run(
        mass="300 g", stiffness="10.5 N/mm", belt_speed="-5 cm/s", x0="-60 mm +- 0.1 mm", damping=(0.02, 0.001)
    ).rig
    assert (rig.mass, rig.stiffness, rig.belt_speed) == (Measured(0.3), Measured(10500.0), Measured(-0.05))
    assert rig.x0 == Measured(pytest.approx(-0.06), pytest.approx(1e-4))
    assert (rig.damping, rig.datum) == (Measured(0.02, 0.001), None)


def test_integers_are_counts_of_their_pitch_and_without_one_counts():
    count = np.rint(X / 7.67e-6).astype(np.int32)
    found = daq.Recording.from_arrays(TIME, count, metres_per_count="7.67 um")
    np.testing.assert_array_equal(found.count, count)
    np.testing.assert_allclose(found.position, count * 7.67e-6, rtol=1e-15)
    bare = daq.Recording.from_arrays(TIME, count)
    assert bare.unit == "count"
    np.testing.assert_array_equal(bare.position, count)
    whole = daq.Recording.from_arrays(TIME, count.astype(float), metres_per_count=7.67e-6)
    np.testing.assert_array_equal(whole.count, count)


def test_positions_of_a_belt_become_counts_of_their_last_decimal():
    belt = np.round(0.0513 * TIME, 5)
    found = run(belt_position=belt)
    assert found.rig.belt_metres_per_count == Measured(1e-5)
    np.testing.assert_allclose(found.belt_count * 1e-5, belt, atol=1e-12)
    np.testing.assert_allclose(found.belt_velocity, 0.0513, atol=1e-3)
    assert run(belt_position=0.05 * TIME + 1e-7 * X).rig.belt_metres_per_count == Measured(1e-9)
    motion = processing.smooth(run(belt_position=0.05 * TIME))
    np.testing.assert_allclose(motion.belt_velocity[100:-100], 0.05, atol=1e-6)
    assert [find_last_decimal(np.array([0.0, value])) for value in (3.0, 0.25, 0.0012)] == [1.0, 0.01, 1e-4]


def test_a_run_of_arrays_is_saved_and_loaded_as_it_was(tmp_path):
    made = run(mass="300 g", x0="1 mm", belt_position=0.05 * TIME, title="a contact")
    assert made.save(tmp_path / "run.h5") == tmp_path / "run.h5"
    found = daq.load(tmp_path / "run.h5")
    np.testing.assert_array_equal(found.position, made.position)
    np.testing.assert_array_equal(found.belt_count, made.belt_count)
    assert (found.rig.mass, found.rig.x0, found.title) == (made.rig.mass, made.rig.x0, "a contact")
    assert (found.started, found.ended) == (made.started, made.ended)
    with pytest.raises(InputError, match="exists"):
        made.save(tmp_path / "run.h5")
    made.save(tmp_path / "run.h5", force=True)
    with pytest.raises(InputError, match="CSV"):
        made.save(tmp_path / "run.csv")


def test_a_run_is_drawn_into_axes_that_are_given():
    figure = run().plot()
    (axes,) = figure.axes
    assert len(axes.lines) == 1
    other = type(figure)()
    left, right = other.subfigures(1, 2)
    place = right.subplots()
    assert run().plot(ax=place) is other
    assert (len(place.lines), left.axes) == (1, [])


@pytest.mark.parametrize(
    ("columns", "changes", "words"),
    [
        ((TIME, X[:-1]), {}, "time has 1500 values, but position has 1499; pass one value"),
        ((TIME, np.c_[X, X]), {}, "position has shape (1500, 2); pass one dimension, as in position[:, 0]"),
        ((TIME[::-1], X), {}, "time does not increase at sample 1; pass increasing times in s"),
        ((np.zeros(1500), X), {}, "time does not increase at sample 1"),
        ((TIME, np.where(TIME == 1, np.nan, X)), {}, "position is nan at sample 500; remove those samples: keep ="),
        ((TIME, ["a"] * 1500), {}, "position contains <U1 values instead of numbers"),
        ((TIME, [None, "x", *X[2:]]), {}, "position contains None instead of numbers"),
        (
            (TIME.astype("M8[s]"), X),
            {},
            "time contains dates or durations instead of numbers; convert them to seconds: (t - t[0])",
        ),
        (([[0], [1, 2]], X), {}, "time is not an array of numbers"),
        (([0.0], [1.0]), {}, "time and position have 1 sample(s); pass two or more"),
        ((TIME, X), {"mass": "500 gg"}, "mass: 'gg' is not a unit of mass (in '500 gg'); did you mean 'g'?"),
        ((TIME, X), {"mass": -1}, "mass: mass is -1; it must be positive"),
        ((TIME, X), {"mass": [1, 2, 3]}, "pass a number in kg, (value, sd), or text such as '300 g'"),
        ((TIME, X), {"x0": "5 cm/s"}, "x0: 'cm/s' is not a unit of length"),
        ((TIME, X), {"metres_per_count": 1e-6}, "not a count, but metres_per_count is given; pass whole counts"),
        ((TIME, X), {"belt_position": X[:10]}, "belt_position has 10 values, but time has 1500"),
    ],
)
def test_a_wrong_array_or_quantity_is_named_with_what_to_do(columns, changes, words):
    with pytest.raises(InputError, match=re.escape(words)) as caught:
        daq.Recording.from_arrays(*columns, **changes)
    assert "--" not in str(caught.value)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((TIME,), "a ndarray without a position; pass a run, a file or two arrays: processing.smooth(time, position)"),
        ((run(), X), "a position was passed in addition to a run; pass only the run"),
        (("no.h5",), "no.h5: no such file"),
    ],
)
def test_smoothing_says_which_call_to_make(arguments, words):
    with pytest.raises(InputError, match=re.escape(words)):
        processing.smooth(*arguments)


def test_arrays_and_files_are_smoothed_as_their_run_is(tmp_path):
    run().save(tmp_path / "run.h5")
    np.savetxt(tmp_path / "run.csv", np.c_[TIME, X], delimiter=",", header="t (s),x (m)", comments="")
    velocity = processing.smooth(run(), method="rts").velocity
    np.testing.assert_array_equal(processing.smooth(TIME, X, method="rts").velocity, velocity)
    for name in ("run.h5", "run.csv"):
        np.testing.assert_allclose(processing.smooth(tmp_path / name, method="rts").velocity, velocity, rtol=1e-9)
