"""What is no table, or says too little or too much, is refused in one short line that says where and what to give.

What a row says behind ``#`` is what used to happen.
"""

import os
import re
from dataclasses import fields
from zipfile import ZipFile

import h5py
import numpy as np
import pytest

import daq
from daq.imports import layout, source, table
from daq.imports.formats import columns as format_columns
from daq.imports.load import FLAGS
from daq.imports.options import ImportOptions
from stickslip.errors import InputError, in_python
from tests.daq.imports import programs

N = 600
TIME = np.arange(N) / 400
X = 0.02 * np.abs((TIME * 1.3) % 1 - 0.5)
TWO = "t,x\n0,1\n1,2\n"
FORCE = [("t", "s", TIME), ("F", "N", X)]
LENGTHS = [("t", "s", TIME), ("x", "mm", 1e3 * X), ("belt", "", X), ("z", "N", X)]
HDF5 = b"\x89HDF\r\n\x1a\n"
COUNT = "t (s),x (mm)\n0,1\n0.5,2\n1,3\n"

FLAG = re.compile(r"(?<![\w-])--([a-z][a-z0-9-]*)")
KEYWORDS = {field.name for field in fields(ImportOptions)} | set(FLAGS)

# A text, the options of `daq.load`, and words of the refusal, in either of its readings.
TEXTS = [
    # Lines and cells.
    ("t,x\n0,1\n0.1,lost\n", {}, ["line 3", "column 'x'", "'lost'", "correct"]),
    ("0,1\n0.1,\n0.2,3\n", {}, ["line 2", "column 2", "empty"]),
    ("t,x\n0,1\n0.1,nan\n", {}, ["line 3", "'nan'"]),
    ("t,x\n0,1\n1,2\n1,3\n", {}, ["line 4", "does not increase", "1 s after 1 s"]),
    ("t,x\n\n0,1\n# note\n2,2\n1,3\n", {}, ["line 6", "does not increase"]),
    ("t,x\n0,1\n1,2,3\n2,3\n", {}, ["line 3", "3 columns"]),
    ("t (s),x (m)\n0,1\n1,2\n2,3\n3\n", {}, ["has 1 column, but the others have 2"]),
    ("t,x\n0,10,1,25\n0,20,1,50\n", {}, ["line 1", "2 columns", "have 4", "semicolons"]),
    ("t,x\n0,1\n", {}, ["single sample"]),
    ("t,x\n", {}, ["has no numbers"]),
    ("", {}, ["is empty"]),
    ("# nothing\n", {}, ["has no data"]),
    ("a\0b", {}, ["not a text file"]),
    ("t,x\n0,1\n1e12,2\n", {}, []),  # this, the third and the fourth: a traceback, or a run of inf Hz
    ("t,x\n0,1\n1,1e300\n", {}, []),
    ("t,x\n0,1\n1e-310,2\n2e-310,1\n", {}, []),
    ("sep=;\n", {}, []),
    ("x\n" + "1" * 140_000 + "x\n", {"frame_rate": 1.0}, []),
    ("Rate,1000\n0,1\n1,2\n2,5\n", {}, ["line 1, column 1: column 1 contains 'Rate', not a number", "preamble 1"]),
    # Columns.
    ("a,b,c\n0,1,2\n1,2,3\n", {}, ["which column is the position", "a, b, c"]),
    ("x,b,c\n0,1,2\n1,2,3\n", {}, ["which column is the time", "--time"]),
    (TWO, {"position": "y"}, ["no column 'y'; the columns are: t, x"]),
    (TWO, {"time": "t", "position": "t"}, ["time and position are the same"]),
    (
        "t,x,x\n0,1,1\n1,2,2\n",
        {"position": "x"},
        ["which column is 'x': 'x' (column 2), 'x' (column 3)?; choose one with position=NUMBER"],
    ),
    ("t,x (m),x (mm)\n0,1,1\n1,2,2\n", {"position": "x"}, ["which column is 'x'"]),
    ("ms,x,y\ns,m,m\n0,1,1\n1,2,2\n", {"position": "x"}, ["'ms' is named like a unit, but its unit is stated as s"]),
    # Units.
    ("t,x (px)\n0,1\n1,2\n", {}, ["'px'", "--x-unit", "0.25 mm"]),
    (TWO, {"x_unit": "kg"}, ["--x-unit", "'kg'"]),
    (TWO, {"x_unit": "0 m"}, ["--x-unit", "zero"]),
    (TWO, {"x_unit": "cmm"}, ["'cmm' is not a unit of length; did you mean 'mm'?"]),
    ("t,y,x (m)\n0,1,1\n1,2,2\n", {"belt_column": "y", "position": "x", "time": "t"}, ["has no unit"]),
    # Times.
    ("x\n1\n2\n", {}, ["no column of times", "--frame-rate"]),
    ("frame,x\n1,2\n2,3\n", {}, ["frame numbers", "--frame-rate"]),
    (
        " ,Area,X,Y,Slice\n1,12,11,7,1\n2,12,12,7,2\n",
        {"position": "X", "x_unit": "1 mm"},
        ["frame numbers but no times"],
    ),
    ("clock,x\n23:59:59.500,0\n23:59:59.750,1\n", {"time": "clock"}, ["times of day such as 23:59:59.500; pass clock"]),
    (
        "t,x\n25-Mar-2026 10:00:01,1\n27-Mar-2026 10:00:02,2\n",
        {"clock": True},
        ["line 3", "with or without a date such as 2026-03-27"],
    ),
    ("x\n1\n2\n3\n", {"frame_rate": 1e-320}, ["--frame-rate"]),
    ("x\n1\n2\n3\n", {"frame_rate": 1e308}, ["--frame-rate"]),
    (TWO, {"start": "yesterday"}, ["--start", "zone"]),
    # Options.
    (TWO, {"xunit": "cm"}, ["'xunit' is not an option for tables; did you mean 'x_unit'?"]),
    (TWO, {"mass": "heavy"}, ["'heavy' is not a valid mass; write it like '300 g'"]),
    (TWO, {"spring_force": "F", "position": "x"}, ["cannot be combined with --position"]),
    ("t (s),F (N)\n0,1\n1,2\n", {"spring_force": "F"}, ["spring_force requires the stiffness of the spring"]),
    (TWO, {"force_unit": "N"}, ["requires --spring-force"]),
    (TWO, {"clock": True, "t_unit": "s"}, ["cannot be combined"]),
    (TWO, {"preamble": -1}, ["--preamble"]),
    (TWO, {"belt_unit": "mm"}, ["belt_unit requires belt_column"]),
    # What a count is.
    (
        COUNT,
        {"counts_per_rev": 100},
        ["counts_per_rev requires circumference; add circumference, or use metres_per_count"],
    ),
    (
        COUNT,
        {"circumference": "1 mm"},
        ["circumference requires counts_per_rev; add counts_per_rev, or use metres_per_count"],
    ),
    (
        COUNT,
        {"counts_per_rev": 0, "circumference": "1 mm"},
        ["counts_per_rev: is 0; use a positive whole number"],
    ),
    (COUNT, {"counts_per_rev": 9, "circumference": 0}, ["metres_per_count is 0; it must be not zero"]),
    (COUNT, {"metres_per_count": 1e-6, "counts_per_rev": 9, "circumference": 1}, ["use one or the other"]),
    (COUNT, {"metres_per_count": 1e-6, "x_unit": "mm"}, ["x_unit cannot be combined with metres per count"]),
    (
        COUNT,
        {"metres_per_count": 1e-6},
        ["is a length, but metres per count are given; omit metres_per_count"],
    ),
]


