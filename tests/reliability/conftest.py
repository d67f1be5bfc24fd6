"""What the campaigns share, and how their results come into results.md.

`make reliability` runs them at full size (``--full``); each then replaces its own rows of the tables.
"""

import platform
from datetime import date
from pathlib import Path

import pytest

from stickslip.version import VERSION

from . import tasks
from .forked import Server
from .page import replace_rows

PAGE = Path(__file__).with_name("results.md")


def pytest_addoption(parser):
    parser.addoption("--full", action="store_true", help="campaigns at full size, with their rows in results.md")


@pytest.fixture(scope="session")
def full_size(pytestconfig):
    """Tell whether campaigns run at full size; where other tests are asked for too, the option is not known."""
    return pytestconfig.getoption("--full", default=False)


@pytest.fixture(scope="session")
def server(tmp_path_factory):
    with Server(tmp_path_factory.mktemp("server")) as started:
        yield started


@pytest.fixture(scope="session")
def sources(server, tmp_path_factory):
    return tasks.prepare(server, tmp_path_factory.mktemp("commands") / "sources")


class Report:
    """Writes the rows of each campaign that ends, in the process that collects what others have run."""

    def pytest_runtest_logreport(self, report):
        properties = dict(report.user_properties)
        if report.when == "call" and "results" in properties:
            run = (
                f"{date.today()}",
                VERSION,
                processor(),
                f"{report.duration / 60:.1f}",
                f"{properties['cpu_s'] / 60:.1f}",
            )
            replace_rows(PAGE, properties["campaign"], properties["results"], run)


def pytest_configure(config):
    if config.getoption("--full", default=False) and not hasattr(config, "workerinput"):
        config.pluginmanager.register(Report())


def processor():
    listing = Path("/proc/cpuinfo")
    lines = listing.read_text().splitlines() if listing.exists() else []
    named = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return f"{len(named)} x {named[0]}" if named else platform.processor() or platform.machine()
