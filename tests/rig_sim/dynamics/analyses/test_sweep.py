"""Sweeps: how values are shared out, and how an interrupted one is continued, without a change of one bit."""

import signal
import subprocess
import sys
import time
from functools import cache

import pytest

from rig_sim.analyses import section
from rig_sim.analyses import sweep as sweeps
from rig_sim.analyses.sweep import AttractorAt
from rig_sim.cli import app as cli
from rig_sim.scenes.scene import BUILTIN_FOLDER
from stickslip.console import application

from ...shared import answer

FEW = "sweep two-mass --over belt.speed=0.14:0.175:4 --section map"
TWO_MASSES = "sweep two-mass --over belt.speed=0.09:0.12:12"
DRIVEN = "sweep forced --over drive.u0=0:0.4:8 --section slip"
whole = cache(answer)  # the document of an undisturbed sweep


def attractor(value):
    return [AttractorAt(value, 1, (value,), 1, 1.0, (value, value))]


@pytest.mark.parametrize("costs", [[0.001] * 400, [1e-6] * 2 + [0.05] * 40, [2.0] * 5, [5.0] + [0.03] * 60])
def test_tasks_take_a_tenth_of_a_second(monkeypatch, costs):
    """Used to be eight values each: 8 ms of a motion that settles at once, 40 s of one that never sticks."""
    clock = [0.0]
    monkeypatch.setattr(sweeps.time, "perf_counter", lambda: clock[0])

    def find(value):
        clock[0] += costs[int(value)]
        return attractor(value)

    tasks = []

    def spread(function, items):
        for item in items:
            tasks.append([costs[int(value)] for value in item])
            yield function(item)

    values = [float(index) for index in range(len(costs))]
    assert [row.value for row in sweeps.sweep(find, values, spread=spread)] == values
    for task in tasks:
        assert sum(task[:-1]) <= 2 * sweeps.TASK_S
    late = [task for number, task in enumerate(tasks) if number >= 8][:-1]  # 1, 2, 4 ... 128 values
    assert all(sum(task) >= 0.1 for task in late)


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
@pytest.mark.parametrize("line", [TWO_MASSES, DRIVEN], ids=["two-mass", "forced"])
def test_processes_change_no_bit_of_a_sweep(tmp_path, line):
    """Nor does it matter that they were killed in between."""
    path = tmp_path / "sweep.jsonl"
    command = [sys.executable, "-m", "rig_sim.cli.app", *line.split(), "--jobs", "2", "--resume", str(path)]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, start_new_session=True) as run:
        while run.poll() is None and not (path.exists() and path.read_bytes().count(b"\n") > 3):
            time.sleep(0.01)
        run.send_signal(signal.SIGKILL)
    assert path.read_bytes().count(b"\n") > 3
    assert answer(line, "--jobs", "2", "--resume", path) == whole(line)


@pytest.mark.slow
@pytest.mark.parametrize("line", [TWO_MASSES, DRIVEN], ids=["two-mass", "forced"])
def test_a_cluster_changes_no_bit_of_a_sweep(tmp_path, monkeypatch, line, cluster):
    """Workers used to read the scene's file themselves, relative to a folder of their own."""
    (tmp_path / "mine.toml").write_bytes((BUILTIN_FOLDER / f"{line.split()[1]}.toml").read_bytes())
    monkeypatch.chdir(tmp_path)
    assert answer(line.replace(line.split()[1], "mine.toml"), "--scheduler", cluster) == whole(line)


@pytest.mark.slow
def test_a_scheduler_killed_in_the_middle_leaves_the_finished_values(
    capsys, tmp_path, monkeypatch, own_scheduler, worker
):
    process, address = own_scheduler
    worker(address)
    path = tmp_path / "sweep.jsonl"
    plain = application.plain

    def then_kill(row):
        if isinstance(row, dict) and "value" in row:
            process.kill()
            process.wait()
        return plain(row)

    with monkeypatch.context() as patch:
        patch.setattr(application, "plain", then_kill)
        assert application.run(cli.app, [*TWO_MASSES.split(), "--resume", str(path), "--scheduler", address]) == 3
    said = capsys.readouterr().err
    assert "connection to the dask scheduler was lost" in said
    finished = path.read_bytes().count(b"\n") - 1
    assert 0 < finished < 12
    assert f"{finished} of 12 values are in {path}" in said
    assert answer(TWO_MASSES, "--resume", path) == whole(TWO_MASSES)
