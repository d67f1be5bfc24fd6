"""Files of strangers: one door, times of their own channel, rows of units, counters that roll over, dates, segments.

Each row says what used to happen.
"""

import hashlib
import zipfile

import numpy as np
import pytest

import daq
from daq.wire.roll_over import find_roll_over, survey_roll_over, unroll
from stickslip.errors import InputError

N = 600
TIME = np.arange(N) / 400
X = 0.02 * np.abs((TIME * 1.3) % 1 - 0.5)


def _text(path, rows, head="t,x\n"):
    path.write_text(head + "".join(f"{row}\n" for row in rows))
    return path


def _pairs(time=TIME, x=X, form="{:.6f}"):
    return [f"{form.format(a)},{b:.7f}" for a, b in zip(time, x, strict=True)]


def test_the_hash_is_that_of_the_bytes_that_were_read(tmp_path):
    path = _text(tmp_path / "a.csv", _pairs())
    assert hashlib.sha256(path.read_bytes()).hexdigest() in daq.load(path, x_unit="m").config_toml


# A time belongs to its channel.
def _lvm(path, *, steps=(0.001, 0.002), rows=N):
    head = "LabVIEW Measurement\t\nSeparator\tTab\nDecimal_Separator\t.\nX_Columns\tNo\n***End_of_Header***\t\n\t\n"
    head += f"Channels\t2\nSamples\t{N}\t{N}\nY_Unit_Label\tN\tm\nX_Dimension\tTime\tTime\nX0\t0.0\t0.0\n"
    head += f"Delta_X\t{steps[0]}\t{steps[1]}\n***End_of_Header***\t\nX_Value\tF\tPos\tComment\n"
    return _text(path, [f"\t3.0\t{x:.7f}" for x in np.resize(X, rows)], head=head)


def _tdms(path):
    from nptdms import ChannelObject, TdmsWriter

    with TdmsWriter(str(path)) as writer:
        force = ChannelObject("g", "F", X, {"wf_increment": 0.001, "unit_string": "N"})
        position = ChannelObject("g", "Pos", X, {"wf_increment": 0.002, "unit_string": "m"})
        writer.write_segment([force, position])
    return path


@pytest.mark.parametrize("make", [lambda path: _lvm(path / "a.lvm"), lambda path: _tdms(path / "a.tdms")])
def test_a_position_has_the_times_of_its_own_channel(tmp_path, make):
    path = make(tmp_path)
    assert daq.load(path, position="Pos").time[-1] == pytest.approx(0.002 * (N - 1))  # was 0.001
    with pytest.raises(InputError, match="contains the times of another channel than column 'Pos"):
        daq.load(path, position="Pos", time="1")


# What a measurement is.
@pytest.mark.parametrize(
    ("make", "starts"),
    [
        (lambda path: _lvm(path / "a.lvm", steps=(0.002, 0.002), rows=2 * N), 2),  # joined without a word
        (lambda path: _text(path / "a.csv", [*_pairs(), "t,x", *_pairs()]), 2),  # "holds 't', not a number"
        (lambda path: _text(path / "a.csv", [*_pairs(), *_pairs(), *_pairs()]), 3),  # "time does not increase"
    ],
)
def test_of_several_measurements_one_is_chosen(tmp_path, make, starts):
    path = make(tmp_path)
    options = {} if path.suffix == ".lvm" else {"x_unit": "m"}
    with pytest.raises(
        InputError, match=rf"has {starts} measurements, .*choose one with segment 1 to segment {starts}"
    ):
        daq.load(path, **options)
    for number in range(1, starts + 1):
        run = daq.load(path, segment=number, **options)
        np.testing.assert_allclose(run.position, X, atol=1e-7)
    assert daq.load(path, segment=0, **options).time.size == starts * N
    with pytest.raises(InputError, match=f"the file has {starts} measurements; choose 1 to {starts}"):
        daq.load(path, segment=starts + 1, **options)


# Rows of units, preambles, names.
@pytest.mark.parametrize(
    ("unit", "time"), [("V", "s"), ("degC", "sec"), ("g", "s"), ("%", "sec"), ("mm/sec", "s"), ("", "sec"), ("-", "s")]
)
def test_a_row_of_units_keeps_the_names_whatever_the_other_unit(tmp_path, unit, time):
    rows = [f"{a:.4f},{1e3 * b:.5f},1.2" for a, b in zip(TIME, X, strict=True)]
    run = daq.load(_text(tmp_path / "a.csv", rows, head=f"t,x,F\n{time},mm,{unit}\n"))
    np.testing.assert_allclose(run.position, X, atol=1e-8)  # was read in m: a factor of 1000


