"""Bad input: one line that names what, where and what to do, the right exit code, and no file made or changed."""

import contextlib
import importlib
import io
import json
import shlex
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest

from daq.runfile import journal
from stickslip.console import application

SAMPLE = Path(__file__).resolve().parent.parent / "data_samples" / "law5.h5"
COMMANDS = {
    "daq": "daq.cli.app",
    "process": "processing.cli",
    "fit-friction": "fitting.cli",
    "rig-sim": "rig_sim.cli.app",
    "stickslip": "stickslip.console.commands",
}
TEXTS = {
    "bad.toml": '[mass]\nm = "heavy"\n[spring]\nk = 1\n',
    "far.csv": "t,x\n0.0,0.1\n0.1,1e30\n0.2,0.3\n",
    "junk.h5.part": "not a journal",
    "notes.txt": "hello",
    "rig.toml": "mine",
    "text.csv": "t,x\n0.0,0.1\n0.1,oops\n0.2,0.3\n",
    "two.csv": "t,x,x\n0.0,0.1,1\n0.1,0.2,2\n0.2,0.3,3\n",
}


def run(typed, folder):
    """Run a command as typed, in this process; return its exit code and what it printed."""
    command, *arguments = shlex.split(typed)
    app = importlib.import_module(COMMANDS[command]).app
    with (
        contextlib.chdir(folder),
        contextlib.redirect_stdout(io.StringIO()) as out,
        contextlib.redirect_stderr(io.StringIO()) as err,
    ):
        code = application.run(app, arguments)
    return code, out.getvalue(), err.getvalue()


@pytest.fixture(scope="module")
def folder(tmp_path_factory, write_capture):
    """Give a folder with inputs of every kind, sound and not."""
    folder = tmp_path_factory.mktemp("inputs")
    run, time = SAMPLE.read_bytes(), np.arange(1000) / 500
    for name in ("run.h5", "run", "schema0.h5", "schema999.h5"):  # no suffix names another format than .h5
        (folder / name).write_bytes(run)
    for version in (0, 999):
        with h5py.File(folder / f"schema{version}.h5", "r+") as file:
            file.attrs["stickslip_schema"] = np.int64(version)
    with h5py.File(folder / "foreign.h5", "w") as file:
        file["x"] = [1.0, 2.0]
    (folder / "cut.h5").write_bytes(run[:3000])
    (folder / "folder").mkdir()
    for name, text in TEXTS.items():
        (folder / name).write_text(text)
    for name, header, size in (
        ("table.csv", "t,x", 0.01),
        ("table", "t,x", 0.01),
        ("force.csv", "t (s),F (N)", 0.01),
        ("pixels.csv", "t (s),x", 100.0),
    ):
        rows = np.c_[time, size * np.sin(6 * time)]
        np.savetxt(folder / name, rows, delimiter=",", header=header, comments="")
    write_capture(folder / "pair.sr", [0, 1, 3, 2] * 50, {0: "A", 1: "B"}, rate="10 kHz")
    write_capture(folder / "rateless.sr", [0, 1], {0: "A", 1: "B"}, rate=None)
    header = {"protocol": "frames", "port": "fake", "rate_hz": 1000.0, "samples": None, "title": "", "operator": ""}
    header |= {"wall_ns": 0, "monotonic_ns": 0, "utc_offset_s": 0, "warnings": [], "provenance": {"port": "fake"}}
    journal.Writer(folder / "board.h5.part", header).close()
    return folder


@pytest.fixture(autouse=True)
def alone(monkeypatch, tmp_path):
    """Keep the tester's own settings out, and measure no CPU times: nothing here is about them."""
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    monkeypatch.setattr("rig_sim.comparison.error_vs_time.LONG_ENOUGH_S", 0.0)


def contents(folder):
    return {path.name: path.is_file() and path.read_bytes() for path in folder.iterdir()}


RECORD = "daq record -o new.h5 --port /dev/ttyNONE"  # what can be known before the port is opened is said before it
REPLAY = "daq replay -o new.h5"
PAIR = "pair.sr --channels A=A,B=B"
NOWHERE = (3, "/dev/ttyNO")

