"""A camera's CSV becomes a run: formats found, bad lines named, a wrong frame rate noticed."""

import json
import math
import re
from csv import reader
from pathlib import Path
from typing import Any

import cyclopts
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from daq.cli.app import app as commands
from daq.imports import frame_rate, layout, lines, table, table_to_run
from daq.imports.lines import number_lines
from daq.imports.options import ImportOptions
from daq.runfile import store
from stickslip import units
from stickslip.compute import stages
from stickslip.console import application
from stickslip.errors import InputError
from stickslip.units import Measured

MASS, STIFFNESS = 0.3, 10.5552  # pi sqrt(m/k) = 0.52963 s


def sawtooth(rate_hz: float, until: float = 12.0, belt: float = 0.22) -> tuple[Any, Any]:
    """Stick at belt speed, then slip half a cosine in pi sqrt(m/k): turning points exactly that far apart."""
    slip = math.pi * math.sqrt(MASS / STIFFNESS)
    stick = 1.1
    reach = belt * stick / 2
    time = np.arange(round(until * rate_hz)) / rate_hz
    phase = time % (stick + slip)
    sticking = -reach + belt * phase
    slipping = reach * np.cos(math.pi * (phase - stick) / slip)
    return time, np.where(phase < stick, sticking, slipping)


def options(**changes: Any) -> ImportOptions:
    known: dict[str, Any] = {"mass": Measured(MASS), "stiffness": Measured(STIFFNESS)}
    return ImportOptions(**(known | {"started": "2024-05-01T12:00:00+02:00"} | changes))


def make(
    path: Path, head: str, rows: Any, *, delimiter: str = ",", decimal: str = ".", end: str = "\n", **how: Any
) -> Path:
    lines = [delimiter.join(f"{cell:.9g}".replace(".", decimal) for cell in row) for row in rows]
    text = head + "".join(line + end for line in lines)
    path.write_bytes(text.encode(how.get("encoding", "utf-8")))
    return path


@pytest.fixture
def csv(tmp_path: Path) -> Path:
    return tmp_path / "track.csv"


FORMATS = [
    ("t,x\n", {}),
    ("", {}),
    ("t;x\r\n", {"delimiter": ";", "decimal": ",", "end": "\r\n", "encoding": "utf-8-sig"}),
    ("t\tx\r", {"delimiter": "\t", "end": "\r"}),
    ("t\tx\n", {"delimiter": "\t", "decimal": ","}),
    ("", {"delimiter": "   "}),
    ("t (s)   x (m)\n", {"delimiter": "  ", "decimal": ","}),
    ("t (s) x (m)\n", {"delimiter": " "}),
    ("t, x\n", {"delimiter": ", "}),
    ("t;x;\n", {"delimiter": ";", "decimal": ",", "end": ";\n"}),
    ("t;x\n", {"delimiter": ";", "decimal": ",", "end": ";\n"}),
    ("sep=;\nt;x\n", {"delimiter": ";"}),
    ("# a camera\n% 400 fps\n\n// more\nt,x\n", {}),
    ("Experiment 12\nmass_A\nt\tx\n", {"delimiter": "\t"}),
    ("t;x\n", {"delimiter": ";", "encoding": "utf-16"}),
    ("Zeit [s];Weg [m]; Größe\n", {"delimiter": ";", "decimal": ",", "encoding": "cp1252", "wide": True}),
]


@pytest.mark.parametrize(("head", "how"), FORMATS)
def test_the_format_is_found(csv: Path, head: str, how: dict[str, Any]) -> None:
    time, x = sawtooth(100, 3)
    how = dict(how)
    columns = [time, x, x] if how.pop("wide", False) else [time, x]
    found = table_to_run.read(make(csv, head, zip(*columns, strict=True), **how), options())
    np.testing.assert_allclose(found.run.time, time, atol=1e-8)
    np.testing.assert_allclose(found.run.position, x, atol=1e-8)
    assert found.decimal == how.get("decimal", ".")


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    rows=st.lists(st.tuples(*[st.floats(-1e6, 1e6).map(lambda v: round(v, 3))] * 3), min_size=2, max_size=30),
    how=st.sampled_from(
        [(",", "."), (";", "."), (";", ","), ("\t", "."), ("\t", ","), (" ", "."), (" ", ","), ("|", ",")]
    ),
    head=st.booleans(),
)
def test_any_table_reads_back(tmp_path: Path, rows: Any, how: tuple[str, str], head: bool) -> None:
    delimiter, decimal = how
    # Written with three decimals: a table of whole numbers alone does not tell its decimal sign.
    lines = [delimiter.join(f"{cell:.3f}".replace(".", decimal) for cell in row) for row in rows]
    text = (delimiter.join("abc") + "\n" if head else "") + "\n".join(lines) + "\n"
    path = tmp_path / "t.csv"
    path.write_text(text)
    found = table.parse_lines(path, number_lines(text), 0, stages.silent)
    assert (found.delimiter, found.decimal) == how
    values, _, bad = found.columns([(column, found.number, "a number") for column in range(3)], skip=False)
    assert values.T.tolist() == [list(row) for row in rows]
    assert bad == ()
    for column, name in enumerate("abc"):
        assert found.label(column) == (f"column {name!r}" if head else f"column {column + 1}")


