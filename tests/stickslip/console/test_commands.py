"""The command `stickslip`: its words are commands of the four packages."""

import pytest

from daq.cli.app import app as daq
from fitting.cli import app as fit_friction
from processing.cli import app as process
from rig_sim.cli.app import app as rig_sim
from stickslip.console import application
from stickslip.console.commands import COMMANDS, app

FUNCTIONS = {word: daq[word] for word in ("record", "import", "list", "watch", "export", "demo", "doctor")}
FUNCTIONS |= {"smooth": process["smooth"], "fit": fit_friction}


@pytest.mark.parametrize("word", FUNCTIONS)
def test_a_word_is_the_command_of_that_name(word):
    assert app[word].default_command is FUNCTIONS[word].default_command


def test_sim_is_the_simulator_with_its_commands():
    assert app["sim"] is rig_sim


def test_the_help_shows_the_way_of_a_record(capsys):
    assert application.run(app, ["--help"]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    way = [shown.index(f"stickslip {word}") for word in ("record", "import", "smooth", "fit")]
    assert way == sorted(way)
    listed = [shown.index(f"│ {word} ") for word in (*(word for word, _, _ in COMMANDS), "sim")]
    assert listed == sorted(listed)


@pytest.mark.parametrize(
    ("line", "code", "said"),
    [
        (("fit", "none.h5"), 2, "stickslip: none.h5: no such file; check the path"),
        (("sim", "cycle", "nowhere"), 2, "stickslip: scene: no built-in scene 'nowhere'"),
        (("smooth", "--windw", "5"), 2, "see 'stickslip smooth --help'"),
        (("smoth", "run.h5"), 2, "see 'stickslip --help'"),
    ],
)
def test_an_error_names_the_command_that_was_typed(line, code, said, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert application.run(app, line) == code
    assert said in capsys.readouterr().err
