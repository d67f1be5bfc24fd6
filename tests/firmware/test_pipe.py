"""From the firmware to a friction law: the true commands, on a board in the emulator and on the simulated rig."""

import json
import subprocess
import sys

import numpy as np
import pytest

import fitting.cli
import processing.cli
from daq.runfile.store import load
from daq.wire.counters import FLAG_BOTH
from rig_sim.board.board import format_calibration
from rig_sim.board.encoder import QuadratureEncoder
from rig_sim.scenes.scene import scene
from stickslip.console import application

from . import bench

SECONDS = 20
SEED = 5
pytestmark = pytest.mark.slow  # a minute of an emulated board


def run(folder, *words):
    line = [sys.executable, "-m", "daq.cli.app", *map(str, words), "--json"]
    done = subprocess.run(line, capture_output=True, text=True, cwd=folder, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return json.loads(done.stdout)


@pytest.fixture(scope="module")
def both(emulator, latch_address, tmp_path_factory):
    """Record the same motion through the firmware and through ``rig://``; give the folder and both summaries."""
    folder = tmp_path_factory.mktemp("pipe")
    rig = scene("rig", seed=SEED)
    (folder / "rig.toml").write_text(format_calibration(rig, QuadratureEncoder(rig.encoder, rig.start.x)))
    edges = bench.of_motion(rig, SECONDS + 1)
    hexfile = bench.FIRMWARE / "stickslip-uno.hex"
    with bench.Board(emulator, "uno", hexfile, folder, edges=edges, watch=latch_address("uno"), speed=3) as board:
        words = ["record", "--port", board.port, "--rate", 1000, "--duration", SECONDS, "-o", "board.h5"]
        by_board = run(folder, *words)
        report = board.stop()
    run(folder, "replay", "board.h5", "--rig", "rig.toml", "-o", "calibrated.h5")
    words = ["record", "--scene", "rig", "--set", f"seed={SEED}", "--duration", SECONDS, "-o", "simulated.h5"]
    by_rig = run(folder, *words)
    return folder, board, report, by_board, by_rig


def test_the_board_is_recorded_like_the_rig_with_every_count_of_the_encoder(both):
    folder, board, report, by_board, by_rig = both
    assert by_board["samples"] == by_rig["samples"] == SECONDS * 1000
    for key in ("lost", "crc_errors", "illegal", "phase_errors"):
        assert by_board[key] == 0
    assert by_board["segments"] == 1
    assert report["bytes_dropped"] == 0
    recorded = load(folder / "board.h5")
    flags = recorded.raw.flags
    assert len(flags) == SECONDS * 1000
    assert np.count_nonzero(flags & ~np.uint16(FLAG_BOTH)) == 0  # both counters move at a reversal

    _, true = board.truth(np.round(recorded.time * bench.CYCLES_PER_S).astype(np.int64))
    assert np.ptp(true) > 10_000
    assert np.array_equal(recorded.count - recorded.count[0], true - true[0])


def test_the_fastest_rate_is_recorded_in_real_time(emulator, tmp_path):
    edges = bench.of_motion(scene("rig", seed=SEED), 5, jitter=0.2)
    hexfile = bench.FIRMWARE / "stickslip-uno.hex"
    words = ["record", "--rate", 5000, "--baud", 1_000_000, "--duration", 4, "-o", "fast.h5"]
    with bench.Board(emulator, "uno", hexfile, tmp_path, edges=edges, speed=1) as board:
        found = run(tmp_path, *words, "--port", board.port)
    assert (found["samples"], found["lost"], found["crc_errors"], found["illegal"]) == (20_000, 0, 0, 0)
    # By the device's clock: a byte that comes in just then, which is up to the host, delays a latch by less than 50 us.
    late = 50e-6 * bench.CYCLES_PER_S
    cycle = load(tmp_path / "fast.h5").time * bench.CYCLES_PER_S
    off = cycle - np.arange(20_000) * bench.CYCLES_PER_S / 5000
    assert np.median(np.diff(cycle)) == pytest.approx(bench.CYCLES_PER_S / 5000, abs=1e-3)
    assert np.abs(off - np.median(off)).max() <= late
    assert found["measured_rate_hz"] == pytest.approx(5000, rel=2 * late / cycle[-1])


@pytest.mark.usefixtures("no_rivals", "undrawn_report")
def test_the_law_and_its_parameters_are_the_same_as_through_the_simulated_rig(both, capsys):
    fits = {}
    for name in ("calibrated", "simulated"):
        path = str(both[0] / f"{name}.h5")
        assert application.run(processing.cli.app, ["smooth", path, "--json"]) == 0
        capsys.readouterr()
        assert application.run(fitting.cli.app, [path, "--json"]) in (0, 5)
        fits[name] = json.loads(capsys.readouterr().out)
    board, rig = fits["calibrated"], fits["simulated"]
    assert board["set"] == rig["set"]
    assert board["verdict"].split(":")[0] == rig["verdict"].split(":")[0]
    best = {name: next(row for row in fit["ranking"] if row["law"] == fit["set"][0]) for name, fit in fits.items()}
    assert best["calibrated"]["law"] == 5
    for name, of_board in best["calibrated"]["parameters"].items():
        of_rig = best["simulated"]["parameters"][name]
        assert of_rig["lo"] <= of_board["value"] <= of_rig["hi"], name
        assert of_board["lo"] <= of_rig["value"] <= of_board["hi"], name
