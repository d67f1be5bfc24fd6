"""Score tests: the departure that was put in comes first, with its size; none where a law is right.

The contacts are made by a generator that shares nothing with rig_sim (tests/rig.py).
"""

import math
import warnings
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from fitting.judge import departures
from fitting.judge.departures import (
    amplitude,
    best_scale,
    find_candidates,
    linear_steps,
    rank_candidates,
    sigmas,
)
from fitting.judge.library import DEPARTURES
from fitting.model.forces import FittedMotion, Forcing
from fitting.model.path import follow
from fitting.model.unknowns import Global

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


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_the_departure_that_was_put_in_comes_first_with_its_size(base_of, name):
    changes, size, near = CASES[name]
    first = rank_candidates([base_of(scatter=0.03, **changes)], 0.0)[0]
    assert first.departure.name == name
    found = first.size[0] if first.size.size == 1 else np.hypot(*first.size)
    assert found == pytest.approx(size, rel=near)


def test_a_hard_spring_is_found_and_not_friction_by_position(base_of):
    """What used to happen: law 5 alone, k/m wrong by sixty standard errors, and not a word."""
    base = base_of(scatter=0.03, k3=0.05 * K / 0.177**2)
    ranked = {candidate.departure.name: candidate for candidate in rank_candidates([base], 7.67e-6 / math.sqrt(12))}
    first = ranked["spring-nonlinear"]
    assert all(0.9 * other.explained < first.explained for other in ranked.values())  # so it is fitted beside them
    assert first.size == pytest.approx([56.15], rel=0.05)
    assert first.explained > 0.8


def test_a_contact_of_the_fitted_law_shows_no_departure(base_of):
    assert find_candidates(base_of(scatter=0.03), 0.0) == []


@pytest.mark.parametrize(("size", "shown"), [(0.1, True), (-0.1, False)])
def test_a_force_by_the_velocity_that_would_push_is_not_shown(base_of, monkeypatch, size, shown):
    """A guide of -0.31 N was the strongest departure of a LuGre contact."""
    monkeypatch.setattr(departures, "linear_steps", lambda *_: (np.full((1, 2), size), np.array([1e6])))
    names = {candidate.departure.name for candidate in find_candidates(base_of(scatter=0.03), 0.0)}
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
        belt_speed=1e-3 * base.motion.elapsed * path.belt_speed,
    )
    trajectory = FittedMotion.from_path(drifting, base.motion.records, drifting.residual)
    assert np.ptp(drifting.belt_speed) > 1e-3
    (drift,) = (departure for departure in DEPARTURES if departure.name == "belt-drift")
    forced = drift.forcing(trajectory, math.nan).belt_speed[:, 0]
    assert forced == pytest.approx(path.unknown(Global.V_DR) * trajectory.elapsed, rel=1e-12)


def test_a_response_beyond_all_numbers_explains_nothing():
    """It was multiplied all the same: an overflow, with a warning on the terminal."""
    numbers = {"raw": [1e300, np.inf, 1.0, 1.0], "gradient": [1e200, 1.0, 2.0, 0.0]}
    information = np.diag([1e300, np.inf, 1.0, 1.0])
    scores = SimpleNamespace(information=information, **{name: np.array(values) for name, values in numbers.items()})
    base = SimpleNamespace(
        motion=None,
        respond=lambda forcings: np.zeros((3, 4)),
        linear=SimpleNamespace(scores=lambda columns: scores),
    )
    departure = SimpleNamespace(columns=2, forcing=lambda trajectory, scale: None)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert linear_steps(base, departure, np.array([1.0, 2.0]))[1] == pytest.approx([0.0, 2.0])


def test_a_known_revolution_is_not_scanned(base_of):
    base = base_of(scatter=0.03)
    eccentricity = next(departure for departure in DEPARTURES if departure.name == "eccentricity")
    known = replace(base, motion=replace(base.motion, revolution=0.12566))
    assert best_scale(known, eccentricity) == 0.12566
    assert best_scale(base, eccentricity) != pytest.approx(0.12566, rel=1e-3)


def test_a_thinned_record_chooses_the_same_scale(base_of):
    base = base_of(scatter=0.03, k3=0.05 * K / 0.177**2)
    departure = next(departure for departure in DEPARTURES if departure.name == "friction-by-mass-position")
    thin = base.thinned()
    assert thin.linear.residual.size < 0.5 * base.linear.residual.size
    assert best_scale(thin, departure) == pytest.approx(best_scale(base, departure), rel=0.1)


@pytest.fixture
def steps_along(base_of):
    """Give a function that returns the gain of a step along readings that err by columns (N, k)."""
    base = base_of(scatter=0.03)

    def gain(columns):
        departure = SimpleNamespace(columns=columns.shape[1], forcing=lambda *_: Forcing(reading=columns))
        return float(linear_steps(base, departure, np.array([math.nan]))[1][0])

    return base, gain


def test_a_column_that_the_fit_already_adjusts_explains_nothing(steps_along):
    base, gain = steps_along
    assert gain(base.linear.derivatives.columns(slice(1)) * 3.0) == 0


def test_more_trials_take_standard_deviations_away():
    assert sigmas(math.log(2 * 2.866515719235352e-07)) == pytest.approx(5.0)  # two tails of a normal variable
    assert sigmas(-20.0, 100) < sigmas(-20.0)
    assert sigmas(-2000.0) == pytest.approx(63.1, abs=0.2)  # beyond what a tail can be written as a number
    assert sigmas(-1.0, 1e6) == 0.0


def test_two_columns_that_do_the_same_end_in_no_error(steps_along):
    base, gain = steps_along
    column = np.sin(np.arange(base.linear.residual.size) * 0.01)[:, np.newaxis]
    assert np.isfinite(gain(np.hstack([column, column])))


@pytest.mark.parametrize(
    ("counted", "words"), [(True, "an eccentric encoder wheel"), (False, "lens distortion or an uneven scale")]
)
def test_an_error_of_the_reading_is_named_by_what_read_it(counted, words):
    """Camera tracks with lens distortion were reported with "an eccentric encoder wheel"; the name of the row stays."""
    eccentricity = next(departure for departure in DEPARTURES if departure.name == "eccentricity")
    assert eccentricity.says(counted=counted) == words


def test_a_sine_and_a_cosine_are_one_amplitude():
    found = amplitude(np.array([3e-4, 4e-4]), np.stack([np.eye(2) * 1e-12, np.eye(2) * 1e-13]))
    assert (found.value, found.sd) == pytest.approx((5e-4, 1e-6))