RUN = "run base --until 9 --rate 1 -o a.csv"
RK4, DOP853 = f"{RUN} --method rk4-henon", f"{RUN} --method dop853"
SHAKER = "shaker --m 1 --k 1 --c 0.1 --gamma 0.4"
STIFF = (
    "map of two masses",
    "with a coupling of 1e+09 one event takes more than 200000",
    "use a coupling.a of 2e+06 or",
)
MEMORY = (
    "--set friction.law=lugre --set friction.s0=15e3 --set friction.s1=60 --set friction.Fc=0.6 --set friction.v_s=0.1 "
    "--set drive.u0=0.1 --set drive.omega=2"
)
RIG_SIM = [
    ("rule", "Unknown command"),
    ("cycles base", "cycles", "Did you mean", "cycle"),
    ("cycle", "SCENE requires an argument", "as in 'rig-sim cycle base"),
    ("run.h5", "did you mean 'process smooth run.h5'"),
    # scenes
    ("cycle base --set friction.Gama=1", "scene base", "did you mean 'gamma'"),
    ("cycle base --set friction=3", "friction", "friction.KEY"),
    ("cycle base --set friction.law=true", "scene base", "friction.law is True", "it should be 0, 1, 2, 3, 4, 5, 6,"),
    (
        "cycle base --set belt.ripple_hz=2",
        "scene base",
        "belt.ripple_hz requires belt.ripple",
        "set the amplitude of the ripple, or remove ripple_hz",
    ),
    ("cycle bad.toml", "bad.toml", "mass.m"),
    ("cycle basic", "basic", "did you mean 'base'"),
    ("cycle none.toml", "none.toml", "no such file", "base"),
    ("cycle run.h5", "run.h5", "not a text file", "--save-scene"),
    ("cycle /dev/full", "/dev/full", "is a folder or a device"),  # it was read for ever
    ("cycle two-mass", "scene two-mass", "remove the section coupling"),
    ("map base --d 0.1", "scene base", "has one mass", "set coupling.a and coupling.b"),
    ("events two-mass --until 1 --set start.attractor=9", "scene two-mass", "start.attractor is 9"),
    # motions
    ("events base", "--until", "rig-sim events --help"),
    ("events rig --until -1", "--until", "use a positive number"),
    ("events rig --until nan", "--until", "not a valid time"),
    ("events rig --until 1 --max-steps 0", "--max-steps", "use a positive number"),
    ("run rig --until 1 --rate 10 -o table.csv", "table.csv", "the output file exists", "--force"),
    (
        "run rig --until 1 --rate 10 -o a.png",
        "a.png",
        ".png is the suffix of a picture",
        "choose a name that ends in .h5 or .csv",
    ),
    ("run base --until 10 --rate 1e12 -o foo.csv", "1e+13 samples", "--rate"),
    (f"{RUN} --method rk5", "rk5", "Choose from", "exact"),
    (f"{RUN} --step 0.1", "--step", "exact has no step", "--method=rk4-henon"),
    (f"{RUN} --rtol 0.1", "--rtol", "exact has no tolerance", "--method=dop853"),
    (f"{DOP853} --rtol 1", "--rtol", "is 1", "use at least 2.3e-14 and less than 1, such as 1e-9"),
    (f"{RK4} --step 0", "--step", "use a positive number"),
    (f"{RK4} --step 9", "--step", "the period of the mass is 6.283", "this step is too long"),
    ("compare base --until 1e6", "--until", "every method steps through all of them", "2000 periods"),
    ("compare rig --until 0.1", "--until", "no event"),
    # analyses
    ("basins two-mass --cells 1000.5", "1000.5 is not a whole number"),  # it was read as 1000
    ("sweep base --over belt.speed=0.1:0.2:2", "scene base", "set drive.u0 and drive.omega"),
    ("sweep forced --over drive.omega", "--over", "START:STOP:N"),
    ("sweep forced --over drive.omga=1:2:3", "drive.omga", "did you mean 'omega'"),
    (
        "sweep forced --over drive.omega=1:2:2 --section map",
        "--section",
        "is 'map', which applies only to two masses",
        "use 'poincare' or 'slip'",
    ),
    (
        "sweep two-mass --over belt.speed=0.1:0.2:2 --section slip",
        "--section",
        "is 'slip', which applies only to a driven mass",
        "use 'poincare' or 'map'",
    ),
    ("sweep two-mass", "--over requires an argument; as in 'rig-sim sweep two-mass --over"),
    ("lyapunov forced --set drive.omega=0", "scene forced", "set drive.omega"),
    ("lyapunov forced --events 3", "--events", "is 3; use 20 to"),
    ("lyapunov base --events 100", "has no drive", "drive.u0"),
    ("quench base", "scene base", "set drive.u0 and drive.omega"),
    # at coupling.a = 1e9 each of 41 values took its 2e7 steps, 10 s
    ("basins two-mass --set coupling.a=1e9", *STIFF),
    ("sweep two-mass --over belt.speed=0.1:0.2:41 --set coupling.a=1e9", *STIFF),
    *(
        (f"continue damped --over {over}", "--over", said)
        for over, said in (
            ("damper.c", "not a range of a parameter"),
            ("damper.c=1:1", "is not an interval; use two different finite numbers"),
            ("damper.c=0:1:1", "1 values; use 2 to"),
            ("damper.c=a:b", "contains something that is not a number"),
        )
    ),
    ("continue damped --over damper.c=0.3:0.6 --plot c.png", "--plot; "),  # "Unknown option: --plot.;"
    # control
    (f"{SHAKER} --a 1", "--phi requires an argument"),
    (f"{SHAKER} --a -1 --phi 3", "--a", "is -1; use 0 or more"),
    (f"{SHAKER} --a nan --phi 3", "--a", "not a valid damping"),
    (f"{SHAKER} --a 1 --phi inf", "--phi", "not a valid angle"),
    *((f"{SHAKER} --a 1 --phi 3 --band {band}", "--band", "not a frequency band", "in rad/s") for band in ("2:1", "1")),
    (
        "lock base --period 1 --budget 0.1",
        "scene base",
        "has no drive that could be controlled",
        "set drive.u0 and drive.omega",
    ),
    ("lock two-mass --period 1 --budget 0.1", "scene two-mass", "has two masses"),
    ("lock forced --period 0 --budget 0.1", "--period", "use 1 to 100 landings"),
    ("lock forced --period 1 --budget -0.1", "--budget", "is -0.1; use 0 or more"),
    ("lock forced --period 1 --budget 2", "--budget", "from 0 to 1"),
    ("lock forced --period 1 --budget 0.1 --events 0", "--events", "is 0; use 1 to"),
    ("lock forced --period 1 --budget 0.1 --set drive.u0=0", "scene forced", "amplitude could be controlled"),
    ("atlas nofigure -o out", "nofigure", "known"),
    *(
        (f"{line} {MEMORY}", "scene rig", "friction law with memory")
        for line in (
            "floquet rig",
            "compare rig --until 3",
            "continue rig --over friction.Fc=0.5:0.6",
            "sweep rig --over belt.speed=0.1:0.2:2",
            "lyapunov rig",
            "quench rig",
            "lock rig --period 1 --budget 0.1",
            "run rig --until 1 --rate 10 --method dop853 -o x.csv",
        )
    ),
]

