"""Curves measured on contacts whose friction is known, made once and shared."""

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest

from fitting.judge.curve import measure_curve
from fitting.laws import SIX
from fitting.model.problem import Run
from fitting.record import cycles
from fitting.record import motion as frame
from fitting.search.exchange import fit_laws
from processing.smoothing import smooth

from ... import rig as belt_rig

COUNT = 50e-6  # m


def run_of(contact, bare):
    """Bring a contact, recorded by an encoder of 50 um, calibrated unless ``bare``, into the fit's frame."""
    recording = belt_rig.by_encoder(contact, count=COUNT, damping_sd=None if bare else 0.1 * contact.c + 1e-4)
    motion = frame.from_kinematics(smooth(recording), recording.rig, None)
    return Run(motion, cycles.segment_cycles(motion, frozenset()))


@pytest.fixture(scope="session")
def measured():
    """Give a function that measures the curve of one contact, or of several together, fitted with ``laws``.

    The runs are calibrated unless ``bare``.  It returns the curve, the fits, and the true friction per unit mass at
    the curve's speeds.
    """

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

    def of(**changes):
        return replace(belt_rig.Contact(scatter=0.03, c=0.01, seed=3), **changes)

    return of