@pytest.mark.parametrize(
    ("head", "rows"),
    [
        ("ms,mm\n", [f"{1e3 * a:.4f},{1e3 * b:.5f}" for a, b in zip(TIME, X, strict=True)]),
        ("Recipe,Averaging,Rate,\nTest.Rx,100,1000,\nTime (s),X (m),\n", [f"{row}," for row in _pairs()]),
        ("Time (s),X (m),\n", [f"{row}," for row in _pairs()]),
        ("=~=~=~=~= PuTTY log 2026.05.06 =~=~=~=~=\nt,x (m)\n", _pairs()),
        ("", [f"12:00:{a:06.3f} -> {a:.4f},{b:.7f}" for a, b in zip(TIME, X, strict=True)]),
    ],
)
def test_how_programs_write_tables(tmp_path, head, rows):
    run = daq.load(_text(tmp_path / "a.csv", rows, head=head), **({} if head else {"x_unit": "m"}))
    np.testing.assert_allclose(run.position, X, atol=1e-7)
    np.testing.assert_allclose(run.time, TIME, atol=2e-4)


def test_a_column_of_a_matrix_is_chosen_by_its_number(tmp_path):
    from scipy.io import savemat

    savemat(tmp_path / "a.mat", {"t": TIME, "x": np.stack([X, -X], axis=1), "x_1": 2 * X})
    np.testing.assert_allclose(daq.load(tmp_path / "a.mat", position="4", x_unit="m").position, 2 * X)


# Counters.
def _motion():
    """Return stick and slip in counts: 78 counts a sample at most."""
    phase = np.arange(4000) % 100
    return np.rint(-31_500 - 4 * np.cumsum(np.where(phase < 80, 5.0, -19.5))).astype(np.int64)


def _restarting(count, limit):
    readings = [int(count[0])]
    for step in np.diff(count):
        value = readings[-1] + int(step)
        readings.append(value - limit if value >= limit else value + limit if value <= -limit else value)
    return np.array(readings)


SWING = np.rint(100_000 * np.sin(np.arange(4000) / 300)).astype(np.int64)


@pytest.mark.parametrize(
    ("motion", "readings", "counts"),
    [
        (_motion(), (_motion() + 32768) % 65536 - 32768, 1 << 16),
        (_motion(), _motion() % 1024, 1024),
        (_motion(), _motion() % 2400, 2400),  # an index pulse
        (SWING, _restarting(SWING, 32767), 32767),  # the pulse counter of an ESP32
    ],
)
def test_a_counter_that_rolls_over_is_undone_exactly(tmp_path, motion, readings, counts):
    roll_over = find_roll_over(readings)
    assert roll_over is not None
    assert roll_over.counts == counts
    np.testing.assert_array_equal(np.diff(unroll(readings, roll_over)), np.diff(motion))
    assert survey_roll_over(readings, np.zeros(readings.size, np.uint16)) == roll_over
    connected = np.abs(np.diff(readings, prepend=readings[0])) <= counts / 2  # else another segment begins
    assert survey_roll_over(readings, np.cumsum(~connected).astype(np.uint16)) is None
    rows = [f"{k / 1000},{value}" for k, value in enumerate(readings)]
    path = _text(tmp_path / "a.csv", rows, head="t (s),counts\n")
    with pytest.warns(UserWarning, match="rolled over or restarted"):
        run = daq.load(path, metres_per_count="1 um")
    np.testing.assert_array_equal(np.diff(run.count), np.diff(motion))


@pytest.mark.parametrize(
    "readings",
    [
        _motion(),
        np.where(np.arange(4000) % 500 == 250, _motion() + 256, _motion()),  # torn readings
        np.cumsum(np.where(np.arange(4000) == 2000, 5000, _motion() % 7)),  # one lost stretch
        np.zeros(10, np.int64),
        np.array([0, 100]),
    ],
)
def test_a_motion_or_a_fault_is_not_taken_for_a_counter_that_rolls_over(readings):
    assert find_roll_over(readings) is None