def fifo(path):
    os.mkfifo(path / "a.csv")
    return path / "a.csv"


def device(path):
    (path / "zero.csv").symlink_to("/dev/zero")
    return path / "zero.csv"


def folder(path):
    (path / "a.csv").mkdir()
    return path / "a.csv"


def sparse(path):
    with (path / "a.csv").open("wb") as file:
        file.truncate(source.MOST_BYTES + 1)
    return path / "a.csv"


def content(name, data):
    """Return what writes a file of this name and content into a folder."""

    def write(path):
        (path / name).write_bytes(data)
        return path / name

    return write


def matlab(path, fill):
    with h5py.File(path / "a.mat", "w", userblock_size=512) as file:
        file["t"] = TIME[None]
        fill(file)
    with (path / "a.mat").open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\0\2IM")
    return path / "a.mat"


def stored_elsewhere(path):
    (path / "secret").write_bytes(b"TOPSECRET!" * 60)
    outside = [(str(path / "secret"), 0, N)]
    return matlab(path, lambda file: file.create_dataset("x", shape=(1, N), dtype="u1", external=outside))


def linked_run(path):
    os.mkfifo(path / "pipe")
    with h5py.File(path / "run.h5", "w") as file:
        file["entry"] = h5py.ExternalLink(str(path / "pipe"), "/entry")
    return path / "run.h5"


