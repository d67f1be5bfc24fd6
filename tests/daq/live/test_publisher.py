"""What pages are told: losses, silence and a lost port; all of the past, in memory that does not grow."""

import json
import shutil
import tracemalloc
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import daq
from daq.finalise.run import run_data
from daq.live import publisher
from daq.live.publisher import LiveRun
from daq.runfile import journal

from ...journals import HEADER
from .motions import stick_slip


def lines(first: int, n: int) -> bytes:
    return b"".join(b"%d,%d\n" % (1000 * k, round(4000 * np.sin(k / 200))) for k in range(first, first + n))


def told(run: LiveRun) -> list[dict[str, Any]]:
    return [json.loads(event.data) for event in run._events]


@pytest.fixture
def writer(tmp_path: Path) -> Iterator[journal.Writer]:
    made = journal.Writer(tmp_path / "run.h5.part", HEADER)
    yield made
    made.abandon()


@pytest.fixture
def look(writer: journal.Writer) -> Callable[..., dict[str, Any]]:
    """Return a function that writes records, and gives the last event that pages are told of them."""

    def look(run: LiveRun, *records: tuple[int, float, bytes]) -> dict[str, Any]:
        for kind, second, content in records:
            writer.append(kind, round(1e9 * second), content)
        writer.sync()
        run.look()
        return told(run)[-1]

    return look


def test_a_loss_of_samples_is_called_out_for_ten_seconds(writer: journal.Writer, look: Any) -> None:
    run = LiveRun(writer.path)
    before = 0
    rows = (1, 3, "3 in the last 10 s"), (8, 2, "5 in the last 10 s"), (12, 0, "2 in the"), (25, 0, "")
    for second, lost, trouble in rows:
        run.tail.counts.lost += lost
        said = look(run, (journal.RECEIVED, second, lines(1000 * before, 1000 * (second - before))))["trouble"]
        before = second
        assert trouble in said
        assert bool(said) == bool(trouble)