CELL = st.sampled_from(
    ["1", "-2.5", "+.5e3", "1e999", "nan", "", " 7 ", "\N{MINUS SIGN}3", "1,5", "x", "\u0663", "5.", "1_0"]
)


@given(
    st.lists(st.lists(CELL | st.floats().map(repr), min_size=1, max_size=3), max_size=12),
    st.sampled_from(".,"),
    st.booleans(),
)
def test_cells_converted_together_are_converted_as_one_by_one(rows: Any, decimal: str, alike: bool) -> None:
    """Each cell of a long table used to be matched by itself: 12 CPU s for 376 s at 2 kHz."""
    rows = [row[:1] * 2 if alike else row for row in rows]
    cells = table.Table(Path("x.csv"), (), rows, np.arange(1, len(rows) + 1), 2, ";", decimal)
    together = [(0, cells.number, "a number"), (1, cells.number, "a number")]
    one_by_one = [(column, lambda cell: cells.number(cell), kind) for column, _, kind in together]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(table, "TOGETHER", 3)
        found, used, bad = cells.columns(together, skip=True)
    values, good, skipped = cells.columns(one_by_one, skip=True)
    assert found.tobytes() == values.tobytes()
    assert (used.lines.tolist(), bad) == (good.lines.tolist(), skipped)
    plain = layout.read_plain_numbers([row[0] for row in rows], decimal) if rows else []
    assert plain is None or plain == [layout.read_number(row[0], decimal) for row in rows]


@pytest.mark.parametrize("delimiter", "\t;,|")
@given(text=st.text('1.5-e;,|\t "x\u00e9', min_size=1, max_size=12))
def test_a_line_without_quotes_is_split_as_csv_splits_it(delimiter: str, text: str) -> None:
    row = next(reader([text.strip(" ")], delimiter=delimiter, skipinitialspace=True), [])
    assert layout.split_cells(text, delimiter) == row


@pytest.mark.parametrize(
    ("head", "t_size", "x_size", "changes"),
    [
        ("t,x", 1, 1, {}),
        ("t (ms),x (cm)", 1e-3, 1e-2, {}),
        ("time [s],pos [mm]", 1, 1e-3, {}),
        ("t/ms,x/µm", 1e-3, 1e-6, {}),
        ("time_s,position_m", 1, 1, {}),
        ("t,x", 1e-3, 1e-2, {"t_unit": "ms", "x_unit": "cm"}),
        ("t,x (px)", 1, 2.5e-4, {"x_unit": "0.25 mm"}),
    ],
)
def test_units_come_from_the_flag_or_the_header(
    csv: Path, head: str, t_size: float, x_size: float, changes: Any
) -> None:
    csv.write_text(f"{head}\n0,1\n2,3\n5,7\n")
    found = table_to_run.read(csv, ImportOptions(**changes))
    np.testing.assert_allclose(found.run.time, np.array([0, 2, 5]) * t_size, rtol=1e-15)
    np.testing.assert_allclose(found.run.position, np.array([1, 3, 7]) * x_size, rtol=1e-15)
    assert found.warnings == ()


def test_a_flag_that_contradicts_the_header_wins_and_says_so(csv: Path) -> None:
    csv.write_text("t,x (cm)\n0,1\n2,3\n")
    found = table_to_run.read(csv, ImportOptions(x_unit="mm"))
    assert found.run.position.tolist() == [0.001, 0.003]
    assert "not in cm" in found.warnings[0]


