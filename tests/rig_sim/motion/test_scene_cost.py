"""What a scene does not name is neither computed, nor loaded, nor stored."""

import sys
from pathlib import Path
from types import ModuleType

import h5py
import pytest

from stickslip.console import application

BENCHMARKS = Path(__file__).resolve().parents[3] / "benchmarks"


@pytest.fixture(scope="module")
def scene_cost() -> ModuleType:
    sys.path.insert(0, str(BENCHMARKS))
    try:
        import scene_cost as benchmark  # type: ignore[import-not-found]
    finally:
        sys.path.remove(str(BENCHMARKS))
    return benchmark  # type: ignore[no-any-return]


def names_in(path: Path) -> set[str]:
    found: set[str] = set()
    with h5py.File(path) as file:
        file.visit(found.add)
    return found


def test_a_kernel_written_for_each_scene_alone_gives_the_engines_events(scene_cost: ModuleType) -> None:
    assert len(scene_cost.SCENES) >= 10
    for name in scene_cost.SCENES:
        events, apart = scene_cost.Race(name, 60.0, machine=False).difference()
        assert events >= 12, name
        assert apart <= 2e-12, name


def test_a_recording_holds_the_truth_only_where_the_scene_tells_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from daq.cli.app import app

    held = []
    for name, changes in (("plain.h5", []), ("truthful.h5", ["--set", "tell.truth=true"])):
        path = tmp_path / name
        assert application.run(app, ["record", "--duration", "1", "-o", str(path), *changes, "--json"]) == 0
        capsys.readouterr()
        held.append(names_in(path))
    plain, truthful = held
    assert not any("truth" in name for name in plain)
    assert {"entry/truth/x", "entry/truth/v", "entry/truth/F"} <= truthful - plain
    assert plain <= truthful
