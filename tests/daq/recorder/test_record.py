"""The recorder: from a port to a run file, through everything that can go wrong on the way."""

import errno
import json
import shutil
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace

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
from daq.wire.frames import Capability
from daq.wire.quadrature import levels_of
from stickslip.errors import DataError, DeviceError, InputError

CONFIG = "[rig]\nmass = 0.3\n[encoder]\nmetres_per_count = 1e-5\n"
RATE = 1000


def motion(k):
    """Return the x4 count of the fake board's sample k: back and forth, some 16-bit roll-overs of `up`."""
    return 40_000 * np.sin(np.asarray(k) * 0.01) // 1


def counters(k):
    n = motion(np.arange(k.stop)).astype(np.int64)
    steps = np.diff(n, prepend=0)
    up, down = np.cumsum(np.maximum(steps, 0)), np.cumsum(np.maximum(-steps, 0))
    return up[k], down[k], n[k]


class FakeBoard:
    """A board on a port: answers commands, sends a frame at each read; ``faults`` says what goes wrong at which frame.

    A fault is a function of the frame's bytes that returns other bytes, or raises.
    """

    def __init__(self, faults=None, start_ticks=5000, config=CONFIG, capabilities=None):
        self.faults = faults or {}
        self.config = config
        self.start_ticks = start_ticks
        every = Capability.BLOCKS | Capability.LEVELS | Capability.ILLEGAL
        self.capabilities = every | Capability.CONFIG * (config is not None) if capabilities is None else capabilities
        self.block = 8
        self.decoder = "x4"
        self.decoders = frames.DECODERS
        self.buffer = b""
        self.running = False
        self.frame = 0
        self.commands = []
        self.closed = False

    def ident(self):
        return frames.encode_ident(
            frames.Ident((1, 2, 3), self.decoder, self.capabilities, 16, 1000, self.block, 5000, 10**8, "fake")
        )

    def write(self, data):
        for line in data.decode().split("\n"):
            self.commands.append(line)
            if line == "I":
                self.buffer += self.ident()
                if Capability.CONFIG in self.capabilities:
                    self.buffer += frames.encode_config(self.config)
            elif line.startswith("B"):
                self.block = int(line[1:])
            elif line.startswith("M") and line[2:] in self.decoders:
                self.decoder = line[2:]
            elif line.startswith("M"):
                self.buffer += frames.encode_notice(f"{line}: no such decoder")
            elif line == "S":
                self.running, self.frame = True, 0
            elif line == "X":
                self.running = False

    def samples(self, frame):
        first = frame * self.block
        up, down, n = counters(slice(first, first + self.block))
        ticks = self.start_ticks + 1000 * first
        dt = [0, *[1000] * (self.block - 1)]
        columns = (dt, (up % 65536).tolist(), (down % 65536).tolist(), levels_of(n).tolist())
        return frames.encode_samples(frames.SampleBlock(first & 0xFFFF, ticks % 2**32, 0, *columns))

    @property
    def in_waiting(self):
        if self.running and self.frame in self.faults.get("in_waiting", ()):
            raise OSError(errno.EIO, "Input/output error")
        return len(self.buffer)

    def read(self, size=1):
        if self.running and not self.buffer:
            line = self.samples(self.frame)
            fault = self.faults.get(self.frame)
            self.frame += 1
            self.buffer += fault(line) if fault else line
        elif not self.buffer:
            time.sleep(0.001)
        data, self.buffer = self.buffer[:size], self.buffer[size:]
        return data

    def close(self):
        self.closed = True


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
    """Put boards behind the port's name, one after the other as it is opened again."""

    def attach(*boards):
        waiting = iter(boards)

        def open_port(url, baud=0):
            try:
                return next(waiting)
            except StopIteration:
                raise DeviceError("no such port", url, "plug the board in") from None

        monkeypatch.setattr(ports, "open_port", open_port)

    return attach


def request(tmp_path, samples=800, **more):
    return RecordRequest("fake://board", tmp_path / "run.h5", RATE, samples / RATE, **more)


def kinds(run):
    return list(zip(run.event_sample.tolist(), run.event_kind, strict=True))


def raising(error):
    def fault(line):
        raise error

    return fault


def test_a_board_may_send_any_text(tmp_path, attach):
    # A NUL in a board's name, CONFIG or NOTICE ended in "VLEN strings do not support embedded NULLs", exit code 1,
    # and so did `daq recover`: nothing could build the journal.
    class Odd(FakeBoard):
        def ident(self):
            return frames.encode_ident(
                frames.Ident(
                    (1, 2, 3), self.decoder, self.capabilities, 16, 1000, self.block, 5000, 10**8, "a\0\x1b[7m"
                )
            )

    board = Odd(faults={50: lambda line: line + frames.encode_notice("b\0\x1b[7m")}, config="# c\0\n" + CONFIG)
    attach(board)
    said = []
    found = record(request(tmp_path), say=said.append)
    run = daq.load(tmp_path / "run.h5")
    assert run.title == r"a\x00\x1b[7m, 1000 Hz"
    assert r"b\x00\x1b[7m" in run.event_note
    assert run.config_toml.startswith("# c\\x00\n")
    assert said[0] == r"a\x00\x1b[7m on fake://board, decoder x4"
    assert any(r"b\x00\x1b[7m" in warning for warning in found.warnings)


def test_a_calibration_may_hold_any_text(tmp_path, attach):
    # TOML spells a NUL: the name of a rig.toml ended as that of a board did.
    attach(FakeBoard())
    record(request(tmp_path, calibration=CONFIG.replace("[rig]", '[rig]\nname = "a\\u0000b"')))
    assert daq.load(tmp_path / "run.h5").rig.name == r"a\x00b"


