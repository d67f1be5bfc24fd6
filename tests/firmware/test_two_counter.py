"""The two hardware counters, for a rig whose own J-K box gives up and down pulses."""

import json
import subprocess
import sys

import numpy as np
import pytest

from daq.runfile.store import load

from . import bench

PULSE_HZ = 1_000_000
IN_FLIGHT = 4  # pulses that may come between the entry of a latch and its reading of a counter, 30 cycles later


def bursts(rng, start, pulses, spacing=16):
    """Return the cycles of so many rises, ``spacing`` apart but for a cycle here and there."""
    return start + spacing * np.arange(pulses) + rng.integers(-1, 2, pulses)


@pytest.mark.parametrize("kind", ["uno", "mega"])
def test_both_counters_are_exact_at_a_million_pulses_a_second(switch_on, kind):
    rng = np.random.default_rng(7)
    up = bursts(rng, 40_000, 900_001)
    down = bursts(rng, 100_007, 700_003)  # overlapping, and not in step
    edges = bench.of_pulses(up, down, width=8)
    with switch_on(kind, edges=edges, pins=bench.COUNTER_PINS[kind]) as board:
        taken = bench.record(board, 1000, 1000, mode="two-counter")
    stream = taken.stream
    assert np.array_equal(taken.seq, np.arange(len(taken.seq)))
    assert stream.up[-1] == len(up) % 65536  # after both have stopped
    assert stream.down[-1] == len(down) % 65536
    assert stream.up[0] == stream.down[0] == 0
    for counter, rises in ((stream.up, up), (stream.down, down)):
        ahead = np.diff(counter.astype(np.int64), prepend=0) & 0xFFFF
        early = np.cumsum(ahead) - np.searchsorted(np.sort(rises), taken.entry - 8)
        assert early.min() >= -1
        assert early.max() <= IN_FLIGHT
    assert np.max(np.diff(stream.up.astype(np.int64)) & 0xFFFF) >= PULSE_HZ / 1000 - 2


@pytest.mark.parametrize("offset", [0, 3])
def test_the_upper_byte_of_the_down_counter_is_never_torn(switch_on, offset):
    # Timer 0 overflows around every sample, at another cycle each time: a torn reading is off by 256.
    period = 16_000
    samples = 1500
    pins = bench.COUNTER_PINS["uno"]
    first = bench.first_sample(switch_on("uno", edges=bench.of_pulses([20], [40]), pins=pins), "two-counter")
    turn = first + period * np.arange(1, samples) + np.arange(samples - 1) % 500 - 250
    rise = (turn[:-1, None] + np.linspace(0, 1, 257)[None, 1:] * np.diff(turn)[:, None]).ravel().astype(np.int64)
    rise = np.concatenate((turn[0] - 60 * np.arange(255, -1, -1), rise)) + offset
    edges = bench.of_pulses([20], rise, width=8)
    with switch_on("uno", edges=edges, pins=pins) as board:
        taken = bench.record(board, 1000, samples - 10, mode="two-counter")
    overflow = rise[255::256]
    meeting = np.min(np.abs(taken.entry[:, None] - overflow[None, :]), axis=1)
    assert np.count_nonzero(meeting < 60) > 100
    true = np.searchsorted(rise, taken.entry - 8)
    early = (taken.stream.down.astype(np.int64) - true) & 0xFFFF
    assert set(np.unique(early)) <= {0, 1, 0xFFFF}
    assert np.count_nonzero(np.diff(taken.stream.down >> 8)) > 0.9 * (samples - 20)


def test_a_run_behind_a_jk_box_is_recorded_by_the_command(switch_on, tmp_path):
    rng = np.random.default_rng(11)
    up, down = bursts(rng, 100_000, 20_000, 800), bursts(rng, 8_000_000, 15_000, 800)
    edges = bench.of_pulses(up, down, width=8)
    words = ["record", "--decoder", "two-counter", "--duration", "1.4", "-o", "run.h5", "--json"]
    with switch_on("mega", edges=edges, pins=bench.COUNTER_PINS["mega"], speed=2) as board:
        line = [sys.executable, "-m", "daq.cli.app", *words, "--port", board.port]
        done = subprocess.run(line, capture_output=True, text=True, cwd=tmp_path, check=False)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert (found["samples"], found["lost"], found["illegal"], found["phase_errors"]) == (1400, 0, 0, 0)
    run = load(tmp_path / "run.h5")
    assert run.rig.decoder == "two-counter"
    assert run.count[0] == 0
    assert run.count.max() > 8_000
    assert run.count[-1] == len(up) - len(down)
