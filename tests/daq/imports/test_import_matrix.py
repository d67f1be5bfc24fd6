"""What labs have: formats, units, forces and belt columns, of files made as the programs make them; no silent unit."""

import json
from itertools import cycle

import numpy as np
import pytest

import daq
from daq.cli.app import app
from stickslip.console import application
from stickslip.errors import InputError
from stickslip.units import Measured
from tests.daq.imports import programs

RATE = 250.0
TIME = np.arange(500) / RATE
BELT = 0.05 * TIME  # m
X = 0.02 * np.sin(6 * TIME) + 0.001 * np.sin(40 * TIME)  # m
SIZES = {
    "m": 1.0,
    "mm": 1e3,
    "cm": 1e2,
    "um": 1e6,
    "s": 1.0,
    "ms": 1e3,
    "us": 1e6,
    "N": 1.0,
    "mN": 1e3,
    "kgf": 1 / 9.80665,
}
STIFFNESS = 168.0


def columns(x_unit="mm", t_unit="s", names=("Time", "x")):
    return [(names[0], t_unit, TIME * SIZES[t_unit]), (names[1], x_unit, X * SIZES[x_unit])]


FORMATS = {
    "csv": lambda path, own: programs.text(path / "t.csv", own),
    "csv, semicolons and decimal commas": lambda path, own: programs.text(
        path / "t.csv", own, delimiter=";", decimal=",", encoding="utf-8-sig", end="\r\n"
    ),
    "tabs, units in a line": lambda path, own: programs.text(path / "t.txt", own, delimiter="\t", units="below"),
    "UTF-16 with a preamble": lambda path, own: programs.text(
        path / "t.txt", own, delimiter="\t", encoding="utf-16", above=["Drive 3", "Gain\t7.5", ""]
    ),
    "numpy.savetxt": lambda path, own: programs.numpy_text(path / "t.dat", own),
    "LabVIEW": lambda path, own: programs.lvm(path / "t.lvm", own),
    "LabVIEW, decimal commas": lambda path, own: programs.lvm(path / "t.lvm", own, decimal=","),
    "LabVIEW, decimal commas of version 1": lambda path, own: programs.lvm(
        path / "t.lvm", own, decimal=",", version="1"
    ),
    "LabVIEW, commas": lambda path, own: programs.lvm(path / "t.lvm", own, separator=","),
    "LabVIEW, no X column": lambda path, own: programs.lvm(path / "t.lvm", own, x_columns="No"),
    "LabVIEW, an X column each": lambda path, own: programs.lvm(path / "t.lvm", [*own, own[1]][:2], x_columns="Multi"),
    "LabVIEW, a header each segment": lambda path, own: programs.lvm(path / "t.lvm", own, multi=True, segments=5),
    "LabVIEW, segments that begin anew": lambda path, own: programs.lvm(
        path / "t.lvm", own, multi=True, segments=5, restart=True
    ),
    "LabVIEW, segments without X": lambda path, own: programs.lvm(
        path / "t.lvm", own, multi=True, segments=5, restart=True, x_columns="No"
    ),
    "workbook": lambda path, own: programs.xlsx(path / "t.xlsx", own),
    "workbook with text above and units in a line": lambda path, own: programs.xlsx(
        path / "t.xlsx", own, above=["Rig 3", "22 July"], units_below=True, others=["Notizen"]
    ),
    "TDMS waveform": lambda path, own: programs.tdms(path / "t.tdms", own),
    "TDMS with a channel of times": lambda path, own: programs.tdms(path / "t.tdms", own, waveform=False),
}


UNITS = ("mm", "cm", "um")


@pytest.mark.parametrize(("form", "unit"), [*zip(FORMATS, cycle(UNITS), strict=False), ("csv", "cm"), ("csv", "um")])
def test_every_format_is_read_with_the_units_it_states(tmp_path, form, unit):
    run = daq.load(FORMATS[form](tmp_path, columns(unit)))
    np.testing.assert_allclose(run.time, TIME, atol=1e-6)
    np.testing.assert_allclose(run.position, X, atol=1e-6 / SIZES[unit] + 1e-9)
    assert run.rate_hz == pytest.approx(RATE, rel=1e-4)


