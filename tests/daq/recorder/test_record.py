"""The recorder: from a port to a run file, through everything that can go wrong on the way."""

import errno
import json
import shutil
import signal
import sys
import threading
import time
from dataclasses import replace
from functools import partial
from pathlib import Path

import h5py
import numpy as np
import pytest
from serial import SerialException

import daq
from daq.finalise import run as finalise
from daq.imports import replay
from daq.protocols import session
from daq.protocols.request import RecordRequest
from daq.recorder import ports, reader
from daq.recorder.record import RecordingInterruptedError, record
from daq.runfile import journal, journal_records, store
from daq.wire import frames
from stickslip.errors import DataError, DeviceError, InputError

from ...boards import BoardPort, Clock, motion

CONFIG = "[rig]\nmass = 0.3\n[encoder]\nmetres_per_count = 1e-5\n"
RATE = 1000
board = partial(BoardPort, config=CONFIG)


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    monkeypatch.setattr(session, "QUIET_S", 0.001)
    monkeypatch.setattr(session, "ANSWER_S", 0.1)
    monkeypatch.setattr(session, "ASK_AGAIN_S", 0.03)
    monkeypatch.setattr(reader, "SILENT_S", 0.2)
    monkeypatch.setattr(reader, "REOPEN_S", 0.5)
    monkeypatch.setattr(reader, "REOPEN_EVERY_S", 0.01)
    monkeypatch.setattr(reader, "PAUSE_S", 0.0)


@pytest.fixture
def attach(monkeypatch):
    """Put boards behind the port's name, one after the other as it is opened again; time is theirs."""
    clock = Clock()
    monkeypatch.setattr(BoardPort, "clock", clock)
    for module in ("recorder.record", "recorder.reader", "protocols.session", "protocols.frames"):
        monkeypatch.setattr(f"daq.{module}.time", clock)

    def attach(*boards):
        waiting = iter(boards)

        def open_port(url, baud=0):
            try:
                return next(waiting)
            except StopIteration:
                clock.sleep(reader.REOPEN_EVERY_S)
                raise DeviceError("no such port", url, "connect the board") from None

        monkeypatch.setattr(ports, "open_port", open_port)

    return attach


def request(tmp_path, samples=800, **more):
    return RecordRequest("fake://board", tmp_path / "run.h5", RATE, samples / RATE, **more)


@pytest.fixture
def take(tmp_path, attach):
    """Return a function that records boards, and gives what was found and the run."""

    def take(*boards, samples=800, say=str, **how):
        attach(*boards)
        return record(request(tmp_path, samples, **how), say=say), daq.load(tmp_path / "run.h5")

    return take


def gone(error):
    def fault(line):
        raise error

    return fault


def changed(change):
    return lambda line: frames.encode_samples(change(frames.FrameReader().feed(line)[0]))


def moved(seq=0, ticks=0):
    return changed(lambda block: block._replace(seq=block.seq + seq & 0xFFFF, time=block.time + ticks & 0xFFFFFFFF))


ALWAYS = 10**9
UNPLUGGED = {50: gone(SerialException("gone"))}
MISCOUNTED = changed(lambda block: block._replace(up=[(u + 2) % 65536 for u in block.up], illegal=1))
WITHIN = changed(lambda block: block._replace(dt=[*block.dt[:3], 21_000, *block.dt[4:]]))
REOPENED = {"segments": 2, "warned": ["positions are not connected"], "noted": ["the port was lost for", " ms"]}
REOPENED |= {"said": ["port was lost", "new segment"]}
JUMPED = {"samples": 4000, "lost": 0, "segments": 2, "events": [(1600, "reopened")], "warned": ["jumped", "1.6"]}
LEAPT = {"samples": 800, "lost": 0, "segments": 2, "measured_rate_hz": pytest.approx(RATE, rel=1e-6)}


def leap(leap_s):
    words = {"warned": [f"clock jumped, by {leap_s:g} s at 0.4"], "noted": [f"jumped by +{1e3 * leap_s:.0f} ms"]}
    expected = LEAPT | words | {"events": [(400, "reopened")]}
    return [{range(50, ALWAYS): moved(ticks=round(1e6 * leap_s))}], 800, expected


