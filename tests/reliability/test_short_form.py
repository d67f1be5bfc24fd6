"""Every campaign of `make reliability` at its short size."""

import sys

import pytest

from . import campaign

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the campaigns use Linux's /proc and preloading"),
]


@pytest.mark.parametrize("name", campaign.CAMPAIGNS)
def test_a_campaign_finds_no_fault(name, tmp_path):
    results = campaign.run(name, "short", tmp_path)
    assert results
    known = campaign.CAMPAIGNS[name].open_faults
    found = [fault for result in results for fault in result.faults]
    assert [fault for fault in found if not any(one in fault for one in known)] == []
