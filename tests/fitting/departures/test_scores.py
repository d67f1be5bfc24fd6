"""Score tests: the departure that was put in comes first, with its size; none where a law is right.

The contacts are made by a generator that shares nothing with rig_sim (tests/rig.py).
"""

import math
import warnings
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from fitting.data import frame
from fitting.departures import strongest as strongest_module
from fitting.departures.library import departures
from fitting.departures.scores import Score, score, sigmas
from fitting.departures.strongest import best_scale, describe, gains, misfit_beyond_noise, strongest
from fitting.forces.fitted_motion import FittedMotion
from fitting.model.parameters import Global
from fitting.sensitivity.path import follow
from processing.smoothing import smooth

K = 10.5552
OMEGA = 5 * math.sqrt(35.184)
CASES = {  # name: what is put in, the size that must come back, and how near one linear step comes to it
    "spring-nonlinear": ({"k3": 0.05 * K / 0.177**2}, 0.05 * K / 0.177**2 / 0.3, 0.05),
    "guide-friction": ({"guide": 0.05}, 0.05 / 0.3, 0.15),
    "eccentricity": ({"eccentricity": (5e-4, 0.12566)}, 5e-4, 0.05),
    "belt-drift": ({"belt_drift": 0.02}, 0.001, 0.05),
    "stiffness-drift": ({"stiffness_drift": -0.02}, -0.001, 0.05),
    "belt-ripple": ({"ripple": ((0.015, 0.7), (0.01, 2.9))}, 0.0022, 0.05),
    "second-mode": ({"second_mass": (0.006, 0.006 * OMEGA**2, 0.006 * 0.02 * OMEGA)}, 0.02, 0.15),
    "friction-by-belt-position": ({"by_belt_position": (0.05, 1.6)}, 0.05, 0.1),
    "friction-by-mass-position": ({"by_mass_position": (0.05, 0.1)}, 0.05, 0.1),
}


def found_in(base, noise=0.0):
    record, excess = base.trajectory.records[0], misfit_beyond_noise(base.linear, noise)
    return tuple(describe(one, record, excess) for one in strongest(base))


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_the_departure_that_was_put_in_comes_first_with_its_size(base_of, name):
    changes, size, near = CASES[name]
    found = found_in(base_of(scatter=0.03, **changes))
    assert found[0].name == name
    assert found[0].value == pytest.approx(size, rel=near)
    assert found[0].sigmas > 4


def test_a_hard_spring_is_found_and_not_friction_by_position(base_of):
    """What used to happen: law 5 alone, k/m wrong by sixty standard errors, and not a word."""
    base = base_of(scatter=0.03, k3=0.05 * K / 0.177**2)
    found = found_in(base, noise=7.67e-6 / math.sqrt(12))
    assert found[0].name == "spring-nonlinear"
    assert found[0].value == pytest.approx(56.15, rel=0.05)
    assert found[0].explained > 0.8
    assert found[0].unit == "m^-2 s^-2"


def test_a_contact_of_the_fitted_law_shows_no_departure(base_of):
    assert found_in(base_of(scatter=0.03)) == ()


@pytest.mark.parametrize(("size", "shown"), [(0.1, True), (-0.1, False)])
def test_a_force_by_the_velocity_that_would_push_is_not_shown(base_of, monkeypatch, size, shown):
    """A guide of -0.31 N was the strongest departure of a LuGre contact."""
    tested = Score(np.array([size]), np.array([[1e-6]]), gain=1e6, log_p=-200.0, kept=1.0)
    monkeypatch.setattr(strongest_module, "score", lambda base, columns, widths: [tested] * len(widths))
    names = {one.departure.name for one in strongest(base_of(scatter=0.03))}
    assert "spring-nonlinear" in names
    assert ("guide-friction" in names) == ("drag-quadratic" in names) == shown


def test_the_drift_of_a_belt_is_relative_to_its_speed_without_it(base_of):
    """It was that of the path before, drift included: a refit left 1.17 times the noise of counts of 7.67 um."""
    base = base_of(scatter=0.03)
    path = base.path
    drifting = follow(
        path.windows,
        path.curve,
        path.u,
        path.local,
        along=path,
        belt_speed=1e-3 * base.trajectory.elapsed * path.belt_speed,
    )
    trajectory = FittedMotion.from_path(drifting, base.trajectory.records, drifting.residual)
    assert np.ptp(drifting.belt_speed) > 1e-3
    (drift,) = (departure for departure in departures() if departure.name == "belt-drift")
    forced = drift.forcing(trajectory, math.nan).belt_speed[:, 0]
    assert forced == pytest.approx(path.unknown(Global.V_DR) * trajectory.elapsed, rel=1e-12)


