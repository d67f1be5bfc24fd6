"""Errors of daq that reach Python name keywords of its functions; fifteen mistakes at the terminal end in one line."""

import ast
import inspect
import re
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

import daq
import processing
from daq.cli.app import app
from daq.imports.load import FLAGS
from daq.imports.options import ImportOptions
from daq.runfile.recording import Recording
from stickslip.console import application
from stickslip.errors import StickslipError

ROOT = Path(__file__).resolve().parents[2]
# What no function of Python reaches: captures, firmware, parts of a run that the analyses ask for, notes, QSB adapters.
OTHERS = ("capture", "replay", "sigrok", "firmware_files", "notes", "joint", "qsb")
ERRORS = ("InputError", "DeviceError", "DataError", "RecordingInterruptedError")
KEYWORDS = {field.name for field in fields(ImportOptions)} | set(FLAGS)
KEYWORDS |= {
    name
    for function in (daq.record, daq.recover, Recording.from_arrays)
    for name in inspect.signature(function).parameters
}
FLAG = re.compile(r"(?<![\w-])--([a-z][a-z0-9-]*)")


def raised():
    """Yield the place of each error below the commands, its texts, and whether it has another call for Python."""
    for folder in ("imports", "recorder", "protocols", "runfile", "finalise", "wire"):
        for path in sorted((ROOT / "daq" / folder).glob("*.py")):
            if path.stem in OTHERS:
                continue
            for call in ast.walk(ast.parse(path.read_text())):
                if isinstance(call, ast.Call) and isinstance(call.func, ast.Name) and call.func.id in ERRORS:
                    texts = [node.value for node in ast.walk(call) if isinstance(node, ast.Constant)]
                    own = {keyword.arg for keyword in call.keywords}
                    yield (
                        f"{path.stem}:{call.lineno}",
                        " ".join(filter(lambda x: isinstance(x, str), texts)),
                        "python" in own,
                    )


def test_every_flag_that_an_error_names_is_a_keyword_or_has_another_call_beside_it():
    found = list(raised())
    assert len(found) > 150
    strange = [
        (place, flag)
        for place, text, in_python in found
        for flag in FLAG.findall(text)
        if not in_python and flag.replace("-", "_") not in KEYWORDS
    ]
    # Asked for by flags alone: parts of a run, markers, the recorder's own line for a board's baud rate.
    assert [each for each in strange if each[1] not in ("from", "to", "mark")] == []


