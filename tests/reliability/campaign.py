"""Campaigns: long trials of what the programs promise, each at two sizes, and the table of all of them.

A campaign is a function ``NAME(size, folder)`` in the module of its name.  It tries, measures and returns one `Result`
per promise.  It asserts nothing: what went wrong stands in ``faults``, each with what to run to see it again.  The same
size gives the same trials: whatever is drawn by chance comes from ``size.seed``.
"""

import importlib
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import cast

IN_MEMORY = "/dev/shm"


@dataclass(frozen=True)
class Result:
    """One row of the table.

    Attributes
    ----------
    promise : str
        What holds, in one sentence.
    tried : str
        What was done to it, with numbers.
    measured : str
        What came out, with numbers and units.
    test : str
        The test that holds the promise: ``tests/folder/test_file.py::test_name``, or the campaign itself.
    faults : tuple of str
        What broke the promise, each with what to run to see it again.
    """

    promise: str
    tried: str
    measured: str
    test: str
    faults: tuple[str, ...] = ()


@dataclass(frozen=True)
class Size:
    """How long a campaign is.

    Attributes
    ----------
    name : str
        "short" or "full".
    amount : int
        How much of what the campaign counts (`Campaign.counts`).
    seed : int
        Of everything that is drawn by chance.
    """

    name: str
    amount: int
    seed: int


@dataclass(frozen=True)
class Campaign:
    """A row of `CAMPAIGNS`.

    Attributes
    ----------
    counts : str
        What ``amount`` counts.
    short, full : int
        How much of it the sizes take.
    on_disk : bool
        Whether it needs a disk: it measures times between syncs, or writes more than memory should hold.  The others
        work in memory where the system offers a folder there, since they would mostly wait for the disk.
    seed : int
        Of everything that is drawn by chance.
    module : str
        Which module has its function, where that is not the module of its name.
    open_faults : tuple of str
        How the faults that it is known to find are named in it.  docs/reliability.md then states them in words, and has
        no rows of it; any other fault fails the short size.
    """

    counts: str
    short: int
    full: int
    on_disk: bool = False
    seed: int = 1
    module: str = ""
    open_faults: tuple[str, ...] = ()

    @property
    def folder(self) -> str | None:
        """The folder in which to make temporary ones; None for the usual one."""
        return None if self.on_disk or not os.access(IN_MEMORY, os.W_OK) else IN_MEMORY

    def size(self, name: str) -> Size:
        """Return the size of this name."""
        return Size(name, {"short": self.short, "full": self.full}[name], self.seed)


# Refused for a reason that is not true (84, 99, 192), or given another law alone (22, 72): docs/reliability.md.
OPEN_CONTACTS = tuple(f"contact {number}," for number in (22, 72, 84, 99, 192))

# The order is that of the table in docs/reliability.md.
CAMPAIGNS: dict[str, Campaign] = {
    "crash": Campaign("kill points per command", short=3, full=100, on_disk=True),
    "disk": Campaign("refusals", short=30, full=882),
    "signals": Campaign("signals", short=12, full=350),
    "concurrency": Campaign("rounds", short=1, full=10),
    "load": Campaign("seconds of recording at each rate", short=30, full=3600, on_disk=True),
    "clocks": Campaign("samples of a run whose counters wrap", short=24, full=200),
    "numerics": Campaign("values for each number", short=2, full=14),
    "security": Campaign("requests", short=25, full=1000),
    "bad_streams": Campaign("pieces of streams", short=20_000, full=1_000_000, module="bad_input"),
    "bad_files": Campaign("files", short=2_400, full=120_000, module="bad_input"),
    "contacts": Campaign("contacts", short=10, full=2_000, open_faults=OPEN_CONTACTS),
}


def run(name: str, size: str, folder: Path) -> list[Result]:
    """Run a campaign in an empty folder."""
    module = importlib.import_module(f"..{CAMPAIGNS[name].module or name}", __name__)
    function = cast(Callable[[Size, Path], list[Result]], getattr(module, name))
    return function(CAMPAIGNS[name].size(size), folder)


def test_of(name: str) -> str:
    """Return the test that runs a campaign's short form."""
    return f"tests/reliability/test_short_form.py[{name}]"
