"""What a motion shows of itself in Python: a short text, tables, and a picture."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import daq
import processing
from daq.runfile import store
from processing import stage
from processing.record.motion import Finding

SAMPLES = Path(__file__).resolve().parents[3] / "data_samples"


@pytest.fixture(scope="module")
def kinematics():
    return processing.smooth(daq.load(SAMPLES / "law5.h5"))


def test_the_text_names_file_method_phases_and_belt_speed(kinematics):
    """It used to be 6000 characters of arrays."""
    text = repr(kinematics)
    assert len(text.splitlines()) <= 3
    assert len(text) < 200
    for part in ("law5.h5", "segment", "6000 samples", "7 sticks, 7 slips", f"{kinematics.belt_speed:.5g} m/s"):
        assert part in text
    assert "unknown" in repr(replace(kinematics, belt_speed=np.nan, phases=()))


def test_what_a_file_says_is_escaped_in_the_table(kinematics):
    found = Finding("belt-speed", "0.2 < 0.3 <script>")
    recording = replace(kinematics.recording, source=Path("<script>.h5"))
    table = replace(kinematics, recording=recording, findings=(found,))._repr_html_()
    assert "<script" not in table
    assert "0.2 &lt; 0.3" in table


def test_the_data_frame_has_a_row_a_sample_with_errors_and_phase(kinematics):
    rows = kinematics.to_dataframe()
    assert len(rows) == kinematics.samples
    np.testing.assert_array_equal(rows["velocity_m_per_s"], kinematics.velocity)
    np.testing.assert_array_equal(rows["position_error_m"], kinematics.position_errors)
    np.testing.assert_array_equal(rows["phase"] == "stick", kinematics.stick)


def test_the_picture_shows_position_velocity_and_the_phase_portrait(kinematics):
    above, below, portrait = kinematics.plot().axes
    np.testing.assert_array_equal(above.lines[0].get_ydata(), 1e3 * kinematics.position)
    np.testing.assert_array_equal(below.lines[0].get_xydata(), np.c_[kinematics.time, kinematics.velocity])
    np.testing.assert_array_equal(portrait.lines[0].get_xdata(), 1e3 * kinematics.position)
    np.testing.assert_array_equal(portrait.lines[0].get_ydata(), kinematics.velocity)
    assert portrait.get_title(loc="left") == "phase portrait, 5 complete cycles"


def test_markers_are_drawn_at_their_times_and_of_a_part_those_within_it(tmp_path):
    # The picture left out what daq note --mark and the live view had set; a part of a run had the whole run's events.
    path = tmp_path / "run.h5"
    shutil.copy(SAMPLES / "law5.h5", path)
    for at, words in ((1.0, "early"), (7.5, "hand on the guide")):
        store.annotate(path, {}, [(at, words)])
    whole = processing.smooth(daq.load(path))
    assert [words for _, words in whole.recording.markers] == ["early", "hand on the guide"]
    assert [text.get_text().strip() for text in whole.plot().axes[0].texts] == ["early", "hand on the guide"]
    own = store.select_between(path, 4.0, 11.0)
    stage.save(processing.smooth(store.load(path, own)), path, own)
    ((at, words),) = stage.load(path).recording.markers
    assert words == "hand on the guide"
    assert at == pytest.approx(7.5, abs=0.002)
