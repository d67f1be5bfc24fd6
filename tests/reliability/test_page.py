"""The page of the campaigns: rows are replaced one campaign at a time, and every campaign has its own."""

import re
from pathlib import Path

import pytest

from . import page
from .campaign import CAMPAIGNS, Result

PAGE = Path(__file__).resolve().parents[2] / "docs/reliability.md"


def test_a_campaign_replaces_its_own_rows_and_the_total(tmp_path):
    copy = tmp_path / "page.md"
    copy.write_text(PAGE.read_text(encoding="utf-8"), encoding="utf-8")
    for minutes, measured in ((1000.0, "first"), (2000.0, "second")):
        result = Result("a promise", "tried | so", measured, "tests/x.py", ("a fault",))
        page.replace_rows(copy, page.Rows("disk", (result,), "2026-01-01", "1.0", "a processor", 5.0, minutes))
    before, after = PAGE.read_text(encoding="utf-8").splitlines(), copy.read_text(encoding="utf-8").splitlines()
    rows = [line for line in after if line.startswith("| disk |")]
    assert rows == [
        "| disk | a promise | tried \\| so | second; **1 faults** | `tests/x.py` |",
        "| disk | 2026-01-01 | 1.0 | a processor | 5.0 | 2000.0 |",
    ]
    assert [line for line in before if line not in after and "| disk |" not in line and "CPU time" not in line] == []
    total = next(line for line in after if line.startswith("All campaigns together"))
    assert total.endswith("the longest one 2000.0.")


@pytest.mark.parametrize("name", [name for name, campaign in CAMPAIGNS.items() if campaign.open_faults])
def test_a_campaign_with_open_faults_has_them_on_the_page_and_no_rows(name):
    text = PAGE.read_text(encoding="utf-8")
    assert f"Open faults of `{name}`:" in text
    assert f"\n| {name} |" not in text


@pytest.mark.parametrize("name", [name for name, campaign in CAMPAIGNS.items() if not campaign.open_faults])
def test_every_campaign_has_its_rows_and_its_cost(name):
    text = PAGE.read_text(encoding="utf-8")
    runs = text.partition(page.BEGIN.format("runs"))[2].partition(page.END.format("runs"))[0]
    assert len(re.findall(rf"^\| {name} \|.*\| \d+\.\d \| \d+\.\d \|$", runs, re.MULTILINE)) == 1
    assert f"test_short_form.py[{name}]" in text


def test_the_page_holds_no_fault():
    assert "faults**" not in PAGE.read_text(encoding="utf-8")