def many_columns(path):
    return matlab(path, lambda file: file.create_dataset("a", data=np.zeros((200_000, 2)), compression="gzip"))


def mat5(path, **variables):
    from scipy.io import savemat

    savemat(path / "a.mat", variables)
    return path / "a.mat"


def complex_mat5(path):
    """Write a file whose numbers are complex, which crashes the library."""
    target = mat5(path, t=np.arange(40) / 100, x=np.arange(40.0))
    data = bytearray(target.read_bytes())
    assert data[144:146] == b"\x06\x00"  # class and flags of the first variable
    data[145] |= 8
    target.write_bytes(data)
    return target


def text(rows):
    return lambda path: programs.text(path / "t.csv", rows)


def lvm(path, dimension):
    target = programs.lvm(path / "t.lvm", LENGTHS)
    target.write_bytes(target.read_bytes().replace(b"X_Dimension\tTime", b"X_Dimension\t" + dimension.encode()))
    return target


def workbook(path, change):
    from openpyxl import load_workbook

    target = programs.xlsx(path / "t.xlsx", LENGTHS, above=["Rig 3"])
    book = load_workbook(target)
    change(book)
    book.save(target)
    return target


def overload(book):
    book.active["B12"] = "overload"


def second_sheet(book):
    book.copy_worksheet(book["Messung 1"]).title = "second"


