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