# The faults of each board that is plugged in, the samples asked for, and the run: attributes of the answer; its
# ``events`` but the edges of both channels at once; parts of the warnings, of the events' notes, and of what was said.
RUNS = {
    "whole, through roll-overs": (
        [{}],
        5000,
        {"samples": 5000, "lost": 0, "segments": 1, "illegal": 0, "phase_errors": 0, "events": []}
        | {"duration_s": pytest.approx(5.0)},
    ),
    "a last block that is cut": ([{}], 803, {"samples": 803}),
    "lost frames": (
        [dict.fromkeys((10, 20, 21), "drop")],
        800,
        {"samples": 776, "lost": 24, "segments": 1, "events": [(80, "gap"), (152, "gap")]}
        | {"warned": ["24 samples were lost in 2 places"]},
    ),
    "many lost frames": (
        [{range(10, 22): "drop"}],
        800,
        {"short": True, "sparse": True, "warned": ["12% of the samples are lost"]},
    ),
    # At 40,000 counts/s or more seen, 16 bits are safe for 0.8 s at most: 1.6 s are not.
    "a gap too long for the counters": (
        [{range(100, 300): "drop"}],
        4000,
        {"segments": 2, "lost": 1600, "events": [(800, "gap"), (800, "invalid")]},
    ),
    "an error of pyserial": ([UNPLUGGED, {}], 2000, REOPENED | {"events": [(400, "reopened")]}),
    "an error of in_waiting": ([{50: "in_waiting"}, {}], 2000, REOPENED),
    "silence": ([{range(50, ALWAYS): "drop"}, {}], 2000, REOPENED),
    "a port that stays away": (
        [UNPLUGGED],
        800,
        {"samples": 400, "short": True, "ended": "port lost"}
        | {"warned": ["0.4 s of samples of the requested 0.8 s were recorded: the port was lost", "(gone) 0."]},
    ),
    "a port lost at the end": ([UNPLUGGED, {}], 401, {"short": False, "sparse": False, "ended": "complete"}),
    "a port lost again and again": (
        [{5: gone(SerialException("gone"))}] * 12 + [{}],
        2000,
        {"segments": 13, "port_lost": 12, "warned": ["lost and reopened 12 times", "the longest outage", "(gone)"]},
    ),
    "counts that disagree with their levels": (
        [{range(20, ALWAYS): MISCOUNTED}],
        800,
        {"illegal": 1, "phase_errors": 640, "events": [(160, "illegal"), (160, "phase")]}
        | {"warned": ["may be off by 2"]},
    ),
    # Of the sequence, of the clock, of both.
    "a jump of the sequence": ([{range(200, ALWAYS): moved(40_000)}], 4000, JUMPED),
    "a silent reset": ([{range(200, ALWAYS): moved(-1600, -1_600_000)}], 4000, JUMPED),
    "a silent reset after an hour": ([{range(200, ALWAYS): moved(30_000, 1_200_000_000)}], 4000, JUMPED),
    "a jump back in the sequence": ([{range(200, ALWAYS): moved(-200, 500_000)}], 4000, JUMPED),
    **{f"a leap of the clock by {leap_s} s": leap(leap_s) for leap_s in (0.02, 3.0)},
    "a leap within a frame": (
        [{50: WITHIN, range(51, ALWAYS): moved(ticks=20_000)}],
        800,
        LEAPT | {"events": [(403, "reopened")]},
    ),
}


@pytest.mark.parametrize("name", RUNS)
def test_what_a_board_does_is_what_the_run_says(tmp_path, take, name):
    faults, samples, expected = RUNS[name]
    said = []
    paced = "leap" in name or "away" in name
    boards = [board(each, first_tick=77 * k, paced=paced) for k, each in enumerate(faults, start=1)]
    found, run = take(*boards, samples=samples, say=said.append)
    events = list(zip(run.event_sample.tolist(), run.event_kind, strict=True))
    shown = {name: getattr(found, name, None) for name in expected}
    shown |= {"events": [event for event in events if event[1] != "both-moved"]}
    texts = {"warned": found.warnings, "noted": run.event_note, "said": said}
    for key, value in expected.items():
        if key in texts:
            assert [part for part in value if not any(part in text for text in texts[key])] == [], texts[key]
        else:
            assert shown[key] == value
    assert (np.diff(run.time) > 0).all()
    assert not (tmp_path / "run.h5.part").exists()
    assert sum(warning.startswith("the port was lost") for warning in found.warnings) <= 1
    truth = motion(np.arange(samples))
    if expected.get("lost") == 0:
        grid = "jump" not in name and "reset" not in name
        assert not grid or run.time == pytest.approx(np.arange(samples) / RATE, abs=1e-6 if "leap" in name else 1e-12)
        assert ((run.count - run.count[0] - truth) % 65536 == 0).all()
    elif not expected.get("illegal"):  # never filled
        assert ((run.count - truth[run.raw.sample]) % 65536 == 0).all()
        if found.segments == 1:
            assert run.time == pytest.approx(run.raw.sample / RATE, abs=1e-12)
            assert np.array_equal(run.count, truth[run.raw.sample])
            assert run.position == pytest.approx(run.count * 1e-5)


