"""Replay: a capture sampled as a board would, a run decoded anew, a journal through its finaliser."""

import json
import tomllib

import h5py
import numpy as np
import pytest

from daq.cli.app import app
from daq.imports import capture, replay, sigrok
from daq.runfile import journal, spill, store
from daq.runfile.recording import Recording
from daq.runfile.rig import Rig
from daq.wire.quadrature import GRAY, PHASE
from stickslip.console import application
from stickslip.units import Measured

from ...boards import BoardPort, motion
from ...journals import HEADER, write_journal

PAIR = {0: "A", 1: "B"}
WIRED = capture.Wiring((0, 1), "x4")
SWING = np.round(900 * np.sin(np.arange(20_011) * 1e-3) + 2.4).astype(np.int64)  # below an edge a sample
CONFIG = "[rig]\nmass = 0.3\n[encoder]\nmetres_per_count = 1e-5\ndatum = 0.001\n"


@pytest.fixture
def swing(tmp_path, write_capture):
    return write_capture(tmp_path / "swing.sr", GRAY[SWING & 3], PAIR, rate="10 kHz", chunk=777)


@pytest.fixture
def part(tmp_path):
    """Write the journal of a board whose counters roll over."""
    board = BoardPort(config=CONFIG)
    sent = [board.answer("I"), *map(board.encode, range(30))]
    records = [(journal.RECEIVED, 8_000_000 * (k + 1), data) for k, data in enumerate(sent)]
    return write_journal(tmp_path / "board.h5.part", records, HEADER | {"protocol": "frames"})


@pytest.mark.parametrize("rate", [1000.0, 300.0, 10_000.0])
def test_a_capture_is_sampled_where_it_stood(swing, rate):
    run, totals = replay.sample_capture(sigrok.read(swing), WIRED, rate, Rig())
    index = np.round(run.time * 10_000).astype(int)
    np.testing.assert_array_equal(index, np.floor(np.arange(index.size) * (10_000 / rate)))
    assert 0 < SWING.size - index[-1] <= np.ceil(10_000 / rate)
    power_up = SWING[0] - int(PHASE[GRAY[SWING[0] & 3]])  # a board wakes up at the phase of the levels
    np.testing.assert_array_equal(run.count, SWING[index] - power_up)
    np.testing.assert_array_equal(run.raw.levels, GRAY[SWING[index] & 3])
    assert not run.raw.flags.any()
    assert totals.net == SWING[-1] - SWING[0]
    np.testing.assert_array_equal(run.raw.device_time, index * 100)


def test_counters_of_a_capture_roll_over_at_16_bits(tmp_path, write_capture):
    count = np.arange(140_001)
    path = write_capture(tmp_path / "far.sr", GRAY[count & 3], PAIR, rate="100 kHz")
    run, _ = replay.sample_capture(sigrok.read(path), WIRED, 1000.0, Rig(metres_per_count=Measured(2.0**-10)))
    assert run.raw.count_up.tolist() == [int(n) & 0xFFFF for n in count[::100]]
    assert run.position.tolist() == [n / 1024 for n in count[::100]]


def test_a_probe_of_any_name_is_kept(tmp_path, write_capture):
    # A quote in a name made the stored settings no TOML.
    names = {0: 'A" = 1', 1: "B\\"}
    path = write_capture(tmp_path / "swing.sr", GRAY[SWING[:200] & 3], names, rate="10 kHz")
    run, _ = replay.sample_capture(sigrok.read(path), WIRED, 1000.0, Rig())
    kept = tomllib.loads(run.config_toml)["replay"]
    assert (kept["a"], kept["b"]) == (names[0], names[1])


def test_illegal_transitions_are_marked_in_the_run(tmp_path, write_capture):
    count = np.arange(200)
    count[120:] += 1  # two counts in one sample: both channels change at once, and the direction is not known
    path = write_capture(tmp_path / "bad.sr", GRAY[count & 3], PAIR, rate="1 kHz")
    run, totals = replay.sample_capture(sigrok.read(path), WIRED, 1000.0, Rig())
    assert totals.illegal == 1
    store.write(tmp_path / "run.h5", run)
    recording = store.load(tmp_path / "run.h5")
    assert list(zip(recording.event_sample.tolist(), recording.event_kind, strict=True)) == [
        (120, "illegal"),
        (120, "phase"),
    ]
    assert replay.count_faults(run) == {"lost": 0, "illegal": 1, "phase_errors": 80, "crc_errors": 0}


