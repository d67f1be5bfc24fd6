"""A camera's CSV becomes a run: formats found, bad lines named, a wrong frame rate noticed."""

import json
import math
from csv import reader
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from daq.cli.app import app
from daq.imports import layout, table, table_to_run
from daq.imports.options import ImportOptions
from daq.runfile import store
from stickslip import units
from stickslip.console import application
from stickslip.errors import InputError
from stickslip.units import Measured

MASS, STIFFNESS = 0.3, 10.5552  # pi sqrt(m/k) = 0.52963 s


def sawtooth(rate_hz, until=12.0, belt=0.22):
    """Stick at belt speed, then slip half a cosine in pi sqrt(m/k): turning points exactly that far apart."""
    slip = math.pi * math.sqrt(MASS / STIFFNESS)
    stick = 1.1
    reach = belt * stick / 2
    time = np.arange(round(until * rate_hz)) / rate_hz
    phase = time % (stick + slip)
    sticking = -reach + belt * phase
    slipping = reach * np.cos(math.pi * (phase - stick) / slip)
    return time, np.where(phase < stick, sticking, slipping)


def options(**changes):
    known: dict[str, Any] = {"mass": Measured(MASS), "stiffness": Measured(STIFFNESS)}
    return ImportOptions(**(known | {"started": "2024-05-01T12:00:00+02:00"} | changes))


def make(path, head, rows, *, delimiter=",", decimal=".", end="\n", **how):
    lines = [delimiter.join(f"{cell:.9g}".replace(".", decimal) for cell in row) for row in rows]
    text = head + "".join(line + end for line in lines)
    path.write_bytes(text.encode(how.get("encoding", "utf-8")))
    return path


@pytest.fixture
def csv(tmp_path):
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
    ("t|x\n", {"delimiter": "|", "decimal": ","}),
    ("Zeit [s];Weg [m]; Größe\n", {"delimiter": ";", "decimal": ",", "encoding": "cp1252", "wide": True}),
]


@pytest.mark.parametrize(("head", "how"), FORMATS)
def test_the_format_is_found(csv, head, how):
    time, x = sawtooth(100, 3)
    how = dict(how)
    columns = [time, x, x] if how.pop("wide", False) else [time, x]
    found = table_to_run.read(make(csv, head, zip(*columns, strict=True), **how), options())
    np.testing.assert_allclose(found.run.time, time, atol=1e-8)
    np.testing.assert_allclose(found.run.position, x, atol=1e-8)
    assert found.decimal == how.get("decimal", ".")


CELL = st.sampled_from(
    ["1", "-2.5", "+.5e3", "1e999", "nan", "", " 7 ", "\N{MINUS SIGN}3", "1,5", "x", "\u0663", "5.", "1_0"]
)


@given(
    st.lists(st.lists(CELL | st.floats().map(repr), min_size=1, max_size=3), max_size=12),
    st.sampled_from(".,"),
    st.booleans(),
)
def test_cells_converted_together_are_converted_as_one_by_one(rows, decimal, alike):
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
def test_a_line_without_quotes_is_split_as_csv_splits_it(delimiter, text):
    row = next(reader([text.strip(" ")], delimiter=delimiter, skipinitialspace=True), [])
    assert layout.split_cells(text, delimiter) == row


def servo_log():
    """Return a table below a preamble with numbers and a line of units, as a servo drive logs it."""
    lines = [f"{0.001 * k:.3f};{2 * k};{5 + k}" for k in range(12)]
    head = "Drive;AX-100\nSample time;0,001;s\nChannels;3\n\nTime;Torque;Position\ns;N;mm\n"
    return head + "\n".join(lines).replace(".", ",") + "\n"


RATE = {"frame_rate_hz": 400.0}
UNITS = "0,1\n2,3\n5,7\n"
NAMES = "i,Clock,laser A,laser B\n0,0.5,1,2\n1,0.6,3,4\n"
IMAGEJ = " ,Area,Mean,X,Y,Slice\n" + "".join(f"{k},12,80.5,{10 + k},7,{k}\n" for k in range(1, 4))
STAMPS = ("23:59:59.500", "23:59:59.750", "00:00:00.000", "0:00:00.250", "00:00:00.50")
MIDNIGHT = "clock,x\n" + "".join(f"{stamp},{k}\n" for k, stamp in enumerate(STAMPS))
SERVO = ((np.arange(12) * 1e-3).tolist(), ((5 + np.arange(12)) * 1e-3).tolist())


