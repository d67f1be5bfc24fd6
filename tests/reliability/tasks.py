"""The commands that the campaigns break off and spoil, with the files they start from and those they must end with."""

import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import h5py

from .forked import Server

CYCLES_S = "9"  # as short a run as the laws can be ranked on
UNTIMED = ("cpu_time", "date")  # of a stage: not the same twice


@dataclass(frozen=True)
class Task:
    """A command.

    Attributes
    ----------
    line : tuple of str
        The command line, in a folder that holds ``files``.
    files : tuple of str
        What it starts from; names in the folder of `prepared`.
    makes : tuple of str
        What it leaves besides.
    consumes : tuple of str
        What it removes.
    ends : int
        Its exit code.
    """

    line: tuple[str, ...]
    files: tuple[str, ...]
    makes: tuple[str, ...]
    consumes: tuple[str, ...] = ()
    ends: int = 0

    @property
    def leaves(self) -> set[str]:
        """The names that it leaves."""
        return {*self.files, *self.makes} - {*self.consumes}

    def begin(self, sources: Path, folder: Path) -> None:
        """Make a folder that holds the files it starts from, and nothing else."""
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        for name in self.files:
            shutil.copy2(sources / name, folder / name)  # an import begins at the table's time


TASKS = {
    "record": Task(("daq", "record", "--duration", "2", "-o", "new.h5"), (), ("new.h5",)),
    "recover": Task(
        ("daq", "recover", "new.h5.part"),
        ("new.h5.part", "new.h5.markers"),
        ("new.h5",),
        ("new.h5.part", "new.h5.markers"),
    ),
    "smooth": Task(("process", "smooth", "run.h5"), ("run.h5",), ()),
    "fit": Task(("fit-friction", "run.h5", "--laws", "5"), ("run.h5",), ("run.report.html",)),
    "import": Task(("daq", "import", "table.csv", "-o", "new.h5"), ("table.csv",), ("new.h5",)),
    "replay": Task(("daq", "replay", "run.h5", "-o", "new.h5"), ("run.h5",), ("new.h5",)),
    "note": Task(("daq", "note", "run.h5", "--title", "x", "--mark", "1", "a"), ("run.h5",), ()),
}


def prepare(server: Server, folder: Path) -> None:
    """Make the files that the tasks start from, and let the server import and compile what they need."""
    folder.mkdir()
    server.warm(["daq", "record", "--duration", CYCLES_S, "-o", "run.h5"], folder)
    server.warm(["daq", "export", "run.h5", "--csv", "table.csv"], folder)
    shutil.copyfile(folder / "run.h5", folder / "warm.h5")
    server.warm(["process", "smooth", "warm.h5"], folder)
    server.warm(["fit-friction", "warm.h5", "--laws", "5"], folder)
    server.warm(["daq", "import", "table.csv", "-o", "table.h5"], folder)
    from .forked import KILL, RENAME

    server.run(["daq", "record", "--duration", "2", "-o", "new.h5"], folder, kinds=RENAME, at=1, action=KILL)
    for left in folder.glob(".*.partial"):
        left.unlink()
    (folder / "new.h5.markers").write_text("")


def content(path: Path) -> dict[str, bytes] | bytes:
    """Return what a file holds: of a run file its datasets and attributes without what is not the same twice.

    Raises
    ------
    OSError
        A run file that HDF5 cannot read.
    """
    if path.suffix != ".h5":
        text = path.read_bytes()
        return text[:15] + text[-8:] if path.suffix == ".html" else text
    found: dict[str, bytes] = {}

    def add(name: str, item: h5py.HLObject) -> None:
        if name.rpartition("/")[2] in UNTIMED:
            return
        found[name] = bytes(repr(item[()]), "utf-8") if isinstance(item, h5py.Dataset) and item.shape == () else b""
        if isinstance(item, h5py.Dataset) and item.shape != ():
            found[name] = item[()].tobytes() if item.dtype.kind != "O" else repr(item[()].tolist()).encode()
        for key, value in item.attrs.items():
            found[f"{name}@{key}"] = repr(value).encode()

    with h5py.File(path, "r") as file:
        file.visititems(add)
    return found


Contents = dict[str, "dict[str, bytes] | bytes"]


def contents(folder: Path, read: Callable[[Path], dict[str, bytes] | bytes] = content) -> Contents:
    """Return what every file of a folder holds, by name."""
    return {path.name: read(path) for path in sorted(folder.iterdir())}
