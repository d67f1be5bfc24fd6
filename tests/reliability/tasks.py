"""The commands that the campaigns break off and spoil, with the files they start from and those they must end with."""

import re
import shutil
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import h5py
import numpy as np

import daq
from stickslip.errors import EXIT_DATA, EXIT_INTERRUPTED

from .forked import HANGS_S, KILL, RENAME, Ended, Server

CYCLES_S = "9"  # as short a run as the laws can be ranked on
SAMPLES = 2000  # of a recording that is broken off, at 1 kHz
# Of a stage, and of the provenance of a checkout in which somebody works meanwhile: not the same twice.
VARYING = ("cpu_time", "date", "git_commit", "git_dirty")


@dataclass(frozen=True)
class Task:
    """A command, in a folder that holds the files it starts from."""

    line: tuple[str, ...]
    files: tuple[str, ...]  # names in the folder of `prepare`
    makes: tuple[str, ...]  # what it leaves besides
    consumes: tuple[str, ...] = ()
    ends: int = 0  # its exit code

    @property
    def records(self) -> bool:
        """Whether it records: a recording is never the same twice."""
        return self.line[1] == "record"

    @property
    def leaves(self) -> set[str]:
        return {*self.files, *self.makes} - {*self.consumes}

    def begin(self, sources: Path, folder: Path) -> None:
        """Make a folder that holds the files it starts from, and nothing else."""
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        for name in self.files:
            shutil.copy2(sources / name, folder / name)  # an import begins at the table's time


JOURNAL = ("new.h5.part", "new.h5.markers")
TASKS = {
    "record": Task(("daq", "record", "--duration", "2", "-o", "new.h5"), (), ("new.h5",)),
    "recover": Task(("daq", "recover", "new.h5.part"), JOURNAL, ("new.h5",), JOURNAL),
    "smooth": Task(("process", "smooth", "run.h5"), ("run.h5",), ()),
    "fit": Task(("fit-friction", "run.h5", "--laws", "5"), ("run.h5",), ("run.report.html",)),
    "import": Task(("daq", "import", "table.csv", "-o", "new.h5"), ("table.csv",), ("new.h5",)),
    "replay": Task(("daq", "replay", "run.h5", "-o", "new.h5"), ("run.h5",), ("new.h5",)),
    "note": Task(("daq", "note", "run.h5", "--title", "x", "--mark", "1", "a"), ("run.h5",), ()),
}


def prepare(server: Server, folder: Path) -> Path:
    """Make the files that the tasks start from; let the server import and compile what they need."""
    folder.mkdir()
    server.warm(["daq", "record", "--duration", CYCLES_S, "-o", "run.h5"], folder)
    server.warm(["daq", "export", "run.h5", "--csv", "table.csv"], folder)
    shutil.copyfile(folder / "run.h5", folder / "warm.h5")
    server.warm(["process", "smooth", "warm.h5"], folder)
    server.warm(["fit-friction", "warm.h5", "--laws", "5"], folder)
    server.warm(["daq", "import", "table.csv", "-o", "table.h5"], folder)
    server.run(["daq", "record", "--duration", "2", "-o", "new.h5"], folder, kinds=RENAME, at=1, action=KILL)
    for left in folder.glob(".*.partial"):
        left.unlink()
    (folder / "new.h5.markers").write_text("")
    return folder


def content(path: Path) -> dict[str, bytes] | bytes:
    """Return what a file holds: of a run file its datasets and attributes without what is not the same twice."""
    if path.suffix != ".h5":
        text = path.read_bytes()
        return text[:15] + text[-8:] if path.suffix == ".html" else text
    found: dict[str, bytes] = {}

    def add(name: str, item: h5py.HLObject) -> None:
        if name.rpartition("/")[2] in VARYING:
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


def contents(folder: Path) -> Contents:
    return {path.name: content(path) for path in sorted(folder.iterdir())}


@dataclass(frozen=True)
class Undisturbed:
    """What the folder of an undisturbed command holds before and after it, and how the command ended."""

    before: Contents
    after: Contents
    ended: Ended


@cache
def undisturbed(server: Server, task: Task, sources: Path) -> Undisturbed:
    folder = sources.parent / "undisturbed"
    task.begin(sources, folder)
    before = contents(folder)
    ended = server.run(list(task.line), folder)
    return Undisturbed(before, contents(folder), ended)