@pytest.mark.parametrize(
    ("text", "changes", "time", "position"),
    [
        ("x\n1\n2\n3\n", {"frame_rate_hz": 400.0}, [0, 1, 2], [1, 2, 3]),
        ("1,5\n2,5\n3,5\n", {"frame_rate_hz": 400.0, "position": "1"}, [0, 1, 2], [1, 2, 3]),
        ("frame,x\n7,1\n8,2\n11,3\n", {"frame_rate_hz": 400.0}, [0, 1, 4], [1, 2, 3]),
        ("x;y\n1;4\n2;5\n3;6\n", {"frame_rate_hz": 400.0, "position": "y"}, [0, 1, 2], [4, 5, 6]),
    ],
)
def test_a_frame_rate_makes_the_times(csv: Path, text: str, changes: Any, time: Any, position: Any) -> None:
    csv.write_text(text)
    found = table_to_run.read(csv, ImportOptions(**changes))
    np.testing.assert_allclose(found.run.time, np.array(time) / 400, rtol=1e-15)
    assert found.run.position.tolist() == position


def test_columns_are_chosen_by_name_or_number(csv: Path) -> None:
    csv.write_text("i,Clock,laser A,laser B\n0,0.5,1,2\n1,0.6,3,4\n")
    for time, position in (("Clock", "laser B"), ("clock", "LASER B"), ("2", "4")):
        found = table_to_run.read(csv, ImportOptions(time=time, position=position))
        assert found.run.position.tolist() == [2, 4]
        np.testing.assert_allclose(found.run.time, [0, 0.1], atol=1e-15)


def test_uneven_times_are_kept_as_they_are(csv: Path) -> None:
    csv.write_text("t,x\n0,1\n0.1,2\n0.35,2\n0.4,5\n")
    found = table_to_run.read(csv, ImportOptions())
    assert not found.even
    assert found.run.time.tolist() == [0, 0.1, 0.35, 0.4]


@pytest.mark.parametrize(
    ("text", "changes", "words"),
    [
        ("t,x\n0,1\n0.1,lost\n", {}, ["line 3", "column 'x'", "'lost'", "correct"]),
        ("t,x\n0,foo\n0.1,2\n", {}, ["line 2", "'foo'"]),
        ("0,1\n0.1,\n0.2,3\n", {}, ["line 2", "column 2", "empty"]),
        ("t,x\n0,1\n0.1,nan\n", {}, ["line 3", "'nan'"]),
        ("t,x\n0,1\ninf,2\n", {}, ["line 3", "column 't'", "'inf'"]),
        ("t,x\n0,1\n1,2\n1,3\n", {}, ["line 4", "does not increase", "1 s after 1 s"]),
        ("t,x\n\n0,1\n# note\n2,2\n1,3\n", {}, ["line 6", "does not increase"]),
        ("t,x\n0,1\n1,2,3\n2,3\n", {}, ["line 3", "3 columns"]),
        ("t,x\n0,10,1,25\n0,20,1,50\n", {}, ["line 1", "2 columns", "have 4", "semicolons"]),
        ("a,b,c\n0,1,2\n1,2,3\n", {}, ["which column is the position", "a, b, c"]),
        ("x,b,c\n0,1,2\n1,2,3\n", {}, ["which column is the time", "--time"]),
        ("t,x\n0,1\n1,2\n", {"position": "y"}, ["no column 'y'", "t, x"]),
        ("t,x\n0,1\n1,2\n", {"time": "t", "position": "t"}, ["time and position are the same"]),
        ("t,x (px)\n0,1\n1,2\n", {}, ["'px'", "--x-unit", "0.25 mm"]),
        ("t,x\n0,1\n1,2\n", {"x_unit": "kg"}, ["--x-unit", "'kg'"]),
        ("t,x\n0,1\n1,2\n", {"x_unit": "0 m"}, ["--x-unit", "zero"]),
        ("x\n1\n2\n", {}, ["no column of times", "--frame-rate"]),
        ("frame,x\n1,2\n2,3\n", {}, ["frame numbers", "--frame-rate"]),
        ("t,x\n0,1\n", {}, ["single sample"]),
        ("t,x\n", {}, ["holds no numbers"]),
        ("", {}, ["is empty"]),
        ("# nothing\n", {}, ["holds no data"]),
        ("t,x\n0,1\n1,2\n", {"started": "yesterday"}, ["--start", "zone"]),
        ("a\0b", {}, ["not a text file"]),
    ],
)
def test_bad_tables_are_refused_by_line(csv: Path, text: str, changes: Any, words: list[str]) -> None:
    csv.write_text(text)
    with pytest.raises(InputError) as error:
        table_to_run.read(csv, ImportOptions(**changes))
    line = error.value.as_line()
    assert "\n" not in line
    for word in words:
        assert word in line


