"""The campaigns: `make test-slow` runs each at its short size, `make reliability` at its full size."""

import inspect
import os
import sys
import tempfile
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import pytest

from . import bad_input, clocks, concurrency, contacts, crash, disk, load, numerics, page, security, signals
from .conftest import PAGE
from .forked import cpu_time
from .inputs import batch
from .result import Result, Size

IN_MEMORY = "/dev/shm"


@dataclass(frozen=True)
class Campaign:
    """A function, and how much it tries at the short and at the full size."""

    function: Callable[..., list[Result]]
    short: int
    full: int
    # It measures times between syncs, or writes more than memory should hold; the others work in memory where the
    # system offers a folder there, since they would mostly wait for the disk.
    on_disk: bool = False
    # How the faults that it is known to find are named: results.md states them in words, and has no rows of
    # the campaign; any other fault fails the short size.
    open_faults: tuple[str, ...] = ()


# Refused with other samples a slip than they have, or without (of 600): results.md.
OPEN_CONTACTS = tuple(f"contact {number}," for number in (201, 240, 278, 351, 546))

# The order is that of the table in results.md.
CAMPAIGNS = {
    "crash": Campaign(crash.crash, 3, 100, on_disk=True),  # kill points per command
    "disk": Campaign(disk.disk, 30, 882),  # refusals
    "signals": Campaign(signals.signals, 12, 350),  # signals
    "concurrency": Campaign(concurrency.concurrency, 1, 10),  # rounds
    "load": Campaign(load.load, 30, 3600, on_disk=True),  # seconds of recording at each rate
    "clocks": Campaign(clocks.clocks, 24, 200),  # samples of a run whose counters wrap
    "numerics": Campaign(numerics.numerics, 2, 14),  # values for each number
    "security": Campaign(security.security, 25, 1000),  # requests
    "bad_streams": Campaign(bad_input.bad_streams, 20_000, 1_000_000),  # pieces of streams
    "bad_files": Campaign(bad_input.bad_files, 2_400, 120_000),  # files
    "contacts": Campaign(contacts.contacts, 10, 2_000, open_faults=OPEN_CONTACTS),  # contacts
}


@pytest.fixture
def size(name, full_size):
    campaign = CAMPAIGNS[name]
    return Size(campaign.full if full_size else campaign.short, full_size)


@pytest.fixture
def folder(name):
    there = None if CAMPAIGNS[name].on_disk or not os.access(IN_MEMORY, os.W_OK) else IN_MEMORY
    with tempfile.TemporaryDirectory(prefix=f"reliability-{name}-", dir=there) as made:
        yield Path(made)


@pytest.mark.slow
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the campaigns use Linux's /proc and preloading")
@pytest.mark.parametrize("name", CAMPAIGNS)
def test_a_campaign_finds_no_fault(name, full_size, request):
    campaign = CAMPAIGNS[name]
    asked = {need: request.getfixturevalue(need) for need in inspect.signature(campaign.function).parameters}
    before = cpu_time(asked.get("server"))
    results = campaign.function(**asked)
    assert results
    properties = {"campaign": name, "results": [asdict(result) for result in results]}
    request.node.user_properties.extend((properties | {"cpu_s": cpu_time(asked.get("server")) - before}).items())
    known = () if full_size else campaign.open_faults
    found = [fault for result in results for fault in result.faults]
    assert [fault for fault in found if not any(one in fault for one in known)] == []


def test_the_page_has_the_rows_of_each_campaign_or_its_open_faults_and_no_other_fault():
    text = PAGE.read_text(encoding="utf-8")
    results, runs = (page.parts(text, table)[1] for table in ("results", "runs"))
    for name, campaign in CAMPAIGNS.items():
        if campaign.open_faults:
            assert f"Open faults of `{name}`:" in text
        rows = results.count(f"\n| {name} | "), runs.count(f"\n| {name} | ")
        assert (rows[0] > 0, rows[1]) == (not campaign.open_faults, not campaign.open_faults), name
    assert f"within {batch.SECONDS} s and {batch.MEMORY >> 20} MB" in text
    assert "faults**" not in text
