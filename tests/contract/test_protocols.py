"""What every protocol must keep, whoever speaks it: the same faults at the other end of a pseudo-terminal."""

import sys

import numpy as np
import pytest

import daq
from daq.protocols.request import RecordRequest
from daq.recorder import reader
from daq.recorder.record import record

from ..boards import AWAY_S, FakeUpForLong, motion

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="pseudo-terminals are POSIX")


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    monkeypatch.setattr(reader, "REOPEN_EVERY_S", 0.02)


def taken(fake, tmp_path, samples):
    """Record that many samples of a fake, and as many more as it may have sent before."""
    samples += fake.lead * (not fake.paced)
    request = RecordRequest(
        str(fake.path),
        tmp_path / "run.h5",
        rate_hz=None,
        duration_s=samples / fake.rate_hz,
        protocol=fake.protocol,
        columns=fake.columns,
    )
    return record(request), daq.load(tmp_path / "run.h5")


def offsets(fake, run, first=0, last=None):
    """Return the count less the true one at each sample, whose number its device time tells."""
    here = slice(first, last)
    k = np.round((run.time[here] - run.time[here][0]) * fake.rate_hz).astype(int)
    if fake.starts_by_itself:  # what was printed before the recording began is not in it
        shifts = np.arange(0, 20_000)
        true = motion(shifts[:, np.newaxis] + k[[0, len(k) // 3, len(k) // 2, -1]])
        seen = run.count[here][[0, len(k) // 3, len(k) // 2, -1]]
        k = k + shifts[np.flatnonzero(np.all(true - true[:, :1] == seen - seen[0], axis=1))[0]]
    return run.count[here] - motion(k)


def kinds(run):
    return list(zip(run.event_sample.tolist(), run.event_kind, strict=True))


def begun_anew(fake, found, run):
    """Return the first sample of the second of two segments, in each of which every count is the true one."""
    assert found.segments == 2
    first = int(np.searchsorted(run.segment, 1))
    assert (first, "reopened") in kinds(run)
    assert np.ptp(offsets(fake, run, 0, first)) == 0
    assert np.ptp(offsets(fake, run, first)) == 0
    return first


def test_every_sample_comes_through(make_fake, tmp_path):
    fake = make_fake()
    found, run = taken(fake, tmp_path, 5000)
    assert (found.samples, found.lost, found.crc_errors, found.segments) == (5000 + fake.lead, 0, 0, 1)
    assert (found.illegal, found.phase_errors, found.dropped_bytes) == (0, 0, 0)
    assert np.ptp(offsets(fake, run)) == 0
    assert run.rate_hz == fake.rate_hz
    assert run.time == pytest.approx(np.arange(5000 + fake.lead) / fake.rate_hz, abs=1e-9)
    assert any("whole milliseconds" in warning for warning in found.warnings) == (fake.columns == "ticks,ms")


def test_faults_of_the_line_cost_their_units_and_nothing_else(make_fake, tmp_path):
    """What is lost is counted, marked and never filled; what comes twice is left out."""
    fake = make_fake({1500: "drop", 1550: "twice", 1600: "late", 1700: "flip", 1800: "drop"})
    unit = fake.unit
    found, run = taken(fake, tmp_path, 1900 * unit)
    assert (found.lost, found.crc_errors, found.segments) == (4 * unit, 1, 1)
    assert found.samples + found.lost == 1900 * unit + fake.lead
    assert any(f"{2 * unit} samples were repeated or late" in warning for warning in found.warnings)
    assert np.ptp(offsets(fake, run)) == 0
    before = np.flatnonzero(np.diff(np.round(run.time * fake.rate_hz)) > 1)
    assert np.diff(before).tolist() == [99 * unit] * 3
    assert {(sample, kind) for sample, kind in kinds(run) if kind == "gap"} == {(k + 1, "gap") for k in before}
    assert "crc" in run.event_kind


def test_a_board_that_resets_is_set_to_work_again_in_a_new_segment(make_fake, tmp_path):
    fake = make_fake({1500: "reset"})
    found, run = taken(fake, tmp_path, 3000 * fake.unit)
    first = begun_anew(fake, found, run)
    assert run.raw.sample[first] == 0
    assert np.all(np.diff(run.time) > 0)
    assert len(run.time) >= 2900 * fake.unit


@pytest.mark.slow
def test_a_sketch_that_was_up_for_long_resets_and_all_its_samples_are_kept(tmp_path):
    # Modulo 2^32 its clock steps ahead by minutes.  Other times: tests/daq/protocols/test_lines.py.
    fake = FakeUpForLong(tmp_path / "ttyFAKE", {3000: "reset"}, paced=True)
    fake.uptime_us = 4_260_000_000
    with fake:
        found, run = taken(fake, tmp_path, 4000)
    begun_anew(fake, found, run)
    assert not found.short
    assert found.lost == 0
    assert run.time[-1] == pytest.approx(4.0, abs=0.3)


def test_an_unplugged_board_is_found_again_and_the_gap_is_told_in_ms(make_fake, tmp_path):
    fake = make_fake(
        {int((0.6 + 1.3 * make_fake.kind.starts_by_itself) * make_fake.kind.rate_hz / make_fake.kind.unit): "unplug"},
        paced=True,
    )
    found, run = taken(fake, tmp_path, 3 * fake.rate_hz)
    begun_anew(fake, found, run)
    note = run.event_note[run.event_kind.index("reopened")]
    gap_ms = float(note.split("lost for ")[1].split(" ms")[0])
    assert 1e3 * AWAY_S <= gap_ms < 1e3 * AWAY_S + 3000
    assert any("reopened" in warning and "ms are missing" in warning for warning in found.warnings)
    assert found.lost == 0
