"""What a scene does not name is not stored."""

from pathlib import Path

import h5py
import pytest

from stickslip.console import application


def names_in(path: Path) -> set[str]:
    found: set[str] = set()
    with h5py.File(path) as file:
        file.visit(found.add)
    return found


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
