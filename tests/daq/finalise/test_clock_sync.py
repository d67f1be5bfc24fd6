"""Drift and offset through USB batches and stalls; silence where the two clocks cannot be compared."""

import tracemalloc
from types import SimpleNamespace

import h5py
import numpy as np
import pytest

import daq
from daq.finalise import run as finalise
from daq.finalise.quality import RecordingQuality
from daq.runfile import journal, spill
from daq.runfile.spill import Shelf, Spill
from daq.stream import clock as clock_sync
from daq.wire import frames as wire

from ...journals import HEADER, write_journal


def compare(host, device, following=None, *, by_bytes=False):
    """Return how the clocks went together by points that come in one piece, numbered from 0."""
    points = Shelf(Spill())
    following = np.full(len(device), np.nan) if following is None else following
    if len(device):
        points.append(clock_sync.Points(host, device, following, np.arange(len(device))))
    return clock_sync.compare_clocks(points, by_bytes=by_bytes)


def late_by_usb(device, drift, rng, batch_s=0.016):
    """Return host times: true time, the USB chip's wait from a batch's first frame on, scatter, stalls of 0.3 s."""
    true = device / (1 + drift)
    host = np.empty(len(true))
    flush = -1.0
    for frame, taken in enumerate(true):
        if taken > flush:
            flush = taken + batch_s
        host[frame] = flush
    host += 0.002 + np.repeat(rng.exponential(0.0005, len(true)), 2)[: len(true)]
    return stall(host, rng, true[-1])


def stall(host, rng, seconds):
    """Hold the reads up twelve times, for 0.3 s."""
    for start in rng.uniform(0, seconds, 12):
        host[(host > start) & (host < start + 0.3)] = start + 0.3
    return host


@pytest.mark.parametrize("ppm", [-100, 0, 100])
@pytest.mark.parametrize("seconds", [3, 7, 20])
def test_a_pause_of_the_computer_is_no_drift(ppm, seconds):
    device = np.arange(0, 12, 0.008)
    host = late_by_usb(device, ppm * 1e-6, np.random.default_rng(seconds))
    paused = (host > 3) & (host < 3 + seconds)
    host[paused] = 3 + seconds + np.linspace(0, 0.5, np.count_nonzero(paused))
    host = np.maximum.accumulate(host)
    found = compare(host, device).ppm
    assert found is None or found == pytest.approx(ppm, abs=1500)


def polled_line(drift, rng, poll_s, seconds=60, block=8, length=71, baud=115_200):
    """Return (host, device, following) of the reads of a serial line that a USB host polls in step with its own clock.

    Each poll brings the bytes sent so far: 1 kHz in blocks of 8 that take 71 byte times, then an idle line.  The poll's
    phase is drawn, its way to the reader takes 50 us and an exponential of 0.2 ms more, twelve stalls hold it up.
    """
    last = np.arange(1, int(seconds * 1000 / block)) * block * 1e-3  # device time of each frame's last sample
    byte_s = 10 / baud
    sent = (last[:, np.newaxis] + byte_s * np.arange(1, length + 1)).ravel()
    true = sent / (1 + drift)
    polls = rng.uniform(0, poll_s) + poll_s * np.arange(int(true[-1] / poll_s) + 2)
    delivered = np.searchsorted(true, polls, side="right")
    host = polls + 5e-5 + rng.exponential(2e-4, len(polls))
    host = stall(host, rng, seconds)
    fresh = np.diff(delivered, prepend=0) > 0
    at = delivered[fresh] - 1
    device = last[:, np.newaxis] + byte_s * np.arange(1, length + 1)
    return np.maximum.accumulate(host)[fresh], device.ravel()[at], np.append(device.ravel(), np.nan)[at + 1]


DRIFTS = [0, 20, -100, 3000]


