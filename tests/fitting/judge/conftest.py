"""Contacts whose friction and whose departures are known: fitted, and their curves measured, once."""

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest

from fitting.judge.curve import measure_curve
from fitting.judge.departures import Base
from fitting.laws import SIX
from fitting.model.predict import law_task
from fitting.model.problem import Run
from fitting.record import cycles
from fitting.search.exchange import fit_all, fit_laws
from processing.smoothing import smooth

from ... import rig as belt_rig
from ..frames import cut, in_frame

COUNT = 50e-6  # m


@pytest.fixture(scope="session")
def measured():
    """Give a function that measures the curve of one contact, or of several together, fitted with ``laws``.

    The runs are calibrated unless ``bare``.  It returns the curve, the fits, and the true friction per unit mass at
    the curve's speeds.
    """

    def run_of(contact, bare):
        sd = None if bare else 0.1 * contact.c + 1e-4
        motion = in_frame(smooth(belt_rig.by_encoder(contact, count=COUNT, damping_sd=sd)))
        return Run(motion, cycles.segment_cycles(motion))

    @cache
    def of(*together, laws=(5,), bare=False):
        runs = [run_of(contact, bare) for contact in together]
        fits = sorted(fit_laws([SIX[law] for law in laws], runs), key=lambda fit: fit.geometric_mean_rms)
        noise = np.array(
            [np.sqrt(COUNT**2 / 12 + belt_rig.JITTER**2 * np.mean(run.motion.velocity**2)) for run in runs]
        )
        curve = measure_curve(fits, noise)
        contact = together[0]
        truth = np.array([belt_rig.curve(contact, s) for s in curve.speed - curve.ramp]) / contact.m
        return SimpleNamespace(curve=curve, fits=fits, truth=truth, contact=contact)

    return of


@pytest.fixture(scope="session")
def contact():
    """Give a function that describes a contact by its changes from the rig of the design."""
    return lambda **changes: replace(belt_rig.Contact(scatter=0.03, c=0.01, seed=3), **changes)


@pytest.fixture(scope="session")
def departing(tmp_path_factory):
    """Give a function that fits one law to a contact, as read by an encoder: ``departing(law=5, k3=16.8)``."""
    path = tmp_path_factory.mktemp("contacts") / "contact.csv"

    @cache
    def of(law=5, **changes):
        time, position = belt_rig.recorded(belt_rig.Contact(**{"duration": 20.0, "scatter": 0.03} | changes))
        run = cut(smooth(belt_rig.imported(path, time, position, decimals=7)))
        (fit,) = fit_all([law_task(SIX[law], [run])])
        return fit

    return of


@pytest.fixture(scope="session")
def base_of(departing):
    """Give a function that makes the fit of a contact linear, for tests of departures."""

    @cache
    def of(**changes):
        fit = departing(**changes)
        return Base.at(fit, fit.problem.motions)

    return of