# Programs that state no units: what is given is what counts.
BARE = {
    "MATLAB 5": lambda path, own: programs.mat5(path / "t.mat", own),
    "MATLAB 5, a structure": lambda path, own: programs.mat5(path / "t.mat", own, struct="data"),
    "MATLAB 7.3": lambda path, own: programs.mat73(path / "t.mat", own),
    "MATLAB 7.3, a structure": lambda path, own: programs.mat73(path / "t.mat", own, struct="data"),
    "Tracker": lambda path, own: programs.tracker(path / "t.txt", own),
    "Tracker, decimal commas": lambda path, own: programs.tracker(path / "t.txt", own, decimal=","),
}


@pytest.mark.parametrize(
    ("form", "unit", "t_unit"),
    [(form, *units) for form, units in zip(BARE, cycle([("mm", "s"), ("m", "ms"), ("um", "ms")]), strict=False)],
)
def test_a_unit_that_a_program_does_not_state_is_given(tmp_path, form, unit, t_unit):
    path = BARE[form](tmp_path, columns(unit, t_unit, ("t", "x")))
    names = {"time": "data.t", "position": "data.x"} if "structure" in form else {}
    run = daq.load(path, x_unit=unit, t_unit=t_unit, **names)
    np.testing.assert_allclose(run.time, TIME, atol=1e-8)
    np.testing.assert_allclose(run.position, X, atol=1e-9)


@pytest.mark.parametrize("form", [*BARE, "csv"])
def test_a_unit_that_cannot_be_is_asked_for_and_not_guessed(tmp_path, form):
    own = [("t", "", TIME), ("x", "", 4e3 * X)]
    path = (BARE | FORMATS)[form](tmp_path, own)
    names = {"time": "data.t", "position": "data.x"} if "structure" in form else {}
    with pytest.raises(InputError, match="the positions have no unit, and in metres the mass"):
        daq.load(path, **names)
    np.testing.assert_allclose(daq.load(path, x_unit="0.25 mm", **names).position, X, atol=1e-8)


def test_si_that_is_assumed_is_said(tmp_path, capsys):
    path = programs.text(tmp_path / "t.csv", [("t", "", TIME), ("x", "", X)])
    assert application.run(app, ["import", str(path), "-o", str(tmp_path / "run.h5")]) == 0
    assert "no units found; assuming m and in s" in capsys.readouterr().out
    path = programs.text(tmp_path / "u.csv", columns())
    assert application.run(app, ["import", str(path), "-o", str(tmp_path / "run.h5"), "--force"]) == 0
    assert "no units found" not in capsys.readouterr().out


@pytest.mark.parametrize("decimal", [".", ","])
def test_a_text_of_kinovea_takes_its_names_from_its_comment(tmp_path, decimal):
    new = programs.kinovea(tmp_path / "new.txt", 1e3 * X, X, RATE, codes=False, decimal=decimal)
    found = daq.load(new, x_unit="mm", t_unit="ms")
    np.testing.assert_allclose(found.position, X, atol=1e-5)
    np.testing.assert_allclose(found.time, TIME, atol=1e-6)
    old = programs.kinovea(tmp_path / "old.txt", 1e3 * X, X, RATE, decimal=decimal)
    with pytest.raises(InputError, match=r"contains time codes, .* frames or hundredths; .*frame_rate"):
        daq.load(old, x_unit="mm")
    found = daq.load(old, x_unit="mm", frame_rate="250 fps")
    np.testing.assert_allclose(found.time, TIME, atol=1e-9)