def test_every_sample_comes_through_the_counters_roll_overs(tmp_path, attach):
    attach(FakeBoard())
    found = record(request(tmp_path, 5000))
    run = daq.load(tmp_path / "run.h5")
    _, _, n = counters(slice(0, 5000))
    assert (found.samples, found.lost, found.segments, found.illegal, found.phase_errors) == (5000, 0, 1, 0, 0)
    assert np.array_equal(run.count - run.count[0], n - n[0])
    assert run.time == pytest.approx(np.arange(5000) / RATE, abs=1e-12)
    assert run.position == pytest.approx(run.count * 1e-5)
    assert found.duration_s == pytest.approx(5.0)
    assert kinds(run) == [k for k in kinds(run) if k[1] == "both-moved"]
    assert not (tmp_path / "run.h5.part").exists()


def test_the_board_is_asked_set_started_and_stopped(tmp_path, attach):
    board = FakeBoard()
    attach(board)
    record(request(tmp_path))
    assert [c for c in board.commands if c] == ["X", "I", "R 1000", "B 8", "I", "S", "X"]
    assert board.closed


def test_a_board_with_another_decoder_is_told_which_and_only_then(tmp_path, attach):
    boards = FakeBoard(), FakeBoard()
    attach(*boards)
    record(request(tmp_path, decoder="two-counter"))
    assert [c for c in boards[0].commands if c][:5] == ["X", "I", "M two-counter", "I", "R 1000"]
    assert daq.load(tmp_path / "run.h5").rig.decoder == "two-counter"
    (tmp_path / "run.h5").unlink()
    record(request(tmp_path, decoder="x4"))  # its counters would start again
    assert not [c for c in boards[1].commands if c.startswith("M")]


def test_a_board_without_the_decoder_is_no_board_for_this_run(tmp_path, attach):
    board = FakeBoard()
    board.decoders = ("x4",)
    attach(board)
    with pytest.raises(DeviceError, match="M jk: no such decoder"):
        record(request(tmp_path, decoder="jk"))
    assert board.closed


@pytest.mark.parametrize(
    ("wrong", "what"),
    [({"counter_bits": 0}, "0 bits"), ({"counter_bits": 255}, "255 bits"), ({"tick_ns": 0}, "tick is 0 ns")],
)
def test_an_identification_that_cannot_be_true_is_refused_and_a_journal_with_one_is_read(tmp_path, attach, wrong, what):
    sound = frames.Ident((1, 2, 3), "x4", Capability.BLOCKS | Capability.LEVELS, 16, 1000, 8, 5000, 10**8, "fake")
    board = FakeBoard(capabilities=sound.capabilities)
    board.ident = lambda: frames.encode_ident(replace(sound, **wrong))
    attach(board)
    with pytest.raises(DeviceError, match=what):
        record(request(tmp_path))
    assert not list(tmp_path.iterdir())
    # An earlier version recorded from such a board, and then recover ended in a traceback.
    attach(FakeBoard(capabilities=sound.capabilities))
    with pytest.raises(RecordingInterruptedError):
        record(request(tmp_path), progress=interrupt)
    part = tmp_path / "run.h5.part"
    spoilt = bytearray(journal.MAGIC)
    for place in journal_records.scan(journal.Content(part.read_bytes())):
        kind, stamp, data = place.record.kind, place.record.stamp_ns, place.record.data
        sent = data.replace(frames.encode_ident(sound), frames.encode_ident(replace(sound, **wrong)))
        spoilt += b"".join(journal_records.packed(kind, stamp, sent))
    assert bytes(spoilt) != part.read_bytes()
    part.write_bytes(spoilt)
    found = finalise.finalise(part, tmp_path / "run.h5", finished_by="daq recover")
    assert found.samples > 0
    assert found.illegal == found.lost == 0


def test_the_last_block_is_cut_to_the_samples_asked_for(tmp_path, attach):
    attach(FakeBoard())
    assert record(request(tmp_path, 803)).samples == 803


def test_lost_frames_are_counted_and_marked_and_never_filled(tmp_path, attach):
    attach(FakeBoard({10: lambda line: b"", 20: lambda line: b"", 21: lambda line: b""}))
    found = record(request(tmp_path))
    run = daq.load(tmp_path / "run.h5")
    assert (found.samples, found.lost, found.segments) == (776, 24, 1)
    assert [k for k in kinds(run) if k[1] == "gap"] == [(80, "gap"), (152, "gap")]
    assert run.raw.sample[79:81].tolist() == [79, 88]
    assert np.diff(run.time)[79] == pytest.approx(0.009)
    assert np.array_equal(run.count, counters(slice(0, 800))[2][run.raw.sample])
    assert "24 samples were lost in 2 places" in found.warnings


@pytest.mark.parametrize(
    "faults",
    [
        {50: raising(SerialException("device disconnected"))},
        {50: raising(OSError(errno.EIO, "Input/output error"))},
        {"in_waiting": (50,)},
        dict.fromkeys(range(50, 10_000), lambda line: b""),
    ],
    ids=["SerialException", "OSError", "in_waiting", "silence"],
)
def test_a_lost_port_is_opened_again_and_a_new_segment_begins(tmp_path, attach, faults):
    said = []
    attach(FakeBoard(faults), FakeBoard(start_ticks=77))
    found = record(request(tmp_path, 2000), say=said.append)
    run = daq.load(tmp_path / "run.h5")
    assert found.segments == 2
    first = int(np.searchsorted(run.segment, 1))
    assert first in (392, 400)
    assert (first, "reopened") in kinds(run)
    assert "the port was lost for" in run.event_note[run.event_kind.index("reopened")]
    assert " ms" in run.event_note[run.event_kind.index("reopened")]
    assert run.raw.sample[first] == 0
    assert run.time[first] > run.time[first - 1]
    assert any("port was lost" in line for line in said)
    assert any("new segment" in line for line in said)
    assert "positions are not connected" in " ".join(found.warnings)


