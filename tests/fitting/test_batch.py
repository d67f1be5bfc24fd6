"""`fit-friction --each`: every run by itself, here, in processes, or on a dask scheduler, and what a bad one does."""

import json
import shutil
import signal
import socket
import subprocess
import sys
import time
from contextlib import contextmanager, nullcontext
from functools import cache
from pathlib import Path

import h5py
import pytest

import fitting
from daq.runfile.rig import Rig
from fitting import batch, cli, job
from fitting.options import Options
from fitting.report.comparison import ComparedRun
from stickslip.compute import cluster
from stickslip.console import application
from stickslip.errors import DataError, DeviceError, InputError, StickslipError

from ..conftest import no_other_law
from . import command

pytestmark = pytest.mark.usefixtures("undrawn_reports")

ERRORS = {error.exit_code: error for error in (StickslipError, InputError, DeviceError, DataError)}


@pytest.fixture(scope="module")
def originals(tmp_path_factory, belt_rig):
    """Write a run of law 5, one of law 3, one too short, and a file that is none."""
    folder = tmp_path_factory.mktemp("batch")
    belt_rig.written(folder / "five.h5", belt_rig.recording(law=5, duration=8.0))
    belt_rig.written(folder / "three.h5", belt_rig.recording(law=3, duration=8.0))
    belt_rig.written(folder / "short.h5", belt_rig.recording(law=5, duration=4.0))
    (folder / "none.h5").write_text("no run")
    return folder


@pytest.fixture
def folder(originals, tmp_path):
    return Path(shutil.copytree(originals, tmp_path / "runs"))


def documents(capsys, *arguments):
    """Run the command; return exit code and document."""
    code = application.run(cli.app, [*map(str, arguments), "--json"])
    return code, json.loads(capsys.readouterr().out)


def without_times(document):
    """Leave out what differs from run to run: CPU times, and where files lie."""
    if isinstance(document, dict):
        left_out = ("cpu_s", "file", "report", "where")
        return {key: without_times(item) for key, item in document.items() if key not in left_out}
    if isinstance(document, list):
        return [without_times(item) for item in document]
    return document


@pytest.fixture(scope="module")
def alone(originals, tmp_path_factory):
    """Give a function that returns each run's document from the command for it alone, whether all laws compete or two.

    Other processes let all laws compete.
    """

    @cache
    def of(all_compete=False):
        folder = Path(shutil.copytree(originals, tmp_path_factory.mktemp("alone") / "runs"))
        with nullcontext() if all_compete else no_other_law():
            answers = {name: command.fit(folder / f"{name}.h5", laws="3,5") for name in ("five", "three")}
        return {name: without_times(application.plain(answer.data)) for name, answer in answers.items()}

    return of


@pytest.mark.parametrize("how", [(), pytest.param(("--jobs", "2"), marks=pytest.mark.slow)])
def test_a_batch_says_of_each_run_what_the_command_says_of_it_alone(folder, capsys, alone, how):
    files = [folder / f"{name}.h5" for name in ("five", "none", "three", "short", "missing")]
    with nullcontext() if how else no_other_law():
        code, document = documents(capsys, "--each", *files, "--laws", "3,5", *how)
    five, none, three, short, missing = document["runs"]
    assert [run["file"] for run in document["runs"]] == [str(file) for file in files]
    assert {"five": without_times(five), "three": without_times(three)} == alone(all_compete=bool(how))
    assert "HDF5" in none["error"]["what"]
    assert "complete stick-slip" in short["error"]["what"]
    assert short["statistics"]["slips"] > 0
    assert "no such file" in missing["error"]["what"]
    assert code == 2
    with h5py.File(files[0]) as file:
        assert "fit_law5" in file["entry"]
    assert (folder / "five.report.html").exists()
    assert not (folder / "short.report.html").exists()


@pytest.mark.usefixtures("asked_law_alone")
def test_a_batch_is_a_table_on_the_screen(folder, capsys):
    assert application.run(cli.app, ["--each", str(folder / "five.h5"), str(folder / "none.h5"), "--laws", "3,5"]) == 2
    shown = capsys.readouterr().out
    assert " five.h5     5   law 5 (hyperbolic)" in shown
    assert " none.h5     -   error: is not an HDF5 file" in shown
    compared = folder / "five+1.each.html"
    assert f"2 runs: 1 decided, 0 undecided, 1 failed; comparison: {compared}" in shown
    assert "error: is not an HDF5 file" in compared.read_text()


