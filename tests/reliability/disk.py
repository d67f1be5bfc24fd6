"""A disk that refuses, and a folder that goes away, at every stage of every command."""

import errno
import shutil
from dataclasses import dataclass
from pathlib import Path

import daq
from stickslip.errors import EXIT_DEVICE, EXIT_INPUT

from . import forked, tasks
from .forked import CREATE, EVERY, RENAME, SYNC, TRUNCATE, WRITE, Ended, Server
from .result import Result, Size
from .tasks import TASKS

BEFORE_THE_RUN = 6  # calls of a recording before it has started the board: the journal with its header, synced


@dataclass(frozen=True)
class Disk:
    """What a disk refuses: which calls, with which errno, from one call on or at that one alone."""

    kinds: int
    error: int
    action: int = forked.REFUSE_ALL


DISKS = {
    "full": Disk(WRITE | TRUNCATE | CREATE, errno.ENOSPC),
    "no inodes": Disk(CREATE, errno.ENOSPC),
    "over quota": Disk(WRITE | TRUNCATE | CREATE, errno.EDQUOT),
    "read-only": Disk(EVERY, errno.EROFS),
    "failing": Disk(WRITE | TRUNCATE | SYNC, errno.EIO),
    "failing once": Disk(EVERY, errno.EIO, forked.REFUSE_ONE),
}
FOLDERS = {
    "renamed": forked.FOLDER_RENAMED,
    "removed": forked.FOLDER_REMOVED,
    "unmounted": forked.FOLDER_EMPTIED,
}


def disk(size: Size, folder: Path, server: Server, sources: Path) -> list[Result]:
    """Refuse calls of every command of `TASKS`, and take its folder away, ``size.amount`` times in all."""
    trials = tasks.Trials(server, sources, folder / "trials" / "folder")
    refused = _tries(trials, list(DISKS), size.amount * 2 // 3)
    moved = _tries(trials, list(FOLDERS), size.amount // 3)
    refusals = [fault for name, how, at in refused for fault in _refuse(trials, name, how, at)]
    moves = [fault for name, how, at in moved for fault in _take_away(trials, name, how, at)]
    return [
        Result(
            "a disk that refuses ends a command with exit code 3 and a line that names the file; originals and journal "
            "stay, nothing half-made is left",
            f"{len(refused)} refusals ({', '.join(DISKS)}) from any call on, of {len(TASKS)} commands",
            f"{len(refused) - len(refusals)} as promised",
            tuple(refusals),
        ),
        Result(
            "where the output's folder goes away, a recording is complete in its new place or in the nearest folder "
            "that exists, and says where; other commands end as on a disk that refuses",
            f"{len(moved)} times the folder was {', '.join(FOLDERS)} before any call of {len(TASKS)} commands",
            f"{len(moved) - len(moves)} as promised, no sample lost",
            tuple(moves),
        ),
    ]


def _tries(trials: tasks.Trials, ways: list[str], amount: int) -> list[tuple[str, str, int]]:
    """Return command, way and call of so many trials, evenly over all commands and ways."""
    found: list[tuple[str, str, int]] = []
    each = max(1, amount // (len(TASKS) * len(ways)))
    for k, name in enumerate(TASKS):
        for j, way in enumerate(ways):
            kinds = DISKS[way].kinds if way in DISKS else EVERY
            points = sum(1 for kind in trials.known(name).ended.calls if kind & kinds)
            if each > 1:
                found += [(name, way, at) for at in tasks.spread(list(range(1, points + 1)), each)]
            else:  # a short campaign: another stage of each command
                found.append((name, way, 1 + (points - 1) * ((3 * k + 5 * j) % 11) // 10))
    return tasks.spread(found, amount)


def _refuse(trials: tasks.Trials, name: str, how: str, at: int) -> list[str]:
    way = DISKS[how]
    clean = how not in ("read-only", "failing once")  # which let nothing be removed
    spoil = {"kinds": way.kinds, "error": way.error, "action": way.action}
    codes = TASKS[name].ends, EXIT_DEVICE
    return trials.disturb(name, at, f"disk {how} from here on:", *codes, clean=clean, **spoil)[0]


def _take_away(trials: tasks.Trials, name: str, how: str, at: int) -> list[str]:
    """Take the folder of a command away; return the faults."""
    task, folder = TASKS[name], trials.folder
    parent = folder.parent
    shutil.rmtree(parent, ignore_errors=True)
    task.begin(trials.sources, folder)
    absolute = name == "record" and at % 2 == 1
    line = [*task.line[:-1], str(folder / "new.h5")] if absolute else list(task.line)
    ended = trials.server.run(line, folder, at=at, action=FOLDERS[how])
    where = f"{' '.join(task.line)}, folder {how} before call {at} ({ended.name})"
    found = [f"{where}: {what}" for what in tasks.ended_badly(ended, task, task.ends, EXIT_DEVICE, EXIT_INPUT)]
    known = trials.known(name)
    if name == "record":
        if BEFORE_THE_RUN < at <= known.ended.calls.index(RENAME) + 1:  # after that it goes away with the run in it
            found += [f"{where}: {what}" for what in _not_recorded(ended, parent, absolute)]
        return found
    away = folder.with_name(f"{folder.name}.away")
    if away.is_dir():
        found += tasks.aftermath(trials.server, task, away, known, where)[0]
    return found + [f"{where}: {path.name} is left in the folder above" for path in parent.iterdir() if path.is_file()]


def _not_recorded(ended: Ended, parent: Path, absolute: bool) -> list[str]:
    """Return whether a recording whose folder went away is not whole, in one place, which was named."""
    runs = [path for path in parent.rglob("*") if path.is_file()]
    if len(runs) != 1 or runs[0].suffix != ".h5":
        return [f"left {[str(path.relative_to(parent)) for path in runs]}, exit code {ended.code}: {ended.err}"]
    found = daq.load(runs[0]).time.size
    if found != tasks.SAMPLES:
        return [f"{found} of {tasks.SAMPLES} samples"]
    if absolute and runs[0].parent != parent / "folder" and str(runs[0]) not in ended.out + ended.err:
        return [f"does not say that the run is {runs[0]}"]
    return []