@pytest.mark.parametrize("belt", [0.22, -0.22])
def test_the_half_period_of_the_slip_is_found_in_either_direction(belt: float) -> None:
    time, x = sawtooth(400, belt=belt)
    swing = frame_rate.measure_half_period(time, x)
    assert swing.duration == pytest.approx(math.pi * math.sqrt(MASS / STIFFNESS), abs=1 / 400)
    assert swing.number == 7
    assert swing.shortest <= math.pi * math.sqrt(MASS / STIFFNESS) <= swing.longest
    assert swing.longest - swing.shortest == pytest.approx(4 / 400)


def test_a_right_frame_rate_is_accepted(csv: Path) -> None:
    found = table_to_run.read(make(csv, "t,x\n", zip(*sawtooth(400), strict=True)), options())
    assert found.warnings == ()


def test_a_wrong_frame_rate_is_noticed_and_the_right_one_named(csv: Path) -> None:
    time, x = sawtooth(400)
    make(csv, "t,x\n", zip(time * 400 / 30, x, strict=True))  # a 400 fps film played at 30
    found = table_to_run.read(csv, options())
    assert "frame rate must be wrong" in found.warnings[0]
    fitting = float(found.warnings[0].split(" would match")[0].split()[-1])
    assert fitting == pytest.approx(400, rel=0.01)


@pytest.mark.parametrize("slower", [1 / 128, 1.0, 64.0])
@pytest.mark.parametrize("samples", [1.3, 2.2, 2.9, 4.0, 5.1, 7.0])
def test_few_samples_a_slip_are_no_wrong_frame_rate(csv: Path, samples: float, slower: float) -> None:
    """A slip lasts a whole number of samples: at 4 a slip "the frame rate must be wrong" was said of a right one."""
    slip = math.pi * math.sqrt(MASS / STIFFNESS)
    time, x = sawtooth(samples / slip, until=60.0)
    make(csv, "t [s],x [m]\n", zip(time * slower, x, strict=True))
    found = table_to_run.read(csv, options(stiffness=Measured(STIFFNESS / slower**2)))
    assert found.warnings == ()


@pytest.mark.parametrize("factor", [0.125, 4.0])
@pytest.mark.parametrize("samples", [5.1, 7.0, 20.0])
def test_a_wrong_frame_rate_is_noticed_at_few_samples_a_slip(csv: Path, samples: float, factor: float) -> None:
    slip = math.pi * math.sqrt(MASS / STIFFNESS)
    time, x = sawtooth(samples / slip, until=60.0)
    make(csv, "t [s],x [m]\n", zip(time * factor, x, strict=True))
    assert "frame rate must be wrong" in table_to_run.read(csv, options()).warnings[0]


def test_a_given_frame_rate_corrects_the_times_and_says_so(csv: Path) -> None:
    time, x = sawtooth(400)
    make(csv, "t,x\n", zip(time * 400 / 30, x, strict=True))
    found = table_to_run.read(csv, options(frame_rate_hz=400.0))
    np.testing.assert_allclose(found.run.time, time, atol=1e-6)
    assert len(found.warnings) == 1
    assert "times were multiplied by 0.075" in found.warnings[0]


def test_times_that_agree_with_the_given_frame_rate_stay_as_they_are(csv: Path) -> None:
    csv.write_text("t,x\n0,1\n0.0025,2\n0.005,2\n0.00752,2\n")
    found = table_to_run.read(csv, ImportOptions(frame_rate_hz=400.0))
    assert found.run.time.tolist() == [0, 0.0025, 0.005, 0.00752]
    assert found.warnings == ()


def test_a_track_without_a_whole_slip_says_that_nothing_was_checked(csv: Path) -> None:
    csv.write_text("t,x\n0,0\n1,1\n2,2\n")
    assert "could not be checked" in table_to_run.read(csv, options()).warnings[0]