# A line as typed, its exit code where it is not 2, and words of the one line on stderr.
REFUSED = [
    *((f"rig-sim {line}", *words) for line, *words in RIG_SIM),
    # stickslip: an error names the command that was typed.
    ("stickslip fit none.h5", "stickslip: none.h5: no such file; check the path"),
    ("stickslip sim cycle nowhere", "stickslip: scene: there is no built-in scene 'nowhere'"),
    ("stickslip smooth --windw 5", "see 'stickslip smooth --help'"),
    ("stickslip smoth run.h5", "see 'stickslip --help'"),
    # daq record.
    ("daq record -o odd.h5 --set belt.sped=1", "belt.sped", "speed"),
    ("daq record -o run.h5", "run.h5", "--force"),
    ("daq record --rat 5", "--rat", "--rate"),
    ("daq record -o new.h5 --rate 0", "--rate"),
    ("daq record -o new.h5 --rate 1000.5", "1000.5"),
    ("daq record -o none/new.h5", "folder"),
    ("daq record -o new.h5 --port /dev/ttyS0 --realtime", "--realtime"),
    ("daq record -o new.h5 --rate 1,000", "decimal point"),
    ("daq record -o new.h5 --duration '20 m'", "is not a unit of time"),
    *((f"daq record -o new.h5 --duration {time}", "--duration", "not a valid time") for time in ("inf", "nan")),
    *((f"daq record -o new.h5 --duration {time}", "--duration", "samples") for time in ("1e12", "0.0001", "-1")),
    ("daq record -o new.h5 --duration 0.5 --log notes.txt", "is not a log of stickslip"),
    ("daq record -o new.h5 --duration 0.5 --log none/a.log", 3, "none/a.log"),
    (RECORD, *NOWHERE, "connect the board"),
    (f"{RECORD} --protocol qsb --rate 1000", "1000 Hz", "at most 512 Hz"),
    (f"{RECORD} --protocol qsb --decoder jk", "no decoder 'jk'"),
    (f"{RECORD} --protocol qsb --columns t_us,count", "--columns"),
    (f"{RECORD} --protocol frames --columns t_us,count", "--columns"),
    (f"{RECORD} --protocol frames --decoder x3", "x4"),
    (f"{RECORD} --protocol text --columns t_us,cuont", "cuont", "did you mean 'count'"),
    (f"{RECORD} --protocol qbs", "did you mean 'qsb'"),
    (f"{RECORD} --rig none.toml", "none.toml"),
    # daq check and calibrate: nobody is asked to leave the mass alone, or to pull it aside, before this is known.
    ("daq check --port /dev/ttyNOPE", *NOWHERE),
    ("daq check --port rig://rig --rate 0", "--rate"),
    ("daq check --port rig://", "does not name a scene", "write rig://rig"),
    ("daq check --port rig://nope", "nope"),
    ("daq check --port rig://base", "no encoder"),
    ("daq check --port rig://rig?set=friction.gama%3D3", "friction.gama"),
    ("daq check --port rig://rig?speed=3", "unknown option speed"),
    ("daq check --port /dev/null --protocol qsb --rate 1000", "1000 Hz"),
    ("daq check --parked -1", "--parked"),
    ("daq check --parked 0 --move 0", "--parked and --move"),
    ("daq calibrate", "rig.toml", "--force"),
    ("daq calibrate -o new.toml --no-ring-down", "command line"),
    ("daq calibrate -o new.toml --distance 0", "--distance"),
    ("daq calibrate -o new.toml --distance '100 mm +- 0.1 mm'", "--distance", "the simulated rig cannot be moved"),
    ("daq calibrate -o new.toml --mass -1", "--mass"),
    ("daq calibrate -o new.toml --port rig://rig --duration -1", "--duration"),
    ("daq calibrate -o new.toml --port rig://rig --move nan --distance 0.1", "--move"),
    # daq import: options; what is wrong in a table is in tests/daq/imports/test_refused_tables.py.
    ("daq import nowhere.csv", "check the path"),
    ("daq import text.csv -o new.h5", "text.csv", "line 3", "oops"),
    ("daq import far.csv -o new.h5", "far.csv", "line 3", "1e+30"),
    ("daq import two.csv", "two.csv", "column 2", "column 3", "--position"),
    ("daq import table.csv --x-unit centimetre", "known: m, km, dm, cm"),
    ("daq import table.csv --postion x", "--position"),
    ("daq import table.csv --position y", "the columns are: t, x"),
    ("daq import force.csv", "--spring-force F --stiffness '168 N/m'"),
    ("daq import pixels.csv", "--x-unit='0.25 mm' (a pixel)"),
    ("daq import table.csv -o table2.csv", "daq export"),
    ("daq import table.csv -o run.h5", "--force to replace it"),
    ("daq import table -o table --force", "table", "is also an input"),
    ("daq import run.h5 -o two.h5", "a run file needs no import"),
    ("daq import table.csv --counts-per-rev 4096", "requires --circumference"),
    ("daq import table.csv --mass --x0 '1 mm'", "write a value after --mass"),
    ("daq import table.csv --mass -1", "--mass"),
    ("daq import table.csv --belt-column belt", "no column 'belt'"),
    ("daq import table.csv --x0 '1 mm' --datum '-1 mm'", "--x0 and --datum cannot be combined", "use only --x0"),
    # Other commands of daq.
    ("daq recover none.h5", "none.h5"),
    ("daq recover run.h5", "use the file RUN.h5.part"),
    ("daq recover junk.h5.part", "junk.h5.part"),
    ("daq run.h5.part", "did you mean 'daq recover run.h5.part'"),
    ("daq export run.h5", "-o FILE.csv", "-o FILE.parquet"),
    ("daq export run.h5 -o run.xlsx", ".csv or .parquet"),
    ("daq export run.h5 -o table.h5", "table.h5", "a run file (HDF5)", ".csv or .parquet"),
    ("daq export run.h5 --csv table.parquet", "table.parquet", "a Parquet table", "table.csv"),
    ("daq export run.h5 -o new.csv --csv ./new.csv", "new.csv", "two outputs"),
    ("daq export run.h5 --csv two.csv", "two.csv", "--force"),
    ("daq export run.h5 --parquet no/where.parquet", "no/where.parquet", "folder"),
    # Of HDF5 under the name of a table, which was written, exit code 0.
    *(
        (line, "is the suffix of a", "name it out.h5 (-o)", "daq export out.h5 -o out.")
        for line in (
            "daq record --duration 1 -o out.csv",
            "daq record --duration 1 -o out.parquet",
            "daq replay board.h5.part -o out.csv",
            "daq recover board.h5.part -o out.csv",
        )
    ),
    ("daq calibrate -o out.csv", "out.csv: .csv is the suffix of a CSV table"),
    ("daq export run --csv run --force", "run", "is also an input"),
    ("daq replay run.h5", "add -o FILE.h5"),
    ("daq replay run.h5 -o run.h5 --force", "run.h5", "is also an input"),
    ("daq replay board.h5.part -o run.h5", "run.h5", "--force"),
    (f"{REPLAY} none.sr", "none.sr", "no such file"),
    (f"{REPLAY} notes.txt", "notes.txt", "neither a journal"),
    (f"{REPLAY} board.h5.part --step 3", "--step", "journal"),
    (f"{REPLAY} board.h5.part --rig none.toml", "none.toml", "--rig"),
    (f"{REPLAY} board.h5.part --rate x", "--rate"),
    (f"{REPLAY} pair.sr", "which probes", "0 A, 1 B"),
    (f"{REPLAY} rateless.sr --channels A=A,B=B", "--capture-rate"),  # it is not guessed
    (f"{REPLAY} {PAIR} --rate 0", "--rate", "not positive"),
    (f"{REPLAY} {PAIR} --rate 20000", "to 10000 Hz"),
    (f"{REPLAY} {PAIR} --rate 1e-300", "1e-300 Hz"),  # these three were tracebacks
    (f"{REPLAY} {PAIR} --capture-rate 1e300", "1e+300 Hz"),
    ("daq decode pair.sr --step A", "which probes"),
    (f"daq decode {PAIR} --step A", "cannot be combined"),
    ("daq decode pair.sr --channels A,B", "'A,B'", "A=NAME,B=NAME"),
    ("daq decode pair.sr --channels A=A,C=B", "does not name two probes"),
    ("daq decode pair.sr --channels A=A,B=A", "same probe"),
    ("daq decode pair.sr --channels A=A,B=Q", "no probe 'Q'", "0 A, 1 B"),
    (f"daq decode {PAIR} --decoder x2", "'x2'", "--decoder"),
    ("daq decode pair.sr --step A --dir A", "same probe"),
    ("daq decode pair.sr --step A --dir B --decoder x4", "need no decoder"),
    ("daq firmware", "--board"),
    ("daq firmware --board esp8266", "did you mean 'esp32'?"),
    ("daq firmware --board uno -o notes.txt", "notes.txt: is not a folder; choose a folder with -o"),
    ("daq watch run.h5.par", ".part"),
    # process.
    ("process smoth run.h5", "smoth", "Did you mean", "smooth"),
    ("process run.h5", "'run.h5' is a file", "did you mean 'process smooth run.h5'"),
    ("process --method rts run.h5", "did you mean 'process smooth --method rts run.h5'"),
    ("process table.csv", "'table.csv' is a file", "did you mean 'daq import table.csv'"),
    ("process smooth", "FILE", "process smooth --help"),
    ("process smooth folder", "folder", "choose a run file in it"),
    ("process smooth table.csv", "table.csv", "daq import"),
    ("process smooth none.h5", "none.h5"),
    ("process smooth cut.h5", "cut.h5"),
    ("process smooth foreign.h5", "foreign.h5"),
    ("process smooth schema999.h5", "schema999.h5", "999"),
    ("process smooth run.h5 --window 0.02", "--window", "0.02", "20ms"),
    ("process smooth run.h5 --belt-speed fast", "--belt-speed", "fast", "22 cm/s"),
    (
        "process smooth run.h5 --window 40",
        "--window: the window must be an odd number above the order (4), not 40; use 41",
    ),
    ("process smooth run.h5 --window broad", "--window: window is 'broad'"),
    ("process smooth run.h5 --method spline", "--method: method is 'spline'; known: auto, segment, rts, sg, fd"),
    ("process smooth run.h5 --method rts --order 4", "rts has no window"),
    ("process smooth run.h5 --method fd --window 41", "finite differences have no window"),
    ("process smooth run.h5 --times guessed", "--times: times is 'guessed'; known: recorded, nominal"),
    ("process smooth run.h5 --order 0", "--order: the order is 0; it must be from 1 to 20"),
    ("process smooth run.h5 --order two", "see 'process smooth --help'"),
    ("process smooth run.h5 --repair-counts yes", "--repair-counts: is 'yes'; known: off, flag, fix"),
    ("process smooth run.h5 --from 5 --to 2", "from 5 to 2 s", "the run lasts", "--from and --to"),
    ("process export run.h5", "no output file was given", "-o FILE.csv"),
    ("process export run.h5 --csv out.xlsx", "out.xlsx", "spreadsheet", "out.csv"),
    ("process export run.h5 --csv new.h5", "the output is a CSV table"),  # a table was written into it
    ("process export run.h5 --csv run.h5 --force", "run.h5", "is also an input"),
    ("process inspect run.h5 --plot out.bmp", "out.bmp", ".png"),
    ("process inspect run.h5 more.h5", "nothing takes 'more.h5'", "process inspect --help"),
    # fit-friction.
    ("fit-friction", "FILE", "fit-friction --help"),
    ("fit-friction none.h5", "none.h5"),
    ("fit-friction table.csv", "table.csv", "daq import"),
    ("fit-friction run.h5 --laws 7", "--laws", "unknown law 7", "1 to 6"),
    ("fit-friction run.h5 --law stribek", "--law", "stribek", "did you mean 'stribeck'"),
    ("fit-friction run.h5 --mass '0.3 N'", "--mass", "'N' is not a unit of mass", "kg"),
    ("fit-friction run.h5 --mass -1kg", "--mass", "-1", "positive"),
    ("fit-friction run.h5 --mass 1kg --stiffness 2N/m", "--mass and --stiffness cannot be combined", "state only one"),
    ("fit-friction run.h5 --x0 '5 kg'", "--x0", "'kg' is not a unit of length"),
    ("fit-friction run.h5 --datum 1mm --x0 1mm", "--x0 and --datum cannot be combined", "use only --x0"),
    ("fit-friction run.h5 --alpha 5", "--alpha", "5", "such as 0.05"),
    ("fit-friction none.h5 --alpha 5", "--alpha", "such as 0.05"),  # the file was read and smoothed first
    ("fit-friction run.h5 --fix gamma", "--fix", "NAME=VALUE", "gamma=9.6"),
    ("fit-friction run.h5 --bound gamma=5:1", "--bound", "gamma", "write the lower bound first"),
    ("fit-friction run.h5 run.h5", "named twice", "once"),
    ("fit-friction run.h5 --damping -1", "damping"),
    ("fit-friction run.h5 --datum 1mm --datum-sd -1e-3", "deviation"),
    ("fit-friction run.h5 --x0 1mm --datum-sd 1mm", "--x0 and --datum-sd cannot be combined", "use only --x0"),
    ("fit-friction run.h5 --datum '1 mm +- 1 mm' --datum-sd 1mm", "--datum with +- and --datum-sd cannot be combined"),
    ("fit-friction run.h5 --from 20", "fewer than two samples"),
    ("fit-friction run.h5 --no-report --report x.html", "--report and --no-report cannot be combined"),
    ("fit-friction run.h5 --csv new.h5", "the output is a CSV table", "(--csv)"),
    ("fit-friction run.h5 --save-scene new.h5", "the output is a TOML file", "(--save-scene)"),
    ("fit-friction run.h5 --save-scene bad.toml", "bad.toml", "exists", "--force"),
    ("fit-friction run.h5 --report none/out.html", "none/out.html", "the folder of this file does not exist; make "),
    # What a person types who has not read the help: a flag, a unit, a suffix or a command was guessed.
    ("fit-friction run.h5 --law 5", "did you mean --laws 5?"),
    ("fit-friction run.h5 --laws hyperbolic", "'hyperbolic' is law 5", "did you mean --laws 5?"),
    ("fit-friction run.h5 --law 'Fs/(1+gamma*s)'", '"NAME: FORMULA"', "mine: Fs/(1 + s/v)"),
    ("fit-friction run.h5 --fix gamma=9,6", "'9,6', not a number", "decimal point in s/m"),
    ("fit-friction run.h5 --fix 'gamma=9.6 m'", "'m' is not a unit of this quantity", "s/m"),
    ("fit-friction run.h5 --mass 300 g", "in quotes: --mass '300 g'"),
    ("fit-friction run.h5 --mass '300 gr'", "did you mean 'g'?"),
    ("fit-friction run.h5 --mass", "write a value after --mass: Moving mass: '0.3', '300 g'"),
    ("fit-friction run.h5 --mas 1", "Did you mean --mass?"),
    ("fit-friction run.h5 --x0 '60 mm +- 0.1'", "error without a unit", "did you mean '60 mm +- 0.1 mm'?"),  # was 0.1 m
    ("fit-friction run.h5 --confidence 95", "confidence is 95", "such as 0.95"),
    ("fit-friction run.h5 --confidence '95 %'", "--confidence is '95 %', not a number"),
    ("fit-friction run.h5 --jobs two", "--jobs is 'two', not a whole number"),
    ("fit-friction run.h5 -report x.html", "did you mean '--report'?"),
    ("fit-friction run.h5 -o out.pdf", "name it out.html", "print this page from a browser"),
    ("fit-friction foreign", "did you mean 'foreign.h5'?"),
    ("fit-friction .", "is a folder", "fit-friction --each *.h5"),  # was a traceback
    ("daq fit run.h5", "not a command of daq", "did you mean 'fit-friction run.h5'?"),
    ("daq recrod -o new.h5", "Did you mean", "record"),
    ("daq record --duration 10 s -o new.h5", "in quotes: --duration '10 s'"),
    ("daq record --duration ten -o new.h5", "write it like '20 ms'"),
    ("daq import table.cvs", "did you mean 'table.csv'?"),
    ("daq import table.csv -o new.h5 --belt 22cm", "--belt-speed", "did you mean 'cm/s'?"),
    ("process inspect run.h5 -o", "write a value after -o"),
    ("stickslip fitt run.h5", "Did you mean", "fit"),
]


