"""--verbose and --log: they show what a command does, and change nothing of what it does."""

import json

import pytest

from daq.cli.app import app
from daq.console import application, log
from daq.errors import EXIT_INPUT, InputError


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


def test_a_file_that_is_no_log_is_refused_and_untouched(tmp_path, capsys):
    mine = tmp_path / "mine.txt"
    mine.write_text("mine")
    assert record(tmp_path, "--log", str(mine)) == EXIT_INPUT
    assert "no log of stickslip" in capsys.readouterr().err
    assert mine.read_text() == "mine"
    assert not (tmp_path / "run.h5").exists()


def test_a_failure_is_in_the_log_with_its_traceback(tmp_path, capsys):
    file = tmp_path / "a.log"
    assert application.run(app, ["recover", str(tmp_path / "none.h5.part"), "--log", str(file)]) == EXIT_INPUT
    assert "Traceback" in file.read_text()
    assert "Traceback" not in capsys.readouterr().err


@pytest.mark.parametrize("typed", [["--log"], ["--log", "--json"], ["--log", "a", "--log=b"]])
def test_a_log_needs_one_file(typed):
    with pytest.raises(InputError, match="--log"):
        log.taken_off(["record", *typed])


def test_what_follows_two_dashes_is_no_flag_of_the_log():
    assert log.taken_off(["note", "--", "--verbose"]) == (["note", "--", "--verbose"], log.LogFlags())
