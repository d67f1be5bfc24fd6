"""A curve, its rest position and what follows them: moved together they give the same motion."""

from dataclasses import replace

import numpy as np
import pytest

from fitting.judge.curve import moved_to, unseen
from fitting.model.path import FrictionSpline, follow, spline_curve
from fitting.model.tangents import shared_tangents, spline_tangents
from fitting.model.unknowns import PER_RUN, Global
from stickslip.units import Measured

K, F, V = 35.184, 4.598, 0.22
PLACES = (Global.K, Global.V_DR, Global.D, Global.DATUM, Global.DAMPING)
SLIP, STUCK = np.array([0.128, 0.1, 0.0, 0.0, 0.0, 0.0]), np.array([0.0, 0.0, 0.0, 0.0, -0.1, 0.215])


@pytest.mark.parametrize("stick", [0, 1])
@pytest.mark.parametrize("contact", [{}, {"d": 0.03}, {"compliance": 0.05}], ids=["jump", "ramp", "belt that slows"])
def test_a_rest_position_is_hidden_by_what_follows_it(one_window, contact, stick):
    u = np.zeros(PER_RUN)
    u[[Global.K, Global.V_DR, Global.DAMPING, Global.STATIC]] = K, V, 0.03, 1.0
    for name, value in contact.items():
        u[Global[name.upper()]] = value
    knots = 0.6 * np.linspace(0, 1, 14) ** 1.6
    ramp = "d" in contact
    curve = spline_curve(FrictionSpline.over(knots), ramp)
    coefficients = F * np.linspace(1.0, 0.5, knots.size + 2)
    windows, local = one_window(stick=stick), (STUCK if stick else SLIP)[None, :]

    def path_with(u, coefficients):
        path = follow(windows, replace(curve, spline=curve.spline.with_coefficients(coefficients)), u, local)
        assert path is not None
        return path

    path = path_with(u, coefficients)
    there = path_with(*moved_to(u, coefficients, Measured(-0.04, 1.0), ramp=ramp))
    assert there.model == pytest.approx(path.model, abs=1e-7)
    assert np.ptp(path.model) > 0.1

    beside = unseen(PLACES, path.curve, u)
    beside[PLACES.index(Global.DATUM)] = 1.0
    columns = shared_tangents(path, PLACES)
    curved = spline_tangents(path, np.full((coefficients.size, 1), -K))[:, 0]
    assert np.abs(columns @ beside + curved).max() <= 1e-4 * max(np.abs(curved).max(), np.abs(columns[:, 3]).max())