@pytest.mark.parametrize(
    ("line", "words"), [(line, words) for line, *words in REFUSED], ids=[row[0] for row in REFUSED]
)
def test_a_mistake_is_one_line_that_says_what_to_do(folder, line, words):
    expected = words[0] if isinstance(words[0], int) else 2
    before = contents(folder)
    code, out, err = run(line, folder)
    assert (code, out, err.count("\n")) == (expected, "", 1), err
    assert [word for word in words if isinstance(word, str) and word not in err] == [], err
    code, out, _ = run(f"{line} --json", folder)
    error = json.loads(out)["error"]
    assert code == expected
    assert set(error) == {"what", "where", "do"}
    assert all(error.values())
    assert contents(folder) == before


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("process smooth belt.h5 --belt-speed -0.22", ("0.22", "sign")),  # that no plateau has
        (
            "daq record --duration 0.05 -o fast.h5 --set encoder.vibration=1e-3 --set encoder.vibration_hz=2e5",
            ("rolled over",),
        ),
    ],
)
def test_what_may_be_wrong_is_warned_about(tmp_path, line, words):
    (tmp_path / "belt.h5").write_bytes(SAMPLE.read_bytes())
    _, out, _ = run(f"{line} --json", tmp_path)
    assert any(all(word in warning for word in words) for warning in json.loads(out)["warnings"])


def test_a_full_stdout_is_one_line_and_no_traceback(tmp_path):
    if not Path("/dev/full").exists():
        pytest.skip("this system has no /dev/full")
    with Path("/dev/full").open("w") as full:
        line = [Path(sys.executable).parent / "rig-sim", "scenes"]
        done = subprocess.run(line, stdout=full, stderr=subprocess.PIPE, text=True, check=False, cwd=tmp_path)
    assert done.returncode == 3
    assert "Traceback" not in done.stderr
    assert "space" in done.stderr
