"""``rig-sim``: its JSON keys, its numbers, its one-line errors, and what it does not import."""

import json
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

import rig_sim
from rig_sim.cli.app import app
from rig_sim.motion.play import ScenePlayer
from rig_sim.results.maps import format_with_error
from stickslip.console import application

from ..shared import answer


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
            stored = json.loads(entry["simulation/scene"][()])
            assert stored["seed"] == 8
            assert not {"droop", "wear", "joint", "shaker", "slip_loss", "gaps"} & set(stored)  # which it does not name
            assert entry["motion/v"].attrs["units"] == "m/s"
    path_exact = ScenePlayer(rig_sim.scene("rig", seed=8)).follow(np.arange(751) / 250, forces=True)
    np.testing.assert_array_equal(table["t"], np.arange(751) / 250)
    np.testing.assert_array_equal(table["x"], path_exact.nodes.x[path_exact.samples])
    np.testing.assert_array_equal(table["v"], path_exact.nodes.v[path_exact.samples])
    np.testing.assert_array_equal(table["F"], path_exact.F)
    assert [entry.name for entry in tmp_path.iterdir()] == [path.name]


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