# Times.
def test_micros_that_roll_over_are_undone(tmp_path):
    ticks = (np.rint(TIME * 1e6).astype(np.int64) + 2**32 - 500_000) % 2**32
    path = _text(tmp_path / "a.csv", _pairs(ticks, form="{}"), head="t_us,x (m)\n")
    with pytest.warns(UserWarning, match=r"clock of the times rolled over 1 time by 2\^32"):
        np.testing.assert_allclose(daq.load(path).time, TIME, atol=1e-9)


def test_rounded_times_are_numbered_evenly_with_a_rate(tmp_path):
    time = np.floor(np.arange(N) * 0.4)  # millis() at 2.5 kHz
    path = _text(tmp_path / "a.csv", _pairs(time, form="{:.0f}"), head="t_ms,x (m)\n")
    with pytest.raises(InputError, match=r"lines repeat the time before, .*frame_rate='2506 Hz'"):
        daq.load(path)
    with pytest.warns(UserWarning, match="spaced evenly at 2500 Hz"):
        np.testing.assert_allclose(daq.load(path, frame_rate="2500 Hz").time, np.arange(N) / 2500)
    with pytest.raises(InputError, match="from even samples at 2000 Hz; check frame_rate"):
        daq.load(path, frame_rate="2000 Hz")


def test_times_since_1970_are_times(tmp_path):
    path = _text(tmp_path / "a.csv", _pairs(1764262800 + TIME))
    np.testing.assert_allclose(daq.load(path, x_unit="m").time, TIME, atol=1e-6)


SUMMER = [f"2026-03-29 {'01:59:59' if k < 400 else '03:00:00'}.{k % 400 * 2500:06d}" for k in range(N)]


@pytest.mark.parametrize(
    ("dates", "last", "words"),
    [
        (None, 3601.4975, "summer"),
        (("2026-03-25", "2026-03-27"), 172801.4975, "no samples for 172800"),
        (("25.12.2026", "26.12.2026"), 86401.4975, "no samples for 86400"),
        (("12/30/2026", "12/31/2026"), 86401.4975, "no samples for 86400"),
    ],
)
def test_dates_count_and_a_long_gap_is_said(tmp_path, dates, last, words):
    stamps = [f"{dates[k >= 300]} 10:00:{TIME[k]:09.6f}" for k in range(N)] if dates else SUMMER
    path = _text(tmp_path / "a.csv", _pairs(stamps, form="{}"))
    with pytest.warns(UserWarning, match=words):
        assert daq.load(path, clock=True, x_unit="m").time[-1] == pytest.approx(last)


# Workbooks.
def _workbook(path, change=lambda sheet: sheet, time=TIME):
    import openpyxl

    book = openpyxl.Workbook()
    book.active.append(["t", "x"])
    for a, b in zip(time, X, strict=True):
        book.active.append([a if not isinstance(a, np.floating) else float(a), float(b)])
    book.save(path / "a.xlsx")
    with zipfile.ZipFile(path / "a.xlsx") as old, zipfile.ZipFile(path / "b.xlsx", "w", zipfile.ZIP_DEFLATED) as new:
        for name in old.namelist():
            new.writestr(name, change(old.read(name)) if "sheet1" in name else old.read(name))
    return path / "b.xlsx"


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda sheet: sheet.replace(b'ref="A1:B601"', b'ref="A1:B301"'), ""),  # half of the samples
        (lambda sheet: sheet.replace(b'ref="A1:B601"', b'ref="A1"'), ""),
        (
            lambda sheet: sheet.replace(
                b"</sheetData>", b'<row r="1048576"><c r="XFD1048576"><v>1</v></c></row></sheetData>'
            ),
            "all their cells are outside the table: 1048576",  # 42 s of CPU time, then refused for memory
        ),
    ],
)
def test_what_is_in_a_sheet_is_read_whatever_it_says_of_its_size(tmp_path, change, words, recwarn):
    run = daq.load(_workbook(tmp_path, change), x_unit="m")
    np.testing.assert_allclose(run.position, X)
    assert [words in str(warning.message) for warning in recwarn] == ([True] if words else [])


def test_times_of_a_sheet_are_not_rounded_to_milliseconds(tmp_path):
    from datetime import datetime, timedelta

    begin = datetime(2026, 5, 6, 23, 59, 59, 500000)
    path = _workbook(tmp_path, time=[begin + timedelta(seconds=a) for a in TIME])
    np.testing.assert_allclose(daq.load(path, clock=True, x_unit="m").time, TIME, atol=2e-6)  # was 2 and 3 ms