# What makes a file in a folder, and the rest as above.
FILES = [
    (fifo, {}, "is a pipe, not a file"),  # blocked for ever
    (device, {}, "is a device, not a file"),  # filled the memory
    (folder, {}, "is a folder"),
    (lambda path: path / "none.csv", {}, "no such file; check the path"),
    (sparse, {}, "a table may have at most 268 MB"),
    (content("a.csv", b"\n" * (source.MOST_LINES + 1)), {}, "8,388,609 lines, but a table may have at most 8,388,608"),
    (content("a.csv", (b"1," * 4999 + b"1\n") * 3), {}, "5,000 columns, but a table may have at most 4,096"),
    (content("a.csv", HDF5 + bytes(64)), {}, "HDF5"),
    (stored_elsewhere, {}, "reads its data from another file"),  # any file of the reader's became positions
    (linked_run, {}, "is a link to another file"),  # waited 80 s for the pipe
    (many_columns, {}, "200,000 columns"),  # a message of 20 MB
    # Damaged files.
    (content("t.xlsx", b"PK\x03\x04 nothing"), {}, "is not a workbook"),
    (content("t.tdms", b"TDSm" + b"\xff" * 60), {}, "has no channel of numbers"),
    (content("t.mat", b"MATLAB 7.3 MAT-file".ljust(512) + HDF5 + bytes(90)), {}, "is not a MATLAB file"),
    (content("fake.mat", b"t,x\n0,1\n"), {}, "is not a MATLAB file"),
    (lambda path: mat5(path, name="nothing"), {}, "has no vector"),
    (lambda path: mat5(path, t=TIME, qm=X), {"position": "q"}, "qm"),
    (
        lambda path: mat5(path, t=TIME, x=np.c_[X, -X], x_1=X),
        {"position": "x_1", "x_unit": "m"},
        "which column is 'x_1': 'x_1' (column 2), 'x_1' (column 4)",
    ),
    (complex_mat5, {}, "it crashes the library"),
    (content("t.lvm", b"LabVIEW Measurement\t\r\nWriter_Version\t2\r\n"), {}, "its header does not end"),
    (
        content("t.lvm", b"LabVIEW Measurement\t\n***End_of_Header***\n\nX_Value\ty\tComment\n"),
        {},
        "has no numbers",
    ),
    (lambda path: lvm(path, "Frequency"), {}, "X_Dimension is 'Frequency'"),
    (
        lambda path: workbook(path, overload),
        {"position": "x"},
        "t.xlsx, line 12, column 2: column 'x (mm)' contains 'overload'",
    ),
    (
        lambda path: workbook(path, second_sheet),
        {},
        "which sheet is the table? 'Messung 1', 'second'; choose one with sheet",
    ),
    (
        lambda path: workbook(path, second_sheet),
        {"sheet": "third"},
        "no sheet 'third'; the sheets are: 'Messung 1', 'second'",
    ),
    # Columns of forces, speeds and belts.
    (text(FORCE), {}, "--stiffness '168 N/m'; else choose"),
    (text([*FORCE, ("COF", "", X), ("v", "mm/s", X)]), {}, "which column is the position?"),
    (text([*FORCE, ("COF", "", X), ("v", "mm/s", X)]), {}, "spring_force='F'"),
    (text([*FORCE, ("v", "mm/s", X)]), {"position": "v"}, "is in mm/s, so it is a speed and not a position"),
    (
        text(LENGTHS),
        {"belt_column": "belt"},
        "has no unit: is it the position or the speed of the belt?; use belt_unit",
    ),
    (text(LENGTHS), {"belt_column": "belt", "belt_unit": "kg"}, "'kg' is not a unit of length or speed"),
    (text(LENGTHS), {"belt_column": "z"}, "'N' is not a unit of length or speed"),
]


def refusal(path, options):
    with pytest.raises(InputError) as caught:
        daq.load(path, **options)
    assert "\n" not in caught.value.as_line()
    assert len(str(caught.value)) < 1000 + len(str(path))
    typed = caught.value.as_line()
    if in_python(typed) == str(caught.value):  # no call for Python stands beside what to type
        assert {name.replace("-", "_") for name in FLAG.findall(typed)} <= KEYWORDS, typed
    return f"{caught.value.as_line()} | {caught.value}"


@pytest.mark.parametrize(("written", "options", "words"), TEXTS, ids=[repr(row[:2])[:60] for row in TEXTS])
def test_a_table_is_refused_by_line_column_and_option(tmp_path, written, options, words):
    (tmp_path / "a.csv").write_text(written)
    said = refusal(tmp_path / "a.csv", options)
    assert [word for word in words if word not in said] == [], said


@pytest.mark.parametrize(("make", "options", "words"), FILES, ids=[row[2] for row in FILES])
def test_a_file_that_is_not_one_table_is_refused(tmp_path, make, options, words):
    assert words in refusal(make(tmp_path), options)


@pytest.mark.parametrize("suffix", ["xlsx", "tdms"])
def test_a_library_that_is_missing_is_named_with_the_extra(tmp_path, monkeypatch, suffix):
    monkeypatch.setattr(format_columns, "find_spec", lambda name: None)
    path = tmp_path / f"t.{suffix}"
    with ZipFile(path, "w") as file:
        file.writestr("nothing", "")
    assert re.search(re.escape("pip install 'stickslip[formats]'"), refusal(path, {}))


def test_a_line_longer_than_a_table_has_is_refused_unread(tmp_path, monkeypatch):
    path = tmp_path / "long.csv"
    path.write_text("t,x\n0,1\n" + "1," * table.LONGEST_LINE + "\n0.1,2\n")
    monkeypatch.setattr(layout, "split_cells", lambda *_: pytest.fail("a line was split"))
    said = refusal(path, {})
    assert f"{path}, line 3: the line has {2 * table.LONGEST_LINE} characters" in said
    assert "delete that line; if the table begins below it, use --preamble 3" in said