def test_a_response_beyond_all_numbers_explains_nothing():
    """It was multiplied all the same: an overflow, with a warning on the terminal."""
    numbers = {"raw": [1e300, np.inf, 1.0, 1.0], "total": [1e200, 1.0, 2.0, 0.0]}
    information = np.diag([1e300, np.inf, 1.0, 1.0])
    scores = SimpleNamespace(
        total_information=information, **{name: np.array(values) for name, values in numbers.items()}
    )
    base = SimpleNamespace(
        trajectory=None,
        respond=lambda forcings: np.zeros((3, 4)),
        linear=SimpleNamespace(scores=lambda columns: scores),
    )
    departure = SimpleNamespace(columns=2, forcing=lambda trajectory, scale: None)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert gains(base, departure, np.array([1.0, 2.0])) == pytest.approx([0.0, 2.0])


def test_a_known_revolution_is_not_scanned(base_of):
    base = base_of(scatter=0.03)
    eccentricity = next(departure for departure in departures() if departure.name == "eccentricity")
    from dataclasses import replace

    known = replace(base, trajectory=replace(base.trajectory, revolution=0.12566))
    assert best_scale(known, eccentricity) == (0.12566, 1)
    assert best_scale(base, eccentricity)[1] > 20


def test_blocks_of_samples_give_the_gains_of_all_samples(base_of):
    base = base_of(scatter=0.03, k3=0.05 * K / 0.177**2)
    departure = next(departure for departure in departures() if departure.name == "friction-by-mass-position")
    scales = np.array([0.1, 0.15, 0.2])
    np.testing.assert_allclose(gains(base.thinned(), departure, scales), gains(base, departure, scales), rtol=0.1)


def test_a_column_that_the_fit_already_adjusts_is_not_tested(base_of):
    base = base_of(scatter=0.03)
    assert score(base.linear, base.linear.derivatives.columns(slice(1)) * 3.0, [1]) == [None]


def test_more_trials_take_standard_deviations_away():
    assert sigmas(math.log(2 * 2.866515719235352e-07)) == pytest.approx(5.0)  # two tails of a normal variable
    assert sigmas(-20.0, 100) < sigmas(-20.0)
    assert sigmas(-2000.0) == pytest.approx(63.1, abs=0.2)  # beyond what a tail can be written as a number
    assert sigmas(-1.0, 1e6) == 0.0


def test_of_equal_explanations_the_one_with_fewest_parameters_comes_first(base_of):
    found = strongest(base_of(scatter=0.03, k3=0.05 * K / 0.177**2))
    equal = [tested for tested in found if tested.score.gain > 0.96 * max(one.score.gain for one in found)]
    assert len(equal) > 1
    assert found[0].parameters == 1


def test_two_columns_that_do_the_same_end_in_no_error(base_of):
    base = base_of(scatter=0.03)
    column = np.sin(np.arange(base.linear.residual.size) * 0.01)[:, np.newaxis]
    found = score(base.linear, np.hstack([column, column]), [2])[0]
    assert found is None or np.isfinite(found.gain)


def test_what_one_cycle_alone_shows_is_not_tested():
    """What the other cycles show of it was rounding, and its inverse overflowed."""
    information = np.full((8, 1, 1), 1e-20)
    information[3] = 1e20
    gradient = np.sqrt(information[:, :, 0])
    whole, total = (1 - 2e-16) * information.sum(axis=0), gradient.sum(axis=0)
    linear = SimpleNamespace(
        scores=lambda columns: SimpleNamespace(
            information=information, score=gradient, total_information=whole, total=total, raw=np.diag(whole)
        )
    )
    with np.errstate(all="raise"):
        assert score(linear, np.ones((8, 1)), [1]) == [None]


@pytest.mark.parametrize(
    ("sensor", "counted", "words"),
    [("encoder", True, "an eccentric encoder wheel"), ("camera", False, "lens distortion or an uneven scale")],
)
def test_an_error_of_the_reading_is_named_by_what_read_it(belt_rig, sensor, counted, words):
    """Camera tracks with lens distortion were reported with "an eccentric encoder wheel"; the name of the row stays."""
    recording = belt_rig.recording(law=5, duration=6.0)
    if sensor == "encoder":
        count = np.rint(recording.position / recording.rig.metres_per_count.value).astype(np.int64)
        recording = replace(recording, count=count)
    record = frame.from_kinematics(smooth(recording), recording.rig, None)
    assert record.counted == counted
    eccentricity = next(departure for departure in departures() if departure.name == "eccentricity")
    score = SimpleNamespace(coefficients=np.array([3e-4, 4e-4]), covariance=np.eye(2) * 1e-12, gain=1.0)
    found = describe(strongest_module.Tested(eccentricity, 0.1, score, 9.0), record, 2.0)
    assert (found.name, found.text, found.value) == ("eccentricity", words, pytest.approx(5e-4))
