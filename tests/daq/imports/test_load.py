"""`daq.load` reads what `daq import` reads, in memory; its keywords are the flags."""

import json
import math
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

import daq
from daq.cli.app import app
from stickslip.console import application
from stickslip.errors import InputError
from stickslip.units import Measured

SAMPLES = Path(__file__).resolve().parents[3] / "data_samples"
TIME = np.arange(1000) / 250
X = np.round(2.0 * np.sin(3 * TIME), 4)


@pytest.fixture
def table(tmp_path):
    path = tmp_path / "track.csv"
    np.savetxt(path, np.c_[TIME, X], fmt="%.6f", delimiter=",", header="t,x", comments="")
    return path


def test_a_table_is_the_run_that_the_command_makes_of_it(table, tmp_path, capsys):
    flags = ["--x-unit", "cm", "--mass", "300 g", "--x0", "-1 mm +- 0.1 mm", "--start", "2024-05-01T12:00:00+02:00"]
    assert application.run(app, ["import", str(table), "-o", str(tmp_path / "run.h5"), *flags, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["samples"] == 1000
    found = daq.load(table, x_unit="cm", mass="300 g", x0="-1 mm +- 0.1 mm", start="2024-05-01T12:00:00+02:00")
    by_command = daq.load(tmp_path / "run.h5")
    np.testing.assert_array_equal(found.position, by_command.position)
    np.testing.assert_array_equal(found.time, by_command.time)
    assert (found.rig, found.title, found.started) == (by_command.rig, by_command.title, by_command.started)
    assert found.config_toml == by_command.config_toml


def test_a_matlab_file_is_read_too(tmp_path):
    savemat(tmp_path / "track.mat", {"t": TIME, "x": X})
    found = daq.load(tmp_path / "track.mat", x_unit="mm", frame_rate="250 fps", mass=(0.3, 0.001))
    np.testing.assert_allclose(found.position, 1e-3 * X, rtol=1e-12)
    assert (found.rate_hz, found.rig.mass) == (pytest.approx(250), Measured(0.3, 0.001))


def test_columns_are_chosen_by_name_or_number(tmp_path):
    np.savetxt(tmp_path / "track.txt", np.c_[X, X + 1, TIME], delimiter="\t", header="a\tb\tc", comments="")
    for chosen in ({"time": "c", "position": "b"}, {"time": 3, "position": 2}):
        np.testing.assert_allclose(daq.load(tmp_path / "track.txt", **chosen).position, X + 1)


def test_what_the_command_warns_about_is_a_warning(table):
    table.write_text(table.read_text().replace("t,x", "t (s),x (mm)"))
    with pytest.warns(UserWarning, match=r"track.csv: .* is read in cm") as caught:
        daq.load(table, x_unit="cm")
    assert caught[0].filename == __file__


@pytest.mark.parametrize(
    ("name", "options", "words"),
    [
        ("track.csv", {"xunit": "cm"}, "no option 'xunit' of a table; did you mean 'x_unit'?"),
        ("track.csv", {"x_unit": "cmm"}, "'cmm' is not a unit of length; did you mean 'mm'?"),
        ("track.csv", {"mass": "heavy"}, "'heavy' is not a valid mass; write it like '300 g'"),
        ("track.csv", {"position": "y"}, "no column 'y'; the columns are: t, x"),
        ("none.csv", {}, "no such file; check the path"),
        ("", {}, "is a folder"),
    ],
)
def test_a_wrong_keyword_or_value_is_named(table, name, options, words):
    with pytest.raises(InputError, match=re.escape(words)):
        daq.load(table.parent / name, **options)


def test_the_date_of_an_imported_file_is_said_to_be_that(table, tmp_path, capsys):
    found = daq.load(table, x_unit="cm")
    assert found.facts()["started"] == f"file of {found.started}"
    stated = daq.load(table, x_unit="cm", start="2024-05-01T12:00:00+02:00")
    assert stated.when == "2024-05-01T12:00:00+02:00"
    found.save(tmp_path / "one.h5")
    stated.save(tmp_path / "two.h5")
    assert application.run(app, ["list", str(tmp_path)]) == 0
    said = capsys.readouterr().out
    assert f"file of {found.started[:10]}" in said
    assert "  2024-05-01 12:00" in said


def test_a_run_file_takes_no_options_of_tables():
    with pytest.raises(InputError, match=r"mass= is for tables, and this is a run file; .* fitting.rank"):
        daq.load(SAMPLES / "law5.h5", mass=0.3)


@pytest.mark.slow
@pytest.mark.skipif(
    not sys.platform.startswith("linux"), reason="the peak of a process's memory is read as Linux has it"
)
def test_an_hour_at_1_khz_takes_300_mb(tmp_path):
    # Every cell was a string of its own: 2085 MB.
    track = tmp_path / "track.csv"
    with track.open("w") as file:
        file.write("t (s),x (mm)\n")
        file.writelines(f"{k / 1000:.3f},{20 * math.sin(0.004 * k):.4f}\n" for k in range(3_600_000))
    # Not ru_maxrss, which a process inherits from the one that started it.
    measure = (
        "import sys, daq; print(daq.load(sys.argv[1]).time.size);"
        "print(*(line.split()[1] for line in open('/proc/self/status') if line.startswith('VmHWM')))"
    )
    done = subprocess.run([sys.executable, "-c", measure, str(track)], capture_output=True, text=True, check=True)
    samples, peak = map(int, done.stdout.split())
    assert samples == 3_600_000
    assert peak < 300_000