TIME = np.arange(1000) / 500
X = 0.01 * np.sin(6 * TIME)
# A mistake in Python, and the call that the message names.
MISTAKES = [
    (lambda: daq.Recording.from_arrays(TIME, X[1:]), "give one each"),
    (lambda: daq.Recording.from_arrays(TIME, np.c_[X, X]), "give one dimension, as in position[:, 0]"),
    (lambda: daq.Recording.from_arrays(TIME, X, mass="500g."), "mass: 'g.' is not a unit of mass"),
    (lambda: daq.Recording.from_arrays(TIME, X, belt_speed="5 cm"), "belt_speed: 'cm' is not a unit of speed"),
    (lambda: daq.Recording.from_arrays(TIME, X, metres_per_count=1e-6), "or leave metres_per_count out"),
    (lambda: daq.Recording.from_arrays(np.arange("2024-01-01", "2024-01-03", dtype="M8[D]"), [0, 1]), "(t - t[0])"),
    (lambda: daq.Recording.from_arrays(TIME, X).save("run.csv"), "CSV"),
    (lambda: daq.load("nowhere.h5"), "no such file; check the path"),
    (lambda: daq.load("table.csv", unit="mm"), "did you mean 'x_unit'?"),
    (lambda: daq.load("table.csv", x_unit="mm/s"), "x_unit: 'mm/s' is not a unit of length"),
    (lambda: daq.load("table.csv", positon=2), "did you mean 'position'?"),
    (lambda: daq.load("table.csv", position="y"), "position: no column 'y'; the columns are: t, x"),
    (lambda: daq.load("force.csv"), "give spring_force='F', stiffness='168 N/m'"),
    (lambda: daq.load("pixels.csv"), "x_unit='0.25 mm', a pixel?"),
    (lambda: daq.load("run.h5", mass=0.3), "arguments of fitting.rank"),
    (lambda: daq.record((TIME, X), "new.h5", rate_hz=500), "daq.Recording.from_arrays(t, x).save(path)"),
    (lambda: daq.record([(TIME, X)], "new.h5", rate_hz=1000), "give rate_hz=500, or the times in s"),
    (lambda: daq.record([(TIME, X)], "run.h5", rate_hz=500), "or force=True to replace it"),
    (lambda: daq.record("/dev/ttyNONE", "new.h5", rate_hz=1000), "no such port; connect the board"),
    (lambda: daq.record("rig://rig", "new.h5", rate_hz=0), "give rate_hz=1 or more"),
    (lambda: daq.recover("run.h5"), "is not a journal; give the RUN.h5.part"),
    (lambda: processing.smooth(TIME), "processing.smooth(time, position)"),
    (lambda: processing.smooth(daq.load("run.h5"), X), "processing.smooth(run, method=...)"),
]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Go into a folder with a run and tables."""
    monkeypatch.chdir(tmp_path)
    daq.Recording.from_arrays(TIME, X).save("run.h5")
    for name, header, column in (("table", "t,x", X), ("force", "t (s),F (N)", X), ("pixels", "t (s),x", 1e4 * X)):
        np.savetxt(f"{name}.csv", np.c_[TIME, column], delimiter=",", header=header, comments="")
    return tmp_path


@pytest.mark.parametrize(("mistake", "words"), MISTAKES, ids=[words[:40] for _, words in MISTAKES])
def test_a_mistake_in_python_names_the_call_to_make(folder, mistake, words):
    before = set(folder.iterdir())
    with pytest.raises(StickslipError) as caught:
        mistake()
    assert words in str(caught.value)
    assert " --" not in str(caught.value)
    assert "\n" not in str(caught.value)
    assert set(folder.iterdir()) == before


# A mistake at the terminal, its exit code, and what the one line says to do.
TYPED = [
    (["import", "nowhere.csv"], 2, "check the path"),
    (["import", "table.csv", "--x-unit", "centimetre"], 2, "known: m, km, dm, cm"),
    (["import", "table.csv", "--postion", "x"], 2, "--position"),
    (["import", "table.csv", "--position", "y"], 2, "the columns are: t, x"),
    (["import", "force.csv"], 2, "--spring-force F --stiffness '168 N/m'"),
    (["import", "pixels.csv"], 2, "--x-unit '0.25 mm', a pixel?"),
    (["import", "table.csv", "-o", "table2.csv"], 2, "daq export"),
    (["import", "table.csv", "-o", "run.h5"], 2, "--force to replace it"),
    (["import", "run.h5", "-o", "two.h5"], 2, "a run file needs no import"),
    (["import", "table.csv", "--counts-per-rev", "4096"], 2, "give --circumference too"),
    (["import", "table.csv", "--mass", "--x0", "1 mm"], 2, "write a value after --mass"),
    (["import", "table.csv", "--belt-column", "belt"], 2, "no column 'belt'"),
    (["record", "--port", "/dev/ttyNONE", "-o", "new.h5"], 3, "connect the board"),
    (["record", "--protocol", "txt", "-o", "new.h5"], 2, "did you mean 'text'?"),
    (["record", "--duration", "20 m", "-o", "new.h5"], 2, "is not a unit of time"),
    (["record", "--rate", "1,000", "-o", "new.h5"], 2, "decimal point"),
    (["record", "--protocol", "text", "--columns", "t,x", "-o", "new.h5"], 2, "--columns"),
    (["recover", "run.h5"], 2, "give the RUN.h5.part"),
    (["export", "run.h5", "-o", "run.xlsx"], 2, ".csv or .parquet"),
    (["replay", "run.h5"], 2, "give -o"),
    (["firmware", "--board", "esp8266"], 2, "did you mean 'esp32'?"),
    (["watch", "run.h5.par"], 2, ".part"),
]


@pytest.mark.parametrize(("line", "code", "words"), TYPED, ids=[" ".join(line[:4]) for line, _, _ in TYPED])
def test_a_mistake_at_the_terminal_ends_in_one_line_that_says_what_to_do(folder, capsys, line, code, words):
    before = set(folder.iterdir())
    assert application.run(app, line) == code
    said = capsys.readouterr()
    text = (said.out + said.err).strip()
    assert words in " ".join(text.split())
    assert "Traceback" not in text
    assert len(text.splitlines()) <= 3  # one sentence, wrapped
    assert set(folder.iterdir()) == before
