"""Commands, answers, baud rates, the watchdog: the firmware keeps the wire's word."""

import itertools
import os
import time

import numpy as np
import pytest
import serial

from daq import firmware_files
from daq.protocols.request import RecordRequest
from daq.recorder.record import record
from daq.runfile.store import load
from daq.wire import frames as wire
from daq.wire.frames import Ident, Notice, SampleBlock
from rig_sim.scenes.scene import scene

from . import bench

BAUDS = (115_200, 250_000, 500_000, 1_000_000)


def test_it_identifies_itself_at_power_up(switch_on):
    with switch_on("uno", speed=1) as board:
        line = os.open(board.port, os.O_RDONLY | os.O_NOCTTY)  # pyserial would throw away what has come already
        time.sleep(0.3)
        said = os.read(line, 4096)
        os.close(line)
    frames = wire.FrameReader().feed(said)
    assert said[0] == 0
    assert [type(frame) for frame in frames] == [Ident]
    assert frames[0].name == "stickslip uno"
    assert ".".join(map(str, frames[0].firmware)) == firmware_files.VERSION


def test_it_says_which_decoder_it_runs_and_refuses_in_words_what_it_cannot_do_and_changes_nothing(switch_on):
    refused = dict.fromkeys(("R 0", "R 5001", "R 99999999999", "R 10.5"), "1 to 5000 Hz")
    refused |= dict.fromkeys(("B 0", "B 17"), "1 to 16") | {"M jk": "no such decoder"}
    refused |= dict.fromkeys(("R ", "hello", "II", "x" * 200), "is no command; known: I, R <hz>, B <n>")
    with switch_on("uno") as board, bench.Host(board) as host:
        other = host.say("M two-counter", "I")[-1]
        assert (other.decoder, other.capabilities) == ("two-counter", 1)
        before = host.say("M x4", "I")[-1]
        assert (before.decoder, before.tick_ns, before.counter_bits, before.max_rate_hz) == ("x4", 500, 16, 5000)
        assert before.capabilities == 7
        for command, words in refused.items():
            notice, after = host.say(command, "I", wait=5.0, until=Ident)
            assert isinstance(notice, Notice), command
            assert words in notice.text
            assert notice.text.startswith(command.strip()[:40])
            assert after == before, command


def test_settings_are_refused_while_it_samples_and_kept_between_starts(switch_on):
    with switch_on("mega", speed=2) as board, bench.Host(board) as host:
        assert host.say("R 500", "B 3") == []
        assert host.say("I")[-1].block_size == 3
        first = host.say("S", "R 1000", wait=0.5)
        notices = [frame for frame in first if isinstance(frame, Notice)]
        assert [notice.text for notice in notices] == ["R 1000: sampling; stop it first with X"]
        rest = host.say("X", wait=0.5)
        blocks = [frame for frame in first + rest if isinstance(frame, SampleBlock)]
        assert [len(block.dt) for block in blocks[:-1]] == [3] * (len(blocks) - 1)
        # 3 samples at 500 Hz in ticks of 0.5 us; a sample that an interrupt delays by more than 8 us would be marked
        np.testing.assert_allclose(np.diff([block.time for block in blocks]), 3 * 4000, rtol=0, atol=16)
        again = host.say("S", wait=0.2) + host.say("X")
        assert again[0].seq == 0
        assert again[0].time > blocks[-1].time


def test_a_rate_too_slow_for_blocks_is_refused_and_single_frames_are_not(switch_on):
    with switch_on("uno") as board, bench.Host(board) as host:
        assert host.say("R 30", "B 8") == []
        assert "single frames" in host.say("S", until=Notice)[0].text
        host.port.close()
        taken = bench.record(board, 3, 6, block=1)
    assert len(taken.seq) >= 6
    # 2/3 s in ticks of 0.5 us; a sample that another interrupt delays by more than 8 us would be marked.
    np.testing.assert_allclose(np.diff(taken.ticks.astype(np.int64)), 2e6 / 3, rtol=0, atol=16)