def test_a_lost_port_and_a_silent_board_are_called_out(
    writer: journal.Writer, look: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = LiveRun(writer.path)
    look(run, (journal.RECEIVED, 1, lines(0, 1000)))
    clock = run._last_new + 5.0
    monkeypatch.setattr(publisher.time, "monotonic", lambda: clock)
    assert look(run)["trouble"] == "no sample for 5 s"
    lost = look(run, (journal.LOST, 6, b"unplugged"))
    assert lost["trouble"] == "the port was lost (unplugged), and the recorder is waiting for it"
    again = look(run, (journal.REOPENED, 7, b"/dev/ttyACM0"), (journal.RECEIVED, 8, lines(1000, 1000)))
    assert (again["trouble"], run.ended) == ("", "")


def test_a_recorder_that_is_gone_ends_the_view(writer: journal.Writer, monkeypatch: pytest.MonkeyPatch) -> None:
    run = LiveRun(writer.path)
    writer.append(journal.RECEIVED, 1_000_000_000, lines(0, 100))
    writer.close()
    run.look()
    clock = run._last_new + 4.0
    monkeypatch.setattr(publisher.time, "monotonic", lambda: clock)
    run.look()
    assert run.ended == "The recording process has ended unexpectedly. Save the data with daq recover run.h5.part"


def test_an_hour_takes_no_more_memory_than_some_minutes_and_can_be_looked_at_again(
    writer: journal.Writer, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At a sixtieth of the limits, one minute is to ten seconds what an hour is to ten minutes."""
    monkeypatch.setattr(publisher, "HISTORY_S", 2.0)
    monkeypatch.setattr(publisher, "MOST_PLACES", 8)
    monkeypatch.setattr("daq.live.overview.ROWS", 512)
    monkeypatch.setattr("daq.live.analysis.MEMORY_S", 1.0)
    monkeypatch.setattr("daq.live.sticks.MOST_OF_SLIP", 1024)
    run = LiveRun(writer.path)
    sizes = {}
    tracemalloc.start(1)
    for k in range(0, 60_000, 1000):
        writer.append(journal.RECEIVED, (k + 1000) * 1_000_000, lines(k, 1000))
        writer.tick()
        run.look()
        sizes[k + 1000] = tracemalloc.get_traced_memory()[0]
    tracemalloc.stop()
    assert sizes[60_000] < 1.2 * sizes[10_000] + 100_000
    writer.append(journal.END, 60_000_000_000, b'{"reason": "stopped"}')
    writer.sync()
    whole, _ = run_data(journal.read(writer.path))
    for begin in (0.5, 9.25, 28.0, 30.0005, 57.0):  # samples at 9.25 and 28.0 were left out by rounding
        found = json.loads(run.stretch(begin, begin + 2.0))
        own = (whole.time >= begin - 1e-7) & (whole.time <= begin + 2.0 + 1e-7)
        np.testing.assert_allclose(found["t"], whole.time[own], atol=1e-6)
        np.testing.assert_array_equal(found["x"], whole.position[own])
    everything = json.loads(run.stretch(0.0, 60.0))
    assert 250 < len(everything["t"]) < 2000
    assert not everything["exact"]
    assert max(np.diff(everything["t"])) < 2.0
    assert (min(everything["x"]), max(everything["x"])) == (-4000, 4000)


def test_what_nothing_connects_is_told_with_a_row_without_a_position(writer: journal.Writer, look: Any) -> None:
    run = LiveRun(writer.path)
    for first, stop in ((0, 1500), (2000, 3000), (3000, 4000)):
        look(run, (journal.RECEIVED, stop / 1000, lines(first, stop - first)))
    t, x = (np.array([value for event in told(run) for value in event[name]], float) for name in "tx")
    (hole,) = np.flatnonzero(np.isnan(x))
    assert t[hole - 1] < t[hole] < t[hole + 1] == pytest.approx(t[hole - 1] + 0.501)
    assert np.all(np.diff(t) > 0)
    again = json.loads(run.stretch(1.0, 3.0))
    np.testing.assert_array_equal(np.isnan(np.array(again["x"], float)), np.isnan(x[(t >= 1.0) & (t <= 3.0)]))
    everything = json.loads(run.stretch(0.0, 1e6))
    assert everything["x"].count(None) == 1


@pytest.mark.parametrize("delay_s", [0.0, 0.07], ids=["at once", "70 ms late: 6.54 s on the page, 6.608 s in the file"])
def test_a_marker_has_the_same_time_on_the_page_as_in_the_file(
    writer: journal.Writer, look: Any, monkeypatch: pytest.MonkeyPatch, delay_s: float
) -> None:
    run = LiveRun(writer.path)
    for k in range(0, 6540, 20):
        writer.append(journal.RECEIVED, round(1e9 + 1e6 * (k + 20)), lines(k, 20))
    look(run)
    stamp_ns = round(1e9 * (7.541 + delay_s))
    monkeypatch.setattr(publisher.time, "monotonic_ns", lambda: stamp_ns)
    run.mark("a hand")
    for k in range(6540, 7000, 20):
        look(run, (journal.RECEIVED, 1.0 + (k + 20) / 1000, lines(k, 20)))
    (marker,) = [event["marker"] for event in told(run) if "marker" in event]
    writer.append(journal.END, 9_000_000_000, b'{"reason": "stopped"}')
    writer.sync()
    whole, _ = run_data(journal.read(writer.path), journal.read_markers(journal.markers_path(writer.path)))
    ((in_file, text),) = whole.markers
    assert (marker["t"], marker["text"]) == (pytest.approx(in_file, abs=1e-6), text)
    assert in_file == pytest.approx(6.54 + delay_s, abs=0.021)


def test_the_view_names_the_command_that_fits_the_run(writer: journal.Writer, look: Any) -> None:
    run = LiveRun(writer.path)
    last = look(run, (journal.RECEIVED, 2, lines(0, 2001)), (journal.END, 3, b'{"reason": "stopped"}'))
    assert last["ended"] == "Recording stopped by the user"
    assert run.describe_run()["next"] == f"fit-friction {writer.path.with_suffix('')}"
    assert last["duration"] == pytest.approx(2.0, abs=0.01)


def test_blocks_of_a_program_are_analysed_and_can_be_looked_at_again(tmp_path: Path) -> None:
    motion = stick_slip(8, 1000.0, 2e-6)
    kept = tmp_path / "kept.h5.part"
    finish = journal.Writer.remove
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(journal.Writer, "remove", lambda self: (shutil.copy(self.path, kept), finish(self))[1])
        blocks = ((motion.time[k : k + 250], motion.x[k : k + 250]) for k in range(0, motion.time.size, 250))
        daq.record(blocks, tmp_path / "run.h5", rate_hz=1000, mass=0.5)
    run = LiveRun(kept)
    run.look()
    assert run.ended == "Recording complete"
    first = told(run)[0]
    assert (first["unit"], first["summary"]["balance"]["mass"]) == ("m", 0.5)
    assert first["summary"]["cycles"] >= 5
    found = json.loads(run.stretch(2.0, 3.0))
    own = (motion.time >= 2.0 - 1e-9) & (motion.time <= 3.0)
    np.testing.assert_allclose(found["x"], motion.x[own], rtol=1e-6)
