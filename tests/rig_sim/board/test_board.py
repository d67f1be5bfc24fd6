"""The board and its port: what a recorder reads over ``rig://`` is what the scene did, wrapped, stamped and framed."""

import threading
import time
from pathlib import Path
from urllib.parse import quote

import numpy as np
import pytest
import serial

from daq.runfile.rig import Rig
from daq.wire.frames import Config, FrameReader, Ident, Notice, SampleBlock, TruthFrame
from daq.wire.quadrature import PHASE
from rig_sim.board.board import SimulatedBoard
from rig_sim.motion.play import ScenePlayer
from rig_sim.protocol_rig import Serial
from rig_sim.scenes.scene import scene

from ..boards import DELTA, Record, frames_in, frames_of, record

PARKED: dict[str, object] = {
    "belt.start": 100,
    "scatter.Fs": 0,
    "encoder.vibration": 2.3e-6,
    "encoder.vibration_hz": 1000,
}


@pytest.fixture(autouse=True)
def handlers(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(serial, "protocol_handler_packages", [*serial.protocol_handler_packages, "rig_sim"])


def notice(data: bytes) -> str:
    (frame,) = frames_in(data)
    assert isinstance(frame, Notice)
    return frame.text


@pytest.mark.parametrize("half", [0, 1, 2, 6])
def test_a_parked_rig_dithers_as_the_table_says(half: int) -> None:
    x = half * DELTA / 2
    error = {}
    for decoder in ("x4", "x1", "jk", "jk-latched"):
        board = SimulatedBoard(scene("rig", **PARKED, **{"start.x": x, "encoder.decoder": decoder}))
        net = record(board, 10_001).net
        error[decoder] = int(net[-1] - net[0]) * (1 if decoder == "x4" else 4)
    assert abs(error["x4"]) <= 1
    assert abs(error["x1"]) <= 4
    # A rises at 1 count when the mass moves up (half 2) and at 3 counts when it moves down (half 6).
    assert error["jk"] == pytest.approx({2: 39_999, 6: -39_999}.get(half, 0), abs=4)
    assert error["jk-latched"] == pytest.approx({2: 39_999, 6: 39_999}.get(half, 0), abs=4)


def test_counters_levels_and_times_are_the_exact_motion() -> None:
    rig = scene("rig", seed=2)
    board = SimulatedBoard(rig)
    taken = record(board, 8000)
    assert len(taken.ticks) == 8000
    exact = ScenePlayer(rig)
    path = exact.follow(np.append(taken.ticks, taken.ticks[-1] + 2) / 1e6)
    x = path.nodes.x[path.samples][:-1]
    v = path.nodes.v[path.samples][:-1]
    # the true instant lies within the tick that was recorded
    low, high = np.minimum(x, x + v * 1e-6), np.maximum(x, x + v * 1e-6)
    assert np.all(taken.net * DELTA <= high + 1e-10)
    assert np.all((taken.net + 1) * DELTA >= low - 1e-10)
    np.testing.assert_array_equal(taken.net % 4, PHASE[taken.levels])
    np.testing.assert_array_equal((taken.up - taken.down) % 4, PHASE[taken.levels])


def test_counters_wrap_at_sixteen_bits_and_sequence_numbers_too() -> None:
    taken = record(SimulatedBoard(scene("rig")), 30_000)
    assert taken.up.max() <= 0xFFFF
    assert np.any(np.diff(taken.up.astype(int)) < -30_000)  # rolled over
    np.testing.assert_array_equal(taken.seq, np.arange(30_000))
    many = record(SimulatedBoard(scene("rig", **{"belt.start": 1e6})), 65_544, b"R 100000\nS\n")
    assert many.seq[-9:].tolist() == [65_535, *range(8)]


def test_recorded_jitter_is_the_jitter_of_the_scene() -> None:
    quiet = record(SimulatedBoard(scene("rig", jitter={"rms": 0.0})), 4000)
    np.testing.assert_array_equal(quiet.ticks, 1000 * np.arange(4000))
    shaken = record(SimulatedBoard(scene("rig")), 4000)
    offsets = shaken.ticks - 1000 * np.arange(4000)
    assert shaken.ticks[0] == 0
    assert offsets.std() == pytest.approx(30, rel=0.05)
    wild = record(SimulatedBoard(scene("rig", jitter={"rms": 0.1})), 4000)
    assert np.all(np.diff(wild.ticks) >= 99)


def test_config_is_a_measurement_with_errors_about_the_truth() -> None:
    z = []
    for seed in range(200):
        board = SimulatedBoard(scene("rig", seed=seed, **{"damper.c": 0.2, "spring.x0": 0.01}))
        _, config = frames_in(board.write(b"I\n"))
        rig = Rig.from_toml(config.toml, "CONFIG")
        assert rig.stiffness is None
        assert rig.counts_per_revolution == 16_384
        true = {
            "mass": 0.3,
            "damping": 0.2,
            "belt_speed": 0.22,
            "metres_per_count": DELTA,
            "datum": 0.5 * DELTA - 0.01,
        }
        row = []
        for key, value in true.items():
            measured = getattr(rig, key)
            assert measured.sd > 0
            row.append((measured.value - value) / measured.sd)
        z.append(row)
    assert np.all(np.abs(np.mean(z, axis=0)) < 0.3)
    np.testing.assert_allclose(np.std(z, axis=0), 1.0, atol=0.2)
    assert rig.mass is not None
    assert rig.mass.sd == pytest.approx(3e-4)
    assert rig.datum is not None
    assert rig.datum.sd == pytest.approx(0.5e-3, rel=0.01)
    again = SimulatedBoard(scene("rig", seed=199, **{"damper.c": 0.2, "spring.x0": 0.01})).write(b"I\n")
    assert frames_in(again)[1] == config


@pytest.mark.parametrize("start", [0.0, 0.0123456, -0.1])
@pytest.mark.parametrize("decoder", ["x4", "x1", "jk", "jk-latched"])
def test_the_datum_turns_counts_into_positions_from_the_spring(decoder: str, start: float) -> None:
    board = SimulatedBoard(scene("rig", **{"start.x": start, "encoder.decoder": decoder, "scatter.Fs": 0}))
    lines = 1 if decoder == "x4" else 4
    frames = frames_of(board, 2000, b"I\nS\n")
    rig = Rig.from_toml(frames[1].toml, "CONFIG")
    assert rig.datum is not None
    assert rig.metres_per_count is not None
    path = ScenePlayer(scene("rig", **{"start.x": start, "scatter.Fs": 0})).follow(Record.of(frames).ticks / 1e6)
    error = Record.of(frames).net * rig.metres_per_count.value + rig.datum.value - path.nodes.x[path.samples]
    assert np.abs(error).max() < 5 * (rig.datum.sd + 0.3 * rig.metres_per_count.sd / DELTA / lines) + 4 * lines * DELTA


def test_truth_comes_only_when_asked_and_is_exact() -> None:
    truthful = scene("rig", tell={"truth": True})
    board = SimulatedBoard(truthful)
    frames = frames_of(board, 3000)
    rows = np.array([row for frame in frames if isinstance(frame, TruthFrame) for row in frame.rows])
    assert rows.shape == (3000, 4)
    taken = Record.of(frames)
    np.testing.assert_array_equal(np.floor(rows[:, 0] * 1e6 + 1e-6), taken.ticks)
    assert np.all(np.abs((taken.net + 0.5) * DELTA - rows[:, 1]) <= 0.5 * DELTA * (1 + 1e-9))
    stick = rows[:, 2] == 0.22
    assert stick.sum() > 500
    np.testing.assert_allclose(rows[stick, 3], truthful.spring.k * rows[stick, 1], rtol=1e-9, atol=1e-12)
    silent = frames_of(SimulatedBoard(scene("rig")), 3000)
    assert not any(isinstance(frame, TruthFrame) for frame in silent)
    np.testing.assert_array_equal(Record.of(silent).up, taken.up)


def test_a_second_start_counts_sequence_numbers_from_zero_and_the_motion_goes_on() -> None:
    board = SimulatedBoard(scene("rig"))
    first, second = record(board, 1000), record(board, 1000)
    assert second.seq[0] == 0
    assert 500 < second.ticks[0] - first.ticks[-1] < 1500
    assert abs(int(second.net[0]) - int(first.net[-1])) < 200


@pytest.mark.parametrize(
    ("command", "word"),
    [
        (b"R 0\n", "rate"),
        (b"R fast\n", "rate"),
        (b"R 1000000\n", "rate"),
        (b"B 0\n", "samples per frame are 1 to 255"),
        (b"B 300\n", "samples per frame are 1 to 255"),
        (b"M x5\n", "decoder"),
        (b"Q\n", "is no command"),
    ],
)
def test_an_impossible_command_is_answered_and_changes_nothing(command: bytes, word: str) -> None:
    board = SimulatedBoard(scene("rig"))
    before = board.rate_hz, board.block
    assert word in notice(board.write(command))
    assert (board.rate_hz, board.block) == before


def test_commands_may_come_in_pieces_and_not_while_sampling() -> None:
    board = SimulatedBoard(scene("rig"))
    assert board.write(b"R 2") + board.write(b"50") == b""
    assert board.rate_hz == 1000
    assert board.write(b"0\r\n\nS\n") == b""
    assert board.rate_hz == 2500
    assert "stop it first" in notice(board.write(b"R 100\n"))


def test_blocks_are_refused_where_their_time_difference_would_overflow() -> None:
    board = SimulatedBoard(scene("rig"))
    assert "single frames" in notice(board.write(b"R 20\nS\n"))
    assert not board.running
    taken = record(board, 5, b"B 1\nS\n")
    assert np.diff(taken.ticks) == pytest.approx(50_000, abs=300)


def test_changing_the_decoder_starts_its_counters_again() -> None:
    board = SimulatedBoard(scene("rig"))
    board.write(b"M jk\n")
    (ident, _, *blocks) = frames_of(board, 3000, b"I\nS\n")
    assert ident.decoder == "jk"
    taken = Record.of(blocks)
    assert taken.up[0] == 0
    assert taken.down[0] == 0
    assert 0.1 < abs(taken.net).max() * 4 * DELTA < 0.2  # lines


def test_a_motion_that_cannot_go_on_says_so() -> None:
    board = SimulatedBoard(scene("rig", **{"friction.law": 3, "friction.G_slip": 5, "start.v": -2.0}))
    frames = frames_of(board, 5000)
    assert isinstance(frames[-1], Notice)
    assert "force reversal" in frames[-1].text
    assert not board.running


# The port ------------------------------------------------------------------------------------------------------------


def test_the_rig_is_a_pyserial_url() -> None:
    port = serial.serial_for_url("RIG://rig/?set=friction.law%3D3&set=seed%3D4", timeout=1)
    assert type(port).__module__ == "rig_sim.protocol_rig"
    assert isinstance(port, Serial)
    reader = FrameReader()
    (power_up,) = reader.feed(port.read(port.in_waiting))
    assert isinstance(power_up, Ident)
    port.write(b"I\nR 1000\nB 8\nS\n")
    frames: list = []  # type: ignore[type-arg]
    while sum(isinstance(frame, SampleBlock) for frame in frames) < 500:
        frames += reader.feed(port.read(4096))
    port.write(b"X\n")
    port.timeout = 0.05
    frames += reader.feed(port.read(10**6))
    assert port.read(1) == b""
    assert port.in_waiting == 0
    port.close()
    assert isinstance(frames[0], Ident)
    assert isinstance(frames[1], Config)
    taken = Record.of(frames)
    expected = record(SimulatedBoard(scene("rig", seed=4, **{"friction.law": 3})), len(taken.ticks))
    np.testing.assert_array_equal(taken.ticks, expected.ticks)
    np.testing.assert_array_equal(taken.up, expected.up)
    with pytest.raises(serial.SerialException):
        port.read(1)
    with pytest.raises(serial.SerialException):
        port.write(b"I\n")


def test_a_scene_file_goes_into_the_url_percent_encoded(tmp_path: Path) -> None:
    path = tmp_path / "my rig.toml"
    path.write_text(
        "[mass]\nm = 1\n[spring]\nk = 10\n[encoder]\nlines_per_rev = 100\ncircumference = 0.1\n", encoding="utf-8"
    )
    port = serial.serial_for_url(f"rig://{quote(str(path), safe='')}")
    (ident,) = FrameReader().feed(port.read(port.in_waiting))
    assert isinstance(ident, Ident)
    assert ident.name == "simulated rig, scene my rig"


def test_a_waiting_read_wakes_on_a_command_and_on_close() -> None:
    port = serial.serial_for_url("rig://rig", timeout=None)
    port.reset_input_buffer()
    got: list[bytes] = []
    thread = threading.Thread(target=lambda: got.append(port.read(10)))
    thread.start()
    port.write(b"I\n")
    thread.join(timeout=600)
    assert not thread.is_alive()
    assert len(got[0]) == 10
    port.reset_input_buffer()
    thread = threading.Thread(target=lambda: got.append(port.read(10)))
    thread.start()
    time.sleep(0.05)
    port.close()
    thread.join(timeout=600)
    assert not thread.is_alive()
    assert got[1] == b""


def test_real_time_brings_samples_no_faster_than_the_clock() -> None:
    port = serial.serial_for_url("rig://rig?realtime=1", timeout=0.3)
    port.reset_input_buffer()
    began = time.monotonic()
    port.write(b"R 200\nB 1\nS\n")
    data = port.read(10**6)
    passed = time.monotonic() - began
    samples = len(frames_in(data))
    assert 0 < samples <= passed * 200 + 1
    port.close()


@pytest.mark.parametrize(
    ("rms", "rate", "said"), [(30e-6, 1000, ""), (30e-6, 20_000, " (jitter cut off at 2.3e-05 s)")]
)
def test_jitter_that_is_cut_off_is_said_in_the_boards_name(rms: float, rate: int, said: str) -> None:
    # It used to be capped silently.
    board = SimulatedBoard(scene("rig", **{"jitter.rms": rms}))
    ident = frames_in(board.write(b"R %d\nI\n" % rate))[0]
    assert ident.name == f"simulated rig, scene rig{said}"