def test_a_port_that_stays_away_leaves_what_came(tmp_path, attach):
    attach(FakeBoard({50: raising(SerialException("gone"))}))
    found = record(request(tmp_path))
    assert found.samples == 400


def test_a_gap_too_long_for_the_counters_is_invalid_and_not_joined(tmp_path, attach):
    """At 40,000 counts/s or more seen, 16 bits are safe for 0.8 s at most: 1.6 s are not."""
    attach(FakeBoard(dict.fromkeys(range(100, 300), lambda line: b"")))
    found = record(request(tmp_path, 4000))
    run = daq.load(tmp_path / "run.h5")
    assert (found.segments, found.lost) == (2, 1600)
    assert (800, "invalid") in kinds(run)
    assert (run.count[800] - counters(slice(0, 4000))[2][2400]) % 65536 == 0


def test_counts_that_disagree_with_their_levels_are_flagged(tmp_path, attach):
    class Miscounting(FakeBoard):
        def samples(self, frame):
            block = frames.FrameReader().feed(super().samples(frame))[0]
            if frame < 20:
                return frames.encode_samples(block)
            up = [(u + 2) % 65536 for u in block.up]
            illegal = 1
            return frames.encode_samples(
                frames.SampleBlock(block.seq, block.time, illegal, block.dt, up, block.down, block.status)
            )

    attach(Miscounting())
    found = record(request(tmp_path))
    run = daq.load(tmp_path / "run.h5")
    assert (found.illegal, found.phase_errors) == (1, 640)
    assert [k for k in kinds(run) if k[1] in ("illegal", "phase")] == [(160, "illegal"), (160, "phase")]
    assert "may be off by 2" in " ".join(found.warnings)


def test_a_board_without_calibration_records_counts(tmp_path, attach):
    attach(FakeBoard(config=None))
    found = record(request(tmp_path))
    run = daq.load(tmp_path / "run.h5")
    assert run.unit == "count"
    assert np.array_equal(run.position, run.count)
    assert any("positions are counts" in warning for warning in found.warnings)


@pytest.mark.parametrize(
    ("config", "said"),
    [
        ("[rig]\nmess = 1\n", "mess"),
        ("a = " + "[" * 1500, "nested too deeply"),  # these two ended the recording in a traceback
        ("[rig]\nmass = 0x" + "f" * 1500, "too many digits"),
    ],
)
def test_a_calibration_that_cannot_be_read_costs_the_calibration_not_the_run(tmp_path, attach, config, said):
    attach(FakeBoard(config=config))
    found = record(request(tmp_path))
    assert found.samples == 800
    assert any(said in warning for warning in found.warnings)


def test_what_the_recorder_itself_could_not_keep_is_counted(tmp_path, attach, monkeypatch):
    monkeypatch.setattr(reader, "QUEUE_READS", 4)
    append = journal.Writer.append

    def slow(writer, kind, stamp, data):
        time.sleep(0.002)
        append(writer, kind, stamp, data)

    monkeypatch.setattr(journal.Writer, "append", slow)
    attach(FakeBoard())
    found = record(request(tmp_path, 2000))
    assert found.dropped_bytes > 0
    assert found.samples + found.lost <= 2000
    assert any("could not keep up" in warning for warning in found.warnings)


def test_a_silent_port_is_a_device_error_and_leaves_nothing(tmp_path, attach):
    class Mute(FakeBoard):
        def write(self, data):
            """Hear nothing."""

    attach(Mute())
    with pytest.raises(DeviceError, match="no reply"):
        record(request(tmp_path))
    assert list(tmp_path.iterdir()) == []


def test_something_else_on_the_line_is_said_to_be_that(tmp_path, attach):
    class Sketch(FakeBoard):
        def write(self, data):
            self.buffer += b"Hello from setup()\r\n"

    attach(Sketch())
    with pytest.raises(DeviceError, match="something else"):
        record(request(tmp_path))


def test_not_one_sample_is_an_error_that_stands_in_nobodys_way(tmp_path, attach):
    attach(FakeBoard(dict.fromkeys(range(10_000), lambda line: b"")))
    with pytest.raises(DataError, match="not one sample"):
        record(request(tmp_path))
    assert list(tmp_path.iterdir()) == []


def test_an_existing_file_is_not_touched(tmp_path, attach):
    (tmp_path / "run.h5").write_bytes(b"mine")
    attach()
    with pytest.raises(InputError, match="force=True"):
        record(request(tmp_path))
    assert (tmp_path / "run.h5").read_bytes() == b"mine"


def test_force_replaces_it(tmp_path, attach):
    (tmp_path / "run.h5").write_bytes(b"mine")
    attach(FakeBoard())
    record(request(tmp_path, force=True))
    assert daq.load(tmp_path / "run.h5").count.size == 800


@pytest.mark.parametrize("force", [False, True])
def test_the_journal_of_a_crashed_run_is_never_overwritten(tmp_path, attach, force):
    part = tmp_path / "run.h5.part"
    part.write_bytes(b"precious")
    attach()
    with pytest.raises(InputError, match=r"daq recover .*run\.h5\.part"):
        record(request(tmp_path, force=force))
    assert part.read_bytes() == b"precious"


def test_a_full_disk_keeps_the_journal_and_says_what_to_do(tmp_path, attach, monkeypatch):
    attach(FakeBoard())
    monkeypatch.setattr(journal, "SYNC_EVERY_S", 0.0)
    calls = []

    def full(writer):
        calls.append(1)
        if len(calls) > 5:
            raise OSError(errno.ENOSPC, "No space left on device")
        writer._file.flush()

    monkeypatch.setattr(journal.Writer, "sync", full)
    with pytest.raises(DeviceError, match=r"disk is full.*daq recover .*run\.h5\.part"):
        record(request(tmp_path))
    monkeypatch.undo()
    assert journal.read(tmp_path / "run.h5.part").records
    assert not (tmp_path / "run.h5").exists()