# Forces: the column's unit, and the stretch that a newton is.
@pytest.mark.parametrize(
    ("form", "unit"),
    [
        ("csv", "N"),
        ("csv", "mN"),
        ("numpy.savetxt", "N"),
        ("LabVIEW", "mN"),
        ("workbook", "kgf"),
        ("TDMS waveform", "N"),
    ],
)
def test_a_column_of_forces_suggests_the_spring_and_is_read_as_its_stretch(tmp_path, form, unit):
    force = ("Fx", unit, STIFFNESS * X * SIZES[unit])
    path = FORMATS[form](tmp_path, [columns()[0], force])
    with pytest.raises(InputError) as caught:
        daq.load(path)
    assert f"is in {unit}: a force, not a position" in str(caught.value)
    name = f"Fx_{unit}" if "numpy" in form else "Fx"
    assert f"spring_force='{name}', stiffness='168 N/m'" in str(caught.value)
    assert "--stiffness '168 N/m'; else choose" in caught.value.as_line()
    assert "pixel" not in caught.value.as_line()
    run = daq.load(path, spring_force="Fx", stiffness="168 N/m", belt="5 cm/s")
    np.testing.assert_allclose(run.position, X, atol=2e-6)
    assert run.rig.belt_speed == Measured(0.05)


@pytest.mark.parametrize("name", ["F", "Load cell", "Kraft"])
def test_a_column_called_a_force_is_no_position_in_metres(tmp_path, name):
    path = programs.text(tmp_path / "t.csv", [("t", "s", TIME), (name, "", STIFFNESS * X)])
    with pytest.raises(InputError, match=r"is a force by its name, not a position; .*spring_force=.*force_unit='N'"):
        daq.load(path)
    run = daq.load(path, spring_force=name, stiffness=168, force_unit="N")
    np.testing.assert_allclose(run.position, X, atol=1e-8)
    np.testing.assert_allclose(daq.load(path, x_unit="mm").position, 1e-3 * STIFFNESS * X, atol=1e-8)


@pytest.mark.parametrize(
    ("name", "unit"), [("COF", ""), ("mu", ""), ("µ", ""), ("Friction coefficient", ""), ("y", "-")]
)
def test_a_friction_coefficient_is_asked_about_and_never_metres(tmp_path, name, unit):
    path = programs.text(tmp_path / "t.csv", [("t", "s", TIME), (name, unit, 0.3 + 10 * X)])
    for position in ({}, {"position": 2}):
        with pytest.raises(
            InputError, match="not a position; if it is the force of a pulling spring divided by"
        ) as caught:
            daq.load(path, **position)
    assert "--force-unit weight" in caught.value.as_line()
    run = daq.load(path, spring_force=2, force_unit="weight", mass="5 kg", stiffness=STIFFNESS)
    np.testing.assert_allclose(run.position, (0.3 + 10 * X) * 5 * 9.80665 / STIFFNESS, rtol=1e-6)


def test_the_one_column_with_a_length_is_the_position(tmp_path):
    own = [("clock", "s", TIME), ("Fx", "N", X), ("track", "mm", 1e3 * X), ("COF", "", X), ("v", "mm/s", X)]
    np.testing.assert_allclose(daq.load(programs.text(tmp_path / "t.csv", own)).position, X, atol=1e-8)


# A belt that was measured: its column, what it holds, and its unit.
BELTS = {
    "its position in mm": ("belt", "mm", 1e3 * BELT),
    "its position in cm": ("belt", "cm", 1e2 * BELT),
    "its speed in mm/s": ("stage", "mm/s", np.full(TIME.size, 50.0)),
    "its speed in m/min": ("stage", "m/min", np.full(TIME.size, 3.0)),
}


@pytest.mark.parametrize(
    ("form", "belt"),
    [
        *(("csv", belt) for belt in BELTS),
        *zip(("LabVIEW", "LabVIEW, an X column each", "workbook", "TDMS waveform"), BELTS, strict=True),
    ],
)
def test_a_column_of_the_belt_becomes_its_counts(tmp_path, form, belt):
    own = [*columns(), BELTS[belt]]
    path = programs.lvm(tmp_path / "t.lvm", own, x_columns="Multi") if "each" in form else FORMATS[form](tmp_path, own)
    run = daq.load(path, belt_column=BELTS[belt][0])
    moved = run.belt_count * run.rig.belt_metres_per_count.value
    np.testing.assert_allclose(moved - moved[0], BELT, atol=2e-8)
    np.testing.assert_allclose(run.belt_velocity, 0.05, atol=1e-5)
    np.testing.assert_allclose(run.position, X, atol=1e-6)