def test_a_board_that_pauses_without_counting_it_keeps_its_clock_and_the_pause_is_said(take):
    longer = {range(50, ALWAYS): moved(ticks=60_000)}  # than this, and the counters may have rolled over
    found, run = take(board(longer, paced=True, pause=(50, 0.06)))
    assert (found.segments, "gap" in run.event_kind) == (1, True)
    assert np.diff(run.time)[399] == pytest.approx(0.061)
    assert any("the board paused, for 0.061 s at" in warning for warning in found.warnings)


@pytest.mark.parametrize(
    ("config", "said"),
    [
        (None, "positions are in counts"),
        ("[rig]\nmess = 1\n", "mess"),
        ("a = " + "[" * 1500, "nested too deeply"),
        ("[rig]\nmass = 0x" + "f" * 1500, "too many digits"),
    ],
    ids=["none", "unknown key", "deep", "long number"],
)
def test_a_calibration_that_cannot_be_read_costs_the_calibration_not_the_run(take, config, said):
    found, run = take(board(config=config))
    assert (found.samples, run.unit) == (800, "count")
    assert np.array_equal(run.position, run.count)
    assert any(said in warning for warning in found.warnings)


def test_a_board_may_send_any_text(take):
    # HDF5 holds no NUL, and TOML spells one.
    noticed = {50: lambda line: line + frames.encode_notice("b\0\x1b[7m")}
    said = []
    found, run = take(board(noticed, config="# c\0\n" + CONFIG, firmware="a\0\x1b[7m"), say=said.append)
    assert run.title == r"a\x00\x1b[7m, 1000 Hz"
    assert r"b\x00\x1b[7m" in run.event_note
    assert run.config_toml.startswith("# c\\x00\n")
    assert said[0] == r"a\x00\x1b[7m on fake://board, decoder x4"
    assert any(r"b\x00\x1b[7m" in warning for warning in found.warnings)
    _, run = take(board(), force=True, calibration=CONFIG.replace("[rig]", '[rig]\nname = "a\\u0000b"'))
    assert run.rig.name == r"a\x00b"


def test_the_board_is_asked_set_started_and_stopped_and_told_another_decoder_only(take):
    plain, told, same = board(), board(), board()
    take(plain)
    assert plain.heard == ["X", "I", "R 1000", "B 8", "I", "S", "X"]
    assert plain.closed
    _, run = take(told, decoder="two-counter", force=True)
    assert told.heard[:5] == ["X", "I", "M two-counter", "I", "R 1000"]
    assert run.rig.decoder == "two-counter"
    take(same, decoder="x4", force=True)  # its counters would start again
    assert same.heard == plain.heard


def test_a_board_without_the_decoder_is_no_board_for_this_run(take):
    without = board(decoders=("x4",))
    with pytest.raises(DeviceError, match="M jk: no such decoder"):
        take(without, decoder="jk")
    assert without.closed


def interrupt(seconds):
    raise KeyboardInterrupt


@pytest.mark.parametrize(
    ("wrong", "what"), [({"bits": 0}, "0 bits"), ({"bits": 255}, "255 bits"), ({"tick_ns": 0}, "tick is 0 ns")]
)
def test_an_identification_that_cannot_be_true_is_refused_and_a_journal_with_one_is_read(tmp_path, attach, wrong, what):
    sound, odd = BoardPort(), BoardPort(**wrong)
    attach(odd)
    with pytest.raises(DeviceError, match=what):
        record(request(tmp_path))
    assert not list(tmp_path.iterdir())
    # An earlier version recorded from such a board.
    attach(sound)
    with pytest.raises(RecordingInterruptedError):
        record(request(tmp_path), progress=interrupt)
    part = tmp_path / "run.h5.part"
    spoilt = bytearray(journal.MAGIC)
    for place in journal_records.scan(journal.Content(part.read_bytes())):
        kind, stamp, data = place.record.kind, place.record.stamp_ns, place.record.data
        spoilt += b"".join(journal_records.pack(kind, stamp, data.replace(sound.identify(), odd.identify())))
    assert bytes(spoilt) != part.read_bytes()
    part.write_bytes(spoilt)
    found = finalise.finalise(part, tmp_path / "run.h5", finished_by="daq recover")
    assert found.samples > 0
    assert found.illegal == found.lost == 0


