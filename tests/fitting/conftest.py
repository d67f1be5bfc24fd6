"""Records and rankings, made once and shared by the tests of the fit."""

from functools import cache

import numpy as np
import pytest

from daq.protocols.request import RecordRequest
from daq.recorder import ports
from daq.recorder.record import record
from daq.runfile import store
from fitting import rank
from fitting.model.windows import ShootingWindows
from processing.smoothing import smooth

from .. import rig as own_rig
from ..conftest import no_other_law
from .frames import cut, in_frame


@pytest.fixture(scope="session")
def belt_rig():
    """Give the module of the tests' own rig."""
    return own_rig


@pytest.fixture(scope="session")
def smoothed():
    """Give a function that smooths a synthetic run, remembered by its changes: ``smoothed(law=5, duration=10.0)``."""
    return cache(lambda **changes: smooth(own_rig.recording(**changes)))


@pytest.fixture(scope="session")
def ranked(smoothed):
    """Give a function that ranks a synthetic run, of 12 s unless changed, and remembers it: ``ranked(law=5)``."""
    return cache(lambda **changes: rank(smoothed(**{"duration": 12.0} | changes)))


@pytest.fixture(scope="session")
def ranked_alone(smoothed):
    """Give a function that ranks such a run by these laws and no others: ``ranked_alone(4, 5, law=5)``."""

    @cache
    def of(*laws, **changes):
        with no_other_law():
            return rank(smoothed(**{"duration": 12.0} | changes), laws=laws)

    return of


@pytest.fixture(scope="session")
def motion_of(smoothed):
    """Give a function that smooths a synthetic run and brings it into the fit's frame."""
    return cache(lambda **changes: in_frame(smoothed(**changes)))


@pytest.fixture(scope="session")
def runs_of(smoothed):
    """Give a function that returns the run of a synthetic scene, ready for the search; remembered by its changes."""
    return cache(lambda **changes: [cut(smoothed(**changes))])


@pytest.fixture(scope="session")
def simulated(tmp_path_factory):
    """Give a function that records the rig scene, changed, and smooths it; remembered by its changes."""
    folder, made = tmp_path_factory.mktemp("rig"), {}

    def of(*changes, duration=20.0):
        key = (*changes, duration)
        if key not in made:
            path = folder / f"run{len(made)}.h5"
            record(RecordRequest(ports.rig_url("rig", ["seed=5", *changes], False), path, 1000, duration))
            made[key] = smooth(store.load(path))
        return made[key]

    return of


@pytest.fixture(scope="session")
def one_window():
    """Give a function that returns the samples of one stick or slip, of one cycle."""

    def of(*, stick=0, overtakes=0, rate=1000.0, begin=2.0, seconds=1.2, earliest_landing=2.2, level_epoch=1.9):
        time = begin + np.arange(round(seconds * rate)) / rate
        return ShootingWindows(
            table=np.array([[0, stick, 0, time.size, overtakes, 0]], np.int64),
            level_epoch=np.array([level_epoch]),
            earliest_landing=np.array([earliest_landing]),
            time=time,
            position=np.zeros(time.size),
            source=np.zeros(time.size, np.int64),
            rows=(slice(0, time.size),),
        )

    return of
