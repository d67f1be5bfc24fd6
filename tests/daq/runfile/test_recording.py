"""What a recording shows of itself in Python: a short text, a table for notebooks, and a picture."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import daq
from daq.runfile.recording import Recording
from daq.runfile.rig import Rig

SAMPLES = Path(__file__).resolve().parents[3] / "data_samples"


@pytest.fixture(scope="module")
def recording():
    return daq.load(SAMPLES / "law5.h5")


def test_the_text_names_file_samples_duration_and_rate(recording):
    """It used to be 3000 characters of arrays."""
    text = repr(recording)
    assert len(text.splitlines()) <= 3
    assert len(text) < 200
    for part in ("law5.h5", "6000 samples", "12 s", "500 Hz", recording.title):
        assert part in text
    assert "lost" not in text


def test_lost_samples_are_in_the_text(recording):
    number = recording.raw.sample.copy()
    number[100:] += 3
    assert "3 samples lost" in repr(replace(recording, raw=replace(recording.raw, sample=number)))


def test_what_a_file_says_is_escaped_in_the_table(recording):
    hostile = "<img src=x onerror=alert(1)>"
    written = {"title": hostile, "started": hostile, "operator": hostile, "sample_name": hostile, "note": hostile}
    table = replace(
        recording, **written, tags={hostile: hostile}, event_kind=(hostile,), source=Path(f"{hostile}.h5")
    )._repr_html_()
    assert "<img" not in table
    assert table.count("&lt;img src=x onerror=alert(1)&gt;") == 9


def test_a_recording_without_file_or_samples_has_a_text_and_a_picture():
    none = np.empty(0)
    empty = Recording(title="", started="", ended="", rate_hz=100.0, rig=Rig(name=""), time=none, position=none)
    assert repr(empty) == "<Recording a run in memory: ''\n 0 samples, 0 s at 100 Hz>"
    assert "<table>" in empty._repr_html_()
    assert not empty.plot().axes[0].lines[0].get_xdata().size


def test_the_picture_has_no_line_across_a_gap_and_marks_what_a_person_marked(recording):
    time = recording.time.copy()
    time[3000:] += 1.0
    marked = replace(
        recording, title="$x^{", time=time, event_sample=np.array([500]), event_kind=("marker",), event_note=("$a^{",)
    )
    figure = marked.plot()
    (axes,) = figure.axes
    first, second, marker = axes.lines
    np.testing.assert_array_equal(first.get_xdata(), time[:3000])
    np.testing.assert_array_equal(second.get_ydata(), 1e3 * recording.position[3000:])
    assert marker.get_xdata()[0] == time[500]
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("time (s)", "position (mm)")
    assert figure._repr_png_().startswith(b"\x89PNG")