def test_it_finds_the_rate_of_its_host(switch_on):
    """From each rate to each other one, on one board: a walk through all pairs."""
    slow, middle, fast, fastest = BAUDS
    walk = [slow, middle, slow, fast, slow, fastest, middle, fast, middle, fastest, fast, fastest, slow]
    assert set(itertools.pairwise(walk)) == set(itertools.permutations(BAUDS, 2))
    with switch_on("uno", speed=4) as board:
        for baud in walk:
            with serial.Serial(board.port, baud, timeout=0.05) as port:
                bench.ask(port, b"I\n", lambda heard: b"stickslip" in heard)
        report = board.stop()
    assert report["baud"] == pytest.approx(walk[-1], rel=0.025)


def test_a_board_that_still_samples_at_another_rate_is_found_again(switch_on):
    with switch_on("uno", speed=1) as board:
        with serial.Serial(board.port, 1_000_000, timeout=0.05) as port:
            bench.ask(port, b"I\n", lambda heard: b"stickslip" in heard)
            port.write(b"S\n")
            assert len(port.read(2000)) > 100
        with bench.Host(board) as host:  # another one: the first has crashed
            assert [frame.name for frame in host.say("I")] == ["stickslip uno"]


def test_a_main_loop_that_hangs_is_restarted_by_the_watchdog(switch_on):
    with switch_on("uno", speed=4, hang=0.5) as board, bench.Host(board) as host:
        said = host.say("R 1000", "S", wait=8, until=Ident, broken=1)  # the reset may cut a frame short
    kinds = [type(frame) for frame in said]
    assert kinds[-1] is Ident  # in mid-stream: a recorder knows that the board has restarted
    assert kinds.count(Ident) == 1
    assert kinds.count(SampleBlock) > 50
    assert board.report["resets"] == 1


def test_a_recording_goes_on_in_a_new_segment_when_the_board_restarts(switch_on, tmp_path):
    with switch_on("uno", speed=1, hang=0.6) as board:
        found = record(RecordRequest(port=board.port, output=tmp_path / "run.h5", duration_s=2.6))
    assert found.segments == 2
    assert 1000 <= found.samples < 2000
    run = load(tmp_path / "run.h5")
    first = int(np.searchsorted(run.segment, 1))
    assert run.raw.sample[first] == 0
    assert run.time[-1] == pytest.approx(2.6, abs=0.1)
    gap = run.time[first] - run.time[first - 1]
    assert 0.5 < gap < 1.5  # the watchdog's second, less what it had waited before


def test_what_came_at_another_rate_is_no_damage_of_the_recording(switch_on, tmp_path):
    with switch_on("uno", speed=1) as board:
        with bench.Host(board, 115_200) as host:
            assert host.say("S")
        found = record(RecordRequest(port=board.port, output=tmp_path / "run.h5", duration_s=0.5, baud=1_000_000))
    assert (found.samples, found.lost, found.crc_errors) == (500, 0, 0)
    assert not [warning for warning in found.warnings if "metres per count" not in warning]


@pytest.mark.parametrize(
    ("baud", "rate", "block"),
    [
        (115_200, 1000, 8),
        *(
            pytest.param(*case, marks=pytest.mark.slow)
            for case in ((115_200, 500, 1), (500_000, 2000, 1), (500_000, 5000, 8), (1_000_000, 3000, 1))
        ),
    ],
)
def test_what_a_line_carries_it_carries_under_load(switch_on, baud, rate, block):
    edges = bench.of_motion(scene("rig"), 2.5, jitter=0.2)  # 100,000 edges/s in its slips
    with switch_on("uno", edges=edges) as board:
        taken = bench.record(board, rate, round(2.4 * rate), baud=baud, block=block)
    assert np.array_equal(taken.seq, np.arange(len(taken.seq)))
    assert np.count_nonzero(taken.error) == 0
    assert edges.peak_rate(50) > 90_000


def test_a_line_too_slow_loses_samples_and_says_so(switch_on):
    with switch_on("uno") as board:
        taken = bench.record(board, 5000, 1000, baud=115_200)
    lost = np.diff(taken.seq) - 1
    after_gap = 1 + np.flatnonzero(lost)
    assert lost.sum() > 1000
    assert np.all(taken.stream.status[after_gap] & wire.OVERRUN)
    assert np.array_equal(np.flatnonzero(taken.stream.status & wire.OVERRUN), after_gap)
    assert np.array_equal(np.round(np.diff(taken.ticks) / 400), np.diff(taken.seq))  # the numbers keep their place