def test_what_the_recorder_itself_could_not_keep_is_counted(take, monkeypatch):
    monkeypatch.setattr(reader, "QUEUE_READS", 4)
    append, sending = journal.Writer.append, board()

    def slow(writer, kind, stamp, data):
        while kind == journal.RECEIVED and sending.running and sending.sent < 100:
            time.sleep(0.001)
        append(writer, kind, stamp, data)

    monkeypatch.setattr(journal.Writer, "append", slow)
    found, _ = take(sending, samples=2000)
    assert found.dropped_bytes > 0
    assert found.samples + found.lost <= 2000
    assert any("was too slow" in warning for warning in found.warnings)


@pytest.mark.parametrize(("sent", "said"), [(b"", "did not reply"), (b"Hello from setup()\r\n", "other bytes")])
def test_a_port_without_a_board_is_a_device_error_and_leaves_nothing(tmp_path, take, sent, said):
    other = board()
    other.out = b""
    other.hear = lambda data: setattr(other, "out", other.out + sent)
    with pytest.raises(DeviceError, match=said):
        take(other)
    assert list(tmp_path.iterdir()) == []


def test_not_one_sample_is_an_error_that_stands_in_nobodys_way(tmp_path, take):
    with pytest.raises(DataError, match="no sample"):
        take(board({range(ALWAYS): "drop"}))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("name", "force", "said"),
    [
        ("run.h5", False, "force=True"),
        ("run.h5.part", False, r"daq recover .*run\.h5\.part"),
        ("run.h5.part", True, r"daq recover .*run\.h5\.part"),
    ],
)
def test_neither_a_file_nor_the_journal_of_a_crashed_run_is_overwritten(tmp_path, take, name, force, said):
    (tmp_path / name).write_bytes(b"precious")
    with pytest.raises(InputError, match=said):
        take(force=force)
    assert (tmp_path / name).read_bytes() == b"precious"


def test_a_disk_that_is_full_meanwhile_keeps_the_journal_and_says_what_to_do(tmp_path, take, monkeypatch):
    left = iter(range(5))

    def sync(writer):
        if next(left, None) is None:
            raise OSError(errno.ENOSPC, "No space left on device")
        writer._file.flush()

    monkeypatch.setattr(journal, "SYNC_EVERY_S", 0.0)
    monkeypatch.setattr(journal.Writer, "sync", sync)
    with pytest.raises(DeviceError, match=r"disk is full.*daq recover .*run\.h5\.part"):
        take(board())
    assert journal.read(tmp_path / "run.h5.part").records
    assert not (tmp_path / "run.h5").exists()


@pytest.mark.parametrize("by", ["file", "event"])
def test_a_stop_or_a_file_beside_the_journal_ends_the_recording_as_the_first_ctrl_c_does(tmp_path, attach, by):
    attach(board(paced=True))
    asked, stop = tmp_path / "run.h5.stop", threading.Event()
    asked.touch()  # one that an earlier recording of this name has left ends nothing
    ask = asked.touch if by == "file" else stop.set
    found = record(request(tmp_path, 600_000), stop=stop, progress=lambda seconds: seconds > 0.2 and ask())
    assert (found.ended, found.lost, found.short) == (journal.STOPPED, 0, False)
    assert 0.2 < found.duration_s < 60.0
    assert daq.load(tmp_path / "run.h5").time.size == found.samples
    assert [path.name for path in tmp_path.iterdir()] == ["run.h5"]


