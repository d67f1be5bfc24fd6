"""Rankings of synthetic runs and smoothed runs of the simulated rig, made once and shared by the tests of the fit."""

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
from . import strangers as stranger_records


@pytest.fixture(scope="session")
def strangers():
    """Give the module of records that are no stick-slip."""
    return stranger_records


@pytest.fixture(scope="session")
def belt_rig():
    """Give the module of the tests' own rig."""
    return own_rig


@pytest.fixture(scope="session")
def ranked():
    """Give a function that ranks a synthetic run, of 12 s unless changed, and remembers it: ``ranked(law=5)``."""

    @cache
    def of(**changes):
        return rank(smooth(own_rig.recording(**{"duration": 12.0} | changes)))

    return of


@pytest.fixture(scope="session")
def motion_of(belt_rig):
    """Give a function that smooths a synthetic run and brings it into the fit's frame."""
    from fitting.record import motion

    @cache
    def of(**changes):
        recording = belt_rig.recording(**changes)
        return motion.from_kinematics(smooth(recording), recording.rig, None)

    return of


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

    def of(*, stick=0, overtakes=0, rate=1000.0, seconds=1.2):
        time = 2.0 + np.arange(round(seconds * rate)) / rate
        return ShootingWindows(
            table=np.array([[0, stick, 0, time.size, overtakes, 0]], np.int64),
            level_epoch=np.array([1.9]),
            earliest_landing=np.array([2.2]),
            time=time,
            position=np.zeros(time.size),
            source=np.zeros(time.size, np.int64),
            rows=(slice(0, time.size),),
        )

    return of
