"""``rig-sim``: its JSON keys, its numbers, its one-line errors, and what it does not import."""

import json
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

import rig_sim
from rig_sim.cli.app import app
from rig_sim.motion import play as motion_module
from rig_sim.motion.play import ScenePlayer
from rig_sim.results.maps import format_with_error
from stickslip.console import application

from ..shared import LIMIT_CYCLES, answer, settings

KEYS = {
    "law": "friction.law",
    "Gs": "friction.G_slip",
    "Gst": "friction.G_stick",
    "gamma": "friction.gamma",
    "vdr": "belt.speed",
    "c": "damper.c",
}


@pytest.mark.parametrize("case", LIMIT_CYCLES["cases"], ids=lambda case: case["name"])
def test_cycle_meets_the_reference_through_set(case: dict[str, Any]) -> None:
    found = answer("cycle base", *settings(*(f"{KEYS[key]}={value}" for key, value in case["params"].items())))
    if "result" in case:  # no limit cycle there
        assert found["outcome"] == "fixed point"
        return
    for key in ("period", "t_stick", "t_slip", "x_slip", "x_stick", "x_min", "x_max", "v_min", "v_max"):
        assert found[key] == pytest.approx(float(case[key]), abs=1e-12)
    assert found["sequence"] == case.get("slip_sequence", "NS")


def test_cycle_has_the_promised_keys() -> None:
    found = answer("cycle base")
    promised = "period t_stick t_slip x_slip x_stick x_min x_max v_min v_max sequence outcome".split()
    assert set(promised) <= set(found)
    for law in (1, 2):
        assert answer(f"cycle base --set friction.law={law}")["outcome"] == "grazing"


def test_scenes_lists_name_title_and_terms(capsys: pytest.CaptureFixture[str]) -> None:
    rows = answer("scenes")
    assert [row["name"] for row in rows] == ["ageing", "base", "damped", "forced", "lugre", "rig", "two-mass"]
    assert rows[1]["terms"] == ["mass", "spring", "belt", "friction", "start"]
    assert all(row["title"] for row in rows)
    assert application.run(app, ["scenes"]) == 0
    assert "laboratory rig" in capsys.readouterr().out


def test_events_have_the_promised_keys(capsys: pytest.CaptureFixture[str]) -> None:
    found = answer("events base --until 60 --set drive.u0=0.2 --set drive.omega=0.3")
    assert set(found) >= {"events", "outcome", "steps"}
    assert set(found["events"][0]) == {"t", "x", "kind"}
    assert len(found["events"]) == 15
    short = answer("events base --until 60 --max-steps 5")
    assert (short["outcome"], short["steps"]) == ("step limit", 5)
    assert application.run(app, "events base --until 60 --max-steps 5".split()) == 0
    assert "allow more steps" in capsys.readouterr().out


@pytest.mark.parametrize("ending", [".csv", ".h5"])
def test_run_writes_the_exact_motion(tmp_path: Path, ending: str) -> None:
    path = tmp_path / f"motion{ending}"
    found = answer("run rig --until 3 --rate 250 --set seed=8 -o", path)
    assert (found["samples"], found["outcome"]) == (751, "completed")
    table: Any
    if ending == ".csv":
        table = np.genfromtxt(path, delimiter=",", names=True)
    else:
        with h5py.File(path) as file:
            entry = file["entry"]
            assert entry.attrs["default"] == "motion"
            assert entry["motion"].attrs["signal"] == "x"
            table = {name: entry["motion"][name][()] for name in "txvF"}
            assert json.loads(entry["simulation/scene"][()])["seed"] == 8
            assert entry["motion/v"].attrs["units"] == "m/s"
    path_exact = ScenePlayer(rig_sim.scene("rig", seed=8)).follow(np.arange(751) / 250, forces=True)
    np.testing.assert_array_equal(table["t"], np.arange(751) / 250)
    np.testing.assert_array_equal(table["x"], path_exact.nodes.x[path_exact.samples])
    np.testing.assert_array_equal(table["v"], path_exact.nodes.v[path_exact.samples])
    np.testing.assert_array_equal(table["F"], path_exact.F)
    assert [entry.name for entry in tmp_path.iterdir()] == [path.name]


