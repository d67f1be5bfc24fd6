"""``rig-sim run --method``: three methods, one file; dop853 to its tolerance, the thesis's to the fourth order."""

import math
from functools import cache
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from rig_sim.comparison.methods import METHODS, choose_phases
from rig_sim.motion.play import ScenePlayer
from rig_sim.scenes.scene import scene

from ..shared import answer

EFFECTS: dict[str, dict[str, object]] = {
    "scatter": {"scatter.Fs": 0.05, "seed": 3},
    "wear": {"wear.rate": 0.002},
    "joint": {"joint.kick": 0.05, "belt.length": 3.0},
    "belt start": {"belt.start": 2.0, "start.x": 0.3},
    "ripple": {"belt.ripple": 0.02, "belt.ripple_hz": 0.3},
    "droop": {"droop.fraction": 0.2},
    "damper": {"damper.c": 0.1},
    "drive": {"drive.u0": 0.2, "drive.omega": 0.7},
    "static": {"friction.static": 1.1},
    "mirrored": {"belt.speed": -0.5},
}


def played(method: str, changes: dict[str, object], until: float = 30.0, **setting: float) -> tuple[np.ndarray, Any]:  # type: ignore[type-arg]
    return play_once(method, tuple(changes.items()), until, tuple(setting.items()))


@cache
def play_once(method: str, changes: Any, until: float, settings: Any) -> tuple[np.ndarray, Any]:  # type: ignore[type-arg]
    found, setting = scene("base", **dict(changes)), dict(settings)
    motion = ScenePlayer(found, phases=choose_phases(method, found, **setting)[0])
    motion.events = []
    path = motion.follow(np.linspace(0.0, until, 301), forces=True)
    at = path.samples
    return np.array([path.nodes.t[at], path.nodes.x[at], path.nodes.v[at], path.F]), motion.events


@pytest.mark.parametrize("law", range(1, 7))
def test_sampled_motion_of_dop853_is_the_exact_one_to_its_tolerance(law: int) -> None:
    exact, events = played("exact", {"friction.law": law})
    found, others = played("dop853", {"friction.law": law})
    if law != 1:  # whose touches of the edge last zero time
        assert [event.kind for event in others] == [event.kind for event in events]
    np.testing.assert_array_equal(found[0], exact[0])
    assert np.abs(found[1:3] - exact[1:3]).max() < 2e-11
    assert np.abs(found[3] - exact[3]).max() < 1e-10


@pytest.mark.parametrize("law", [3, 4, 5, 6])
@pytest.mark.parametrize("rtol", [1e-7, 1e-10])
def test_a_looser_tolerance_of_dop853_is_a_larger_error(law: int, rtol: float) -> None:
    exact, _ = played("exact", {"friction.law": law})
    found, _ = played("dop853", {"friction.law": law}, rtol=rtol)
    assert rtol / 10 < np.abs(found[1:3] - exact[1:3]).max() < 100 * rtol


@pytest.mark.parametrize("name", EFFECTS)
@pytest.mark.parametrize("method", ["rk4-henon", "dop853"])
def test_every_section_plays_with_every_method(method: str, name: str) -> None:
    exact, events = played("exact", EFFECTS[name])
    found, others = played(method, EFFECTS[name])
    assert [event.kind for event in others] == [event.kind for event in events]
    tolerance = 2e-6 if method == "rk4-henon" else 1e-8  # scipy finds events on an interpolant of lower order
    assert np.abs(found[1:3] - exact[1:3]).max() < tolerance


@pytest.mark.parametrize("law", [3, 4, 5, 6])
@pytest.mark.parametrize(
    "changes", [{}, {"belt.speed": -0.5, "damper.c": 0.02}, {"drive.u0": 0.1, "drive.omega": 0.7}], ids=str
)
def test_the_thesis_method_converges_with_the_fourth_power_of_its_step(law: int, changes: dict[str, object]) -> None:
    changes = {"friction.law": law, **changes}
    exact, events = played("exact", changes)
    errors = []
    for step in (0.02, 0.005):
        found, others = played("rk4-henon", changes, step=step)
        assert [event.kind for event in others] == [event.kind for event in events]
        late = max(abs(one.t - other.t) for one, other in zip(others, events, strict=True))
        errors.append((late, np.abs(found[1:3] - exact[1:3]).max()))
    for coarse, fine in zip(*errors, strict=True):
        assert 3.5 < math.log(coarse / fine) / math.log(4.0) < 5.0
        assert fine < 1e-7


@pytest.mark.parametrize("ending", [".h5", ".csv"])
def test_the_file_is_the_same_for_all_methods_and_names_its_own(tmp_path: Path, ending: str) -> None:
    shapes = []
    for method in METHODS:
        path = tmp_path / f"{method}{ending}"
        printed = answer(f"run base --until 10 --rate 20 --method {method} -o", path)
        assert (printed["method"], printed["samples"], printed["outcome"]) == (method, 201, "completed")
        if ending == ".csv":
            head, *rows = path.read_text().splitlines()
            shapes.append((head, len(rows)))
            continue
        with h5py.File(path) as file:
            names: list[str] = []
            file.visit(names.append)
            shapes.append((names, {name: file[f"entry/motion/{name}"].shape for name in "txvF"}))
            setting = {"exact": "exact", "rk4-henon": "rk4-henon h 0.01", "dop853": "dop853 rtol 2.3e-14"}[method]
            assert file["entry/simulation/method"].asstr()[()] == setting
    assert shapes[0] == shapes[1] == shapes[2]


@pytest.mark.parametrize("method", ["rk4-henon", "dop853"])
@pytest.mark.parametrize(
    ("changes", "steps", "outcome"),
    [
        ({}, 50, "step limit"),
        ({"friction.law": 3, "friction.G_slip": 1.0, "start.x": 0.9, "start.v": 0.5}, 100_000, "force reversal"),
    ],
)
def test_a_motion_by_any_method_ends_by_name(method: str, changes: dict[str, object], steps: int, outcome: str) -> None:
    ending = scene("base", **changes)
    motion = ScenePlayer(ending, max_steps=steps, phases=choose_phases(method, ending)[0])
    assert not motion.advance(1000.0)
    assert motion.outcome.name == outcome
    assert motion.steps == steps or outcome == "force reversal"