@pytest.mark.parametrize(
    ("text", "dimension", "value"),
    [
        ("1 kg", "mass", 1.0),
        ("300g", "mass", 0.3),
        ("0.3", "mass", 0.3),
        ("12 cm", "length", 0.12),
        ("-1.5e2 mm", "length", -0.15),
        ("400 fps", "rate", 400.0),
        ("1 kHz", "rate", 1000.0),
        ("22 cm/s", "speed", 0.22),
        ("10.5 N/m", "stiffness", 10.5),
        ("1 N/mm", "stiffness", 1000.0),
        ("5 µs", "time", 5e-6),
        ("5 \N{GREEK SMALL LETTER MU}s", "time", 5e-6),
    ],
)
def test_quantities_are_read_in_si(text: str, dimension: str, value: float) -> None:
    assert units.quantity(text, dimension, "--flag") == pytest.approx(value, rel=1e-15)


@pytest.mark.parametrize("text", ["300 g +- 1 g", "0.3 ± 0.001", "300 +/- 1 g", "0.3 kg +- 1 g"])
def test_a_quantity_may_carry_its_error(text: str) -> None:
    found = units.measured(text, "mass", "--mass")
    assert (found.value, found.sd) == pytest.approx((0.3, 0.001), rel=1e-12)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("heavy", ["--mass", "'heavy'", "300 g"]),
        ("", ["--mass"]),
        ("1 kn", ["'kn'", "did you mean 'kg'"]),
        ("1,5 kg", ["decimal point"]),
        ("1 KG", ["'KG'"]),
        ("1 kg +- 1 g +- 2 g", ["more than one"]),
        ("1 kg +- -1 g", ["negative"]),
        ("1e999 kg", ["too large"]),
    ],
)
def test_what_is_no_quantity_is_refused(text: str, words: list[str]) -> None:
    with pytest.raises(InputError) as error:
        units.measured(text, "mass", "--mass")
    for word in words:
        assert word in error.value.as_line()


@pytest.fixture
def app() -> cyclopts.App:
    return commands


