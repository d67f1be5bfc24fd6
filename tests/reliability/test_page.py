"""The page of the campaigns: rows are replaced one campaign at a time, and every campaign has its own."""

import re
from dataclasses import asdict

import pytest

from . import page
from .conftest import PAGE
from .inputs import batch
from .result import Result
from .test_campaigns import CAMPAIGNS

TEXT = PAGE.read_text(encoding="utf-8")


def test_a_campaign_replaces_its_own_rows_and_the_total(tmp_path):
    copy = tmp_path / "page.md"
    copy.write_text(TEXT, encoding="utf-8")
    for minutes, measured in (("1000.0", "first"), ("2000.0", "second")):
        result = asdict(Result("a promise", "tried | so", measured, ("a fault",), "tests/x.py"))
        page.replace_rows(copy, "disk", [result], ("2026-01-01", "1.0", "a processor", "5.0", minutes))
    before, after = TEXT.splitlines(), copy.read_text(encoding="utf-8").splitlines()
    rows = [line for line in after if line.startswith("| disk |")]
    assert rows == [
        "| disk | a promise (`tests/x.py`) | tried \\| so | second; **1 faults** |",
        "| disk | 2026-01-01 | 1.0 | a processor | 5.0 | 2000.0 |",
    ]
    assert [line for line in before if line not in after and "| disk |" not in line and "CPU time" not in line] == []
    total = next(line for line in after if line.startswith("All campaigns together"))
    assert total.endswith("the longest one 2000.0.")


@pytest.mark.parametrize("name", CAMPAIGNS)
def test_a_campaign_has_its_rows_and_its_cost_or_its_open_faults_on_the_page(name):
    if CAMPAIGNS[name].open_faults:
        assert f"Open faults of `{name}`:" in TEXT
        assert f"\n| {name} |" not in TEXT
        return
    runs = page.parts(TEXT, "runs")[1]
    assert len(re.findall(rf"^\| {name} \|.*\| \d+\.\d \| \d+\.\d \|$", runs, re.MULTILINE)) == 1
    assert re.search(rf"^\| {name} \| ", page.parts(TEXT, "results")[1], re.MULTILINE)


def test_the_page_states_the_limits_of_damaged_input():
    assert f"within {batch.SECONDS} s and {batch.MEMORY >> 20} MB" in TEXT


def test_the_page_holds_no_fault():
    assert "faults**" not in TEXT