def test_recover_completes_its_own_run_and_replaces_no_other(tmp_path, attach):
    attach(board(), board())
    part, run, other = tmp_path / "run.h5.part", tmp_path / "run.h5", tmp_path / "other.h5"
    for output in (run, other):
        with pytest.raises(RecordingInterruptedError, match="daq recover"):
            record(replace(request(tmp_path), output=output), progress=interrupt)
    shutil.copy(part, tmp_path / "kept")
    finalise.finalise(part, run, finished_by="daq recover")
    made = run.read_bytes()
    shutil.copy(tmp_path / "kept", part)
    finalise.finalise(part, run, finished_by="daq recover")
    with pytest.raises(InputError, match="exists"):
        finalise.finalise(Path(f"{other}.part"), run, finished_by="daq recover")
    assert (run.read_bytes(), part.exists(), Path(f"{other}.part").exists()) == (made, False, True)


def test_a_recovered_file_is_the_finished_one_up_to_who_finished_it(tmp_path, take, monkeypatch):
    kept = tmp_path / "kept"
    kept.mkdir()
    unlink = type(kept).unlink

    def keep(path, missing_ok=False):
        if path == tmp_path / "run.h5.part":
            shutil.copy(path, kept / path.name)
        unlink(path, missing_ok=missing_ok)

    monkeypatch.setattr(type(kept), "unlink", keep)
    take(board({30: "drop"}))
    finalise.finalise(kept / "run.h5.part", kept / "run.h5", finished_by="daq recover")
    monkeypatch.undo()
    for path, finisher in ((tmp_path / "run.h5", "daq record"), (kept / "run.h5", "daq recover")):
        with h5py.File(path, "r+") as file:
            assert file["entry/provenance/finished_by"].asstr()[()] == finisher
            file["entry/provenance/finished_by"][()] = b"x"
    assert (tmp_path / "run.h5").read_bytes() == (kept / "run.h5").read_bytes()


@pytest.mark.skipif(sys.platform == "win32", reason="POSIX signals")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_that_comes_when_the_recording_is_over_takes_no_result(tmp_path, monkeypatch, capsys, number):
    from daq.cli.app import app
    from stickslip.console import application

    def signalled(value):
        signal.raise_signal(number)
        printed(value)

    printed, before = application.print_json, signal.signal(number, signal.default_int_handler)
    monkeypatch.setattr(application, "print_json", signalled)
    try:
        code = application.run(app, ["record", "--duration", "0.1", "-o", str(tmp_path / "run.h5"), "--json"])
        after = signal.getsignal(number)
    finally:
        signal.signal(number, before)
    assert (code, after) == (0, signal.default_int_handler)
    assert json.loads(capsys.readouterr().out)["samples"] == 100


def test_a_board_that_stops_with_a_notice_ends_the_run_and_its_words_are_kept(tmp_path):
    output = tmp_path / "run.h5"
    heard: list[str] = []
    changes = "set=friction.law%3D3&set=start.v%3D-5"  # the linear curve changes its sign at this slip speed
    found = record(RecordRequest(f"rig://rig?{changes}", output), say=heard.append)
    assert found.samples < 20_000
    assert any("force reversal" in line for line in heard)
    assert any("force reversal" in warning for warning in found.warnings)
    kinds = dict(zip(store.load(output).event_kind, store.load(output).event_note, strict=True))
    assert "force reversal" in kinds["notice"]


@pytest.mark.parametrize("decoder", ["x4", "x1", "jk", "jk-latched"])
def test_the_decoder_asked_for_is_the_one_that_counts_and_its_calibration_the_one_that_is_kept(tmp_path, decoder):
    url = ports.rig_url("rig", ["tell.truth=true"], False)
    found = record(RecordRequest(url, tmp_path / "run.h5", duration_s=2, decoder=decoder))
    run, truth = daq.load(tmp_path / "run.h5"), store.truth(tmp_path / "run.h5")
    assert run.rig.decoder == decoder
    edges = 1 if decoder == "x4" else 4
    assert run.rig.metres_per_count.value == pytest.approx(edges * 7.67e-6, rel=0.01)
    assert found.phase_errors == 0
    assert truth.time == pytest.approx(run.time, abs=1e-6)
    error = run.position - truth.x
    assert np.ptp(error[:1000]) < 3 * 30.7e-6 + 1e-3 * np.ptp(truth.x[:1000])  # a few lines, and the pitch as measured
    if decoder == "x4":  # one count of 7.67 um, and the edges' own scatter
        assert np.ptp(error - np.polyval(np.polyfit(truth.x, error, 1), truth.x)) < 1e-5


