"""Sweeps: how values are shared out, and how an interrupted one is continued, without a change of one bit."""

import signal
import subprocess
import sys
import time
from functools import cache

import pytest

from rig_sim.analyses import section
from rig_sim.cli import app as cli
from rig_sim.scenes.scene import BUILTIN_FOLDER
from stickslip.console import application

from ...shared import answer

FEW = "sweep two-mass --over belt.speed=0.14:0.175:4 --section map"
TWO_MASSES = "sweep two-mass --over belt.speed=0.09:0.12:12"
whole = cache(answer)  # the document of an undisturbed sweep


def test_an_interrupted_sweep_is_continued(capsys, tmp_path, monkeypatch):
    """Used to begin anew: all that was found was lost with the process."""
    path, expected = tmp_path / "sweep.jsonl", whole(FEW)
    find = section.attractors_at
    found = []

    def interrupted(flow_at, section, value):
        if len(found) == 2:
            raise KeyboardInterrupt
        found.append(value)
        return find(flow_at, section, value)

    monkeypatch.setattr(section, "attractors_at", interrupted)
    assert application.run(cli.app, [*FEW.split(), "--resume", str(path)]) == 130
    assert f"2 of 4 values are in {path}" in capsys.readouterr().err
    path.write_bytes(path.read_bytes()[:-1])  # cut in the middle of a line
    again = []
    monkeypatch.setattr(section, "attractors_at", lambda *asked: again.append(asked[-1]) or find(*asked))
    assert answer(FEW, "--resume", path) == expected
    assert len(again) == 3
    assert answer(FEW, "--resume", path) == expected
    assert len(again) == 3
    kept = path.read_bytes()
    for line, named in (
        (FEW.replace("map", "poincare"), "section"),
        (f"{FEW} --set friction.gamma=2.5", "scene.friction.gamma"),
        (FEW.replace("0.175:4", "0.175:5"), "over.number"),
    ):
        assert named in answer(line, "--resume", path, code=2)["error"]["what"]
    assert path.read_bytes() == kept


def test_values_without_an_attractor_are_kept_too(tmp_path):
    line, path = "sweep forced --over drive.omega=0:0.3:2", tmp_path / "sweep.jsonl"
    assert whole(line)["rows"][0]["outcome"] == "no drive period"
    assert [answer(line, "--resume", path) for _ in range(2)] == [whole(line)] * 2


def test_rows_of_something_else_are_refused(tmp_path):
    path = tmp_path / "sweep.jsonl"
    answer(FEW, "--resume", path)
    path.write_bytes(path.read_bytes() + b'{"value": 1.0, "attractors": [{}]}\n')
    assert "not written by a sweep" in answer(FEW, "--resume", path, code=2)["error"]["what"]


def test_a_picture_that_exists_is_refused_before_anything_is_computed(tmp_path, monkeypatch):
    """Used to be refused at the end, and the result of the whole sweep with it."""
    monkeypatch.setattr(section, "attractors_at", None)
    path = tmp_path / "sweep.png"
    path.touch()
    assert "exists" in answer(FEW, "--plot", path, code=2)["error"]["what"]


@pytest.mark.slow
def test_processes_change_no_bit_of_a_sweep(tmp_path):
    """Nor does it matter that they were killed in between."""
    path = tmp_path / "sweep.jsonl"
    command = [sys.executable, "-m", "rig_sim.cli.app", *TWO_MASSES.split(), "--jobs", "2", "--resume", str(path)]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, start_new_session=True) as run:
        while run.poll() is None and not (path.exists() and path.read_bytes().count(b"\n") > 3):
            time.sleep(0.01)
        run.send_signal(signal.SIGKILL)
    assert path.read_bytes().count(b"\n") > 3
    assert answer(TWO_MASSES, "--jobs", "2", "--resume", path) == whole(TWO_MASSES)


@pytest.mark.slow
def test_a_cluster_changes_no_bit_of_a_sweep(tmp_path, monkeypatch, cluster):
    """Workers used to read the scene's file themselves, relative to a folder of their own."""
    (tmp_path / "mine.toml").write_bytes((BUILTIN_FOLDER / "two-mass.toml").read_bytes())
    monkeypatch.chdir(tmp_path)
    assert answer(TWO_MASSES.replace("two-mass", "mine.toml"), "--scheduler", cluster) == whole(TWO_MASSES)
