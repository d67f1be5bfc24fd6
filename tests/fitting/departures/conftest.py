"""One law fitted to contacts that depart from it, made once."""

from functools import cache

import numpy as np
import pytest

from daq.imports import table_to_run
from daq.imports.options import ImportOptions
from fitting.judge.departures import Base
from fitting.laws import SIX
from fitting.model.predict import law_task
from fitting.model.problem import Run
from fitting.record import cycles, ripple
from fitting.record import motion as frame
from fitting.search.exchange import fit_all
from processing.smoothing import smooth


@pytest.fixture(scope="session")
def fitted(belt_rig, tmp_path_factory):
    """Give a function that fits one law to a contact, as read by an encoder: ``fitted(law=5, k3=16.8)``."""
    folder = tmp_path_factory.mktemp("contacts")

    @cache
    def of(law=5, duration=20.0, count=7.67e-6, **changes):
        time, position = belt_rig.recorded(belt_rig.Contact(duration=duration, **changes), count=count)
        path = folder / "contact.csv"
        np.savetxt(path, np.c_[time, position], fmt="%.6f,%.7f", header="t,x", comments="")
        kinematics = smooth(table_to_run.read(path, ImportOptions()).run)
        motion = frame.from_kinematics(kinematics, kinematics.recording.rig, None)
        cut = cycles.segment_cycles(motion)
        found = ripple.find_ripple(motion, cut)
        if found is not None:
            cut = cycles.segment_cycles(found.removed(motion))
        (fit,) = fit_all([law_task(SIX[law], [Run(motion, cut, found)])])
        return fit

    return of


@pytest.fixture(scope="session")
def base_of(fitted):
    """Give a function that makes the fit of a contact linear, for tests of departures."""

    @cache
    def of(**changes):
        found = fitted(**changes)
        return Base.at(found, found.problem.motions)

    return of