@dataclass(frozen=True)
class Trials:
    """The commands of `TASKS` in one folder, each disturbed at one of its calls."""

    server: Server
    sources: Path
    folder: Path

    def known(self, name: str) -> Undisturbed:
        return undisturbed(self.server, TASKS[name], self.sources)

    def disturb(
        self, name: str, at: int, how: str, *codes: int, clean: bool = False, **spoil: int
    ) -> tuple[list[str], int | None]:
        """Spoil a call of a command, which must end with one of ``codes``, then do what a person would do next.

        Return the faults, and the samples of the journal that was left, if any.  ``clean``: nothing half-made is left.
        """
        task = TASKS[name]
        task.begin(self.sources, self.folder)
        ended = self.server.run(list(task.line), self.folder, at=at, **spoil)
        where = f"{' '.join(task.line)}, {how} call {at} ({ended.name})"
        found = [f"{where}: {what}" for what in ended_badly(ended, task, *codes)]
        found += [f"{where}: {path.name} is left" for path in self.folder.glob(".*.partial") if clean]
        following, samples = aftermath(self.server, task, self.folder, self.known(name), where)
        return found + following, samples


def ended_badly(ended: Ended, task: Task, *codes: int) -> list[str]:
    """Return whether a disturbed command ended otherwise than with one of ``codes`` and, but for its own, a line."""
    if ended.hung or ended.traceback or ended.code not in codes:
        return [f"{'hung, ' * ended.hung}ended with {ended.code}: {ended.err}"]
    silent = ended.code not in (task.ends, EXIT_INTERRUPTED) and ended.code > 0 and not ended.err.strip()
    return [f"ended with {ended.code} without a word"] * silent


def aftermath(server: Server, task: Task, folder: Path, known: Undisturbed, where: str) -> tuple[list[str], int | None]:
    """Look at the files that a disturbed command left, do what a person would do next, and look again."""
    found = [f"{where}: {what}" for what in spoiled(task, folder, known.before, known.after)]
    following, samples = _follow(server, task, folder, known.after)
    found += [f"{where}, then {what}" for what in following]
    wrong = _differences(contents(folder), known.after, task.records)
    return found + [f"{where}: after the next command: {what}" for what in wrong], samples


def spoiled(task: Task, folder: Path, before: Contents, after: Contents) -> list[str]:
    """Return what is wrong with the files that a broken-off command left: each must be as before or as after."""
    found = []
    for path in folder.iterdir():
        if path.name.endswith((".partial", ".part")):
            continue  # `_follow` shows whether they can be used
        try:
            held = content(path)
        except OSError as error:
            found.append(f"half a file {path.name}: {error}")
            continue
        if task.records and daq.load(path).time.size > 0:
            continue  # `_differences` looks at its samples
        if held not in (before.get(path.name), after.get(path.name)):
            found.append(f"{path.name} is neither as before nor as after")
    gone = [name for name in before if not (folder / name).exists()]
    done = all((folder / name).exists() for name in task.makes)
    return found + [f"{name} is gone" for name in gone if name not in task.consumes or not done]


def _follow(server: Server, task: Task, folder: Path, after: Contents) -> tuple[list[str], int | None]:
    """Do what a person would do next; return what is wrong with that, and the samples of a journal that was left."""
    part, run = folder / "new.h5.part", folder / "new.h5"
    if part.exists():
        line = ["daq", "recover", part.name]
        ended = server.run(line, folder)
        if ended.code == 0:
            return [], daq.load(run).time.size
        if not re.search(r"delete (it|this file) and record again", ended.err):
            return [f"{' '.join(line)} ended with {ended.code}: {ended.err}"], None
        if ended.code == EXIT_DATA:  # the board had not sent a sample
            part.unlink()
    elif all((folder / name).exists() for name in task.makes) and (
        task.records or all((folder / name).exists() and content(folder / name) == after[name] for name in task.leaves)
    ):
        return [], None  # it has done its work
    ended = server.run(list(task.line), folder)
    if ended.code != task.ends or ended.traceback or ended.hung:
        return [f"{' '.join(task.line)} ended with {ended.code}: {ended.err}"], None
    return [], None


def _differences(now: Contents, after: Contents, recording: bool) -> list[str]:
    found = [f"{name} is left over" for name in now if name not in after]
    found += [f"{name} is missing" for name in after if name not in now]
    if not recording:
        return found + [f"{name} differs" for name in after if name in now and now[name] != after[name]]
    counts = "entry/raw/count_up"
    shortened = "new.h5" in now and not after["new.h5"][counts].startswith(now["new.h5"][counts])
    return found + ["its counts are not the beginning of the undisturbed run's"] * shortened


def wait_for_journal(part: Path, ended: Callable[[], bool] = lambda: False) -> None:
    """Wait until a recording's journal holds samples, its recorder has ended, or `HANGS_S` have passed."""
    until = time.monotonic() + HANGS_S
    while not (part.exists() and part.stat().st_size > 8000) and not ended() and time.monotonic() < until:
        time.sleep(0.02)


def spread(values: list[Any], amount: int) -> list[Any]:
    """Return so many of the values, evenly, with the first and the last."""
    at = np.unique(np.linspace(0, len(values) - 1, min(amount, len(values))).round().astype(int))
    return [values[k] for k in at]