@pytest.mark.parametrize(
    ("poll_s", "seed"), [*((1e-3, seed) for seed in range(2)), *((16e-3, seed) for seed in range(3))]
)
@pytest.mark.parametrize("ppm", DRIFTS)
def test_a_line_polled_in_step_with_the_host_is_known_as_well_as_it_can_be(ppm, poll_s, seed):
    """Each ms: a USB serial chip that is asked for low latency, and a board with its own USB; else each 16 ms.

    Within 5 ppm, unless most polls fell into the 1.84 ms in which the line is idle: then within 31 ppm and 1.1 ms.
    By whole frames alone, which come every 8 ms, 130 ppm would be as good as it gets.
    """
    host, device, following = polled_line(ppm * 1e-6, np.random.default_rng([seed, ppm + 5000]), poll_s)
    found = compare(host, device, following, by_bytes=True)
    within_frames = np.count_nonzero(following - device < 1e-4) > 0.5 * len(device)
    error, stated, late = (1.5, 8, 1e-3) if poll_s < 2e-3 else (5, 11, 1.1e-3) if within_frames else (31, 40, 1.1e-3)
    assert abs(found.ppm - ppm) < error
    off = np.abs(found.offset - device[found.index] / (1 + ppm * 1e-6) + device[found.index])
    assert off.max() < late
    # The error that is given covers the true one, and is not large where the line shows more.
    assert abs(found.ppm - ppm) <= found.ppm_error < stated
    assert np.all(off <= found.offset_error)


@pytest.mark.parametrize("seed", range(3))
def test_whole_frames_polled_in_step_are_told_as_little_sharp_as_they_are(seed):
    """A port without bytes to go by, polled with its frames."""
    rng = np.random.default_rng(seed)
    ppm, poll_s = 20.0, 8e-3
    device = np.arange(1, 7500) * 8e-3
    polls = rng.uniform(0, poll_s) + poll_s * np.arange(7502)
    at = np.searchsorted(device / (1 + ppm * 1e-6), polls, side="right") - 1
    fresh = np.diff(at, prepend=-1) > 0
    host, at = polls[fresh] + rng.exponential(1e-4, fresh.sum()), at[fresh]
    following = np.append(device, np.nan)[at + 1]
    found = compare(host, device[at], following)
    assert abs(found.ppm - ppm) <= found.ppm_error < 300
    true = device[at][found.index] / (1 + ppm * 1e-6) - device[at][found.index]
    known = np.isfinite(found.offset_error)
    assert np.all(np.abs(found.offset - true)[known] <= found.offset_error[known])


def test_reads_that_were_all_slow_widen_the_interval_and_are_no_contradiction():
    host, device, following = polled_line(50e-6, np.random.default_rng(1), 1e-3)
    late = host + np.where(device > 30, 0.004, 0.0)  # from 30 s on each read takes 4 ms more
    found = compare(late, device, following, by_bytes=True)
    assert abs(found.ppm - 50) <= found.ppm_error
    assert found.ppm_error > 50


def test_a_stamp_that_is_plainly_wrong_does_not_turn_the_line():
    device = np.arange(0, 60, 0.008)
    host = 100 + late_by_usb(device, 40e-6, np.random.default_rng(3))
    host[5000] -= 7.0
    found = compare(host, device)
    assert found.ppm == pytest.approx(40, abs=5)
    assert 5000 not in found.index


@pytest.mark.parametrize("seconds", [0.0, 0.5, 2.0])
def test_neither_a_short_run_nor_a_stream_faster_than_real_time_has_a_drift(seconds):
    device = np.arange(0, seconds, 0.008)
    assert compare(device + 0.01, device).ppm is None
    fast = compare(np.arange(0, 60, 0.008) / 40, np.arange(0, 60, 0.008))
    assert (fast.ppm, len(fast.offset)) == (None, 0)


def test_points_that_were_put_aside_are_not_all_brought_back(monkeypatch):
    monkeypatch.setattr(spill, "MEMORY_BYTES", 0)
    points = Shelf(Spill())
    for begin in range(0, 160_000, 4000):
        device = 2.5e-4 * np.arange(begin, begin + 4000)
        points.append(clock_sync.Points(device + 0.01, device, device + 2.5e-4, np.arange(begin, begin + 4000)))
    tracemalloc.start()
    assert clock_sync.compare_clocks(points, by_bytes=False).ppm == pytest.approx(0, abs=1e-3)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 2.5e6  # all points are 5.1 MB