def test_a_stop_keeps_what_came(tmp_path, attach):
    attach(FakeBoard())
    stop = threading.Event()

    def progress(seconds):
        if seconds > 0.5:
            stop.set()

    found = record(request(tmp_path, 100_000), stop=stop, progress=progress)
    assert 500 <= found.samples < 100_000
    assert found.lost == 0
    assert daq.load(tmp_path / "run.h5").count.size == found.samples


def interrupt(seconds):
    raise KeyboardInterrupt


def test_an_interrupt_leaves_the_journal_and_recover_makes_the_file(tmp_path, attach):
    attach(FakeBoard())
    with pytest.raises(RecordingInterruptedError, match="daq recover") as caught:
        record(request(tmp_path), progress=interrupt)
    assert caught.value.exit_code == 130
    part = tmp_path / "run.h5.part"
    assert not (tmp_path / "run.h5").exists()
    found = finalise.finalise(part, tmp_path / "run.h5", finished_by="daq recover")
    assert found.samples > 0
    assert not part.exists()


def test_a_command_killed_between_its_file_and_its_journal_is_completed_by_recover(tmp_path, attach):
    # "The output file exists", it used to say, of the run file that was made of this journal.
    attach(FakeBoard(), FakeBoard())
    with pytest.raises(RecordingInterruptedError):
        record(request(tmp_path), progress=interrupt)
    part, run = tmp_path / "run.h5.part", tmp_path / "run.h5"
    journal.markers_path(part).write_text(f"{time.monotonic_ns()} a hand\n")
    shutil.copy(part, tmp_path / "kept")
    finalise.finalise(part, run, finished_by="daq recover")
    made = run.read_bytes()
    shutil.copy(tmp_path / "kept", part)
    finalise.finalise(part, run, finished_by="daq recover")
    assert (run.read_bytes(), part.exists()) == (made, False)
    with pytest.raises(RecordingInterruptedError):
        record(replace(request(tmp_path), output=tmp_path / "other.h5"), progress=interrupt)
    with pytest.raises(InputError, match="exists"):
        finalise.finalise(tmp_path / "other.h5.part", run, finished_by="daq recover")
    assert (run.read_bytes(), (tmp_path / "other.h5.part").exists()) == (made, True)


def test_a_recovered_file_is_the_finished_one_up_to_who_finished_it(tmp_path, attach, monkeypatch):
    attach(FakeBoard({30: lambda line: b""}))
    kept = tmp_path / "kept"
    kept.mkdir()
    unlink = type(kept).unlink

    def keep(path, missing_ok=False):
        if path == tmp_path / "run.h5.part":
            shutil.copy(path, kept / path.name)
        unlink(path, missing_ok=missing_ok)

    monkeypatch.setattr(type(kept), "unlink", keep)
    record(request(tmp_path))
    finalise.finalise(kept / "run.h5.part", kept / "run.h5", finished_by="daq recover")
    with h5py.File(tmp_path / "run.h5") as one, h5py.File(kept / "run.h5") as other:
        names = []
        one.visit(names.append)
        others = []
        other.visit(others.append)
        assert names == others
        for name in names:
            if isinstance(one[name], h5py.Dataset):
                same = np.array_equal(one[name][()], other[name][()])
                assert same is not name.endswith("finished_by"), name
    # With the same finisher the two are the same file, byte for byte.
    shutil.copy(kept / "run.h5", kept / "recovered.h5")
    monkeypatch.undo()
    for path in (tmp_path / "run.h5", kept / "run.h5"):
        with h5py.File(path, "r+") as file:
            file["entry/provenance/finished_by"][()] = b"x"
    assert (tmp_path / "run.h5").read_bytes() == (kept / "run.h5").read_bytes()


def small_journal(tmp_path, attach):
    attach(FakeBoard())
    calls = iter(range(100))
    with pytest.raises(RecordingInterruptedError):
        record(request(tmp_path, 64), progress=lambda s: interrupt(s) if next(calls) == 4 else None)
    return tmp_path / "run.h5.part"


@pytest.mark.slow
def test_a_journal_cut_at_any_byte_gives_the_samples_before_the_cut(tmp_path, attach):
    part = small_journal(tmp_path, attach)
    whole = part.read_bytes()
    _, _, n = counters(slice(0, 64))
    seen = set()
    headers = len(whole) - len(whole[whole.rindex(b'"protocol"') :])
    for cut in [*range(len(journal.MAGIC), headers, 29), *range(headers, len(whole) + 1)]:
        part.write_bytes(whole[:cut])
        try:
            data, found = finalise.run_data(journal.read(part))
        except (InputError, DataError):
            assert not seen, "a longer journal cannot hold less"
            continue
        assert found.samples >= max(seen, default=0)
        seen.add(found.samples)
        assert np.array_equal(data.count, n[: found.samples])
    assert len(seen) > 3


def test_markers_from_another_process_become_events(tmp_path, attach):
    part = small_journal(tmp_path, attach)
    stamps = [r.stamp_ns for r in journal.read(part).records if r.kind == journal.RECEIVED]
    journal.markers_path(part).write_text(f"{stamps[-1]} belt on\n12 long ago\n", encoding="utf-8")
    finalise.finalise(part, tmp_path / "run.h5", finished_by="daq recover")
    run = daq.load(tmp_path / "run.h5")
    assert [note for kind, note in zip(run.event_kind, run.event_note, strict=True) if kind == "marker"] == ["belt on"]
    assert not journal.markers_path(part).exists()


def test_a_journal_without_samples_is_said_to_be_that_and_stays(tmp_path):
    part = tmp_path / "run.h5.part"
    header = {"protocol": "frames", "rate_hz": 1000, "samples": 10, "port": "COM3", "title": "", "operator": ""}
    header |= {"wall_ns": 0, "monotonic_ns": 0, "utc_offset_s": 0, "warnings": [], "provenance": {}}
    journal.Writer(part, header).close()
    with pytest.raises(DataError, match="no samples"):
        finalise.finalise(part, tmp_path / "run.h5", finished_by="daq recover")
    assert part.exists()


