"""`daq.load` reads what `daq import` reads, in memory; its keywords are the flags."""

import json
import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

import daq
from daq.cli import sentences
from daq.cli.app import app
from daq.imports import table_to_run
from daq.imports.options import ImportOptions
from stickslip.console import application
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
    np.testing.assert_allclose(found.position, X / 100, rtol=1e-15)  # x0 is a reading: it moves none of them
    assert (found.rig.x0, found.rig.datum) == (Measured(-1e-3, 1e-4), None)
    by_command = daq.load(tmp_path / "run.h5")
    np.testing.assert_array_equal(found.position, by_command.position)
    np.testing.assert_array_equal(found.time, by_command.time)
    assert (found.rig, found.title, found.started) == (by_command.rig, by_command.title, by_command.started)
    assert found.config_toml == by_command.config_toml


def test_vectors_of_a_matlab_file_are_columns_bit_for_bit(tmp_path):
    other = {"vir": np.ones((5000, 2)), "gtau": 35.15, "s": "EMPS"}
    savemat(tmp_path / "track.mat", {"t": TIME[:, None], "qm": X[None, :], **other})
    found = daq.load(tmp_path / "track.mat", time="t", position="qm", x_unit="m", mass=(0.3, 0.001))
    assert np.array_equal(found.time, TIME)
    assert np.array_equal(found.position, X)
    assert found.rig.mass == Measured(0.3, 0.001)
    # It was "read as: delimiter tab, decimal '.'".
    said = sentences.format_columns(
        table_to_run.read(tmp_path / "track.mat", ImportOptions(time="t", position="qm", x_unit="m"))
    )
    assert said.startswith("read as: vectors of a MATLAB file, time from column 't' in s")


def test_what_the_command_warns_about_is_a_warning(table):
    table.write_text(table.read_text().replace("t,x", "t (s),x (mm)"))
    with pytest.warns(UserWarning, match=r"track.csv: .* is read in cm") as caught:
        found = daq.load(table, x_unit="cm")  # the option wins
    assert caught[0].filename == __file__
    np.testing.assert_allclose(found.position, X / 100, rtol=1e-15)


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