def test_a_belt_whose_unit_is_given_is_read_and_said(tmp_path, capsys):
    path = programs.text(tmp_path / "t.csv", [*columns(), ("belt", "", 1e3 * BELT)])
    run = daq.load(path, belt_column="belt", belt_unit="mm")
    np.testing.assert_allclose(run.belt_velocity, 0.05, atol=1e-5)
    line = ["import", str(path), "-o", str(tmp_path / "run.h5"), "--belt-column", "belt", "--belt-unit", "mm"]
    assert application.run(app, line) == 0
    assert "belt from column 'belt' in mm, its position" in capsys.readouterr().out
    np.testing.assert_array_equal(daq.load(tmp_path / "run.h5").belt_count, run.belt_count)


# Counts of an encoder in a table.
@pytest.mark.parametrize(
    "flags",
    [
        ["--metres-per-count", "7.67 um"],
        ["--counts-per-rev", "16384", "--circumference", f"{16384 * 7.67e-3} mm +- 0.1 mm"],
    ],
)
def test_counts_of_a_table_become_metres(tmp_path, capsys, flags):
    count = np.rint(X / 7.67e-6)
    path = programs.text(tmp_path / "t.csv", [("t", "s", TIME), ("encoder", "counts", count)])
    line = ["import", str(path), "-o", str(tmp_path / "run.h5"), "--json"]
    assert application.run(app, line) == 2
    assert "--metres-per-count" in json.loads(capsys.readouterr().out)["error"]["do"]
    assert application.run(app, [*line, *flags]) == 0
    run = daq.load(tmp_path / "run.h5")
    np.testing.assert_array_equal(run.count, count)
    np.testing.assert_allclose(run.position, count * 7.67e-6, atol=1e-12)
    assert run.rig.metres_per_count.value == pytest.approx(7.67e-6)
    assert run.rig.counts_per_revolution == (16384 if len(flags) > 2 else None)
    replayed = ["replay", str(tmp_path / "run.h5"), "-o", str(tmp_path / "two.h5"), "--metres-per-count", "-1 um"]
    assert application.run(app, replayed) == 0
    np.testing.assert_allclose(daq.load(tmp_path / "two.h5").position, count * -1e-6, atol=1e-12)


def test_the_sheet_of_a_workbook_is_chosen_and_its_bad_cells_are_left_out(tmp_path):
    from openpyxl import load_workbook

    path = programs.xlsx(tmp_path / "t.xlsx", columns(), above=["Rig 3"])
    book = load_workbook(path)
    book.copy_worksheet(book["Messung 1"]).title = "second"
    book["second"]["B12"] = "overload"
    book.save(path)
    np.testing.assert_allclose(daq.load(path, sheet="Messung 1").position, X, atol=1e-9)
    with pytest.warns(UserWarning, match="1 lines .* skipped: 12"):
        assert daq.load(path, sheet="second", skip_bad=True).time.size == TIME.size - 1


def test_segments_whose_times_nobody_knows_are_measurements_of_their_own(tmp_path):
    path = programs.lvm(tmp_path / "t.lvm", columns(), multi=True, segments=2, restart=True)
    path.write_bytes(path.read_bytes().replace(b"Date\t", b"Day\t"))
    with pytest.raises(
        InputError, match=r"has 2 measurements, which begin at line 24, line \d+; choose one with segment 1"
    ):
        daq.load(path)
    second = daq.load(path, segment=2)
    np.testing.assert_allclose(second.position, X[TIME.size // 2 :], atol=1e-6)
    np.testing.assert_allclose(daq.load(path, segment=0).time, TIME - TIME[0], atol=1e-9)


def test_when_it_was_recorded_is_kept_with_the_run(tmp_path):
    run = daq.load(programs.lvm(tmp_path / "t.lvm", columns()))
    assert 'recorded = "2019/07/22 17:18:18.5"' in run.config_toml