HANGS_S = 600  # a command that takes so long hangs, on however busy a machine


def run_daq(*arguments, cwd):
    command = [sys.executable, "-m", "daq.cli.app", *arguments]
    return subprocess.Popen(command, cwd=cwd, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def wait_for_samples(part):
    """Wait until the journal holds samples and has been synced."""
    until = time.monotonic() + HANGS_S
    while time.monotonic() < until:
        if part.exists() and part.stat().st_size > 8000:
            return
        time.sleep(0.05)
    pytest.fail(f"the recording did not begin within {HANGS_S} s")


def test_the_simulated_rig_is_recorded_to_the_last_sample(tmp_path):
    process = run_daq("record", "--duration", "5", "--json", cwd=tmp_path)
    out, err = process.communicate(timeout=HANGS_S)
    assert process.returncode == 0, err
    answer = json.loads(out)
    assert (answer["samples"], answer["lost"], answer["crc_errors"], answer["segments"]) == (5000, 0, 0, 1)
    assert (answer["illegal"], answer["phase_errors"], answer["warnings"]) == (0, 0, [])
    assert answer["rate_hz"] == 1000
    assert answer["clock_ppm"] is None  # it ran faster than real time: there is no clock to compare with
    assert answer["duration_s"] == pytest.approx(5.0, abs=1e-3)
    run = daq.load(tmp_path / answer["file"])
    assert run.rig.mass.value == pytest.approx(0.3, rel=0.01)
    assert run.unit == "m"
    assert store.truth(run.source) is None


def test_truth_is_recorded_beside_each_sample_when_the_rig_tells_it(tmp_path):
    url = ports.rig_url("rig", ["tell.truth=true"], False)
    record(RecordRequest(url, tmp_path / "run.h5", RATE, 2.0))
    run, truth = daq.load(tmp_path / "run.h5"), store.truth(tmp_path / "run.h5")
    assert truth.time == pytest.approx(run.time, abs=1e-6)
    offset = run.position - truth.x
    assert (
        np.ptp(offset - np.polyval(np.polyfit(truth.x, offset, 1), truth.x)) < 1e-5
    )  # one count of 7.67 um, and the edges' own scatter


@pytest.mark.parametrize(
    ("decoder", "lines", "least"), [("x4", 0, 0), ("x1", 0, 0), ("jk", 2000, 1), ("jk-latched", 2000, 1)]
)
def test_a_parked_mass_that_vibrates_makes_only_the_jk_boxes_drift(tmp_path, decoder, lines, least):
    """2 s of +-0.3 count at 1 kHz about both places at which A dithers; the board's own test has those between."""
    parked = ["belt.start=100", "scatter.Fs=0", "encoder.vibration=2.3e-6", "encoder.vibration_hz=1000"]
    drifts = []
    for half_counts in (2, 6):
        changes = [*parked, f"start.x={half_counts * 3.835e-6}", f"encoder.decoder={decoder}"]
        path = tmp_path / f"{half_counts}.h5"
        record(RecordRequest(ports.rig_url("rig", changes, False), path, RATE, 2.0))
        run = daq.load(path)
        drifts.append(abs(int(run.count[-1] - run.count[0])))
    assert max(drifts) == pytest.approx(lines, abs=1)
    assert sum(drift > 1 for drift in drifts) >= least


@pytest.mark.skipif(sys.platform == "win32", reason="POSIX signals")
def test_the_first_ctrl_c_keeps_the_data_and_exits_0(tmp_path):
    process = run_daq("record", "--realtime", "--json", cwd=tmp_path)
    wait_for_samples(tmp_path / "run.h5.part")
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=HANGS_S)
    assert process.returncode == 0, err
    answer = json.loads(out)
    assert answer["samples"] > 500
    assert answer["lost"] == 0
    assert daq.load(tmp_path / "run.h5").count.size == answer["samples"]
    assert [path.name for path in tmp_path.iterdir()] == ["run.h5"]


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


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        (["--port", "/dev/ttyNONE7"], 3, "/dev/ttyNONE7: no such port"),
        (["--set", "friction.lew=3"], 2, "lew"),
        (["--rate", "0"], 2, "--rate"),
        (["--duration", "-1"], 2, "--duration"),
        (["--port", "/dev/ttyS0", "--realtime"], 2, "--realtime"),
        (["--output", "nowhere/run.h5"], 2, "folder"),
    ],
)
def test_bad_requests_end_in_one_line_and_touch_nothing(tmp_path, monkeypatch, capsys, arguments, code, said):
    from daq.cli.app import app
    from stickslip.console import application

    monkeypatch.chdir(tmp_path)
    assert application.run(app, ["record", *arguments]) == code
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    assert said in err
    assert list(tmp_path.iterdir()) == []


def test_a_board_that_stops_with_a_notice_ends_the_run_and_its_words_are_kept(tmp_path):
    # It used to be waited for, and the port opened anew.
    output = tmp_path / "run.h5"
    heard: list[str] = []
    changes = "set=friction.law%3D3&set=start.v%3D-5"  # the linear curve changes its sign at this slip speed
    found = record(RecordRequest(f"rig://rig?{changes}", output), say=heard.append)
    assert found.samples < 20_000
    assert any("force reversal" in line for line in heard)
    assert any("force reversal" in warning for warning in found.warnings)
    kinds = dict(zip(store.load(output).event_kind, store.load(output).event_note, strict=True))
    assert "force reversal" in kinds["notice"]