@pytest.mark.parametrize(
    ("codes", "expected"),
    [((0, 0), 0), ((0, 5), 5), ((6, 0, 5), 6), ((6, 4), 4), ((4, 2), 2), ((2, 3), 3), ((3, 1), 1), ((0, 4, 5), 4)],
)
def test_the_exit_code_of_a_batch(codes, expected):
    rows = [
        ComparedRun(
            Path("x"),
            {
                "set": [5, 6] if code == 5 else [5],
                "adequacy": {"verdict": "none of the six" if code == 6 else "adequate"},
            },
            ERRORS[code]("") if code in ERRORS else None,
        )
        for code in codes
    ]
    assert batch.exit_code(rows) == expected


@pytest.mark.usefixtures("asked_law_alone")
def test_a_bug_or_a_foreign_report_is_that_runs_own_error_and_stops_no_other(folder, capsys, monkeypatch):
    def broken(runs, options):
        if "short" in str(runs[0].recording.source):
            raise ZeroDivisionError("by nothing")
        return done(runs, options)

    done = job.fit_runs
    monkeypatch.setattr(job, "fit_runs", broken)
    (folder / "five.report.html").write_text("mine")
    files = [folder / f"{name}.h5" for name in ("five", "short", "three")]
    code, document = documents(capsys, "--each", *files, "--laws", "3")
    assert "not a report" in document["runs"][0]["error"]["what"]
    assert "ZeroDivisionError" in document["runs"][1]["error"]["what"]
    assert document["runs"][2]["set"] == [3]
    assert code == 1


def is_running(process):
    """Return whether a process is there and has not ended: in a container, none may wait for an orphan."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


@pytest.mark.parametrize(("sent", "code"), [(signal.SIGINT, 130), (signal.SIGKILL, -signal.SIGKILL)])
def test_whatever_ends_the_command_ends_its_processes(folder, sent, code):
    """A killed command used to leave its processes behind, for ever."""
    script = (
        "import sys\nfrom stickslip.compute import workers\nfrom time import sleep\n"
        "from multiprocessing import active_children\n"
        "if __name__ == '__main__':\n"
        "    try:\n"
        "        with workers.workers(2) as each:\n"
        "            found = each(sleep, [0.0, 600.0, 600.0])\n"
        "            next(found)\n"
        "            print(*[child.pid for child in active_children()], flush=True)\n"
        "            next(found)\n"
        "    except KeyboardInterrupt:\n"
        "        sys.exit(130)\n"
    )
    path = folder / "script.py"
    path.write_text(script)
    with subprocess.Popen(
        [sys.executable, str(path)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as run:
        children = [int(word) for word in run.stdout.readline().split()]
        run.send_signal(sent)
        _, said = run.communicate(timeout=600)  # a hang, on however busy a machine
    assert run.returncode == code
    assert children
    assert said == "" or sent == signal.SIGKILL  # Python's own process that then removes semaphores says so
    deadline = time.monotonic() + 600
    while any(map(is_running, children)) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not any(map(is_running, children))


def test_without_dask_the_extra_is_named(folder, monkeypatch):
    monkeypatch.setattr(cluster, "find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"not installed; pip install 'stickslip\[cluster\]'"):
        command.fit(folder / "five.h5", scheduler="tcp://127.0.0.1:8786")


@pytest.mark.usefixtures("dask")
@pytest.mark.parametrize("address", ["nonsense", "foo://1:2", "tcp://host:port", "tcp://:8786"])
def test_what_is_no_address_is_refused(folder, address):
    with pytest.raises(InputError, match="is not an address"):
        command.fit(folder / "five.h5", scheduler=address)


@pytest.mark.usefixtures("dask")
def test_an_address_where_nothing_listens_is_refused_at_once(folder):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
    with pytest.raises(InputError, match="no dask scheduler answers"):
        command.fit(folder / "five.h5", each=True, scheduler=f"127.0.0.1:{port}")


@pytest.mark.slow
def test_a_scheduler_gives_the_same_batch(folder, capsys, cluster, alone):
    files = [folder / "five.h5", folder / "none.h5", folder / "three.h5"]
    code, document = documents(capsys, "--each", *files, "--laws", "3,5", "--scheduler", cluster)
    assert code == 2
    five, none, three = document["runs"]
    assert {"five": without_times(five), "three": without_times(three)} == alone(all_compete=True)
    assert "error" in none


@pytest.mark.slow
def test_a_scheduler_killed_in_the_middle_leaves_the_finished_runs(folder, capsys, own_scheduler, worker, monkeypatch):
    """Used to end in a traceback, without a table, though the first run was fitted and stored."""
    process, address = own_scheduler
    worker(address)
    saved = batch._saved

    def then_kill(*arguments):
        process.kill()
        process.wait()
        return saved(*arguments)

    monkeypatch.setattr(batch, "_saved", then_kill)
    files = [folder / "five.h5", *(Path(shutil.copy(folder / "five.h5", folder / f"{n}.h5")) for n in range(4))]
    table = folder / "all.csv"
    code, document = documents(capsys, "--each", *files, "--laws", "5", "--scheduler", address, "--csv", table)
    assert code == 3
    assert document["runs"][0]["set"] == [5]
    assert "connection to the dask scheduler was lost" in document["runs"][-1]["error"]["what"]
    assert (folder / "five.report.html").exists()
    assert str(folder / "five.h5") in table.read_text()


@pytest.mark.slow
def test_workers_that_cannot_import_the_fit_are_named(folder, capsys, own_scheduler, worker, tmp_path):
    """Used to end in a traceback: another distribution's package `fitting` hides ours there."""
    (tmp_path / "other" / "fitting").mkdir(parents=True)
    (tmp_path / "other" / "fitting" / "__init__.py").touch()
    worker(own_scheduler[1], str(tmp_path / "other"))
    code, document = documents(capsys, "--each", folder / "five.h5", "--laws", "5", "--scheduler", own_scheduler[1])
    assert code == 2
    assert "cannot load the work: ModuleNotFoundError: No module named 'fitting." in document["error"]["what"]


