"""The rest position of the spring as it is stated and printed: one name, one sign, from import to report."""

import json

import numpy as np
import pytest

from daq.cli.app import app as daq
from fitting import cli, job
from stickslip.console import application
from stickslip.errors import DataError
from stickslip.units import Measured

pytestmark = pytest.mark.usefixtures("asked_laws_alone")
X0 = 0.6  # m: the reading at the rest; the mass moves between 0.46 and 0.74


@pytest.fixture(scope="module")
def table(tmp_path_factory, belt_rig):
    """Write a table of readings, whose zero lies 0.6 m behind the spring's rest."""
    path = tmp_path_factory.mktemp("table") / "track.csv"
    run = belt_rig.recording(law=5, duration=10.0)
    rows = np.c_[run.time, run.position + X0]
    np.savetxt(path, rows, fmt=["%.6f", "%.7f"], delimiter=",", header="t (s),x (m)", comments="")
    return path


@pytest.fixture(scope="module")
def bare(table):
    """Import the table without any calibration."""
    path = table.with_name("bare.h5")
    assert application.run(daq, ["import", str(table), "-o", str(path), "--mass", "0.3"]) == 0
    return path


@pytest.fixture
def fitted(capsys):
    """Give a function that runs a command line of fit-friction for law 5; exit code and document."""

    def run(file, *flags):
        code = application.run(cli.app, [str(file), "--laws", "5", "--no-report", "--json", *flags])
        return code, json.loads(capsys.readouterr().out)

    return run


def rest(document):
    return document["ranking"][0]["parameters"]["x0"]["value"]


def test_what_an_import_states_is_what_the_fit_prints(table, fitted, capsys):
    path = table.with_name("stated.h5")
    line = ["import", str(table), "-o", str(path), "--mass", "0.3", "--x0", "600 mm +- 0.5 mm"]
    assert application.run(daq, line) == 0
    capsys.readouterr()
    code, document = fitted(path)
    assert code == 0
    assert rest(document) == pytest.approx(X0, abs=2e-3)
    assert not [text for text in document["warnings"] if "x0" in text]


def test_x0_and_the_datum_are_one_but_for_the_sign(bare, fitted, monkeypatch):
    """--datum took no +-, and a minus before a unit was taken for a flag."""
    code, document = fitted(bare, "--datum", "-600 mm +- 0.5 mm")
    assert code == 0
    assert rest(document) == pytest.approx(X0, abs=2e-3)
    read = []

    def read_alone(runs, *_, **__):
        read.append((runs[0].rig.x0, runs[0].rig.datum))
        raise DataError("read", "", "")

    monkeypatch.setattr(job, "fit_runs", read_alone)
    for flags in (["--x0", "600 mm +- 0.5 mm"], ["--datum", "-600 mm +- 0.5 mm"], ["--datum=-0.6", "--datum-sd=5e-4"]):
        assert fitted(bare, *flags)[0] == 4
    datum = Measured(-X0, 5e-4)
    assert read == [(Measured(X0, 5e-4), None), (None, datum), (None, datum)]


def test_the_printed_value_stated_again_changes_nothing(bare, fitted):
    code, first = fitted(bare, "--x0", "600 mm +- 0.5 mm")
    assert code == 0
    assert rest(first) == pytest.approx(X0, abs=2e-3)
    _, again = fitted(bare, "--x0", f"{rest(first):.9g} +- 0.0005")
    assert rest(again) == pytest.approx(rest(first), abs=1e-4)


@pytest.mark.slow  # tests/daq/runfile/test_rest_position.py holds the question
def test_a_wrong_sign_is_asked_about(bare, fitted):
    """It was taken without a word: another law, exit code 0, a friction level six times too large."""
    _, document = fitted(bare, "--x0", "-600 mm +- 0.5 mm")
    (asked,) = (text for text in document["warnings"] if "Is its sign correct?" in text)
    assert asked.startswith("x0 (-600 mm) is ")
    assert "600 mm lies inside it" in asked


def test_a_spring_at_rest_beyond_the_break_away_is_refused(bare, fitted):
    code, document = fitted(bare, "--x0", "1.2 m +- 1 mm")
    assert code == 2
    assert "outside the travel" in document["error"]["what"]
    assert "friction would hold it back" in document["error"]["what"]
    assert "--x0" in document["error"]["do"]


@pytest.mark.parametrize(
    ("flags", "what"),
    [
        (["--x0", "1 mm", "--datum", "1 mm"], "--x0 and --datum cannot be combined"),
        (["--x0", "1 mm", "--datum-sd", "1 mm"], "--x0 and --datum-sd together"),
        (["--datum", "1 mm +- 1 mm", "--datum-sd", "1 mm"], "--datum with +- and --datum-sd together"),
        (["--damping", "0.1 +- 0.1", "--damping-sd", "0.1"], "--damping with +- and --damping-sd together"),
    ],
)
def test_what_is_stated_twice_is_refused(bare, fitted, flags, what):
    code, document = fitted(bare, *flags)
    assert code == 2
    assert document["error"]["what"] == what


def test_every_calibration_takes_an_error(bare, fitted):
    """Only --mass and --stiffness did."""
    flags = ["--x0", "0.6 +- 5e-4", "--damping", "0 +- 0.002", "--belt-speed", "22 cm/s +- 2 mm/s"]
    code, document = fitted(bare, *flags, "--mass", "300 g +- 1 g")
    assert code == 0
    assert not document["warnings"]