def test_a_damaged_journal_gives_all_but_the_damage_and_is_kept(tmp_path):
    # It used to be cut at the damage and then removed: what came after was lost for good.
    whole = tmp_path / "whole.h5"
    part = tmp_path / "run.h5.part"

    class KeptError(Exception):
        pass

    def keep(seconds: float) -> None:
        if seconds >= 2:
            raise KeptError

    with pytest.raises(KeptError):
        record(RecordRequest("rig://rig", tmp_path / "run.h5", duration_s=3), progress=keep)
    shutil.copy(part, tmp_path / "whole.h5.part")
    taken = finalise.finalise(tmp_path / "whole.h5.part", whole, finished_by="test").samples
    content = bytearray(part.read_bytes())
    middle = len(content) // 2
    content[middle : middle + 300] = bytes(300)
    part.write_bytes(content)
    found = finalise.finalise(part, tmp_path / "run.h5", finished_by="test")
    assert part.read_bytes() == content
    assert taken - 2000 < found.samples < taken
    assert found.samples + found.lost == taken
    assert any("damaged" in warning and "run.h5.part" in warning for warning in found.warnings)


def test_the_peak_edge_rate_is_that_of_the_motion_at_any_sample_rate(tmp_path):
    # At 20 kHz one count more or less within a sample used to look like 200,000 edges/s.
    peaks = [
        record(RecordRequest("rig://rig", tmp_path / f"{rate}.h5", rate_hz=rate, duration_s=3)).peak_edge_rate_hz
        for rate in (1000, 20_000)
    ]
    assert peaks[1] == pytest.approx(peaks[0], rel=0.03)


@pytest.mark.parametrize("decoder", ["x4", "x1", "jk", "jk-latched"])
def test_the_decoder_asked_for_is_the_one_that_counts_and_its_calibration_the_one_that_is_kept(tmp_path, decoder):
    url = ports.rig_url("rig", ["tell.truth=true"], False)
    found = record(RecordRequest(url, tmp_path / "run.h5", duration_s=2, decoder=decoder))
    run = daq.load(tmp_path / "run.h5")
    assert run.rig.decoder == decoder
    edges = 1 if decoder == "x4" else 4
    assert run.rig.metres_per_count.value == pytest.approx(edges * 7.67e-6, rel=0.01)
    assert found.phase_errors == 0
    truth = store.truth(tmp_path / "run.h5")
    error = run.position - truth.x
    assert np.ptp(error[:1000]) < 3 * 30.7e-6 + 1e-3 * np.ptp(truth.x[:1000])  # a few lines, and the pitch as measured


def test_a_given_calibration_replaces_the_boards(tmp_path):
    text = '[encoder]\nmetres_per_count = 1e-3\n[board]\nport = "rig://rig"\n'
    record(RecordRequest("rig://rig", tmp_path / "run.h5", duration_s=1, calibration=text))
    run = daq.load(tmp_path / "run.h5")
    assert run.rig.metres_per_count.value == 1e-3
    assert run.rig.mass is None
    assert run.config_toml == text


def test_a_port_that_never_came_back_is_told_with_its_time(tmp_path, monkeypatch):
    # It used to look like a healthy, short recording.
    monkeypatch.setattr("daq.recorder.reader.REOPEN_S", 0.3)
    real = ports.open_port
    opened = []

    class Pulled:
        def __init__(self, port):
            self._port, self._until = port, time.monotonic() + 0.5

        def __getattr__(self, name):
            if time.monotonic() > self._until:
                raise OSError(5, "Input/output error")
            return getattr(self._port, name)

    def once(*given):
        if opened:
            raise OSError(2, "no such port")
        opened.append(True)
        return Pulled(real(*given))

    monkeypatch.setattr(ports, "open_port", once)
    found = record(RecordRequest("rig://rig?realtime=1", tmp_path / "run.h5", 1000, 5.0))
    (reopening,) = [warning for warning in found.warnings if "not reopened" in warning]
    assert 0.1 < float(reopening.split(") ")[1].split(" s after")[0]) < 0.6


def jumping(at, seq=0, ticks=0):
    """Return faults of a board whose sequence numbers and clock are off by so much from a frame on."""

    def moved(line):
        block = frames.FrameReader().feed(line)[0]
        return frames.encode_samples(block._replace(seq=block.seq + seq & 0xFFFF, time=block.time + ticks & 0xFFFFFFFF))

    return dict.fromkeys(range(at, 10_000), moved)


@pytest.mark.parametrize(
    ("seq", "ticks"),
    [(40_000, 0), (-1600, -1_600_000), (30_000, 1_200_000_000), (-1000, 77)],
    ids=["sequence alone", "a silent reset", "a silent reset of a board that ran for an hour", "both"],
)
def test_a_jump_of_the_sequence_is_a_new_segment_and_ends_nothing_early(tmp_path, attach, seq, ticks):
    # It was trusted: +40,000 made 30 s of a run of 4 s, and a silent reset ended a run early with exit 0.
    attach(FakeBoard(jumping(200, seq, ticks)))
    found = record(request(tmp_path, 4000))
    run = daq.load(tmp_path / "run.h5")
    assert (found.samples, found.lost, found.segments) == (4000, 0, 2)
    assert found.duration_s == pytest.approx(4.0, abs=0.5)
    assert np.flatnonzero(np.diff(run.segment)).tolist() == [1599]
    assert (1600, "reopened") in kinds(run)
    assert any("jumped" in warning and "1.6" in warning for warning in found.warnings)
    _, _, n = counters(slice(0, 4000))
    assert np.array_equal(run.count - run.count[0], n - n[0])
    if not ticks:
        assert run.time == pytest.approx(np.arange(4000) / RATE)


def test_a_short_run_and_a_sparse_one_are_known_to_be_that(tmp_path, attach):
    # They used to end like any other.
    attach(FakeBoard({50: raising(SerialException("gone"))}), FakeBoard())
    found = record(request(tmp_path, 401))
    assert (found.short, found.sparse, found.ended) == (False, False, "complete")
    (tmp_path / "run.h5").unlink()
    attach(FakeBoard({50: raising(SerialException("gone"))}))
    found = record(request(tmp_path))
    assert (found.short, found.ended) == (True, "port lost")
    assert "the run holds 0.4 s of samples of the 0.8 s asked for: the port was lost" in found.warnings
    (tmp_path / "run.h5").unlink()
    attach(FakeBoard(dict.fromkeys(range(10, 22), lambda line: b"")))
    found = record(request(tmp_path))
    assert (found.short, found.sparse) == (True, True)
    assert "12% of the samples are lost" in found.warnings


