"""The comparison of runs fitted one by one: each has its verdict, and its intervals unless they are withheld."""

import re
from pathlib import Path

import pytest

from fitting.palette import law_styles
from fitting.report import comparison
from fitting.report.comparison import ComparedRun
from fitting.report.symbols import pretty
from stickslip.errors import InputError


@pytest.fixture(scope="module")
def runs(ranked):
    five, three = (ranked(law=law).as_json() for law in (5, 3))
    lawless = ranked(law=5).as_json() | {"verdict": "none of the six laws describes this record"}
    best = lawless["ranking"][0]
    withheld = {name: item | dict.fromkeys(("stderr", "lo", "hi")) for name, item in best["parameters"].items()}
    lawless["ranking"] = [best | {"parameters": withheld}]
    unlike = ranked(law=5).as_json() | {"verdict": "no law comes near", "ranking": [], "set": []}
    documents = [five, three, lawless, unlike]
    found = [ComparedRun(Path(f"{number}.h5"), document) for number, document in enumerate(documents)]
    return [*found, ComparedRun(Path("<i>bad.h5"), {}, InputError("no such file"))]


def test_every_run_is_there_with_its_verdict_or_what_went_wrong(runs):
    page = comparison.render(runs, 0.05, "2 decided")
    for run in runs[:4]:
        assert pretty(run.document["verdict"]) in page
    assert "error: no such file" in page
    assert "&lt;i&gt;bad.h5" in page
    assert "<i>bad" not in page
    assert not re.findall(r"""(?:src|href)\s*=\s*["'](?!#|data:)""", page)


def test_the_intervals_are_drawn_and_printed_where_they_are_not_withheld(runs):
    page = comparison.render(runs, 0.05, "")
    best = law_styles([5])[5]["color"].lower()
    bars = re.findall(rf'd="M ([\d.]+) [\d.]+\nL ([\d.]+) [^"]*" [^>]*stroke: {best}; stroke-width: 2.2', page)
    assert len(bars) == 6 * 1  # k/m, Fs/m, v_dr, gamma, x0, c/m of the one run whose intervals are trusted
    assert all(float(right) > float(left) for left, right in bars)
    best = runs[0].document["ranking"][0]["parameters"]["gamma"]
    printed = [(float(lo), float(hi)) for lo, hi in re.findall(r"(-?[\d.]+) … (-?[\d.]+)", page)]
    assert any(ends == pytest.approx((best["lo"], best["hi"]), abs=1e-3) for ends in printed)
    assert page.count("withheld") > 4


def test_a_page_of_other_runs_is_not_replaced(tmp_path, runs):
    path = tmp_path / "0+1.each.html"
    comparison.write(runs[:2], path, 0.05, "")
    comparison.write(runs[:2], path, 0.05, "again")
    assert "again" in path.read_text()
    with pytest.raises(InputError, match="other runs"):
        comparison.write(runs[:3], path, 0.05, "")
    comparison.write(runs[:3], path, 0.05, "", force=True)
    path.write_text("mine")
    with pytest.raises(InputError, match="not a comparison"):
        comparison.refuse_foreign_file(path, [run.file for run in runs[:3]])