def test_processes_lost_in_the_middle_leave_the_finished_runs(folder, monkeypatch):
    @contextmanager
    def breaking(*_):
        def each(function, items):
            yield function(next(items))
            raise DeviceError("a fitting process was killed", "--jobs", "use fewer")

        yield each

    monkeypatch.setattr(batch, "workers", breaking)
    monkeypatch.setattr(batch, "_fitted", lambda run, options, draw: DataError("fitted"))
    rows = batch.fit([folder / "five.h5", folder / "three.h5"], [Path("a"), Path("b")], Options())
    assert [row.failure.what for row in rows] == ["fitted", "a fitting process was killed"]


@pytest.mark.usefixtures("asked_law_alone")
def test_rank_each_gives_of_each_run_what_rank_gives_of_it_alone(folder, alone):
    files = [folder / f"{name}.h5" for name in ("five", "none", "short", "missing")]
    counted = []
    ranked = fitting.rank_each(map(str, files), laws=(3, 5), progress=counted.append)
    five, none, short, missing = ranked
    assert [run.file for run in ranked] == files
    document = application.plain(five.ranking.as_json())
    assert without_times(document)["ranking"] == alone()["five"]["ranking"]
    assert [run.ranking for run in (none, short, missing)] == [None] * 3
    assert [type(run.error).__name__ for run in (none, short, missing)] == ["InputError", "DataError", "InputError"]
    assert str(missing.error) == f"{files[3]}: no such file; check the path"
    assert short.error.data["statistics"]["slips"] > 0
    assert counted == [1, 2, 3, 4]
    assert not list(folder.glob("*.html"))
    table = ranked.to_dataframe()
    assert list(table.file) == list(map(str, files))
    assert table.law[0] == 5
    assert table.gamma[0] == five.ranking.best.parameters["gamma"].value
    assert table.attrs["units"]["gamma"] == "s/m"
    assert list(table.error.isna()) == [True, False, False, False]
    assert table.error[3] == str(missing.error)


@pytest.mark.parametrize(
    ("runs", "keywords", "said"),
    [
        ("run.h5", {}, "one run; pass a list of runs"),
        ([], {}, "no run; pass files"),
        ([1.0], {}, "some of the arguments are not runs; pass files"),
        (["run.h5"], {"jobs": 0}, "jobs is 0; it must be 1 or more"),
        (["run.h5"], {"mass": 1.0, "stiffness": 1.0}, "mass and stiffness cannot be combined"),
        (["run.h5"], {"laws": 9}, "9"),
        (["run.h5"], {"rig": [Rig()] * 2}, "2 rigs for 1 runs"),
    ],
)
def test_what_rank_each_cannot_do_for_any_run_is_refused(runs, keywords, said):
    with pytest.raises(InputError, match=said):
        fitting.rank_each(runs, **keywords)