def test_a_journal_that_cannot_be_decoded_is_kept(tmp_path, attach):
    # It used to be deleted: "it is empty".
    attach(FakeBoard(dict.fromkeys(range(10_000), lambda line: b"\x55" * 300)))
    stop = threading.Event()
    threading.Timer(0.3, stop.set).start()
    with pytest.raises(DataError, match="not one sample can be read in the") as caught:
        record(request(tmp_path), stop=stop)
    assert str(tmp_path / "run.h5.part") in caught.value.do
    assert (tmp_path / "run.h5.part").stat().st_size > 1000


def test_a_recorder_that_began_meanwhile_is_not_taken_for_a_crash(tmp_path, attach):
    # The advice was to recover the journal, which destroyed the other run.
    class Slow(FakeBoard):
        def write(self, data):
            super().write(data)
            if data.startswith(b"B") or b"\nB" in data:
                other.append(journal.Writer(tmp_path / "run.h5.part", {"wall_ns": 0, "pid": 4711, "host": "lab"}))

    other = []
    attach(Slow())
    with pytest.raises(InputError, match="process 4711 on lab") as caught:
        record(request(tmp_path))
    assert "recover" not in str(caught.value)
    other[0].close()


def ends_by_itself(request):
    """Record, and stop a recording that does not end; return what was found, and whether it had to be stopped."""
    stop = threading.Event()
    timer = threading.Timer(20, stop.set)
    timer.start()
    try:
        return record(request, stop=stop), stop.is_set()
    finally:
        timer.cancel()


def test_a_board_that_sends_the_same_samples_again_and_again_ends_at_its_duration(tmp_path, attach):
    # It used to be read for ever: bytes came, so the port was not silent, and no sample was new.
    same = FakeBoard().samples(0)
    attach(*(FakeBoard(dict.fromkeys(range(100_000), lambda line: same)) for _ in range(20)))
    found, stopped = ends_by_itself(request(tmp_path, 300))
    assert not stopped
    assert found.short
    assert found.samples <= 8 * found.segments
    assert any("no new sample in the" in warning for warning in found.warnings)
    assert any("came twice or late" in warning for warning in found.warnings)


def test_a_board_that_sends_noise_ends_and_its_bytes_are_kept(tmp_path, attach):
    # It used to be read for ever.
    attach(FakeBoard(dict.fromkeys(range(100_000), lambda line: b"\x55" * 300 + b"\0")))
    with pytest.raises(DataError, match="not one sample can be read in the"):
        ends_by_itself(request(tmp_path, 300))
    recorded = journal.read(tmp_path / "run.h5.part")
    assert journal.end_reason(list(recorded.records)[-1]) == journal.PORT_LOST


def test_a_port_that_is_lost_again_and_again_is_one_warning(tmp_path, attach):
    # There used to be one for each time: 52 kB for 1000.
    attach(*(FakeBoard({5: raising(SerialException("gone"))}) for _ in range(12)), FakeBoard())
    found = record(request(tmp_path, 2000))
    assert (found.segments, found.port_lost) == (13, 12)
    lost = [warning for warning in found.warnings if "port was lost" in warning]
    assert len(lost) == 1
    assert "lost and reopened 12 times" in lost[0]
    assert "the longest time" in lost[0]
    assert "(gone)" in lost[0]


