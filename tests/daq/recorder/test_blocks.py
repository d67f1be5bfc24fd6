"""Blocks of samples that a program hands over: the same journal, safety, live view and quality as of a board."""

import re
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest

import daq
from daq.finalise.run import finalise
from daq.live.tail import JournalTail
from daq.protocols import blocks as packing
from daq.recorder.record import RecordingInterruptedError
from daq.runfile import journal
from stickslip.errors import DataError, DeviceError, InputError
from stickslip.units import Measured

from ...journals import write_journal

RATE = 1000
TIME = np.arange(2000) / RATE
X = 0.01 * np.sin(6 * TIME) + 0.1


MASKED = np.ma.array(X[700:800], mask=TIME[700:800] > 0.75)


def card(x=X, t=TIME, size=100, after=lambda k: None):
    """Yield blocks as a data acquisition card gives them; ``after`` is called before each with its number."""
    for k in range(len(t) // size):
        after(k)
        own = slice(k * size, (k + 1) * size)
        yield t[own], x[own]


def failing(at, error):

    def fail(k):
        if k == at:
            raise error

    return fail


def taken(tmp_path, source, **how):
    found = daq.record(source, tmp_path / "run.h5", **({"rate_hz": RATE} | how))
    return found, daq.load(tmp_path / "run.h5")


def test_positions_are_kept_to_the_last_bit(tmp_path):
    found, run = taken(tmp_path, card(), mass="300 g +- 1 g", x0="-5 mm", title="a card", sample="steel")
    np.testing.assert_array_equal(run.position, X)
    np.testing.assert_array_equal(run.time, TIME)
    assert (run.count, run.raw, run.unit, run.rate_hz) == (None, None, "m", RATE)
    assert (run.rig.mass, run.rig.x0) == (Measured(0.3, 0.001), Measured(-0.005))
    assert (run.title, run.sample_name) == ("a card", "steel")
    assert (found.samples, found.lost, found.segments, found.warnings) == (2000, 0, 1, ())
    assert (found.ended, found.asked_s, found.short, found.file) == ("complete", None, False, tmp_path / "run.h5")
    assert not list(tmp_path.glob("*.part*"))
    assert repr(found) == "<RecordingQuality run.h5: 2000 samples, 2 s at 1000 Hz, no sample lost>"


def test_integers_are_counts(tmp_path):
    count = np.rint(X / 1e-6).astype(np.int32)
    _, run = taken(tmp_path, card(count), metres_per_count="1 um")
    np.testing.assert_array_equal(run.count, count)
    np.testing.assert_allclose(run.position, count * 1e-6, rtol=1e-15)
    found = daq.record(card(count.astype(np.int64) + 2**40), tmp_path / "bare.h5", rate_hz=RATE)
    assert found.warnings == ("the metres per count are not known, so positions are in counts",)
    bare = daq.load(tmp_path / "bare.h5")
    np.testing.assert_array_equal(bare.count, count.astype(np.int64) + 2**40)
    assert bare.unit == "count"


@pytest.mark.parametrize(
    "source",
    [
        lambda: ([t, x] for t, x in zip(TIME[:200].tolist(), X[:200].tolist(), strict=True)),
        lambda: [(TIME[:7].tolist(), X[:7].tolist()), ([], []), (TIME[7:200], X[7:200])],
        lambda: iter([np.array([TIME[:200], X[:200]])]),
        lambda: ((TIME[k], X[k]) for k in range(200)),
    ],
    ids=["single samples", "lists, and an empty block", "an array of two rows", "numbers of numpy"],
)
def test_any_iterable_of_blocks_is_a_source(tmp_path, source):
    _, run = taken(tmp_path, source())
    np.testing.assert_array_equal(run.position, X[:200])


def test_times_of_another_clock_begin_with_0_and_a_long_block_is_cut_into_records(tmp_path):
    n = 2 * packing.RECORD_SAMPLES + 5
    time_s = 1.7e9 + np.arange(n) / RATE
    found, run = taken(tmp_path, [(time_s, np.arange(n, dtype=float))])
    assert (found.samples, found.lost) == (n, 0)
    np.testing.assert_array_equal(run.time, time_s - time_s[0])
    np.testing.assert_array_equal(run.position, np.arange(n))


def test_missing_samples_are_counted_and_marked_and_never_filled(tmp_path):
    keep = np.ones(2000, bool)
    keep[[250, 251, 900]] = False
    parts = [(TIME[own][keep[own]], X[own][keep[own]]) for own in (slice(0, 300), slice(300, 900), slice(900, 2000))]
    found, run = taken(tmp_path, parts)
    assert (found.samples, found.lost, found.sparse) == (1997, 3, False)
    assert found.warnings == ("3 samples were lost in 2 places",)
    assert run.event_kind == ("gap", "gap")
    assert run.time[run.event_sample].tolist() == [0.252, 0.901]
    np.testing.assert_array_equal(run.position, X[keep])


def test_a_source_that_ends_early_is_a_short_run(tmp_path):
    found, _ = taken(tmp_path, card(), seconds=5)
    assert (found.ended, found.short, found.asked_s) == ("source ended", True, 5.0)
    assert found.warnings == ("2 s of samples of the requested 5 s were recorded: the source ended",)


def test_enough_samples_end_the_recording_and_close_the_generator(tmp_path):
    closed = []

    def source():
        try:
            yield from card()
        finally:
            closed.append(True)

    found, run = taken(tmp_path, source(), rate_hz="1 kHz", seconds="550 ms")
    assert (found.samples, found.ended, closed, run.rate_hz) == (550, "complete", [True], 1000)
    np.testing.assert_array_equal(run.position, X[:550])


def empty_blocks():
    while True:
        time.sleep(0.01)
        yield [], []


BLOCKS_S = 60.0


def blocking():
    time.sleep(BLOCKS_S)
    yield [], []


@pytest.mark.parametrize("then", [empty_blocks, blocking])
@pytest.mark.parametrize("began", [True, False], ids=["after samples", "before the first"])
@pytest.mark.parametrize("by", ["stop", "seconds"])
def test_a_source_that_gives_nothing_is_ended(tmp_path, monkeypatch, then, began, by):
    monkeypatch.setattr("daq.recorder.blocks.LEAVE_S", 0.3)
    monkeypatch.setattr("daq.recorder.blocks.SILENT_S", 0.5)

    stop = threading.Event()
    how = {"stop": stop} if by == "stop" else {"seconds": 0.8}

    def source():
        yield from card(t=TIME[:700]) if began else []
        threading.Timer(0.3, stop.set).start()
        yield from then()

    begun = time.monotonic()
    if began:
        found, _ = taken(tmp_path, source(), **how)
        assert (found.samples, found.ended) == (700, "stopped" if by == "stop" else "source silent")
        assert any("the source gave no further samples" in text for text in found.warnings) == (by == "seconds")
    else:
        stopped, silent = (
            (RecordingInterruptedError, "before the first block"),
            (DataError, "no samples in 0.8 s"),
        )
        error, words = stopped if by == "stop" else silent
        with pytest.raises(error, match=words):
            taken(tmp_path, source(), **how)
        assert not list(tmp_path.iterdir())
    assert time.monotonic() - begun < BLOCKS_S  # not waited for


def test_a_file_beside_the_journal_ends_the_recording(tmp_path):
    def ask(k):
        if k >= 5:
            (tmp_path / "run.h5.stop").touch()
            time.sleep(0.05)

    found, run = taken(tmp_path, card(np.zeros(100_000), np.arange(100_000) / RATE, after=ask))
    assert found.ended == journal.STOPPED
    assert 500 <= found.samples == run.time.size < 5000
    assert [path.name for path in tmp_path.iterdir()] == ["run.h5"]


def test_ctrl_c_in_the_source_keeps_what_came(tmp_path):
    found, run = taken(tmp_path, card(after=failing(7, KeyboardInterrupt())), seconds=2)
    assert (found.samples, found.ended, found.short) == (700, "stopped", False)
    np.testing.assert_array_equal(run.position, X[:700])
    with pytest.raises(RecordingInterruptedError, match="before the first block"):
        daq.record(card(after=lambda k: signal.raise_signal(signal.SIGINT)), tmp_path / "none.h5", rate_hz=RATE)
    assert not list(tmp_path.glob("none*"))


def test_the_least_integer_is_no_count_and_those_before_it_are_kept(tmp_path):
    count = np.arange(2000)
    count[1050] = np.iinfo(np.int64).min  # what a NaN becomes as an integer; its absolute value is negative
    with pytest.raises(InputError, match=r"the value of sample 50 in block 11 is -9.22337e\+18"):
        taken(tmp_path, card(x=count))
    assert daq.load(tmp_path / "run.h5").count.tolist() == list(range(1000))


def test_a_journal_stays_until_its_run_file_can_be_read(tmp_path, monkeypatch):
    monkeypatch.setattr("daq.recorder.blocks.FARTHEST", 1e300)
    with pytest.raises(InputError, match=r"position is 1e\+20, too large at sample 500; the journal is kept"):
        taken(tmp_path, card(x=np.where(TIME == 0.5, 1e20, X)))
    assert (tmp_path / "run.h5.part").exists()


def test_an_error_of_the_source_is_raised_and_what_came_before_is_in_the_file(tmp_path):
    class CardError(OSError):
        pass

    with pytest.raises(DeviceError, match=r"the source failed: CardError: buffer overflow; .* 700 samples") as caught:
        taken(tmp_path, card(after=failing(7, CardError("buffer overflow"))))
    assert isinstance(caught.value.__cause__, CardError)
    run = daq.load(tmp_path / "run.h5")
    np.testing.assert_array_equal(run.position, X[:700])

    class SilentError(Exception):
        def __str__(self):
            raise RuntimeError

    with pytest.raises(DeviceError, match="the source failed: SilentError; "):
        taken(tmp_path, card(after=failing(7, SilentError())), force=True)
    assert daq.load(tmp_path / "run.h5").time.size == 700
    with pytest.raises(DeviceError, match="failed before its first block: CardError: none"):
        daq.record(card(after=failing(0, CardError("none"))), tmp_path / "n.h5", rate_hz=RATE)
    assert not (tmp_path / "n.h5.part").exists()


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ((TIME[700:800], X[700:799]), "block 8 has 100 times and 99 values"),
        ((TIME[650:750], X[700:800]), "time does not increase at sample 0 in block 8: 0.65 s after 0.699 s"),
        ((TIME[700:800], np.where(TIME[700:800] == 0.75, np.inf, X[700:800])), "value of sample 50 in block 8 is inf"),
        ((TIME[700:800], np.arange(100)), "block 8 has counts (integers) after positions (floats)"),
        (TIME[700:800], "block 8 is a ndarray of shape (100,) instead of two arrays"),
        ((TIME[700:800], ["a"] * 100), "daq.record, block 8: position contains <U1 values instead of numbers"),
        (None, "block 8 is a NoneType instead of two arrays"),
        ((TIME[700:800], MASKED), "daq.record, block 8: position is masked at sample 51 and 48 more"),
        ((TIME[700:800], X[700:800] > 0), "block 8: position contains bool values"),
        ((TIME[700:800].astype("M8[s]"), X[700:800]), "block 8: time contains dates or durations instead of numbers"),
        ((TIME[700:800] * np.where(TIME[700:800] > 0.75, 1e12, 1), X[700:800]), "its times reach"),
    ],
)
def test_a_wrong_block_is_named_and_those_before_it_are_kept(tmp_path, wrong, words):
    with pytest.raises(InputError, match=re.escape(words)) as caught:
        taken(tmp_path, [*card(t=TIME[:700]), wrong])
    assert "the 700 samples before it are in" in str(caught.value)
    assert daq.load(tmp_path / "run.h5").time.size == 700


