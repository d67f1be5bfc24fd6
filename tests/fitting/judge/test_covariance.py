"""Covariances where a direction is hardly or not at all known."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from daq.runfile.rig import Rig
from fitting.judge.parameters import covariance, derived_parameters, remove_level_errors
from fitting.laws import SIX
from fitting.least_squares.normal_equations import NormalEquations
from fitting.search.exchange import fit_laws
from processing.smoothing import smooth
from stickslip.units import Measured

from ..frames import cut


def fit_with(slopes, guess):
    """Return what `covariance` reads of a fit whose cycles each measure slopes (p,) times the unknowns, once."""
    slopes = np.asarray(slopes, float)
    count, p = slopes.shape
    misfit = np.where(np.arange(count) % 2, 1.0, -1.0)
    blocks = NormalEquations(
        g=np.zeros(p),
        H=slopes.T @ slopes + np.diag(guess),
        gl=np.zeros((count, 1)),
        Hl=np.ones((count, 1, 1)),
        cross=np.zeros((count, p, 1)),
        cycle_g=slopes * misfit[:, None],
        cycle_curvature=slopes[:, :, None] * slopes[:, None, :],
    )
    return SimpleNamespace(
        solution=SimpleNamespace(blocks=blocks),
        residual=misfit,
        sigma=np.ones(1),
        least_squares=SimpleNamespace(weights=np.ones(count), precision=np.asarray(guess)),
        problem=SimpleNamespace(level_prior=1.0),
        windows=SimpleNamespace(run=np.zeros(count, int), table=np.array([(k, 0, k, 1, 0, 0) for k in range(count)])),
    )


def test_what_one_cycle_alone_shows_is_as_uncertain_as_that_cycle_s_residuals():
    # The belt's speed from a drag on a rippling belt was wrong by up to 18 of its standard errors (constant friction).
    slopes = np.array([[1.0, 0.0], [1.0, 0.0], [1.0, 0.0], [0.0, 10.0]])
    sound, rippled = fit_with(slopes, np.zeros(2)), fit_with(slopes, np.zeros(2))
    rippled.residual = np.append(rippled.residual[:3], np.full(4, 5.0))  # correlated, and five times what was assumed
    rippled.windows.table[3, 3] = 4
    before, after = covariance(sound), covariance(rippled)
    assert after[0, 0] == pytest.approx(before[0, 0])
    assert after[1, 1] > 25 * before[1, 1]


def test_what_two_unknowns_show_together_is_no_narrower_than_by_the_curvature():
    # Fs and gamma of a contact without scatter: their variances were raised and their correlation was kept, so that the
    # slope of friction at the belt's speed had an interval five times too narrow.
    slopes = np.array([[1.0, -1.05], [1.0, -0.95], [1.0, -1.05], [1.0, -0.95], [0.01, 0.02], [0.01, 0.02]])
    fit = fit_with(slopes, np.zeros(2))
    blocks = fit.solution.blocks
    own = blocks.cycle_g.copy()
    own[:4] *= 0.1  # the cycles agree better than their noise allows
    fit.solution.blocks = replace(blocks, cycle_g=own)
    found, curvature = covariance(fit), np.linalg.inv(blocks.H)
    for angle in np.linspace(0.0, np.pi, 60):
        along = np.array([np.cos(angle), np.sin(angle)])
        assert along @ found @ along >= (1 - 1e-9) * (along @ curvature @ along)


def test_without_a_datum_the_error_of_the_level_is_that_of_its_mean_over_the_cycles(belt_rig):
    # The prior of the levels, five times wider than their scatter, went into it: it was four times too large.
    recording = replace(belt_rig.recording(law=5, delta=5e-5), rig=Rig())
    run = cut(smooth(recording))
    (fit,) = fit_laws((SIX[5],), [run])
    level = derived_parameters(fit, run.motion, 0.05)["Fs/m"]
    assert level.stderr == pytest.approx(level.value * fit.noise.scatter / np.sqrt(len(fit.rows)), rel=0.3)
    assert level.lo < 35.184 * 0.13068 < level.hi


@pytest.mark.slow
def test_levels_that_differ_by_their_errors_alone_do_not_show_the_belt_speed_of_a_ramp(belt_rig):
    """Without a datum and without scatter only v_dr - d is known; v_dr used to be off by a hundred standard errors."""
    recording = replace(belt_rig.recording(law=4, scatter=0.0), rig=Rig())
    run = cut(smooth(recording))
    (fit,) = fit_laws((SIX[4],), [run])
    found = derived_parameters(remove_level_errors(fit), run.motion, 0.05)
    assert found["v_dr"].lo < belt_rig.Scene().belt < found["v_dr"].hi
    assert found["v_dr"].stderr > 0.2 * found["d"].value
    assert "Fs/m" not in found
    assert "x0 + Fs/k" in found


@pytest.mark.parametrize(("known", "unit"), [("mass", "k"), ("stiffness", "m")])
def test_a_mass_gives_newtons_and_a_stiffness_gives_the_mass(ranked_alone, known, unit):
    ranking = ranked_alone(5, law=5)
    calibration = {"mass": None, "stiffness": None} | {known: Measured(0.3 if known == "mass" else 10.5552)}
    found = derived_parameters(ranking.best.fit, replace(ranking.motion, **calibration), 0.05)
    assert found[unit].value == pytest.approx({"k": 10.5552, "m": 0.3}[unit], rel=2e-4)
    assert found["Fs"].value == pytest.approx(0.3 * found["Fs/m"].value, rel=2e-4)
    assert {"k", "m"} & set(found) == {unit}


def test_correlations_give_the_error_of_a_ratio(ranked_alone):
    ranking = ranked_alone(5, law=5)
    known, found = ranking.best.parameters, ranking.correlations()
    i, j = found.names.index("Fs/m"), found.names.index("k/m")
    level, rate = (known[name].stderr / known[name].value for name in ("Fs/m", "k/m"))
    ratio = known["Fs/k"].stderr / known["Fs/k"].value
    assert ratio**2 == pytest.approx(level**2 + rate**2 - 2 * found.matrix[i, j] * level * rate, rel=1e-4)
    assert found.matrix == pytest.approx(found.matrix.T, abs=1e-12)
    assert np.diag(found.matrix) == pytest.approx(np.ones(len(found.names)))
    assert set(found.names) == {"k/m", "Fs/m", "v_dr", "gamma", "x0", "c/m"}
