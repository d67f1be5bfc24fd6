"""`fit-friction`: flags, JSON, exit codes, and what it leaves in the run file."""

import csv
import io
import json
import re
import shutil
import subprocess
import sys
from dataclasses import replace

import h5py
import pytest

from daq.runfile import listing, store
from daq.runfile.rig import Rig
from fitting import job
from fitting.laws import Competitors
from fitting.options import Options
from fitting.report import stage as fit_stage
from fitting.report import stage as table
from processing import stage
from processing.smoothing import smooth
from stickslip.console import application
from stickslip.errors import InputError
from stickslip.units import Measured

from . import command

pytestmark = pytest.mark.usefixtures("undrawn_reports", "asked_laws_alone")


@pytest.fixture(scope="module")
def run(tmp_path_factory, belt_rig):
    recording = belt_rig.recording(law=5, duration=10.0)
    return belt_rig.written(tmp_path_factory.mktemp("run") / "run.h5", recording)


@pytest.fixture(scope="module")
def fitted(run, asked_laws_alone):
    path = run.with_name("fitted.h5")
    shutil.copy(run, path)
    answer = command.fit(path, laws="3,5", csv=run.with_name("ranking.csv"), curve_csv=run.with_name("curve.csv"))
    return path, answer


def test_the_document_has_the_promised_keys(fitted):
    path, answer = fitted
    document = json.loads(json.dumps(application.plain(answer.data)))
    assert document["set"] == [5]
    assert document["verdict"].startswith("law 5 ")
    row = document["ranking"][0]
    assert {"law", "name", "score", "weight", "in_set", "rms_m", "cycles", "parameters", "cpu_s"} <= set(row)
    assert row["law"] == 5
    for item in row["parameters"].values():
        assert set(item) == {"value", "stderr", "lo", "hi", "unit"}
    assert {"t", "static_level", "kinetic_scale", "flag"} <= set(document["cycles"][0])
    assert document["warnings"] == []
    assert answer.exit_code == 0
    assert answer.text[-1].startswith("verdict: law 5 ")
    assert answer.data["report"] == path.with_name("fitted.report.html")
    assert answer.data["report"].exists()


@pytest.mark.parametrize("columns", [60, 80, 120])
def test_names_and_numbers_of_parameters_stay_whole(fitted, columns):
    """At 60 columns the names were "Fs…", "Fs…", "Fs…"."""
    from rich.console import Console

    _, answer = fitted
    shown = next(part for part in answer.text if getattr(part, "title", "") == "law 5")
    console = Console(width=columns, record=True, file=io.StringIO())
    console.print(shown)
    lines = console.export_text().splitlines()
    assert max(map(len, lines)) <= columns
    words = {word for line in lines for word in line.split()}
    for name, item in answer.data["ranking"][0]["parameters"].items():
        own = next(line for line in lines if line.split()[:1] == [name])
        assert item["unit"] in own
        number = own.split()[1]
        assert float(number) == pytest.approx(item["value"], abs=10.0 ** -len(number.partition(".")[2].split("e")[0]))
    assert not any(word.endswith("…") and word != "…" for word in words)


def test_results_stand_beside_untouched_raw_data(fitted, run):
    path, _ = fitted
    with h5py.File(path) as file, h5py.File(run) as before:
        entry = file["entry"]
        assert entry.attrs["default"] == "fit"
        assert list(entry["fit/ranking/law"]) == [3, 5]
        assert entry["fit_law5/parameters/gamma"].attrs["units"] == "s/m"
        assert "fit_law6" not in entry
        value = "entry/instrument/encoder/value_log/value"
        assert (file[value][:] == before[value][:]).all()


def test_a_run_that_was_changed_while_it_was_fitted_gets_no_fit(run, tmp_path, belt_rig):
    # A fit used to stand beside a smoothed motion, or even a recording, that it was not made from.
    path = tmp_path / "run.h5"
    shutil.copy(run, path)
    options = Options(competitors=Competitors.of(5))
    done = job.fit_runs([job.load_run(path, options)], options)
    job.save(done, None, "")
    stage.save(smooth(store.load(path), method="sg"), path)
    refused(done, path, "smoothed again")
    command.fit(path, laws="5", no_report=True)
    with h5py.File(path) as file:
        assert file["entry/fit/parameters/sha256_smooth"].asstr()[()] == stage.digest(file["entry"])
    store.write(path, belt_rig.recording(law=5, duration=10.0, seed=2), force=True)
    refused(done, path, "recorded again")


def refused(done, path, what):
    """Assert that a fit is not written into a run, for this reason."""
    before = path.read_bytes()
    with pytest.raises(InputError, match=what):
        job.save(done, None, "")
    assert path.read_bytes() == before


def test_the_list_says_which_part_of_a_run_was_fitted_and_its_table_is_replaced(run, tmp_path):
    # The verdict of a part of a run, or of some laws, used to stand in the list as that of the run.
    path, out = tmp_path / "run.h5", tmp_path / "ranking.csv"
    shutil.copy(run, path)
    parts, lines = [], []
    for options in ({"end": "9 s"}, {"laws": "1-6"}):
        command.fit(path, **{"laws": "5"} | options, no_report=True, csv=out)
        parts += [row.part for row in listing.list_runs([tmp_path])]
        lines.append(len(out.read_text().splitlines()))
    assert parts == ["0 to 9 s; law 5", None]
    assert lines == [2, 7]