@pytest.mark.parametrize(
    ("text", "changes", "time", "position"),
    [
        # Units come from the flag or the header.
        (f"t,x\n{UNITS}", {}, [0, 2, 5], [1, 3, 7]),
        (f"t (ms),x (cm)\n{UNITS}", {}, [0, 2e-3, 5e-3], [1e-2, 3e-2, 7e-2]),
        (f"time [s],pos [mm]\n{UNITS}", {}, [0, 2, 5], [1e-3, 3e-3, 7e-3]),
        (f"t/ms,x/µm\n{UNITS}", {}, [0, 2e-3, 5e-3], [1e-6, 3e-6, 7e-6]),
        (f"time_s,position_m\n{UNITS}", {}, [0, 2, 5], [1, 3, 7]),
        (f"t,x\n{UNITS}", {"t_unit": "ms", "x_unit": "cm"}, [0, 2e-3, 5e-3], [1e-2, 3e-2, 7e-2]),
        (f"t,x (px)\n{UNITS}", {"x_unit": "0.25 mm"}, [0, 2, 5], [2.5e-4, 7.5e-4, 1.75e-3]),
        # A frame rate makes the times, or agrees with them.
        ("x\n1\n2\n3\n", RATE, [0, 1 / 400, 2 / 400], [1, 2, 3]),
        ("1,5\n2,5\n3,5\n", RATE | {"position": "1"}, [0, 1 / 400, 2 / 400], [1, 2, 3]),
        ("frame,x\n7,1\n8,2\n11,3\n", RATE, [0, 1 / 400, 4 / 400], [1, 2, 3]),
        ("x;y\n1;4\n2;5\n3;6\n", RATE | {"position": "y"}, [0, 1 / 400, 2 / 400], [4, 5, 6]),
        (IMAGEJ, RATE | {"position": "X", "x_unit": "0.25 mm"}, [0, 1 / 400, 2 / 400], [2.75e-3, 3e-3, 3.25e-3]),
        ("t,x\n0,1\n0.0025,2\n0.005,2\n0.00752,2\n", RATE, [0, 0.0025, 0.005, 0.00752], [1, 2, 2, 2]),
        # Columns are chosen by name or number.
        (NAMES, {"time": "Clock", "position": "laser B"}, [0, 0.1], [2, 4]),
        (NAMES, {"time": "clock", "position": "LASER B"}, [0, 0.1], [2, 4]),
        (NAMES, {"time": "2", "position": "4"}, [0, 0.1], [2, 4]),
        # Uneven times are kept; times of day go on after midnight.
        ("t,x\n0,1\n0.1,2\n0.35,2\n0.4,5\n", {}, [0, 0.1, 0.35, 0.4], [1, 2, 2, 5]),
        (MIDNIGHT, {"time": "clock", "clock": True}, [0, 0.25, 0.5, 0.75, 1.0], [0, 1, 2, 3, 4]),
        # A preamble with numbers and a line of units is passed over.
        (servo_log(), {}, *SERVO),
        (servo_log(), {"preamble": 4}, *SERVO),
        ("Rate,1000\n0,1\n1,2\n2,5\n", {"preamble": 1}, [0, 1, 2], [1, 2, 5]),
    ],
)
def test_a_table_is_read_as_its_header_and_the_options_say(csv, text, changes, time, position):
    csv.write_text(text)
    found = table_to_run.read(csv, ImportOptions(**changes))
    np.testing.assert_allclose(found.run.time, time, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(found.run.position, position, rtol=1e-12)
    assert found.warnings == ()
    assert found.even == (np.ptp(np.diff(time)) < 1e-9)


@pytest.mark.parametrize("belt", [0.22, -0.22])
def test_a_wrong_frame_rate_is_noticed_and_the_right_one_named(csv, belt):
    time, x = sawtooth(400, belt=belt)
    assert table_to_run.read(make(csv, "t,x\n", zip(time, x, strict=True)), options()).warnings == ()
    make(csv, "t,x\n", zip(time * 400 / 30, x, strict=True))  # a 400 fps film played at 30
    found = table_to_run.read(csv, options())
    assert "frame rate is probably wrong" in found.warnings[0]
    fitting = float(found.warnings[0].split(" would match")[0].split()[-1])
    assert fitting == pytest.approx(400, rel=0.01)
    corrected = table_to_run.read(csv, options(frame_rate_hz=400.0))
    np.testing.assert_allclose(corrected.run.time, time, atol=1e-6)
    assert len(corrected.warnings) == 1
    assert "times were multiplied by 0.075" in corrected.warnings[0]


@pytest.mark.parametrize(
    ("samples", "slower"), [(1.3, 1.0), (2.9, 64.0), (4.0, 1 / 128), (4.0, 1.0), (5.1, 64.0), (7.0, 1 / 128)]
)
def test_few_samples_a_slip_are_no_wrong_frame_rate_and_a_wrong_one_is_noticed_from_five_on(csv, samples, slower):
    """A slip lasts a whole number of samples."""
    slip = math.pi * math.sqrt(MASS / STIFFNESS)
    time, x = sawtooth(samples / slip, until=60.0)
    make(csv, "t [s],x [m]\n", zip(time * slower, x, strict=True))
    found = table_to_run.read(csv, options(stiffness=Measured(STIFFNESS / slower**2)))
    assert found.warnings == ()
    for factor in (0.125, 4.0) if samples > 5 else ():
        wrong = options(stiffness=Measured(STIFFNESS / (slower * factor) ** 2))
        assert "frame rate is probably wrong" in table_to_run.read(csv, wrong).warnings[0]


def test_a_track_without_a_whole_slip_says_that_nothing_was_checked(csv):
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
def test_quantities_are_read_in_si(text, dimension, value):
    assert units.quantity(text, dimension, "--flag") == pytest.approx(value, rel=1e-15)


@pytest.mark.parametrize("text", ["300 g +- 1 g", "0.3 ± 0.001", "300 +/- 1 g", "0.3 kg +- 1 g"])
def test_a_quantity_may_carry_its_error(text):
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
def test_what_is_no_quantity_is_refused(text, words):
    with pytest.raises(InputError) as error:
        units.measured(text, "mass", "--mass")
    for word in words:
        assert word in error.value.as_line()


@pytest.mark.parametrize(("flag", "value"), [("--x0", "-5 m"), ("--datum", "5 m")])
def test_a_rest_position_far_from_the_travel_is_asked_about(csv, capsys, flag, value):
    time, x = sawtooth(400)
    make(csv, "t (s),x (m)\n", zip(time, x, strict=True))
    line = ["import", str(csv), "-o", str(csv.with_name("run.h5")), flag, value, "--json"]
    assert application.run(app, line) == 0
    (asked,) = json.loads(capsys.readouterr().out)["warnings"]
    assert "x0 (-5 m) is" in asked
    assert "Are its sign and its unit correct?" in asked


def test_the_start_is_the_files_date_unless_given(csv):
    csv.write_text("t,x\n0,1\n1.5,2\n")
    given_start = table_to_run.read(csv, ImportOptions(started="2024-05-01T12:00:00+02:00")).run
    assert (given_start.started, given_start.ended) == ("2024-05-01T12:00:00+02:00", "2024-05-01T12:00:01.500000+02:00")
    assert "modification" in str(table_to_run.read(csv, ImportOptions()).run.provenance["start_time_from"])


def test_bad_lines_are_counted_and_left_out_on_request(csv, capsys):
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
    assert "6 lines (15 %) could not be read and were skipped: 5, 9, 13, 22, 23 and 1 more" in document["warnings"][0]
    run = store.load(csv.with_name("run.h5"))
    assert "skipped_lines = [5, 9, 13, 22, 23, 32]" in run.config_toml
    np.testing.assert_allclose(run.position[:5], np.array([0, 1, 2, 4, 5]) * 1e-3)


@pytest.mark.parametrize(
    ("t_size", "x_size", "question", "answer"),
    [
        (1, 1e3, "--x-unit=mm", {"x_unit": "mm"}),
        (1, 1e2, "--x-unit=cm", {"x_unit": "cm"}),
        (1e3, 1, "state the unit, perhaps --t-unit=ms;", {"t_unit": "ms"}),
        (1e6, 1, "state the unit, perhaps --t-unit=us;", {"t_unit": "us"}),
    ],
)
def test_a_unit_that_cannot_be_right_is_asked_for(csv, t_size, x_size, question, answer):
    time, x = sawtooth(400)
    make(csv, "t,x\n", zip(t_size * time, x_size * x, strict=True))
    with pytest.raises(InputError) as error:
        table_to_run.read(csv, options())
    assert question in error.value.as_line()
    found = table_to_run.read(csv, options(**answer))
    np.testing.assert_allclose(found.run.position, x, atol=1e-6)
    assert table_to_run.read(csv, options(x_unit="m", t_unit="s")).run.time[-1] == pytest.approx(t_size * time[-1])


def test_a_force_over_the_weight_needs_the_mass_or_stays_in_its_units(csv):
    time, x = sawtooth(400)
    make(csv, "t,Fnorm\n", zip(time, x, strict=True))
    force = {"spring_force": "Fnorm", "force_unit": "weight", "mass": None, "stiffness": Measured(168.0)}
    bare = table_to_run.read(csv, options(**force))
    np.testing.assert_allclose(bare.run.position, x, atol=1e-8)
    assert "units of weight / stiffness" in bare.warnings[0]
    assert bare.run.rig.stiffness is None
    with pytest.raises(InputError, match="belt_speed is in SI"):
        table_to_run.read(csv, options(**force, belt_speed=Measured(4.2e-5)))
    known = table_to_run.read(csv, options(**force | {"mass": Measured(0.03)}))
    np.testing.assert_allclose(known.run.position, x * 0.03 * 9.80665 / 168, atol=1e-10)
    plain = table_to_run.read(csv, options(**force | {"force_unit": None}))
    np.testing.assert_allclose(plain.run.position, x / 168, atol=1e-10)
    assert "has no unit, so N is assumed" in plain.warnings[0]


def test_the_time_column_is_named_with_its_unit_or_as_times_of_day(csv):
    rows = list(zip(*sawtooth(400), strict=True))[:40]
    found = table_to_run.read(make(csv, "t (s),x (m)\n", rows), ImportOptions())
    assert found.columns["time"] == "column 't (s)' in s"
    csv.write_text("clock,x (m)\n" + "".join(f"12:00:{t:09.6f},{x:.9g}\n" for t, x in rows))
    found = table_to_run.read(csv, ImportOptions(clock=True))
    assert found.columns["time"] == "column 'clock', times of day"
