"""Viewers of NeXus files open a run on its default plot: nexusformat, silx and xarray find signal and axis by name.

Nothing here is ours but the files: the readers follow default, signal and axes themselves.
"""

import shutil
from pathlib import Path

import h5py
import numpy as np
import pytest
import xarray

import daq
import processing
from fitting.cli import app as fit_friction
from processing import stage
from stickslip.console import application

from .conftest import compete_alone

SAMPLES = Path(__file__).resolve().parent.parent / "data_samples"
# Of each stage: the group that is plotted, its signal, its axis and how many values are drawn.
RECORDED = ("/entry/data", "value", "time", 6000)
SMOOTHED = ("/entry/smooth/phase_portrait", "velocity", "position", 6000)
FITTED = ("/entry/fit/ranking", "score", "law", 6)


def in_nexusformat(path):
    """Return what nexusformat plots by default."""
    from nexusformat.nexus import nxload

    plotted = nxload(path).plottable_data
    signal, (axis,) = plotted.nxsignal, plotted.nxaxes
    return plotted.nxpath, signal.nxname, axis.nxname, signal.shape, axis.shape


def in_silx(path):
    """Return what silx plots by default."""
    import silx.io
    from silx.io import nxdata

    with silx.io.open(str(path)) as file:
        plotted = nxdata.get_default(file)
        assert plotted.is_valid
        assert plotted.is_curve
        assert np.isfinite(plotted.signal[:]).all()
        (axis,) = plotted.axes
        names = plotted.signal_dataset_name, plotted.axes_dataset_names[0]
        return plotted.group.name, *names, plotted.signal.shape, axis.shape


def in_xarray(path):
    """Return what xarray makes of the group that the chain of default attributes leads to."""
    with h5py.File(path) as file:
        group = file
        while "default" in group.attrs:
            group = group[group.attrs["default"]]
        name = group.name
    with xarray.open_dataset(path, engine="h5netcdf", group=name) as data:
        signal = data[data.attrs["signal"]]
        axis = data[data.attrs["axes"]]
        return name, signal.name, axis.name, signal.shape, axis.shape


READERS = pytest.mark.parametrize("reader", [in_nexusformat, in_silx, in_xarray])


def check(found, wanted):
    group, signal, axis, drawn = wanted
    assert found == (group, signal, axis, (drawn,), (drawn,))


@READERS
def test_a_run_as_recorded_opens_on_position_against_time(reader):
    check(reader(SAMPLES / "law5.h5"), RECORDED)


@pytest.fixture(scope="module")
def smoothed(tmp_path_factory):
    run = tmp_path_factory.mktemp("viewers") / "run.h5"
    shutil.copy(SAMPLES / "law5.h5", run)
    stage.save(processing.smooth(daq.load(run)), run)
    return run


@pytest.fixture(scope="module")
def fitted(smoothed):
    run = shutil.copy(smoothed, smoothed.with_name("fitted.h5"))
    with pytest.MonkeyPatch.context() as patch:
        compete_alone(patch)
        assert application.run(fit_friction, [str(run), "--no-report"]) in (0, 5)
    return run


@READERS
def test_a_smoothed_run_opens_on_its_phase_portrait(smoothed, reader):
    check(reader(smoothed), SMOOTHED)


@pytest.mark.slow
@READERS
def test_a_fitted_run_opens_on_its_ranking(fitted, reader):
    check(reader(fitted), FITTED)