def test_a_recorder_that_began_meanwhile_is_not_taken_for_a_crash(tmp_path, take):
    # To recover that journal would destroy the other run.
    slow, other = board(), []

    def answer(line):
        if line.startswith("B"):
            other.append(journal.Writer(tmp_path / "run.h5.part", {"wall_ns": 0, "pid": 4711, "host": "lab"}))
        return BoardPort.answer(slow, line)

    slow.answer = answer
    with pytest.raises(InputError, match="process 4711 on lab") as caught:
        take(slow)
    assert "recover" not in str(caught.value)
    other[0].close()


@pytest.fixture
def limit():
    """Return an event that stops a recording that does not end by itself."""
    stop = threading.Event()
    timer = threading.Timer(20, stop.set)
    timer.start()
    yield stop
    timer.cancel()


def test_a_board_that_sends_the_same_samples_again_and_again_ends_at_its_duration(tmp_path, attach, limit):
    same = board().encode(0)
    attach(*(board({range(ALWAYS): lambda line: same}) for _ in range(20)))
    found = record(request(tmp_path, 300), stop=limit)
    assert not limit.is_set()
    assert found.short
    assert found.samples <= 8 * found.segments
    assert any("contain no new sample" in warning for warning in found.warnings)
    assert any("repeated or late" in warning for warning in found.warnings)


def test_a_board_that_sends_noise_ends_and_its_bytes_are_kept(tmp_path, attach, limit):
    attach(board({range(ALWAYS): lambda line: b"\x55" * 300 + b"\0"}))
    with pytest.raises(DataError, match="no sample could be read from the") as caught:
        record(request(tmp_path, 300), stop=limit)
    part = tmp_path / "run.h5.part"
    assert str(part) in caught.value.do
    recorded = journal.read(part)
    assert journal.end_reason(list(recorded.records)[-1]) == journal.PORT_LOST
    assert part.stat().st_size > 1000


@pytest.mark.parametrize("how", ["resets", "is replaced"])
def test_a_segment_is_read_as_the_board_identified_itself_before_it(tmp_path, take, how):
    change = {"tick_ns": 250, "decoder": "x1", "bits": 15}
    boards = [board({100: change})] if how == "resets" else [board({100: UNPLUGGED[50]}), board(**change)]
    found, run = take(*boards, samples=2000)
    assert (found.segments, found.lost, found.phase_errors) == (2, 0, 0)
    first = int(np.searchsorted(run.segment, 1))
    assert first == 800
    for here in (slice(0, first), slice(first, None)):  # the motion that began anew, in m, at 1000 Hz
        x = run.position[here] - run.position[here][0]
        assert x == pytest.approx(motion(np.arange(x.size)) * 1e-5, abs=4e-5)
        assert np.diff(run.time[here]) == pytest.approx(1e-3)
    assert run.time[first] - run.time[first - 1] < 0.5
    assert any("identified itself again" in warning for warning in found.warnings)
    assert run.sent_as.segment.tolist() == [0, 1]
    assert run.sent_as.counter_bits.tolist() == [16, 15]
    assert run.sent_as.counts.tolist() == [1, 4]
    assert "tick 250 ns" in run.sent_as.ident[1]
    again = replay.decode_run(tmp_path / "run.h5")
    assert np.array_equal(again.count, run.count)
    assert np.array_equal(again.position, run.position)


def test_a_finer_decoder_behind_a_reset_divides_the_metres_per_count(take):
    found, run = take(board({100: {"decoder": "x4"}}, decoder="x1"), samples=2000)
    assert (run.rig.decoder, run.rig.metres_per_count.value) == ("x4", pytest.approx(1e-5 / 4))
    assert run.sent_as.counts.tolist() == [4, 1]
    first = int(np.searchsorted(run.segment, 1))
    true = motion(np.arange(800))
    assert np.ptp(run.count[:first] - true[:first]) <= 8
    assert np.ptp(run.count[first : first + 800] - true) == 0
    assert any("decoder changed between x1 and x4" in warning for warning in found.warnings)


def test_a_restarted_board_is_asked_for_its_identification_and_keeps_the_decoder_of_the_run(take):
    forgetful = board({100: {"decoder": "x4"}})  # its own decoder, until it is told
    _, run = take(forgetful, samples=2000, decoder="x1")
    assert forgetful.heard[-6:] == ["M x1", "R 1000", "B 8", "I", "S", "X"]
    assert run.rig.decoder == "x1"
    assert run.sent_as is None