@pytest.mark.parametrize(
    ("source", "how", "words"),
    [
        (lambda: (1e3 * TIME, X), {}, "block 1 is a ndarray of shape (2000,)"),
        (
            lambda: [(1e3 * TIME, X)],
            {},
            "the times have a rate of 1 Hz, but rate_hz is 1000; use rate_hz=1, or times in s",
        ),
        (lambda: card(t=TIME * 2, size=5), {}, "the times have a rate of 500 Hz, but rate_hz is 1000"),
        (lambda: iter([]), {}, "the source yielded no samples"),
        (lambda: 5, {}, "the source must not be a int; pass a port, a URL, or an iterable of blocks (t, x)"),
        (lambda: {"t": TIME, "x": X}, {}, "the source must not be a dict"),
        (card, {"rate_hz": None}, "rate_hz is None; pass the samples per second"),
        (card, {"rate_hz": 0}, "rate_hz is 0"),
        (card, {"mass": "3 m"}, "mass: 'm' is not a unit of mass"),
        (card, {"seconds": -1}, "the duration is -1 s"),
        (card, {"tags": {"a b": "c"}}, "'a b=c' is not a tag"),
        (card, {"tags": "a=b"}, "tags is a str; give a mapping of texts"),
        (card, {"title": b"a"}, "title is a bytes; give text"),
        (card, {"stop": True}, "stop is a bool; give a threading.Event"),
        (card, {"rig": 5}, "rig is a int; give the path of a rig.toml"),
        (card, {"rate_hz": "1 m"}, "rate_hz: 'm' is not a unit of rate"),
        (card, {"rate_hz": True}, "rate_hz is True; pass a number in Hz"),
        (card, {"rate_hz": float("nan")}, "rate_hz is nan"),
        (card, {"rate_hz": "1 kHz +- 1 Hz"}, "rate_hz: '1 kHz +- 1 Hz' has an error, which is not accepted here"),
        (card, {"seconds": "2 s +- 1 s"}, "seconds: '2 s +- 1 s' has an error, which is not accepted here"),
        (card, {"seconds": "2 kg"}, "seconds: 'kg' is not a unit of time"),
        (card, {"seconds": float("nan")}, "the duration is nan s"),
        (lambda: "rig://rig", {"rate_hz": float("inf")}, "a port requires whole Hz"),
        (lambda: "rig://rig", {"baud": "fast"}, "baud is a str; give a whole number"),
        (lambda: "rig://rig", {"rate_hz": 0.5}, "a port requires whole Hz"),
        (lambda: "nowhere://rig", {}, "nowhere:// is not a supported kind of port"),
    ],
)
def test_what_cannot_be_is_refused_and_leaves_nothing(tmp_path, source, how, words):
    with pytest.raises((InputError, DataError), match=re.escape(words)):
        taken(tmp_path, source(), **how)
    assert not list(tmp_path.iterdir())


