"""--verbose and --log: they show what a command does, and change nothing of what it does."""

import json
import subprocess
import sys

import pytest

from daq.cli.app import app
from stickslip.console import application, log
from stickslip.errors import EXIT_INPUT, InputError


def record(folder, *flags):
    return application.run(app, ["record", "--duration", "0.5", "-o", str(folder / "run.h5"), "--force", *flags])


def test_a_log_holds_what_was_done_and_stdout_only_the_result(tmp_path, capsys):
    file = tmp_path / "run.log"
    assert record(tmp_path, "--json") == 0
    quiet, none = capsys.readouterr()
    assert record(tmp_path, "--json", "--verbose", f"--log={file}") == 0
    shown, said = capsys.readouterr()
    changes = {"clock_ppm", "clock_ppm_error"}
    assert {k: v for k, v in json.loads(quiet).items() if k not in changes} == {
        k: v for k, v in json.loads(shown).items() if k not in changes
    }
    assert "at 1000 Hz" not in none
    for words in ("rig://rig at 1000 Hz", "ended: complete;", "500 samples", f"wrote {tmp_path / 'run.h5'}"):
        assert words in said
        assert words in file.read_text()
    first = file.read_text()
    assert record(tmp_path, "--log", str(file)) == 0
    assert file.read_text().startswith(first)  # it is added to
    assert file.read_text().count("# log of stickslip") == 1


def test_a_failure_is_in_the_log_with_its_traceback(tmp_path, capsys):
    file = tmp_path / "a.log"
    assert application.run(app, ["recover", str(tmp_path / "none.h5.part"), "--log", str(file)]) == EXIT_INPUT
    assert "Traceback" in file.read_text()
    assert "Traceback" not in capsys.readouterr().err


@pytest.mark.parametrize("typed", [["--log"], ["--log", "--json"], ["--log", "a", "--log=b"]])
def test_a_log_needs_one_file(typed):
    with pytest.raises(InputError) as refused:
        log.take_log_flags(["record", *typed])
    assert "--log" in refused.value.as_line()


def test_what_follows_two_dashes_is_no_flag_of_the_log():
    assert log.take_log_flags(["note", "--", "--verbose"]) == (["note", "--", "--verbose"], log.LogFlags())


@pytest.mark.skipif(sys.platform == "win32", reason="limits of file size are POSIX")
@pytest.mark.parametrize("room", [0, 5, 100])
def test_a_log_that_outgrows_its_disk_is_cut_and_no_more(tmp_path, room):
    # A disk without a byte left ended the command before it began, exit code 3, though a log decides nothing.
    file = tmp_path / "a.log"
    line = [sys.executable, "-m", "daq.cli.app", "list", str(tmp_path), "--log", str(file)]
    limit = "import resource, os, signal, sys; signal.signal(signal.SIGXFSZ, signal.SIG_IGN); "
    limit += f"resource.setrlimit(resource.RLIMIT_FSIZE, ({room}, {room})); os.execv(sys.argv[1], sys.argv[1:])"
    done = subprocess.run([sys.executable, "-c", limit, *line], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, f"no runs in {tmp_path}\n"), done.stderr
    assert file.stat().st_size <= room
    assert ("the log cannot be written" in done.stderr) == (room < len(log.MARK))
