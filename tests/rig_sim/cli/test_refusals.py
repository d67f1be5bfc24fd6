"""What a command cannot do is refused in one line that says where and what to do, with exit code 2 and no file left."""

import json

import pytest

from rig_sim.cli.app import app
from rig_sim.comparison import error_vs_time
from stickslip.console import application

from ..shared import settings

RUN = "run base --until 9 --rate 1 -o a.csv"
RK4, DOP853 = f"{RUN} --method rk4-henon", f"{RUN} --method dop853"
SHAKER = "shaker --m 1 --k 1 --c 0.1 --gamma 0.4"
LOCK = "lock forced --period 1 --budget 0.1"
STIFF = ("step limit: with a coupling of 1e+09 one event takes more than 200000", "use a coupling.a of 2e+06 or less")

REFUSED = [  # command line, where, words of the rest
    ("rule", "command line", "Unknown command"),
    ("maps base", "command line", "Did you mean"),
    ("cycle", "command line", "SCENE requires an argument"),
    # scenes
    ("cycle bass", "scene", "did you mean 'base'"),
    ("cycle base --set friction.Gama=1", "scene base", "did you mean 'gamma'"),
    ("cycle base --set friction", "--set", "write section.key=value"),
    ("cycle base --set friction.law=true", "scene base", "friction.law is True", "it should be 0, 1, 2, 3, 4, 5, 6,"),
    ("cycle base --set belt.ripple_hz=2", "scene base", "belt.ripple_hz requires belt.ripple"),
    ("cycle /dev/full", "/dev/full", "is a folder or a device"),  # it was read for ever
    ("cycle .", ".", "is a folder or a device"),
    ("cycle two-mass", "scene two-mass", "remove the section coupling"),
    ("map base --d 0.1", "scene base", "set coupling.a and coupling.b"),
    ("events two-mass --until 1 --set start.attractor=9", "scene two-mass", "start.attractor is 9"),
    # motions
    ("events rig --until 0", "--until", "use a positive number"),
    ("events rig --until -1", "--until", "use a positive number"),
    ("events rig --until inf", "--until", "not a valid time"),
    ("events rig --until nan", "--until", "not a valid time"),
    ("events rig --until 1 --max-steps 0", "--max-steps", "use a positive number"),
    ("run rig --until 1 --rate 10 -o a.png", "a.png", "choose a name that ends in .h5 or .csv"),
    ("run rig --until 1 --rate 0 -o a.csv", "--rate", "use a positive number"),
    ("run rig --until 1 --rate 10 -o none/a.csv", "none/a.csv", "the folder of this file does not exist"),
    (f"{RUN} --method rk5", "command line", "Choose from"),
    (f"{RUN} --step 0.1", "--step", "exact has no step", "--method=rk4-henon"),
    (f"{RUN} --rtol 0.1", "--rtol", "exact has no tolerance", "--method=dop853"),
    (f"{DOP853} --step 0.1", "--step", "dop853 has no step", "--method=rk4-henon"),
    (f"{DOP853} --rtol 1", "--rtol", "is 1", "use at least 2.3e-14 and less than 1, such as 1e-9"),
    (f"{DOP853} --rtol 1e-16", "--rtol", "is 1e-16", "use at least 2.3e-14 and less than 1, such as 1e-9"),
    (f"{RK4} --step 0", "--step", "use a positive number"),
    (f"{RK4} --step nan", "--step", "not a valid time"),
    (f"{RK4} --step 9", "--step", "so this step is too long"),
    (f"{RK4} --step 100", "--step", "the period of the mass is 6.283", "use 1 (a sixth of the period) or less"),
    ("compare base --until 1e6", "--until", "every method steps through all of them", "2000 periods"),
    ("compare base --until nan", "--until", "not a valid time"),
    ("compare base --until -1", "--until", "use a positive number"),
    ("compare rig --until 0.1", "--until", "no event"),
    # analyses
    ("basins two-mass --cells 1000.5", "command line", "1000.5 is not a whole number"),  # it was read as 1000
    ("sweep base --over belt.speed=0.1:0.2:2", "scene base", "set drive.u0 and drive.omega"),
    ("sweep forced --over drive.omega=1:2:2 --section map", "--section", "is 'map', which applies only to two masses"),
    (
        "sweep two-mass --over belt.speed=0.1:0.2:2 --section slip",
        "--section",
        "is 'slip', which applies only to a driven mass",
    ),
    ("lyapunov forced --set drive.omega=0", "scene forced", "set drive.omega"),
    ("lyapunov forced --events 3", "--events", "give 20 to"),
    ("quench base", "scene base", "set drive.u0 and drive.omega"),
    # at coupling.a = 1e9 each of 41 values took its 2e7 steps, 10 s
    ("basins two-mass --set coupling.a=1e9", "map of two masses", *STIFF),
    ("sweep two-mass --over belt.speed=0.1:0.2:41 --set coupling.a=1e9", "map of two masses", *STIFF),
    *(
        (f"continue damped --over {over}", "--over", said)
        for over, said in (
            ("c=0:1", "not a range of a parameter"),
            ("damper.c", "not a range of a parameter"),
            ("damper.c=1", "not a range of a parameter"),
            ("damper.c=1:1", "use two different finite numbers"),
            ("damper.c=0:nan", "use two different finite numbers"),
            ("damper.c=0:1:1", "use 2 to"),
            ("damper.c=a:b", "contains something that is not a number"),
        )
    ),
    # control
    (f"{SHAKER} --a 1", "command line", "--phi requires an argument"),
    (f"{SHAKER} --a -1 --phi 3", "--a", "use 0 or more"),
    (f"{SHAKER} --a nan --phi 3", "--a", "not a valid damping"),
    (f"{SHAKER} --a 1 --phi inf", "--phi", "not a valid angle"),
    *((f"{SHAKER} --a 1 --phi 3 --band {band}", "--band", "not a frequency band") for band in ("2:1", "1", "-1:2")),
    ("lock base --period 1 --budget 0.1", "scene base", "has no drive that could be controlled"),
    ("lock two-mass --period 1 --budget 0.1", "scene two-mass", "has two masses"),
    (
        "lock rig --set belt.ripple=0.01 --set belt.ripple_hz=1 --period 1 --budget 0.1",
        "scene rig",
        "has no drive that could be controlled",
    ),
    ("lock forced --period 0 --budget 0.1", "--period", "use 1 to 100 landings"),
    ("lock forced --period 101 --budget 0.1", "--period", "use 1 to 100 landings"),
    ("lock forced --period 1 --budget -0.1", "--budget", "use 0 or more"),
    ("lock forced --period 1 --budget nan", "--budget", "use 0 or a size"),
    ("lock forced --period 1 --budget 2", "--budget", "from 0 to 1"),
    (f"{LOCK} --events 0", "--events", "use 1 to"),
    *(
        (f"{LOCK} --set {key}=0", "scene forced", "amplitude could be controlled")
        for key in ("drive.u0", "drive.omega")
    ),
]
MEMORY = ["friction.law=lugre", "friction.s0=15e3", "friction.s1=60", "friction.Fc=0.6", "friction.v_s=0.1"]
NOT_WITH_MEMORY = (
    "floquet rig",
    "compare rig --until 3",
    "continue rig --over friction.Fc=0.5:0.6",
    "sweep rig --over belt.speed=0.1:0.2:2",
    "lyapunov rig",
    "quench rig",
    "lock rig --period 1 --budget 0.1",
    "run rig --until 1 --rate 10 --method dop853 -o x.csv",
)
REFUSED += [
    (" ".join([line, *settings(*MEMORY, "drive.u0=0.1", "drive.omega=2")]), "scene rig", "friction law with memory")
    for line in NOT_WITH_MEMORY
]


@pytest.mark.parametrize(
    ("line", "where", "words"),
    [(line, where, words) for line, where, *words in REFUSED],
    ids=[row[0] for row in REFUSED],
)
def test_a_command_line_is_refused(capsys, tmp_path, monkeypatch, line, where, words):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(error_vs_time, "LONG_ENOUGH_S", 0.0)  # nothing here is about CPU times
    assert application.run(app, [*line.split(), "--json"]) == 2
    printed = capsys.readouterr()
    assert printed.err == ""
    error = json.loads(printed.out)["error"]
    assert (error["where"], sorted(error)) == (where, ["do", "what", "where"])
    assert error["do"]
    for word in words:
        assert word in f"{error['what']}; {error['do']}"
    assert application.run(app, line.split()) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []
