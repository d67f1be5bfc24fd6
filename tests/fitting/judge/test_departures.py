"""What departs from a law is named, with its size, by fitting the law together with it; none where a law is right."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from fitting.judge import departures
from fitting.judge.departures import (
    Base,
    explain_misfit,
    find_best_scale,
    find_candidates,
    fit_departure,
)
from fitting.judge.library import DEPARTURES

K = 10.5552
OMEGA = 5 * math.sqrt(35.184)
NOISE = 7.67e-6 / math.sqrt(12)
HARD = 0.05 * K / 0.177**2
LIBRARY = {departure.name: departure for departure in DEPARTURES}


def explained(fit, chi=40.0, describes=lambda refit: True, **laws):
    """Explain the misfit of a law beside a free curve that shows no departure of its own."""
    curve = SimpleNamespace(chi=chi, linear=None, spline_fit=None, confidence=0.95)
    with pytest.MonkeyPatch.context() as patch:
        at = Base.at
        patch.setattr(departures.Base, "at", lambda fit, *args: None if fit is None else at(fit, *args))
        return explain_misfit([fit, *laws.values()], curve, fit.problem.motions, NOISE, None, describes)


def test_a_hard_spring_is_fitted_with_the_law(departing):
    """Law 5 alone was named, with k/m wrong by sixty standard errors, and not a word."""
    first = explained(departing(k3=HARD))[0]
    assert (first.name, first.refitted, first.law) == ("spring-nonlinear", True, 5)
    assert first.value == pytest.approx(HARD / 0.3, rel=0.01)
    assert abs(first.value - HARD / 0.3) < 4 * first.stderr
    gamma = first.as_json()["parameters"]["gamma"]
    assert gamma["lo"] < 9.618 < gamma["hi"]
    assert gamma["stderr"] < 0.02 * gamma["value"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "changes", "size", "near"),
    [
        ("guide-friction", {"guide": 0.05}, 0.05 / 0.3, 0.05),
        # Its force was that along the path before: the refit ended 40 % off with the free curve, or was given up.
        ("guide-friction", {"guide": 0.15}, 0.15 / 0.3, 0.003),
        ("guide-friction", {"guide": 0.25, "gamma": 4.0}, 0.25 / 0.3, 0.003),
        ("eccentricity", {"eccentricity": (5e-4, 0.12566)}, 5e-4, 0.05),
        # It was relative to the speed of the path before, drift included: 1.17 times the noise was left.
        ("belt-drift", {"belt_drift": 0.02}, 0.001, 0.05),
        ("stiffness-drift", {"stiffness_drift": -0.02}, -0.001, 0.05),
        ("belt-ripple", {"ripple": ((0.015, 0.7), (0.01, 2.9))}, 0.0022, 0.05),
        ("second-mode", {"second_mass": (0.006, 0.006 * OMEGA**2, 0.006 * 0.02 * OMEGA)}, 0.02, 0.05),
        ("friction-by-belt-position", {"by_belt_position": (0.05, 1.6)}, 0.05, 0.05),
        # Its fit reached the noise, and was then refused: one step beside its wavelength showed it in no two cycles.
        ("friction-by-mass-position", {"by_mass_position": (0.05, 0.1)}, 0.05, 0.05),
    ],
)
def test_the_size_of_what_was_put_in_comes_back(departing, name, changes, size, near):
    first = explained(departing(**changes))[0]
    assert (first.name, first.refitted, first.law) == (name, True, 5)
    assert first.value == pytest.approx(size, rel=near)
    assert 0 < first.stderr < near * abs(first.value)


@pytest.mark.slow
def test_a_drag_that_the_free_curve_takes_up_is_fitted_with_the_law(departing):
    """A linear step alone gave its size: 9 % too little."""
    first = explained(departing(drag=0.15), chi=1.0, describes=lambda refit: refit.median_rms < 1.05 * NOISE)[0]
    assert (first.name, first.refitted, first.law) == ("drag-quadratic", True, 5)
    assert first.value == pytest.approx(0.15 / 0.3, rel=0.04)
    assert abs(first.value - 0.15 / 0.3) < 4 * first.stderr


@pytest.mark.slow
def test_the_law_is_found_together_with_the_departure(departing):
    """Law 3 on a hard spring: without a datum law 3 alone ends 0.28 m off, and law 5 fits better."""
    changes = {"curve": "linear", "k3": 0.05 * K / 0.195**2}
    first = explained(departing(law=5, **changes), right=departing(law=3, **changes))[0]
    assert (first.name, first.law) == ("spring-nonlinear", 3)
    assert first.value == pytest.approx(0.05 * K / 0.195**2 / 0.3, rel=0.02)


def test_a_departure_that_is_not_there_is_not_confirmed(departing, base_of):
    found = find_candidates(base_of(k3=HARD), NOISE)
    (other,) = (candidate for candidate in found if candidate.departure.name == "second-mode")
    assert fit_departure(other, [departing(k3=HARD)], NOISE) is None


def test_a_contact_of_the_fitted_law_shows_no_departure(base_of):
    assert find_candidates(base_of(), 0.0) == []


@pytest.mark.parametrize(("size", "shown"), [(0.1, True), (-0.1, False)])
def test_a_force_by_the_velocity_that_would_push_is_not_shown(base_of, monkeypatch, size, shown):
    """A guide of -0.31 N was the strongest departure of a LuGre contact."""
    monkeypatch.setattr(departures, "linear_steps", lambda *_: (np.full((1, 2), size), np.array([1e6])))
    names = {candidate.departure.name for candidate in find_candidates(base_of(), 0.0)}
    assert "spring-nonlinear" in names
    assert ("guide-friction" in names) == ("drag-quadratic" in names) == shown


def test_a_known_revolution_is_not_scanned(base_of):
    base, eccentricity = base_of(), LIBRARY["eccentricity"]
    known = replace(base, motion=replace(base.motion, revolution=0.12566))
    assert find_best_scale(known, eccentricity) == 0.12566
    assert find_best_scale(base, eccentricity) != pytest.approx(0.12566, rel=1e-3)


@pytest.mark.parametrize(
    ("counted", "words"), [(True, "an eccentric encoder wheel"), (False, "lens distortion or an uneven scale")]
)
def test_an_error_of_the_reading_is_named_by_what_read_it(counted, words):
    """Camera tracks with lens distortion were reported with "an eccentric encoder wheel"; the name of the row stays."""
    assert LIBRARY["eccentricity"].says(counted=counted) == words


def test_significance_is_that_of_fishers_distribution_in_normal_standard_deviations():
    from scipy import stats  # 2 s, which no other test needs

    found = departures.log_probability(np.array([3.0, 4.0]), np.diag([0.5, 0.5]), 19)
    assert found == pytest.approx(stats.f.logsf(50.0 * 17 / (2 * 18), 2, 17), rel=1e-9)
    assert departures.sigmas(np.log(2 * stats.norm.sf(5.0))) == pytest.approx(5.0)
    assert departures.sigmas(-1e4) == pytest.approx(np.sqrt(2e4), rel=1e-2)  # beyond what a number holds