def test_no_file_is_replaced_unless_forced(tmp_path):
    taken(tmp_path, card())
    with pytest.raises(InputError, match="exists"):
        taken(tmp_path, card())
    found, _ = taken(tmp_path, card(t=TIME[:500]), force=True)
    assert found.samples == 500
    with pytest.raises(InputError, match="CSV"):
        daq.record(card(), tmp_path / "run.csv", rate_hz=RATE)


KILLED = """
import os, signal, sys
import numpy as np
import daq

def blocks():
    for k in range(40):
        if k == 25:
            os.kill(os.getpid(), signal.SIGKILL)
        t = (50 * k + np.arange(50)) / 1000
        yield t, 0.01 * np.sin(6 * t) + 0.1

daq.record(blocks(), sys.argv[1], rate_hz=1000, stiffness="10 N/m")
"""


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="no SIGKILL on this system")
def test_a_killed_recording_gives_all_blocks_by_recover(tmp_path):
    run, part = tmp_path / "run.h5", tmp_path / "run.h5.part"
    done = subprocess.run([sys.executable, "-c", KILLED, str(run)], cwd=tmp_path, check=False)
    assert done.returncode == -signal.SIGKILL
    assert not run.exists()
    with part.open("ab") as file:
        file.write(b"R\xff")  # a record that was cut short
    recovered = finalise(part, run, finished_by="daq recover")
    assert recovered.samples == 1250
    assert any("an incomplete record" in text for text in recovered.warnings)
    found = daq.load(run)
    np.testing.assert_array_equal(found.position, X[:1250])
    np.testing.assert_array_equal(found.time, TIME[:1250])
    assert found.rig.stiffness == Measured(10.0)


