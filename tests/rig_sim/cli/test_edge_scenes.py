"""Every analysis of scenes at the edge of what they are made for ends soon, by name, and prints no nan."""

import re
import time

import pytest

from rig_sim.cli import app as cli
from stickslip.console import application

PAIRS = {
    "a Coulomb pair that never sticks again": {"friction.law": 1, "belt.speed": 0.33, "friction.static": 1.13},
    "no friction on the second mass": {"coupling.b": 0, "belt.speed": 0.3},
    "a second mass that never slips": {"coupling.b": 50},
    "no coupling": {"coupling.a": 0},
    "a rigid coupling": {"coupling.a": 1000, "belt.speed": 0.05},
    "masses that come to rest": {"damper.c": 1.92, "belt.speed": 1.07},  # a sweep took 11 s for each value
    "next to no friction in slip": {"friction.gamma": 1e5},
    "a slow belt": {"belt.speed": 1e-8},
}
PAIR_COMMANDS = [
    "map two-mass --d 0.00001 --iterate 3",
    "map two-mass --periodic --iterate 2",
    "sweep two-mass --over friction.Fs=0.9:1.1:2",
    "basins two-mass --cells 60",
    "continue two-mass --over friction.Fs=0.9:1.1:2",
    "fixed-point two-mass",
    "events two-mass --until 20",
]
DRIVEN = {
    "Coulomb friction": {"friction.law": 1},
    "micro-slips": {"belt.speed": 0.001, "drive.u0": 0.4, "drive.omega": 9},
    "no friction": {"friction.Fs": 0},
    "a steep ramp": {"friction.law": 6, "friction.G_stick": -1e7},
    "a belt at rest": {"belt.speed": 0},
}
DRIVEN_COMMANDS = [
    "sweep forced --over drive.u0=0.1:0.2:2",
    "lyapunov forced --events 200",
    "quench forced",
    "lock forced --period 1 --budget 0.02 --events 500",
]


@pytest.mark.slow
@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("scenes", "commands"), [(PAIRS, PAIR_COMMANDS), (DRIVEN, DRIVEN_COMMANDS)], ids=["two masses", "driven"]
)
def test_every_analysis_ends_by_name(capsys, scenes, commands):
    for scene, changes in scenes.items():
        settings = [word for key, value in changes.items() for word in ("--set", f"{key}={value}")]
        for command in commands:
            begun = time.process_time()
            code = application.run(cli.app, [*command.split(), *settings])
            spent = time.process_time() - begun
            shown = capsys.readouterr()
            assert code in (0, 2), (scene, command, shown.err)
            assert not re.search(r"\b(nan|inf)\b|Traceback|Warning", shown.out + shown.err), (scene, command, shown.out)
            assert spent < 60.0, (scene, command)