def test_the_command_writes_a_run_that_loads(csv: Path, app: cyclopts.App, capsys: pytest.CaptureFixture[str]) -> None:
    time, x = sawtooth(400)
    make(csv, "t;x [cm]\n", zip(time, 100 * x, strict=True), delimiter=";", decimal=",")
    target = csv.with_name("run.h5")
    line = ["import", str(csv), "-o", str(target), "--mass", "300 g +- 1 g", "--belt", "22 cm/s", "--datum", "2 mm"]
    assert application.run(app, [*line, "--stiffness", "10.5552 N/m", "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed["samples"] == time.size
    assert printed["warnings"] == []
    assert (printed["delimiter"], printed["decimal"], printed["even"]) == ("semicolon", ",", True)
    recording = store.load(target)
    np.testing.assert_allclose(recording.position, x + 0.002, atol=1e-9)
    assert recording.raw is None
    assert recording.count is None
    assert recording.unit == "m"
    assert recording.rate_hz == pytest.approx(400, rel=1e-6)
    assert recording.rig.mass == Measured(pytest.approx(0.3), pytest.approx(0.001))
    assert recording.rig.belt_speed == Measured(0.22)
    assert recording.rig.datum == Measured(0.002)


@pytest.mark.parametrize("text", ["-60 mm +- 0.1 mm", "-0.06 +- 1e-4"])
def test_the_rest_position_is_a_reading_and_leaves_the_readings_as_they_are(
    csv: Path, app: cyclopts.App, text: str
) -> None:
    """There was --datum alone, which is -x0 and is added to every position; '-60 mm' was taken for a flag."""
    time, x = sawtooth(400)
    make(csv, "t (s),x (m)\n", zip(time, x, strict=True))
    target = csv.with_name("run.h5")
    assert application.run(app, ["import", str(csv), "-o", str(target), "--x0", text]) == 0
    recording = store.load(target)
    np.testing.assert_allclose(recording.position, x, atol=1e-9)
    assert recording.rig.x0 == Measured(pytest.approx(-0.06), pytest.approx(1e-4))
    assert recording.rig.datum is None


def test_a_rest_position_is_stated_once(csv: Path, app: cyclopts.App, capsys: pytest.CaptureFixture[str]) -> None:
    time, x = sawtooth(400)
    make(csv, "t (s),x (m)\n", zip(time, x, strict=True))
    target = csv.with_name("run.h5")
    assert application.run(app, ["import", str(csv), "-o", str(target), "--x0", "1 mm", "--datum", "-1 mm"]) == 2
    assert "--x0 and --datum together; give --x0 alone: --datum is -x0" in capsys.readouterr().err
    assert not target.exists()


@pytest.mark.parametrize(("flag", "value"), [("--x0", "-5 m"), ("--datum", "5 m")])
def test_a_rest_position_far_from_the_travel_is_asked_about(
    csv: Path, app: cyclopts.App, capsys: pytest.CaptureFixture[str], flag: str, value: str
) -> None:
    time, x = sawtooth(400)
    make(csv, "t (s),x (m)\n", zip(time, x, strict=True))
    line = ["import", str(csv), "-o", str(csv.with_name("run.h5")), flag, value, "--json"]
    assert application.run(app, line) == 0
    (asked,) = json.loads(capsys.readouterr().out)["warnings"]
    assert "x0 (-5 m) is" in asked
    assert "are its sign and its unit right?" in asked


def test_the_command_refuses_in_one_line_and_writes_nothing(
    csv: Path, app: cyclopts.App, capsys: pytest.CaptureFixture[str]
) -> None:
    csv.write_text("t,x\n0,1\n1,oops\n")
    target = csv.with_name("run.h5")
    assert application.run(app, ["import", str(csv), "-o", str(target)]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert not target.exists()
    target.write_text("precious")
    csv.write_text("t,x\n0,1\n1,2\n")
    assert application.run(app, ["import", str(csv), "-o", str(target)]) == 2
    assert "--force" in capsys.readouterr().err
    assert target.read_text() == "precious"
    assert application.run(app, ["import", str(csv), "-o", str(target), "--mass", "-1"]) == 2
    assert application.run(app, ["import", str(csv), "-o", str(target), "--force"]) == 0
    assert store.load(target).position.tolist() == [1, 2]


def test_the_start_is_the_files_date_unless_given(csv: Path) -> None:
    csv.write_text("t,x\n0,1\n1.5,2\n")
    given_start = table_to_run.read(csv, ImportOptions(started="2024-05-01T12:00:00+02:00")).run
    assert (given_start.started, given_start.ended) == ("2024-05-01T12:00:00+02:00", "2024-05-01T12:00:01.500000+02:00")
    assert "modification" in str(table_to_run.read(csv, ImportOptions()).run.provenance["start_time_from"])


def servo_log(rows: str = "") -> str:
    """Return a table below a preamble with numbers and a line of units, as a servo drive logs it."""
    lines = [f"{0.001 * k:.3f};{2 * k};{5 + k}" for k in range(12)]
    head = "Drive;AX-100\nSample time;0,001;s\nChannels;3\n\nTime;Torque;Position\ns;N;mm\n"
    return head + rows + "\n".join(lines).replace(".", ",") + "\n"


@pytest.mark.parametrize("changes", [{}, {"preamble": 4}])
def test_a_preamble_with_numbers_and_a_line_of_units_is_passed_over(csv: Path, changes: Any) -> None:
    """Used to end in "holds 'Drive', not a number"; a line of units was taken for the names."""
    csv.write_text(servo_log())
    found = table_to_run.read(csv, ImportOptions(**changes))
    np.testing.assert_allclose(found.run.time, np.arange(12) * 1e-3, atol=1e-12)
    np.testing.assert_allclose(found.run.position, (5 + np.arange(12)) * 1e-3, rtol=1e-12)


def test_a_preamble_that_could_be_data_is_asked_about(csv: Path) -> None:
    csv.write_text("Rate,1000\n0,1\n1,2\n2,5\n")
    with pytest.raises(InputError, match=r"line 1, column 1: column 1 holds 'Rate', not a number.*preamble 1"):
        table_to_run.read(csv, ImportOptions())
    assert table_to_run.read(csv, ImportOptions(preamble=1)).run.position.tolist() == [1, 2, 5]


def test_bad_lines_are_counted_and_left_out_on_request(csv: Path, app: cyclopts.App, capsys: Any) -> None:
    """Any empty cell used to stop the import."""
    rows = [f"{0.01 * k:.2f},{k}" for k in range(40)]
    for at, text in ((3, "0.03,"), (7, "0.07,lost"), (11, "0.11"), (20, ",4"), (21, "0.21,nan"), (30, "0.3,1,2")):
        rows[at] = text
    csv.write_text("t (s),x (mm)\n" + "\n".join(rows) + "\n")
    line = ["import", str(csv), "-o", str(csv.with_name("run.h5")), "--json"]
    assert application.run(app, line) == 2
    error = json.loads(capsys.readouterr().out)["error"]
    assert error["where"].endswith("line 5, column 2")
    assert "6 lines cannot be read: 5, 9, 13, 22, 23 and 1 more" in error["what"]
    assert "--skip-bad" in error["do"]
    assert application.run(app, [*line, "--skip-bad"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert (document["samples"], document["skipped"]) == (34, 6)
    assert "6 lines (15 %) could not be read and were left out: 5, 9, 13, 22, 23 and 1 more" in document["warnings"][0]
    run = store.load(csv.with_name("run.h5"))
    assert "skipped_lines = [5, 9, 13, 22, 23, 32]" in run.config_toml
    np.testing.assert_allclose(run.position[:5], np.array([0, 1, 2, 4, 5]) * 1e-3)


def test_times_of_day_are_read_across_midnight(csv: Path) -> None:
    stamps = ["23:59:59.500", "23:59:59.750", "00:00:00.000", "0:00:00.250", "00:00:00.50"]
    csv.write_text("clock,x\n" + "".join(f"{stamp},{k}\n" for k, stamp in enumerate(stamps)))
    with pytest.raises(InputError, match=r"times of day such as 23:59:59\.500; give clock"):
        table_to_run.read(csv, ImportOptions(time="clock"))
    found = table_to_run.read(csv, ImportOptions(time="clock", clock=True))
    np.testing.assert_allclose(found.run.time, [0, 0.25, 0.5, 0.75, 1.0], atol=1e-9)


def test_the_results_table_of_imagej_takes_a_frame_rate(csv: Path) -> None:
    csv.write_text(" ,Area,Mean,X,Y,Slice\n" + "".join(f"{k},12,80.5,{10 + k},{7},{k}\n" for k in range(1, 9)))
    options_ = {"position": "X", "x_unit": "0.25 mm"}
    with pytest.raises(InputError, match="frame numbers but no times; give frame_rate"):
        table_to_run.read(csv, ImportOptions(**options_))
    found = table_to_run.read(csv, ImportOptions(**options_, frame_rate_hz=400.0))
    np.testing.assert_allclose(found.run.time, np.arange(8) / 400, atol=1e-12)
    np.testing.assert_allclose(found.run.position, (11 + np.arange(8)) * 2.5e-4)


@pytest.mark.parametrize(
    ("t_size", "x_size", "question", "answer"),
    [
        (1, 1e3, "--x-unit mm?", {"x_unit": "mm"}),
        (1, 1e2, "--x-unit cm?", {"x_unit": "cm"}),
        (1e3, 1, "--t-unit ms?", {"t_unit": "ms"}),
        (1e6, 1, "--t-unit us?", {"t_unit": "us"}),
    ],
)
def test_a_unit_that_cannot_be_right_is_asked_for(
    csv: Path, t_size: float, x_size: float, question: str, answer: Any
) -> None:
    """Positions in mm used to make a belt of 220 m/s, silently."""
    time, x = sawtooth(400)
    make(csv, "t,x\n", zip(t_size * time, x_size * x, strict=True))
    with pytest.raises(InputError) as error:
        table_to_run.read(csv, options())
    assert question in error.value.as_line()
    found = table_to_run.read(csv, options(**answer))
    np.testing.assert_allclose(found.run.position, x, atol=1e-6)
    assert table_to_run.read(csv, options(x_unit="m", t_unit="s")).run.time[-1] == pytest.approx(t_size * time[-1])


def test_the_force_of_a_pulled_spring_is_its_stretch(csv: Path, app: cyclopts.App, capsys: Any) -> None:
    time, x = sawtooth(400)
    make(csv, "t (s),F (mN)\n", zip(time, 1e3 * 168 * x, strict=True))
    line = ["import", str(csv), "-o", str(csv.with_name("run.h5")), "--spring-force", "F", "--json"]
    assert application.run(app, line) == 2
    assert "--stiffness" in json.loads(capsys.readouterr().out)["error"]["do"]
    assert application.run(app, [*line, "--stiffness", "168 +- 2", "--belt", "42 um/s"]) == 0
    assert json.loads(capsys.readouterr().out)["warnings"] == []
    run = store.load(csv.with_name("run.h5"))
    np.testing.assert_allclose(run.position, x, atol=1e-6)
    assert (run.rig.stiffness, run.rig.belt_speed) == (Measured(168, 2), Measured(pytest.approx(42e-6)))


def test_a_force_over_the_weight_needs_the_mass_or_stays_in_its_units(csv: Path) -> None:
    time, x = sawtooth(400)
    make(csv, "t,Fnorm\n", zip(time, x, strict=True))
    force = {"spring_force": "Fnorm", "force_unit": "weight", "mass": None, "stiffness": Measured(168.0)}
    bare = table_to_run.read(csv, options(**force))
    np.testing.assert_allclose(bare.run.position, x, atol=1e-8)
    assert "units of weight / stiffness" in bare.warnings[0]
    assert bare.run.rig.stiffness is None
    with pytest.raises(InputError, match="belt is in SI"):
        table_to_run.read(csv, options(**force, belt_speed=Measured(4.2e-5)))
    known = table_to_run.read(csv, options(**force | {"mass": Measured(0.03)}))
    np.testing.assert_allclose(known.run.position, x * 0.03 * 9.80665 / 168, atol=1e-10)
    plain = table_to_run.read(csv, options(**force | {"force_unit": None}))
    np.testing.assert_allclose(plain.run.position, x / 168, atol=1e-10)
    assert "states no unit and is read in N" in plain.warnings[0]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"spring_force": "F", "position": "x"}, "excludes --position"),
        ({"force_unit": "N"}, "without --spring-force"),
        ({"clock": True, "t_unit": "s"}, "exclude each other"),
        ({"preamble": -1}, "--preamble"),
        ({"frame_rate_hz": 1e-300, "time": None}, "--frame-rate"),
        ({"frame_rate_hz": 1e-320, "time": None}, "--frame-rate"),  # a RuntimeWarning
        ({"frame_rate_hz": 1e308, "time": None}, "--frame-rate"),  # a rate of inf Hz
    ],
)
def test_flags_that_cannot_go_together_are_refused(csv: Path, changes: Any, words: str) -> None:
    csv.write_text("x\n1\n2\n3\n")
    with pytest.raises(InputError) as error:
        table_to_run.read(csv, ImportOptions(**changes))
    assert re.search(words, error.value.as_line())


@pytest.mark.parametrize(
    "text",
    [
        "t,x\n0,1\n1e12,2\n",
        "t,x\n0,1\n1,1e300\n",
        "t,x\n0,1\n1e-310,2\n2e-310,1\n",
        "sep=;\n",
        "\f\n",
        "x\n" + "1" * 140_000 + "x\n",
    ],
)
def test_wild_tables_end_in_one_line(csv: Path, text: str) -> None:
    """The first, the third and the fourth used to end in a traceback, or in a run of inf Hz."""
    csv.write_text(text)
    with pytest.raises(InputError):
        table_to_run.read(csv, ImportOptions(frame_rate_hz=1.0 if text.startswith("x") else None))


def test_progress_counts_the_lines_of_each_stage(csv, monkeypatch):
    for module in (lines, table):
        monkeypatch.setattr(module, "TOGETHER", 2000)
    done = []
    table_to_run.read(
        make(csv, "t,x\n", zip(*sawtooth(400), strict=True)), options(), lambda *stage: done.append(stage)
    )
    stages_of = (("reading lines", 4802), ("splitting lines", 4801), ("reading numbers", 4800))  # the last one is empty
    assert done == [(stage, begin, whole) for stage, whole in stages_of for begin in (0, 2000, 4000)]


def test_the_time_column_is_named_with_its_unit_or_as_times_of_day(csv):
    # A table of times of day was "read as: ... time from column 'clock' in time of day".
    rows = list(zip(*sawtooth(400), strict=True))[:40]
    found = table_to_run.read(make(csv, "t (s),x (m)\n", rows), ImportOptions())
    assert found.columns["time"] == "column 't (s)' in s"
    csv.write_text("clock,x (m)\n" + "".join(f"12:00:{t:09.6f},{x:.9g}\n" for t, x in rows))
    found = table_to_run.read(csv, ImportOptions(clock=True))
    assert found.columns["time"] == "column 'clock', times of day"


def test_a_run_file_is_named_as_what_it_is(csv):
    csv.write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(64))
    with pytest.raises(InputError, match="HDF5"):
        table_to_run.read(csv, ImportOptions())


def test_a_line_cut_short_is_counted_in_the_singular(csv):
    csv.write_text("t (s),x (m)\n" + "".join(f"{i / 100},0.0{i}\n" for i in range(9)) + "0.09\n")
    with pytest.raises(InputError, match="has 1 column where the others have 2"):
        table_to_run.read(csv, ImportOptions())