def test_run_never_replaces_a_file_unasked(tmp_path: Path) -> None:
    path = tmp_path / "kept.csv"
    path.write_text("mine")
    line = "run rig --until 1 --rate 10 -o"
    error = answer(line, path, code=2)["error"]
    assert (error["what"], error["where"]) == ("the output file exists", str(path))
    assert "--force" in error["do"]
    assert path.read_text() == "mine"
    answer(line, path, "--force")
    assert path.read_text().startswith("t,x,v,F\n")


def test_light_commands_import_no_array_package() -> None:
    code = (
        "import sys; from stickslip.console import application; from rig_sim.cli.app import app\n"
        "for line in ('--help', 'scenes', 'cycle base', 'events rig --until 20'):\n"
        "    assert application.run(app, line.split()) == 0, line\n"
        "    heavy = {'numpy', 'scipy', 'mpmath', 'numba', 'matplotlib', 'pandas', 'h5py'} & set(sys.modules)\n"
        "    assert not heavy, (line, heavy)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


def test_the_package_imports_nothing_until_asked() -> None:
    code = "import sys, rig_sim; print([m for m in sys.modules if m.startswith(('rig_sim.', 'numpy', 'pydantic'))])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
    assert rig_sim.cycle(rig_sim.scene("base")).outcome == "cycle"
    assert rig_sim.events(rig_sim.scene("base"), 3.0).outcome == "completed"


def test_a_scene_file_without_an_end_is_not_read_to_it(tmp_path: Path) -> None:
    large = tmp_path / "large.toml"
    large.write_text("# much\n" * 200_000)
    error = answer("cycle", large, code=2)["error"]
    assert "too large for a scene: over 1048576 bytes" in error["what"]


@pytest.mark.slow
def test_a_long_list_of_events_is_the_same_by_compiled_code(monkeypatch: pytest.MonkeyPatch) -> None:
    # A step limit of a million interpreted steps used to take most of a minute.
    forced = rig_sim.scene("base", **{"drive.u0": 0.2, "drive.omega": 0.3})
    interpreted = rig_sim.events(forced, 400.0)
    monkeypatch.setattr(motion_module, "INTERPRETED_STEPS", 50)
    assert interpreted.steps > 100
    assert rig_sim.events(forced, 400.0) == interpreted
    assert motion_module.events(forced, 400.0, max_steps=120).outcome == "step limit"
    assert motion_module.events(forced, 400.0, max_steps=40).steps == 40


@pytest.mark.skipif(sys.platform == "win32", reason="an interrupt is sent as a signal")
def test_an_interrupted_run_is_one_line_and_leaves_nothing(tmp_path: Path) -> None:
    line = [sys.executable, "-m", "rig_sim.cli.app", "run", "rig", "--until", "90000", "--rate", "1000", "-o", "m.csv"]
    with subprocess.Popen(line, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        while process.poll() is None and not list(tmp_path.glob(".m.csv.*")):
            time.sleep(0.02)
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=600)  # a hang, on however busy a machine
    # Python ends by the signal itself where it came while a module was loaded; a shell tells 130 either way.
    assert process.returncode in (130, -signal.SIGINT)
    assert (out, err) == ("", "rig-sim: interrupted\n")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("value", "stderr", "text"),
    [
        (0.86521896, 0.0129, "0.865 +- 0.013"),
        (-0.53850894, 0.0, "-0.53850894 +- 0"),
        (12.3, 4.5, "12.3 +- 4.5"),
        (1234.5, 120.0, "1234 +- 1.2e+02"),
    ],
)
def test_a_value_has_the_digits_that_its_error_leaves(value, stderr, text):
    assert format_with_error(value, stderr) == text
