"""Errors of daq that reach Python name keywords of its functions, and the call to make."""

import numpy as np
import pytest

import daq
import processing
from stickslip.errors import StickslipError

TIME = np.arange(1000) / 500
X = 0.01 * np.sin(6 * TIME)
# A mistake in Python, and the call that the message names.
MISTAKES = [
    (lambda: daq.load("pixels.csv"), "x_unit='0.25 mm' (a pixel)"),
    (lambda: daq.load("run.h5", mass=0.3), "pass calibrations and x0 to fitting.rank"),
    (lambda: daq.record((TIME, X), "new.h5", rate_hz=500), "daq.Recording.from_arrays(t, x).save(path)"),
    (lambda: daq.record([(TIME, X)], "run.h5", rate_hz=500), "or force=True to replace it"),
    (lambda: daq.record("/dev/ttyNONE", "new.h5", rate_hz=1000), "no such port; connect the board"),
    (lambda: daq.record("rig://rig", "new.h5", rate_hz=0), "it must be rate_hz=1 or more"),
    (lambda: daq.recover("run.h5"), "is not a journal; use the file RUN.h5.part"),
    (lambda: processing.smooth(daq.load("run.h5"), X), "processing.smooth(run, method=...)"),
]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Go into a folder with a run and a table."""
    monkeypatch.chdir(tmp_path)
    daq.Recording.from_arrays(TIME, X).save("run.h5")
    np.savetxt("pixels.csv", np.c_[TIME, 1e4 * X], delimiter=",", header="t (s),x", comments="")
    return tmp_path


@pytest.mark.parametrize(("mistake", "words"), MISTAKES, ids=[words[:40] for _, words in MISTAKES])
def test_a_mistake_in_python_names_the_call_to_make(folder, mistake, words):
    before = set(folder.iterdir())
    with pytest.raises(StickslipError) as caught:
        mistake()
    assert words in str(caught.value)
    assert " --" not in str(caught.value)
    assert "\n" not in str(caught.value)
    assert set(folder.iterdir()) == before
