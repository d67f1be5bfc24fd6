"""Bad input: one line that names what, where and what to do, the right exit code, and nothing overwritten."""

import contextlib
import importlib
import io
import json
import shlex
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import h5py
import numpy as np
import pytest

from stickslip.console import application

COMMANDS = {
    "daq": "daq.cli.app",
    "process": "processing.cli",
    "fit-friction": "fitting.cli",
    "rig-sim": "rig_sim.cli.app",
}


class Ended(NamedTuple):
    """How a command ended and what it printed."""

    returncode: int
    stdout: str
    stderr: str


def run(command: str, *arguments: object, cwd: Path) -> Ended:
    """Run a command in a folder, within this process: a process of its own would load numpy 90 times."""
    app = importlib.import_module(COMMANDS[command]).app
    with (
        contextlib.chdir(cwd),
        contextlib.redirect_stdout(io.StringIO()) as out,
        contextlib.redirect_stderr(io.StringIO()) as err,
    ):
        code = application.run(app, [str(argument) for argument in arguments])
    return Ended(code, out.getvalue(), err.getvalue())


def assert_refused(folder: Path, code: int, names: list[str], command: str, *arguments: object) -> None:
    """Assert the exit code, one line on stderr that names each of ``names``, and the same facts under --json."""
    done = run(command, *arguments, cwd=folder)
    assert done.returncode == code, done.stderr
    assert done.stdout == ""
    lines = done.stderr.strip().splitlines()
    assert len(lines) == 1, done.stderr
    for name in names:
        assert name in lines[0], done.stderr
    as_json = run(command, *arguments, "--json", cwd=folder)
    assert as_json.returncode == code
    error = json.loads(as_json.stdout)["error"]
    assert set(error) == {"what", "where", "do"}
    assert error["what"]
    assert error["where"]
    assert error["do"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("run")
    done = run("daq", "record", "--duration", "6", "-o", "run.h5", cwd=folder)
    assert done.returncode == 0, done.stderr
    return folder


def changed_schema(folder: Path, name: str, version: int) -> str:
    """Write a copy of the run whose schema number is ``version``."""
    (folder / name).write_bytes((folder / "run.h5").read_bytes())
    with h5py.File(folder / name, "r+") as file:
        file.attrs["stickslip_schema"] = np.int64(version)
    return name


def test_an_odd_scene_key_names_its_neighbour(folder):
    assert_refused(folder, 2, ["friction.gama", "gamma"], "rig-sim", "cycle", "base", "--set", "friction.gama=3")


def test_an_odd_scene_section_names_its_neighbour(folder):
    assert_refused(folder, 2, ["belts", "belt"], "rig-sim", "cycle", "base", "--set", "belts.speed=3")


def test_an_odd_scene_key_is_refused_while_recording_and_leaves_no_file(folder):
    assert_refused(folder, 2, ["belt.sped", "speed"], "daq", "record", "-o", "odd.h5", "--set", "belt.sped=1")
    assert not list(folder.glob("odd*"))


def test_a_scene_file_with_a_text_number_names_file_and_key(folder):
    (folder / "bad.toml").write_text('[mass]\nm = "heavy"\n[spring]\nk = 1\n')
    assert_refused(folder, 2, ["bad.toml", "mass.m"], "rig-sim", "cycle", "bad.toml")


def test_an_unknown_scene_lists_the_known_ones(folder):
    assert_refused(folder, 2, ["basic", "base"], "rig-sim", "cycle", "basic")


@pytest.mark.parametrize("value", ["nan", "inf", "-1", "0"])
def test_an_impossible_mass_is_refused_by_key(folder, value):
    assert_refused(folder, 2, ["mass.m"], "rig-sim", "cycle", "base", "--set", f"mass.m={value}")


def test_an_existing_output_file_is_left_alone(folder):
    before = (folder / "run.h5").read_bytes()
    assert_refused(folder, 2, ["run.h5", "--force"], "daq", "record", "-o", "run.h5")
    assert (folder / "run.h5").read_bytes() == before


def test_a_missing_port_is_a_device_error(folder):
    assert_refused(folder, 3, ["/dev/ttyNONE"], "daq", "record", "-o", "x.h5", "--port", "/dev/ttyNONE")
    assert not (folder / "x.h5").exists()


@pytest.mark.parametrize(
    ("arguments", "names"),
    [
        (("--protocol", "qsb", "--rate", "1000"), ["1000 Hz", "512"]),
        (("--protocol", "text", "--columns", "t_us,cuont"), ["cuont", "count"]),
        (("--protocol", "qbs"), ["qbs", "qsb"]),
        (("--rig", "none.toml"), ["none.toml"]),
    ],
)
def test_what_a_protocol_cannot_do_is_refused_before_the_port_is_opened(folder, arguments, names):
    assert_refused(folder, 2, names, "daq", "record", "-o", "x.h5", "--port", "/dev/ttyNONE", *arguments)
    assert not (folder / "x.h5").exists()


@pytest.mark.parametrize("command", [("process", "smooth"), ("process", "inspect"), ("fit-friction",)])
def test_a_foreign_hdf5_file_is_refused(folder, command):
    with h5py.File(folder / "foreign.h5", "w") as file:
        file["x"] = [1.0, 2.0]
    assert_refused(folder, 2, ["foreign.h5"], *command, "foreign.h5")


@pytest.mark.parametrize("command", [("process", "smooth"), ("fit-friction",)])
@pytest.mark.parametrize("version", [0, 999])
def test_an_older_or_newer_schema_is_refused(folder, command, version):
    name = changed_schema(folder, f"schema{version}.h5", version)
    assert_refused(folder, 2, [name, str(version)], *command, name)


@pytest.mark.parametrize("command", [("process", "smooth"), ("fit-friction",), ("daq", "recover")])
def test_a_missing_file_is_refused(folder, command):
    assert_refused(folder, 2, ["none.h5"], *command, "none.h5")


def test_a_truncated_run_file_is_refused(folder):
    (folder / "cut.h5").write_bytes((folder / "run.h5").read_bytes()[:3000])
    assert_refused(folder, 2, ["cut.h5"], "process", "smooth", "cut.h5")


def test_text_in_a_number_column_is_named_by_line(folder):
    (folder / "text.csv").write_text("t,x\n0.0,0.1\n0.1,oops\n0.2,0.3\n")
    assert_refused(folder, 2, ["text.csv", "line 3", "oops"], "daq", "import", "text.csv", "-o", "text.h5")
    assert not (folder / "text.h5").exists()


def test_an_unknown_flag_names_its_neighbour(folder):
    assert_refused(folder, 2, ["--rat", "--rate"], "daq", "record", "--rat", "5")


def test_a_journal_cut_short_gives_what_it_holds_and_one_without_a_header_is_refused(folder):
    (folder / "junk.h5.part").write_bytes(b"not a journal")
    assert_refused(folder, 2, ["junk.h5.part"], "daq", "recover", "junk.h5.part")
    assert (folder / "junk.h5.part").read_bytes() == b"not a journal"


@pytest.mark.parametrize(
    ("command", "arguments"),
    [
        ("process", ("export", "run.h5", "--csv", "run.h5", "--force")),
        ("process", ("inspect", "run.h5", "--plot", "run.h5", "--force")),
        ("daq", ("export", "run", "--csv", "run", "--force")),
        ("daq", ("replay", "run.h5", "-o", "run.h5", "--force")),
    ],
)
def test_no_output_replaces_its_own_source_even_by_force(folder, command, arguments):
    (folder / "run").write_bytes((folder / "run.h5").read_bytes())  # no suffix names another format
    source = folder / arguments[1]
    before = source.read_bytes()
    assert_refused(folder, 2, [source.name, "own source"], command, *arguments)
    assert source.read_bytes() == before


def test_an_import_does_not_replace_its_table(folder):
    (folder / "table").write_text("t,x\n0.0,0.1\n0.1,0.2\n0.2,0.3\n")
    assert_refused(folder, 2, ["table", "own source"], "daq", "import", "table", "-o", "table", "--force")
    assert (folder / "table").read_text().startswith("t,x")


def test_an_impossible_position_is_refused_by_line(folder):
    (folder / "far.csv").write_text("t,x\n0.0,0.1\n0.1,1e30\n0.2,0.3\n")
    assert_refused(folder, 2, ["far.csv", "line 3", "1e+30"], "daq", "import", "far.csv", "-o", "far.h5")


def test_two_columns_of_one_name_are_asked_about(folder):
    (folder / "two.csv").write_text("t,x,x\n0.0,0.1,1\n0.1,0.2,2\n0.2,0.3,3\n")
    assert_refused(folder, 2, ["two.csv", "column 2", "column 3", "--position"], "daq", "import", "two.csv")


def test_a_file_of_ten_thousand_billion_samples_is_refused_at_once(folder):
    line = ("run", "base", "--until", "10", "--rate", "1e12", "-o", "foo.csv")
    assert_refused(folder, 2, ["1e+13 samples", "--rate"], "rig-sim", *line)


@pytest.mark.parametrize("duration", ["1e12", "inf", "nan", "0.0001", "-1"])
def test_an_impossible_duration_is_refused_with_its_number_of_samples(folder, duration):
    what = "not a valid time" if duration in ("inf", "nan") else "samples"
    assert_refused(folder, 2, ["--duration", what], "daq", "record", "-o", "x.h5", "--duration", duration)


def test_a_broken_number_of_samples_per_second_is_not_rounded(folder):
    assert_refused(folder, 2, ["1000.5"], "daq", "record", "-o", "x.h5", "--rate", "1000.5")


def test_a_section_given_as_a_number_is_told_how_to_write(folder):
    assert_refused(folder, 2, ["friction", "friction.KEY"], "rig-sim", "cycle", "base", "--set", "friction=3")


def test_a_full_stdout_is_one_line_and_no_traceback(folder):
    if not Path("/dev/full").exists():
        pytest.skip("this system has no /dev/full")
    with Path("/dev/full").open("w") as full:
        line = [Path(sys.executable).parent / "rig-sim", "scenes"]
        done = subprocess.run(line, stdout=full, stderr=subprocess.PIPE, text=True, check=False, cwd=folder)
    assert done.returncode == 3
    assert "Traceback" not in done.stderr
    assert "space" in done.stderr


def test_a_belt_speed_that_no_plateau_has_is_warned_about(folder):
    (folder / "belt.h5").write_bytes((folder / "run.h5").read_bytes())
    done = run("process", "smooth", "belt.h5", "--belt-speed", "-0.22", "--json", cwd=folder)
    assert any("0.22" in warning and "sign" in warning for warning in json.loads(done.stdout)["warnings"])


def test_counters_that_may_have_rolled_over_are_warned_about(folder):
    changes = ["--set", "encoder.vibration=1e-3", "--set", "encoder.vibration_hz=2e5"]
    done = run("daq", "record", "--duration", "0.05", "-o", "fast.h5", "--json", *changes, cwd=folder)
    assert any("rolled over" in warning for warning in json.loads(done.stdout)["warnings"])


MISTAKES = [
    ("process smoth run.h5", ["smoth", "Did you mean", "smooth"]),
    ("process run.h5", ["'run.h5' is a file", "did you mean 'process smooth run.h5'"]),
    ("process --method rts run.h5", ["did you mean 'process smooth --method rts run.h5'"]),
    ("process table.csv", ["'table.csv' is a file", "did you mean 'daq import table.csv'"]),
    ("daq run.h5.part", ["did you mean 'daq recover run.h5.part'"]),
    ("rig-sim run.h5", ["did you mean 'process smooth run.h5'"]),
    ("process smooth", ["FILE", "process smooth --help"]),
    ("process smooth folder", ["folder", "give the run file in it"]),
    ("process smooth table.csv", ["table.csv", "daq import"]),
    ("process smooth run.h5 --window 0.02", ["--window", "0.02", "20ms"]),
    ("process smooth run.h5 --belt-speed fast", ["--belt-speed", "fast", "22 cm/s"]),
    ("process smooth run.h5 --from 5 --to 2", ["from 5 to 2 s", "the run lasts", "--from and --to"]),
    ("process export run.h5", ["nothing to write", "--csv FILE"]),
    ("process export run.h5 --csv out.xlsx", ["out.xlsx", "spreadsheet", "out.csv"]),
    ("process inspect run.h5 --plot out.bmp", ["out.bmp", ".png"]),
    ("process inspect run.h5 more.h5", ["nothing takes 'more.h5'", "process inspect --help"]),
    ("fit-friction", ["FILE", "fit-friction --help"]),
    ("fit-friction table.csv", ["table.csv", "daq import"]),
    ("fit-friction run.h5 --laws 7", ["--laws", "unknown law 7", "1 to 6"]),
    ("fit-friction run.h5 --law stribek", ["--law", "stribek", "did you mean 'stribeck'"]),
    ("fit-friction run.h5 --mass '0.3 N'", ["--mass", "'N' is not a unit of mass", "kg"]),
    ("fit-friction run.h5 --mass -1kg", ["--mass", "-1", "positive"]),
    ("fit-friction run.h5 --mass 1kg --stiffness 2N/m", ["--mass and --stiffness together", "give one"]),
    ("fit-friction run.h5 --x0 '5 kg'", ["--x0", "'kg' is not a unit of length"]),
    ("fit-friction run.h5 --datum 1mm --x0 1mm", ["--x0 and --datum together", "give --x0 alone"]),
    ("fit-friction run.h5 --alpha 5", ["--alpha", "5", "such as 0.05"]),
    ("fit-friction none.h5 --alpha 5", ["--alpha", "such as 0.05"]),  # the file was read and smoothed first
    ("fit-friction run.h5 --fix gamma", ["--fix", "NAME=VALUE", "gamma=9.6"]),
    ("fit-friction run.h5 --bound gamma=5:1", ["--bound", "gamma", "lower one first"]),
    ("fit-friction run.h5 run.h5", ["named twice", "once"]),
    ("fit-friction run.h5 --report none/out.html", ["none/out.html", "folder does not exist"]),
    ("fit-friction run.h5 --jobs 0", ["--jobs", "0", "1 or more"]),
    ("rig-sim cycles base", ["cycles", "Did you mean", "cycle"]),
    ("rig-sim cycle none.toml", ["none.toml", "no such file", "base"]),
    ("rig-sim cycle run.h5", ["run.h5", "no text file", "--save-scene"]),
    ("rig-sim cycle base --set friction.law=9", ["friction.law is 9", "1, 2, 3"]),
    ("rig-sim events base", ["--until", "rig-sim events --help"]),
    ("rig-sim events base --until -5", ["--until", "-5", "positive"]),
    ("rig-sim run base --until 10 --rate 100 --method euler -o out.csv", ["euler", "exact"]),
    ("rig-sim sweep forced --over drive.omega", ["--over", "START:STOP:N"]),
    ("rig-sim sweep forced --over drive.omga=1:2:3", ["drive.omga", "did you mean 'omega'"]),
    ("rig-sim continue base --over belt.speed=0.2:0.2", ["--over", "two different"]),
    ("rig-sim map base --d 1", ["has one mass", "two-mass"]),
    ("rig-sim lyapunov base --events 100", ["has no drive", "drive.u0"]),
    ("rig-sim lock forced --period 2 --budget 10", ["--budget", "10", "from 0 to 1"]),
    ("rig-sim atlas nofigure -o out", ["nofigure", "known"]),
]


@pytest.mark.parametrize(("line", "names"), MISTAKES, ids=[line for line, _ in MISTAKES])
def test_a_mistake_at_the_terminal_is_one_line_that_says_what_to_do(folder, line, names):
    (folder / "folder").mkdir(exist_ok=True)
    (folder / "table.csv").write_text("t,x\n0,1\n1,2\n")
    before = sorted(folder.iterdir()), (folder / "run.h5").read_bytes()
    assert_refused(folder, 2, names, *shlex.split(line))
    assert before == (sorted(folder.iterdir()), (folder / "run.h5").read_bytes())
