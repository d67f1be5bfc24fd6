"""The page stands alone, gives the verdict, and never replaces a file that is not a report."""

import base64
import csv
import html
import io
import re
import zipfile
from contextlib import nullcontext
from dataclasses import replace

import numpy as np
import pytest

from daq.runfile import store
from daq.runfile.run_data import OF_FILE
from fitting.judge.adequacy import NONE_OF_SIX
from fitting.report import page as report
from fitting.report.symbols import pretty
from stickslip.errors import InputError


@pytest.fixture(scope="module")
def page(ranked):
    """Give the page of a run that it does not name: the tests name runs of their own."""
    return re.sub("; sha256 of the raw record [0-9a-f]+", "", report.render(ranked(law=5)))


def test_the_page_asks_nothing_of_the_network(page):
    assert not re.findall(r"""(?:src|href)\s*=\s*["'](?!#|data:)""", page)
    assert "@import" not in page
    assert "<script" not in page


def test_the_page_holds_verdict_pictures_and_every_law(page, ranked):
    assert html.escape(ranked(law=5).verdict) in page
    assert page.count("<svg") == 10
    assert len(page.encode()) < 1_200_000  # with the figures once more, and their data, in compressed archives
    assert len(set(re.findall(r'clipPath id="([^"]+)"', page))) == page.count("<clipPath")
    assert "noise, ±2 sd" in page
    assert "Correlations of their errors" in page
    assert f">{100 * ranked(law=5).best.orbit:.2g} %</td>" in page
    assert not re.search(r"\bCPU\b", page)  # CPU times stood among the evidence
    for law in range(1, 7):
        assert f"</span>{law} " in page


OWN, OTHER, THIRD = (8 * digits for digits in ("0123abcd", "4567cdef", "89abef01"))


def report_of(page, *digests):
    return page.replace("</footer>", "".join(f"; sha256 of the raw record {one}" for one in digests) + "</footer>")


@pytest.mark.parametrize(
    ("made_of", "runs", "said"),
    [
        (None, [""], "is not a report"),
        ([OWN], [OWN], None),
        ([OWN], [OTHER], "another run"),  # a report of any run used to be replaced
        ([OWN, OTHER], [OTHER, OWN], None),
        ([OWN, OTHER], [OWN], "another run"),
        ([OWN, OTHER], [OWN, OTHER, THIRD], "another run"),
    ],
)
def test_a_report_is_replaced_by_one_of_the_same_runs_alone(tmp_path, page, made_of, runs, said):
    path = tmp_path / "run.report.html"
    path.write_text("<html>mine</html>" if made_of is None else report_of(page, *made_of))
    before = path.read_text()
    with nullcontext() if said is None else pytest.raises(InputError, match=said):
        report.refuse_foreign_file(path, runs)
    assert path.read_text() == before
    if said == "another run":
        report.refuse_foreign_file(path, runs, force=True)


def test_the_report_of_a_run_that_is_gone_is_replaced(tmp_path, page, belt_rig):
    """After `daq import new.csv -o run.h5 --force` the fit was refused: the report was "of another run", now gone."""
    run, moved, path = tmp_path / "run.h5", tmp_path / "moved.h5", tmp_path / "run.report.html"
    store.write(run, belt_rig.recording(law=5, duration=2.0, seed=1))
    path.write_text(report_of(page, store.load(run).digest))
    report.refuse_foreign_file(path, [OWN], files=[run])
    with pytest.raises(InputError, match="another run"):
        report.refuse_foreign_file(path, [OWN], files=[tmp_path / "else.h5"])
    run.rename(moved)
    with pytest.raises(InputError, match=r"another run, moved\.h5"):
        report.refuse_foreign_file(path, [OWN], files=[run])


def test_the_first_pictures_are_the_friction_curve_and_one_cycle(page, ranked):
    described = re.findall(r'<svg[^>]*aria-label="([^"]+)"', page)
    assert len(described) == page.count("<svg"), "a picture without a description"
    name = ranked(law=5).best.name
    assert described[0] == f"Friction against slip speed: model-free estimate with its band, and {name}."
    assert described[1] == f"Position and velocity of one cycle: as measured and {name}, fitted."