@pytest.mark.parametrize("ppm", [-3000, 20, 3000])
def test_a_recorded_line_gives_drift_and_offset_through_journal_and_file(tmp_path, ppm):
    """60 s at 1 kHz and 115200 baud, polled each 16 ms off the host's grid by 0.3 %, with stalls; byte by byte."""
    drift = ppm * 1e-6
    ident = wire.Ident((1, 0, 0), "x4", wire.Capability.BLOCKS, 16, 1000, 8, 5000, 125_000, "uno")
    zeros = (0,) * 8
    frames = [
        wire.encode_samples(wire.SampleBlock(8 * k & 0xFFFF, 8000 * k, 0, (0, *[1000] * 7), zeros, zeros, zeros))
        for k in range(7500)
    ]
    assert {len(frame) for frame in frames} == {71}
    line = b"".join(frames)
    byte_s = 10 / 115_200
    last = 8e-3 * np.arange(7500) + 7e-3
    sent = (last[:, np.newaxis] + byte_s * np.arange(1, 72)).ravel() / (1 + drift)
    polls = np.arange(0.003, sent[-1] + 0.03, 16.048e-3)
    rng = np.random.default_rng(4)
    host = polls + 5e-5 + rng.exponential(2e-4, len(polls))
    host = np.maximum.accumulate(stall(host, rng, 60))
    ends = np.searchsorted(sent, polls, side="right")
    records = [(journal.RECEIVED, 0, wire.encode_ident(ident))]
    for stamp, begin, end in zip(host, [0, *ends[:-1]], ends, strict=True):
        if end > begin:
            records.append((journal.RECEIVED, round(1e9 * (1000 + stamp)), line[begin:end]))
    write_journal(tmp_path / "run.h5.part", records, HEADER | {"protocol": "frames"})
    found = finalise.finalise(tmp_path / "run.h5.part", tmp_path / "run.h5", finished_by="test")
    assert (found.samples, found.lost) == (60_000, 0)
    assert found.clock_ppm == pytest.approx(ppm, abs=5)
    assert abs(found.clock_ppm - ppm) <= found.clock_ppm_error < 10
    run = daq.load(tmp_path / "run.h5")
    # Run time 0 is the first sample, and host time 0 the first frame's stamp.
    device = run.time[run.clock_sample]
    first = host[np.searchsorted(ends, 71)]
    true = device / (1 + drift) - device - first
    assert np.abs(run.clock_offset - true).max() < 1e-3
    assert np.all(np.abs(run.clock_offset - true) <= run.clock_offset_error + 1e-4)  # the first stamp's own delay
    assert run.clock_ppm_error == found.clock_ppm_error
    with h5py.File(tmp_path / "run.h5") as file:
        assert file["entry/clock_sync/drift"][()] == pytest.approx(found.clock_ppm)
        assert file["entry/clock_sync/drift"].attrs["units"] == "ppm"
        assert file["entry/clock_sync/drift_errors"][()] == found.clock_ppm_error
        errors = file["entry/clock_sync/host_minus_device_errors"]
        assert errors.shape == file["entry/clock_sync/host_minus_device"].shape


@pytest.mark.parametrize(
    ("ppm", "error", "said"),
    [
        (-167.0, 3265.0, ""),
        (None, None, ""),
        (-167.0, 30.0, "the board's clock deviates by -167 ppm (+- 30)"),
        (20.0, 60.0, "the board's clock agrees with this computer's to within 140 ppm"),
    ],
)
def test_a_drift_is_printed_where_the_run_shows_one(ppm, error, said):
    assert RecordingQuality.clock_drift.fget(SimpleNamespace(clock_ppm=ppm, clock_ppm_error=error)) == said
