"""`daq check` and `daq calibrate` on the simulated rig, whose true values are known, and on a board that lies."""

import json
import math
import tomllib
from urllib.parse import quote

import numpy as np
import pytest

import daq
from daq.calibration import board_test, rig_constants
from daq.cli import sentences
from daq.cli.app import app
from daq.protocols.request import RecordRequest
from daq.recorder import record
from daq.runfile.rig import Rig
from stickslip.console import application
from stickslip.errors import DataError
from stickslip.units import Measured

REST = ["belt.speed=0.0", "scatter.Fs=0"]
OMEGA0 = math.sqrt(35.184)


@pytest.fixture(autouse=True)
def alone(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    monkeypatch.chdir(tmp_path)


def url(*changes):
    return "rig://rig?" + "&".join(f"set={quote(change, safe='')}" for change in changes)


def said(capsys, *arguments):
    code = application.run(app, [*map(str, arguments), "--json"])
    out, err = capsys.readouterr()
    assert out.count("\n") == 1
    return code, json.loads(out), err


def test_the_simulated_rig_passes_its_check(capsys):
    code, found, _ = said(capsys, "check")
    assert code == 0
    assert found["ok"] is True
    assert (found["lost"], found["illegal"], found["parked_drift"]) == (0, 0, 0)
    assert found["hand_move"] > 0
    assert found["measured_rate_hz"] == pytest.approx(1000, rel=1e-3)
    assert {check["name"] for check in found["checks"]} >= {"rate", "line", "clock", "parked drift", "direction"}


@pytest.mark.slow
def test_a_vibrating_jk_box_fails_by_its_parked_drift(capsys):
    parked = ["belt.start=100", "scatter.Fs=0", "encoder.vibration=2.3e-6", "encoder.vibration_hz=200"]
    drifts = {}
    for decoder in ("jk", "x4"):
        worst = 0
        for half_counts in (2, 6):
            port = url(*parked, f"start.x={half_counts * 3.835e-6}", f"encoder.decoder={decoder}")
            code, found, _ = said(capsys, "check", "--port", port, "--parked", 2, "--move", 0)
            worst = max(worst, abs(found["parked_drift"]))
            assert code == (4 if abs(found["parked_drift"]) > 1 else 0)
        drifts[decoder] = worst
    assert drifts["jk"] == pytest.approx(400, abs=2)
    assert drifts["x4"] <= 1


@pytest.mark.parametrize(
    ("arguments", "name", "seen", "do"),
    [
        (["--parked", 3, "--move", 0], "parked drift", "moved", ""),  # drift was not tried
        (["--port", url("belt.speed=-0.22"), "--move", 0.5], "direction", "", "swap"),
        (["--port", url("belt.start=100"), "--parked", 0, "--move", 1], "direction", "", "no edge was counted"),
    ],
)
def test_a_check_that_fails_says_what_was_seen_and_what_to_do(capsys, arguments, name, seen, do):
    code, found, _ = said(capsys, "check", *arguments)
    check = next(check for check in found["checks"] if check["name"] == name)
    assert (code, check["ok"]) == (4, False)  # nobody is to go on to calibrate
    assert seen in check["seen"]
    assert do in check["do"]
    assert do != "swap" or found["hand_move"] < 0


def test_a_channel_that_never_changes_is_named(tmp_path):
    found = record.record(RecordRequest(url("belt.start=0.1"), tmp_path / "run.h5", 1000, 2.0))
    run = daq.load(tmp_path / "run.h5")
    run.raw.levels[:] &= 1
    names = {finding.name: finding for finding in board_test.check_board(found, run, 0.0)}
    assert names["channels"].ok is False
    assert "B never changes" in names["channels"].seen


@pytest.mark.parametrize("law", [5, pytest.param(1, marks=pytest.mark.slow)])
@pytest.mark.parametrize(("Fs", "c"), [(0.03, 0.02), pytest.param(0.01, 0.05, marks=pytest.mark.slow)])
def test_a_ring_down_gives_the_rig_back_within_its_errors(capsys, tmp_path, law, Fs, c):
    port = url(*REST, "start.x=0.1", f"friction.law={law}", f"friction.Fs={Fs}", f"damper.c={c}")
    code, found, _ = said(capsys, "calibrate", "--port", port, "--mass", "300 g +- 0.3 g", "--rate", 500)
    assert code == 0
    assert found["warnings"] == []
    assert abs(found["omega0"] - OMEGA0) < 4 * found["omega0_sd"]
    assert found["omega0_sd"] < 1e-3
    zeta = c / (2 * 0.3 * OMEGA0)
    assert abs(found["damping_ratio"] - zeta) < 4 * found["damping_ratio_sd"]
    rig = Rig.from_toml((tmp_path / "rig.toml").read_text(), "rig.toml")
    for measured, true in ((rig.stiffness, 0.3 * OMEGA0**2), (rig.damping, c), (rig.mass, 0.3)):
        assert abs(measured.value - true) < 4 * measured.sd
    assert abs(rig.datum.value - 0.1) < 4 * rig.datum.sd + 7.67e-6
    assert found["friction_length"] == pytest.approx(Fs / 10.5552, rel=0.01)
    assert (rig.belt_speed, found["left_out"]) == (None, ["belt_speed"])


def test_a_known_distance_gives_the_metres_per_count(capsys, tmp_path):
    # Pulled to 0.1 m and let creep back by a strong damper: friction of 1e-6 N ends within 0.1 um of the rest.
    port = url(*REST, "start.x=0.1", "friction.law=1", "friction.Fs=1e-6", "damper.c=8")
    line = ("calibrate", "--port", port, "--distance=-100 mm +- 0.1 mm", "--no-ring-down")
    code, found, _ = said(capsys, *line)
    assert code == 0
    pitch = Rig.from_toml((tmp_path / "rig.toml").read_text(), "rig.toml").metres_per_count
    assert pitch.value == pytest.approx(0.12566 / 16384, rel=1e-4)
    assert pitch.sd == pytest.approx(1e-3 * pitch.value, rel=0.01)
    assert any("first sample" in warning for warning in found["warnings"])


def test_what_was_calibrated_is_what_a_recording_uses(capsys, tmp_path):
    rig = tmp_path / "rig.toml"
    port = url(*REST, "start.x=0.1", "friction.law=1", "friction.Fs=0.01", "damper.c=0.05")
    said(capsys, "calibrate", "--port", port, "--rate", 500, "--mass", "0.3", "-o", rig)
    board = tomllib.loads(rig.read_text())["board"]
    assert board == {"port": port, "rate": 500}
    code, found, _ = said(capsys, "record", "--rig", rig, "--duration", 20)
    assert code == 0
    assert found["rate_hz"] == 500
    run = daq.load(tmp_path / "run.h5")
    assert run.rig == Rig.from_toml(rig.read_text(), "rig.toml")
    assert run.position[0] == pytest.approx(0.1, abs=1e-4)
    assert run.position[-1] == pytest.approx(0.0, abs=1.1e-3)  # within Fs/k


@pytest.mark.parametrize(
    ("port", "duration", "what"),
    [
        (url("belt.speed=0.0"), 2, "not moved"),
        # This one was written with a warning, and the next recording took it.
        ("rig://rig", 4, "not that of a mass on a spring"),
    ],
)
def test_a_motion_that_is_no_ring_down_writes_no_calibration(capsys, tmp_path, port, duration, what):
    code, found, _ = said(capsys, "calibrate", "--port", port, "--mass", "300 g", "--duration", duration, "-y")
    assert code == 4
    assert what in found["error"]["what"]
    assert not (tmp_path / "rig.toml").exists()


def test_derived_errors_are_those_of_their_parts():
    ring = type("Ring", (), {"omega0": Measured(6.0, 0.006), "zeta": Measured(0.01, 1e-4)})()
    mass = Measured(0.3, 3e-4)
    assert rig_constants.compute_stiffness(ring, mass).value == pytest.approx(10.8)
    assert rig_constants.compute_stiffness(ring, mass).sd == pytest.approx(10.8 * math.hypot(1e-3, 2e-3))
    assert rig_constants.compute_damping(ring, mass).sd == pytest.approx(0.036 * math.hypot(1e-2, 1e-3, 1e-3))


def test_counts_across_a_lost_port_are_not_joined(tmp_path):
    record.record(RecordRequest("rig://rig", tmp_path / "run.h5", 1000, 3.0))
    run = daq.load(tmp_path / "run.h5")
    run.segment[-1] = 1
    with pytest.raises(DataError, match="port was lost"):
        rig_constants.measure_pitch(run, Measured(0.1))
    assert np.all(run.segment[:-1] == 0)


@pytest.mark.slow
def test_the_examples_of_calibrate_run_on_the_simulated_rig(capsys, tmp_path):
    code, found, _ = said(capsys, "calibrate", "--mass", "300 g +- 1 g")
    assert code == 0
    assert found["omega0"] == pytest.approx(OMEGA0, abs=5 * found["omega0_sd"])
    assert found["rig"]["datum"] == pytest.approx(0.0, abs=5 * found["rig"]["datum_sd"])


def test_an_interrupted_check_names_no_journal_that_is_gone(capsys, monkeypatch):
    def interrupted(*_, **__):
        raise record.RecordingInterruptedError("interrupted; the journal was kept", "/gone", "recover it")

    monkeypatch.setattr(record, "record", interrupted)
    assert application.run(app, ["check", "--parked", "0.1"]) == 130
    assert capsys.readouterr().err.splitlines()[-1] == "daq: interrupted"


def test_a_lost_port_stands_beside_no_sample_lost(tmp_path):
    from daq.finalise.quality import RecordingQuality

    numbers = (100, 0, 0, 0, 0, 2, 1000.0, 1000.0, None, None, 0.1, 0.0, 0, 0, (0.0, 1.0), "m")
    lost_port = sentences.format_recording("recorded", RecordingQuality(*numbers, port_lost=1))
    assert ", no sample lost while the port was open\n" in lost_port
    assert ", no sample lost\n" in sentences.format_recording("recorded", RecordingQuality(*numbers))