def test_a_damaged_record_costs_its_own_samples(tmp_path):
    part, content = tmp_path / "run.h5.part", bytearray()
    taken(tmp_path, card(after=lambda k: k == 19 and content.extend(part.read_bytes())))
    at = content.index(X[500:501].tobytes())
    content[at + 3] ^= 0x10
    part = tmp_path / "damaged.h5.part"
    part.write_bytes(content)
    found = finalise(part, tmp_path / "damaged.h5", finished_by="daq recover")
    assert (found.samples, found.lost, found.crc_errors) == (1800, 100, 1)
    np.testing.assert_array_equal(daq.load(tmp_path / "damaged.h5").position, np.delete(X[:1900], slice(500, 600)))
    assert part.read_bytes() == content
    assert any("damaged" in text and part.name in text for text in found.warnings)


def test_the_live_view_sees_each_block_and_a_marker_becomes_an_event(tmp_path):
    part = tmp_path / "run.h5.part"
    seen = []

    def look(k):
        if k == 1:
            seen.append(JournalTail(part))
        if k in (1, 2, 10):
            new = seen[0].poll()
            seen.append((sum(one.time.size for one in new), seen[0].counts.lost, seen[0].unit))
            if k == 10:
                with journal.markers_path(part).open("a") as file:
                    file.write(f"12 long ago\n{time.monotonic_ns()} here\n")
                time.sleep(0.01)

    blocks = ((t[keep], x[keep]) for t, x in card(after=look) for keep in [(t < 0.15) | (t >= 0.16)])
    _, run = taken(tmp_path, blocks)
    assert seen[1:] == [(100, 0, "m"), (90, 10, "m"), (800, 10, "m")]
    assert [kind for kind in run.event_kind if kind == "marker"] == ["marker"]
    assert run.markers[0][1] == "here"
    assert 0.9 <= run.markers[0][0] <= 1.1