class Another(FakeBoard):
    """Resets at frame 100, and is another board from there on: another tick, decoder or width of its counters."""

    def __init__(self, tick_ns=1000, decoder="x4", bits=16, config=CONFIG, resets=True):
        super().__init__({100: self.reset} if resets else {}, config=config)
        self.now = (1000, "x4", 16) if resets else (tick_ns, decoder, bits)
        self.then = tick_ns, decoder, bits

    def reset(self, line):
        self.running, self.now, self.start_ticks = False, self.then, 77
        self.faults.clear()
        return line[:30] + b"\0" + self.ident()

    def ident(self):
        tick_ns, decoder, bits = self.now
        ident = frames.Ident((1, 2, 3), decoder, self.capabilities, bits, tick_ns, self.block, 5000, 10**8, "fake")
        return frames.encode_ident(ident)

    def samples(self, frame):
        tick_ns, decoder, bits = self.now
        first = frame * self.block
        up, down, n = counters(slice(first, first + self.block))
        counted = [(each // (4 if decoder == "x1" else 1) % 2**bits).tolist() for each in (up, down)]
        dt = [0, *[1_000_000 // tick_ns] * (self.block - 1)]
        ticks = self.start_ticks + 1_000_000 // tick_ns * first
        return frames.encode_samples(
            frames.SampleBlock(first & 0xFFFF, ticks % 2**32, 0, dt, *counted, levels_of(n).tolist())
        )


def assert_one_motion(run, samples):
    """Check that both segments are the motion that began anew, in m, at 1000 Hz."""
    first = int(np.searchsorted(run.segment, 1))
    assert first == 800
    true = counters(slice(0, samples))[2] * 1e-5
    for here in (slice(0, first), slice(first, samples)):
        x = run.position[here] - run.position[here][0]
        assert x == pytest.approx(true[: len(x)] - true[0], abs=4e-5)
        assert np.diff(run.time[here]) == pytest.approx(1e-3)
    assert run.time[first] - run.time[first - 1] < 0.5


@pytest.mark.parametrize(
    "change", [{"tick_ns": 500}, {"decoder": "x1"}, {"bits": 12}, {"tick_ns": 250, "decoder": "x1", "bits": 15}]
)
@pytest.mark.parametrize("how", ["resets", "is replaced"])
def test_a_segment_is_read_as_the_board_identified_itself_before_it(tmp_path, attach, change, how):
    # All of it used to be read as the first identification says: with a tick of half a length the second segment ran
    # at half its speed, with a decoder x1 it had a quarter of its speed.
    if how == "resets":
        attach(Another(**change))
    else:
        lost = Another()
        lost.faults = {100: raising(SerialException("gone"))}
        attach(lost, Another(**change, resets=False))
    found = record(request(tmp_path, 2000))
    run = daq.load(tmp_path / "run.h5")
    assert (found.segments, found.lost, found.phase_errors) == (2, 0, 0)
    assert_one_motion(run, len(run.time))
    assert any("identified itself anew" in warning for warning in found.warnings)
    assert run.sent_as.segment.tolist() == [0, 1]
    assert run.sent_as.counter_bits.tolist() == [16, change.get("bits", 16)]
    assert run.sent_as.counts.tolist() == [1, 4 if "decoder" in change else 1]
    assert f"tick {change.get('tick_ns', 1000)} ns" in run.sent_as.ident[1]
    again = replay.from_run(tmp_path / "run.h5")
    assert np.array_equal(again.count, run.count)
    assert np.array_equal(again.position, run.position)


def test_a_finer_decoder_behind_a_reset_divides_the_metres_per_count(tmp_path, attach):
    board = Another()
    board.now = 1000, "x1", 16
    attach(board)
    found = record(request(tmp_path, 2000))
    run = daq.load(tmp_path / "run.h5")
    assert (run.rig.decoder, run.rig.metres_per_count.value) == ("x4", pytest.approx(1e-5 / 4))
    assert run.sent_as.counts.tolist() == [4, 1]
    first = int(np.searchsorted(run.segment, 1))
    true = counters(slice(0, 800))[2]
    assert np.ptp(run.count[:first] - true[:first]) <= 8
    assert np.ptp(run.count[first : first + 800] - true) == 0
    assert any("decoder changed between x1 and x4" in warning for warning in found.warnings)


def test_a_restarted_board_is_asked_for_its_identification_and_keeps_the_decoder_of_the_run(tmp_path, attach):
    board = Another()
    board.then = 1000, "x4", 16  # its own decoder, until it is told
    told = board.write

    def write(data):
        if b"M x1" in data:
            board.now = 1000, "x1", 16
        told(data)

    board.write = write
    attach(board)
    record(request(tmp_path, 2000, decoder="x1"))
    assert [c for c in board.commands if c][-6:] == ["M x1", "R 1000", "B 8", "I", "S", "X"]
    run = daq.load(tmp_path / "run.h5")
    assert run.rig.decoder == "x1"
    assert run.sent_as is None


def leaping(at, ticks):
    """Return faults after which the clock of a board is off, while its sequence goes on."""

    def leap(line):
        block = frames.FrameReader().feed(line)[0]
        return frames.encode_samples(block._replace(time=(block.time + ticks) % 2**32))

    return dict.fromkeys(range(at, 10_000), leap)


class InRealTime(FakeBoard):
    """Sends each frame when it is due, from frame ``at`` on some seconds later."""

    at, pause_s = 0, 0.0

    def read(self, size=1):
        if self.running and not self.buffer:
            if self.frame == 0:
                self.began = time.monotonic()
            due_s = self.frame * self.block / RATE + self.pause_s * (self.frame >= self.at)
            time.sleep(max(0.0, self.began + due_s - time.monotonic()))
        return super().read(size)


@pytest.mark.parametrize("leap_s", [0.02, 0.4, 3.0])
def test_a_clock_that_leaps_while_the_sequence_goes_on_is_said_and_the_sequence_is_the_time(tmp_path, attach, leap_s):
    # The leap stood in the time axis, without a segment, an event or a warning.
    attach(InRealTime(leaping(100, round(1e6 * leap_s))))
    found = record(request(tmp_path, 1600))
    run = daq.load(tmp_path / "run.h5")
    assert (found.samples, found.lost, found.segments) == (1600, 0, 2)
    assert run.time == pytest.approx(np.arange(1600) / RATE, abs=1e-6)
    assert (800, "reopened") in kinds(run)
    assert f"leapt by +{1e3 * leap_s:.0f} ms" in run.event_note[run.event_kind.index("reopened")]
    assert any(f"clock leapt, by {leap_s:g} s at 0.8" in warning for warning in found.warnings)
    assert found.measured_rate_hz == pytest.approx(RATE)


def test_a_clock_that_leaps_within_a_frame_is_found_there(tmp_path, attach):
    def within(line):
        block = frames.FrameReader().feed(line)[0]
        return frames.encode_samples(block._replace(dt=[*block.dt[:3], 21_000, *block.dt[4:]]))

    attach(InRealTime(leaping(101, 20_000) | {100: within}))
    found = record(request(tmp_path, 1600))
    run = daq.load(tmp_path / "run.h5")
    assert (found.samples, found.lost, found.segments) == (1600, 0, 2)
    assert np.flatnonzero(np.diff(run.segment)).tolist() == [802]
    assert run.time == pytest.approx(np.arange(1600) / RATE, abs=1e-6)


def test_a_board_that_pauses_without_counting_it_keeps_its_clock_and_the_pause_is_said(tmp_path, attach):
    board = InRealTime(leaping(100, 60_000))  # longer, and the counters may have rolled over
    board.at, board.pause_s = 100, 0.06
    attach(board)
    found = record(request(tmp_path, 1600))
    run = daq.load(tmp_path / "run.h5")
    assert found.segments == 1
    assert np.diff(run.time)[799] == pytest.approx(0.061)
    assert (800, "gap") in kinds(run)
    assert any("the board paused, for 0.061 s at" in warning for warning in found.warnings)