def test_damping_without_a_mass_is_refused(belt_rig, run, tmp_path):
    path = belt_rig.written(tmp_path / "bare.h5", replace(store.load(run), rig=Rig()))
    with pytest.raises(InputError, match="requires the mass"):
        command.fit(path, damping=Measured(0.01))


@pytest.mark.parametrize(
    ("flag", "text", "said"),
    [
        ("report", "mine", "not a report"),
        ("csv", "mine", "not a ranking"),
        ("curve_csv", "my own table\n", "mine"),
        # A curve was replaced by that of another run: it does not say of which run it is.
        ("curve_csv", "speed (m/s),friction (N),lo (N),hi (N)\n", "mine"),
    ],
)
def test_a_strangers_file_is_not_replaced(run, tmp_path, flag, text, said):
    mine = tmp_path / ("mine.html" if flag == "report" else "mine.csv")
    mine.write_text(text)
    with pytest.raises(InputError, match=said):
        command.fit(run, **{flag: mine})
    assert mine.read_text() == text


def test_a_part_of_a_run_is_fitted_without_a_report_or_anything_that_draws_one(run, tmp_path):
    path = tmp_path / "part.h5"
    shutil.copy(run, path)
    source = (
        "import sys\nfrom stickslip.console import application\nfrom fitting.cli import app\n"
        "from fitting.judge import formulas\nformulas.PUBLISHED = {}\n"  # to reject them takes most of the time
        f"code = application.run(app, [{str(path)!r}, *'--laws 5 --from 1 --to 9500ms --no-report --json'.split()])\n"
        "drawing = {'matplotlib', 'PIL', 'pandas', 'jinja2', 'scipy.stats'} & set(sys.modules)\n"
        "sys.exit(f'{code} {drawing}' if code or drawing else 0)\n"
    )
    done = subprocess.run([sys.executable, "-c", source], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    document = json.loads(done.stdout)
    assert document["report"] is None
    assert not list(tmp_path.glob("*.html"))
    assert all(1 < event["t"] < 9.5 for event in document["cycles"])
    with h5py.File(path) as file:
        about = file["entry/fit/parameters"]
        assert (about["begin"][()], about["end"][()]) == pytest.approx((1.0, 9.5), abs=2e-3)


def test_every_field_of_a_fit_is_in_its_tree(fitted):
    path, _ = fitted
    written = set()
    with h5py.File(path) as file:
        file["entry"].visititems(lambda name, item: written.add(name) if isinstance(item, h5py.Dataset) else None)
    known = {row.path for row in fit_stage.TREE}
    assert {name for name in written if name.startswith("fit/")} <= known
    of_laws = {re.sub("^fit_law[35]/", "fit_law1/", name) for name in written if name.startswith("fit_law")}
    parameters = {name for name in of_laws if name.startswith("fit_law1/parameters/")}
    assert len(parameters) > 10
    assert of_laws - parameters <= known


def test_the_verdict_is_printed_once_and_last(fitted):
    lines = [line for line in fitted[1].text if isinstance(line, str)]  # it came first too, before the tables
    assert [line for line in lines if line.startswith("verdict: ")] == lines[-1:]
    assert lines[-1].startswith("verdict: law 5 (hyperbolic), F = Fs/(1 + gamma s): Fs")


def test_the_ranking_can_be_had_as_a_table(fitted):
    path, answer = fitted
    document, out = application.plain(answer.data), path.with_name("ranking.csv")
    with out.open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [int(row["law"]) for row in rows] == [row["law"] for row in document["ranking"]]
    assert float(rows[0]["k/m"]) == document["ranking"][0]["parameters"]["k/m"]["value"]
    for part in ("stderr", "lo", "hi"):  # the page promised intervals that the table did not have
        assert float(rows[0][f"gamma {part}"]) == document["ranking"][0]["parameters"]["gamma"][part]
    assert rows[1]["gamma"] == ""


def test_the_ranking_of_another_run_is_replaced_by_force_alone(tmp_path):
    """It used to be replaced by any run's."""
    out = tmp_path / "ranking.csv"
    table.write(out, [(tmp_path / "one.h5", [dict.fromkeys(table.EVIDENCE, 1) | {"parameters": {}}])])
    table.refuse_foreign_file(out, [tmp_path / "one.h5", tmp_path / "two.h5"])
    with pytest.raises(InputError, match=r"another run, one\.h5"):
        table.refuse_foreign_file(out, [tmp_path / "two.h5"])
    table.refuse_foreign_file(out, [tmp_path / "two.h5"], force=True)


def test_the_measured_curve_is_a_table(fitted):
    path, answer = fitted
    out = path.with_name("curve.csv")
    curve = application.plain(answer.data)["adequacy"]["curve"]
    with out.open() as file:
        header, *rows = csv.reader(file)
    assert header == ["speed (m/s)", *(f"{name} ({curve['unit']})" for name in ("friction", "lo", "hi", "law 5"))]
    columns = [[float(value) for value in column] for column in zip(*rows, strict=True)]
    assert columns[:4] == [curve[name] for name in ("speed", "friction", "lo", "hi")]
    assert all(low < law < high for low, high, law in zip(curve["lo"], curve["hi"], columns[4], strict=True))