def test_a_port_is_recorded_as_the_command_records_it(tmp_path):
    found = daq.record("rig://rig", tmp_path / "run.h5", rate_hz=500, seconds=1, mass="400 g +- 1 g", operator="Ada")
    run = daq.load(tmp_path / "run.h5")
    assert (found.samples, run.rate_hz, run.operator) == (500, 500, "Ada")
    assert run.rig.mass == Measured(0.4, 0.001)
    assert run.rig.metres_per_count.value == pytest.approx(7.67e-6, rel=1e-3)  # as the board sends it


def test_a_rig_toml_is_taken_and_what_is_stated_replaces_it(tmp_path):
    toml = tmp_path / "rig.toml"
    toml.write_text("[rig]\nmass = 0.3\nstiffness = 10.0\n[encoder]\ndatum = 0.1\n")
    _, run = taken(tmp_path, card(), rig=toml, mass=0.5, x0=0.01)
    found = run.rig.mass, run.rig.stiffness, run.rig.x0, run.rig.datum
    assert found == (Measured(0.5), Measured(10.0), Measured(0.01), None)


def test_the_clock_of_a_source_is_compared_with_this_machines(tmp_path):
    header = {}  # as the recorder makes it
    taken(tmp_path, card(after=lambda k: k == 1 and header.update(journal.read_header(tmp_path / "run.h5.part"))))
    records = []
    for k in range(120):  # blocks of 0.5 s by a clock that is fast by 500 ppm, up to 3 ms late
        t = np.arange(500 * k, 500 * k + 500) / RATE
        stamp = header["monotonic_ns"] + round(1e9 * t[-1] / 1.0005) + k * 7919 % 31 * 100_000
        records.append((journal.RECEIVED, stamp, next(iter(packing.pack(t, t)))))
    part = write_journal(tmp_path / "clock.h5.part", records, header)
    found = finalise(part, tmp_path / "clock.h5", finished_by="daq recover")
    assert found.clock_ppm == pytest.approx(500, abs=10)
    assert abs(found.clock_ppm - 500) <= (found.clock_ppm_error or 10)
