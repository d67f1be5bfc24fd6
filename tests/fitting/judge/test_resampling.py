"""Bootstrap and profile of a fitted law, against scipy's minimiser and against the covariance."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from fitting import rank
from fitting.judge import resampling
from fitting.judge.parameters import covariances
from fitting.model.unknowns import Global
from processing.smoothing import smooth
from stickslip.errors import InputError


@pytest.fixture(scope="module")
def ranking(ranked_alone):
    return ranked_alone(5, law=5, rate=200)


def by_scipy(fit, held):
    """Return the least objective with unknowns held (index to value) and the others fitted by scipy at once."""
    problem = fit.least_squares
    free = [place for place in range(fit.q.size) if place not in held]
    cycles, p = fit.local.shape, len(free)
    weight = np.sqrt(problem.weight)
    prior, local_prior = np.sqrt(problem.precision), np.sqrt(problem.local_precision)
    known = prior > 0

    def unpacked(z):
        u = fit.q.copy()
        u[list(held)] = list(held.values())
        u[free] = z[:p]
        return u, z[p:].reshape(cycles)

    def residuals(z):
        u, local = unpacked(z)
        found = problem.evaluate(u, local, False)[0]
        priors = (prior * (u - problem.prior))[known], (local_prior * (local - problem.local_prior)).ravel()
        return np.concatenate([weight * found, *priors])

    def slopes(z):
        tangent = problem.evaluate(*unpacked(z), True)[1].columns()
        tangent, own = tangent * weight[:, None], np.zeros((tangent.shape[0], cycles[0], cycles[1]))
        for k in range(cycles[0]):
            own[problem.rows[k], k] = tangent[problem.rows[k], fit.q.size :]
        rows = np.hstack([tangent[:, free], own.reshape(tangent.shape[0], -1)])
        shared = np.zeros((int(known.sum()), z.size))
        shared[:, :p] = np.diag(prior)[np.ix_(known, free)]
        locals_ = np.hstack([np.zeros((local_prior.size, p)), np.diag(local_prior.ravel())])
        return np.vstack([rows, shared, locals_])

    start = np.concatenate([fit.q[free], fit.local.ravel()])
    low = np.concatenate([problem.lower[free], np.full(fit.local.size, -np.inf)])
    high = np.concatenate([problem.upper[free], np.broadcast_to(problem.local_upper, cycles).ravel()])
    start = np.clip(start, np.nextafter(low, np.inf), np.nextafter(high, -np.inf))
    found = least_squares(residuals, start, slopes, (low, high), x_scale="jac", ftol=1e-12, xtol=1e-12, gtol=1e-12)
    return found.cost


@pytest.mark.slow
def test_a_profile_is_that_of_scipy(ranking):
    """Beside a damping that cannot be negative it rises faster on one side."""
    row = ranking.best
    found = resampling.profile(row.fit, ranking.motion, row.parameters, "gamma")
    place = row.fit.places.index(Global.SHAPE)
    least = by_scipy(row.fit, {})
    for end in (0, -1):
        rise = 2 * (by_scipy(row.fit, {place: found["value"][end]}) - least)
        assert found["deviance"][end] == pytest.approx(rise, rel=1e-2)


def test_a_profile_of_a_nearly_linear_unknown_is_the_square_of_the_distance_in_standard_errors(ranking):
    row = ranking.best
    found = resampling.profile(row.fit, ranking.motion, row.parameters, "k/m")
    by_curvature = math.sqrt(covariances(row.fit)[1][0, 0])
    distance = (found["value"] - row.parameters["k/m"].value) / by_curvature
    assert found["deviance"] == pytest.approx(distance**2, rel=0.05, abs=0.01)
    assert np.all(found["rms_m"] >= 0.999 * row.rms_m)


@pytest.mark.slow
@pytest.mark.usefixtures("asked_law_alone")
def test_the_spread_of_drawn_cycles_is_that_of_the_sandwich_covariance(belt_rig):
    """Damping is held: at its bound of 0 one half of all draws would have the same."""
    motion = smooth(belt_rig.recording(law=5, rate=200, duration=80.0))
    ranking = rank(motion, laws=5, fix={"c/m": 0.0})
    fit, draws = ranking.best.fit, 100
    found = resampling.bootstrap(fit, ranking.motion, draws, 1)
    slots = {"k/m": Global.K, "v_dr": Global.V_DR, "gamma": Global.SHAPE, "x0": Global.DATUM}
    sandwich = np.sqrt(np.diag(covariances(fit)[0])[[fit.places.index(slot) for slot in slots.values()]])
    spread = np.array([found[name].std() for name in slots])
    # the scatter of a standard deviation, and what 44 cycles leave out of it
    assert spread / sandwich == pytest.approx(1.0, abs=3 / math.sqrt(2 * draws) + 1 / ranking.best.cycles)


def test_draws_repeat_by_their_seed_and_have_the_error_of_the_metres_per_count(ranking):
    """v_dr is known to 1e-6 in counts: its error is that of a count's length.  k/m has no length in its unit."""
    fit, motion = ranking.best.fit, replace(ranking.motion, length_error=0.01)
    found, again = (resampling.bootstrap(fit, motion, 20, 2) for _ in range(2))
    assert all(np.array_equal(again[name], found[name]) for name in found)
    assert found["v_dr"].std() / found["v_dr"].mean() == pytest.approx(0.01, rel=0.5)
    assert found["k/m"].std() / found["k/m"].mean() < 1e-3


@pytest.mark.parametrize(
    ("name", "words"),
    [("gama", "did you mean 'gamma'"), ("Fs/k", "is computed from other parameters; choose one of k/m")],
)
def test_what_has_no_profile_is_refused(ranking, name, words):
    with pytest.raises(InputError, match=words):
        resampling.profile(ranking.best.fit, ranking.motion, ranking.best.parameters, name)