def test_the_first_row_is_headline_badge_and_parameter_table(page, ranked):
    first = page[: page.index('class="laws"')]
    ranking = ranked(law=5)
    best = ranking.best
    for name in ("gamma", "Fs", "k", "v_dr"):
        value, error = best.parameters[name].value, best.parameters[name].stderr
        digits = best.parameters[name].decimals
        assert f"<td>{value:.{digits}f} ± {error:.{digits}f}</td>" in first
    assert "✓ describes the record" in first
    assert f"<h2>{best.called}</h2>" in first
    assert f"Parameters of {best.called}" in page
    headline = re.findall("<h1[^>]*>(.*)</h1>", page)
    assert headline == [html.escape(pretty(ranking.verdict.split(". ")[0]))]
    assert f"<title>rig.h5: {best.called}</title>" in page


def test_a_fact_has_the_same_number_as_elsewhere(page, ranked):
    """The report had 62 % of a record stuck and 20,011 samples where `process smooth` had 60 % and 20,000."""
    ranking = ranked(law=5)
    motion = ranking.records[0]
    assert f"<dt>stuck</dt><dd>{100 * motion.plateau_fraction:.0f} % of the record</dd>" in page
    assert f"<dt>samples</dt><dd>{motion.recording.time.size}</dd>" in page
    speed = ranking.best.parameters["v_dr"]
    assert page.count(f"{speed.value:.{speed.decimals}f} ± {speed.stderr:.{speed.decimals}f}") == 2


def test_a_figure_is_saved_with_its_data(page, ranked):
    saved = dict(re.findall(r'download="([^"]+)" href="data:application/zip;base64,([^"]+)"', page))
    assert len(saved) == page.count('<svg role="img"')  # all but the drawing of the rig
    archive = zipfile.ZipFile(io.BytesIO(base64.b64decode(saved["rig-friction.zip"])))
    assert archive.read("rig-friction.svg").startswith(b"<svg")
    rows = list(csv.DictReader(io.StringIO(archive.read("rig-friction.csv").decode())))
    assert {row["x axis"] for row in rows} == {"slip speed s (m/s)"}
    shown = [(float(row["x"]), float(row["y"])) for row in rows if row["curve"] == "model-free estimate"]
    curve = ranked(law=5).adequacy.curve
    np.testing.assert_allclose(shown, np.c_[curve.speed, curve.friction], rtol=1e-6)


def test_where_no_law_describes_the_record_no_set_weight_or_interval_is_shown(ranked):
    ranking = ranked(law=5)
    parameters = {name: replace(item, trusted=False) for name, item in ranking.best.parameters.items()}
    nothing = {"score": None, "weight": None, "behind": None, "in_set": False, "parameters": parameters}
    rejected = replace(
        ranking,
        rows=tuple(replace(row, **nothing) for row in ranking.rows),
        members=(),
        warnings=("a & b",),
        adequacy=replace(ranking.adequacy, verdict=NONE_OF_SIX),
    )
    text = report.render(rejected)
    assert "! no law describes the record" in text
    assert f"<h2>Closest law: {ranking.best.called}</h2>" in text
    shown = text[text.index("<body>") : text.index("<summary>Method")]
    for word in (">weight", "Δ log error", "95 % interval", "std. error", "compatible laws"):
        assert word not in shown, word
    assert "Correlations" not in text
    assert "<li>a &amp; b" in text


def test_every_published_law_is_listed_with_its_misfit(page):
    forms = page[page.index("Published laws") :]
    assert re.search(r"</math> = [\d.]+ m/s</td><td class=\"n\">[\d.]+</td>", forms)
    assert len(re.findall("<td>stribeck[a-z-]*</td><td>Fc", forms)) == 4


def test_an_imported_table_is_a_file_of_some_date(ranked):
    """The date of the file stood there as that of the recording."""
    ranking = ranked(law=5)
    recording = ranking.records[0].recording
    imported = replace(recording, provenance=recording.provenance | {"start_time_from": OF_FILE})
    text = report.render(replace(ranking, records=(replace(ranking.records[0], recording=imported),)))
    assert "<dd>file of 2" in text
    assert "recorded 2" not in text


def test_a_length_is_in_mm_as_positions_are(page, ranked):
    x0 = report.in_shown_unit(ranked(law=5).best.parameters["x0"])
    assert x0.unit == "mm"
    assert f'<td class="n">{x0.value:.{x0.decimals}f}</td>' in page
    assert '<td class="unit">m</td>' not in page