def test_a_journal_is_replayed_and_kept(part, capsys, tmp_path):
    before = part.read_bytes()
    assert application.run(app, ["replay", str(part), "-o", str(tmp_path / "a.h5"), "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    keys = "samples lost crc_errors illegal phase_errors segments rate_hz clock_ppm duration_s file warnings"
    assert set(keys.split()) <= set(printed)
    assert (printed["samples"], printed["lost"], printed["segments"], printed["phase_errors"]) == (240, 0, 1, 0)
    assert part.read_bytes() == before
    recording = store.load(tmp_path / "a.h5")
    count = motion(np.arange(240))
    np.testing.assert_array_equal(recording.count, count)
    np.testing.assert_allclose(recording.position, count * 1e-5 + 0.001, rtol=1e-15)


def test_a_run_is_decoded_anew_from_its_raw_counters(part, tmp_path):
    first, second = tmp_path / "a.h5", tmp_path / "b.h5"
    assert application.run(app, ["replay", str(part), "-o", str(first)]) == 0
    store.extend(first, "smooth", lambda entry: entry.create_group("smooth"), default="smooth")
    before = store.load(first)
    with h5py.File(first, "r+") as file:
        file["entry/instrument/encoder/value_log/raw_value"][...] = 7  # derived, so not to be trusted
    assert application.run(app, ["replay", str(first), "-o", str(second)]) == 0
    after = store.load(second)
    np.testing.assert_array_equal(after.count, before.count)
    np.testing.assert_array_equal(after.position, before.position)
    assert after.digest == before.digest
    assert (before.default, after.default) == ("smooth", "data")


def test_another_calibration_moves_positions_and_no_raw_data(part, tmp_path):
    rig = tmp_path / "rig.toml"
    rig.write_text("[rig]\nmass = 0.5\n[encoder]\nmetres_per_count = 2e-5\n")
    first, second = tmp_path / "a.h5", tmp_path / "b.h5"
    assert application.run(app, ["replay", str(part), "-o", str(first)]) == 0
    assert application.run(app, ["replay", str(first), "-o", str(second), "--rig", str(rig)]) == 0
    before, after = store.load(first), store.load(second)
    np.testing.assert_allclose(after.position, 2 * (before.position - 0.001), rtol=1e-12)
    assert after.rig.mass == Measured(0.5)
    assert after.digest == before.digest


@pytest.mark.parametrize("stated", [[], ["--metres-per-count", "2e-5", "--x0", "0"]])
def test_a_journal_that_does_not_fit_into_memory_is_replayed_as_another(part, tmp_path, monkeypatch, stated):
    first, second = tmp_path / "a.h5", tmp_path / "b.h5"
    assert application.run(app, ["replay", str(part), "-o", str(first), *stated]) == 0
    monkeypatch.setattr(spill, "MEMORY_BYTES", 0)
    assert application.run(app, ["replay", str(part), "-o", str(second), *stated]) == 0
    one, other = store.load(first), store.load(second)
    np.testing.assert_array_equal(other.position, one.position)
    assert other.digest == one.digest
    assert other.config_toml == one.config_toml


def test_an_import_is_replayed_as_it_stands(tmp_path):
    (tmp_path / "t.csv").write_text("t,x\n0,1\n1,2\n")
    first, second = str(tmp_path / "a.h5"), str(tmp_path / "b.h5")
    assert application.run(app, ["import", str(tmp_path / "t.csv"), "-o", first]) == 0
    assert application.run(app, ["replay", first, "-o", second]) == 0
    again = store.load(second)
    assert again.position.tolist() == [1, 2]
    assert again.count is None


def test_real_captures_become_runs(captures, tmp_path, capsys):
    run = tmp_path / "y.h5"
    source = captures / "avago_adns_2051_move_mouse_up_down.sr"
    line = ["replay", str(source), "--channels", "A=YA,B=YB", "-o", str(run), "--json"]
    assert application.run(app, line) == 0
    printed = json.loads(capsys.readouterr().out)
    assert (printed["edges"], printed["illegal"], printed["samples"], printed["rate_hz"]) == (629, 0, 3000, 1000)
    recording = store.load(run)
    assert recording.unit == "count"
    assert recording.count[-1] - recording.count[0] == printed["net"]


def test_positions_of_a_table_move_with_the_datum_of_another_calibration(tmp_path):
    """The old datum stayed in them beside the new one, so that the fit's rest position was off by the difference."""
    x = np.linspace(0.0, 0.1, 11)
    stated = Rig(datum=Measured(-0.06))
    run = Recording("", "", "", 10.0, stated, np.arange(11) / 10, x - 0.06)
    np.testing.assert_allclose(replay.recalibrate(run, Rig(datum=Measured(-0.05))).position, x - 0.05, atol=1e-15)
    np.testing.assert_allclose(replay.recalibrate(run, Rig(x0=Measured(0.06))).position, x, atol=1e-15)
