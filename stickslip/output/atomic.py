"""An output file: refused where one stands, written beside its place, and put there whole.

The file beside it, ``.NAME.partial``, is locked while it is written: one that is not locked was left by a killed
command, and is removed.  Two commands that write one file do so one after the other.  No other file and no folder is
locked: others lock folders for reasons of their own (``flock DIR command``).

Whoever finds the name free makes the file and locks it, and whoever finds it unlocked locks and removes it.  In either
case another command may have been faster, so what counts is whether the file that was locked still has the name.
"""

import contextlib
import glob
import logging
import os
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from stickslip.errors import InputError
from stickslip.output import disk
from stickslip.output.lock import FileLock

# Where the file system has no locks: a temporary file that was not written to for so long belongs to no running
# command, as a file of an hour at 5 kHz is written in 30 s.  Half is still ten times that; double keeps a dead file
# twice as long.
ABANDONED_S = 600.0
# How long to wait for another command that writes the same file.  Half is still that of an hour at 5 kHz; double lets a
# person wait as much longer for the refusal.
WAIT_S = 60.0
logger = logging.getLogger(__name__)
LOOK_EVERY_S = 0.02


def refuse_existing(
    path: Path, force: bool = False, *sources: Path, mark: str = "", kind: str = "", flag: str = "-o"
) -> None:
    """Raise InputError for an existing file, without ``force`` or a ``mark`` in its first 2000 bytes."""
    where, other = str(path), "choose another name"
    if path.exists() and any(source.exists() and path.samefile(source) for source in sources):
        raise InputError("is also an input of this command", where, f"{other} ({flag})", python=other)
    if path.is_dir():
        raise InputError("is a folder", where, f"use a file name ({flag})", python="use a file name")
    if path.exists() and not path.is_file():
        raise InputError("is a device, not a file", where, "use a file name")
    if path.exists() and not force:
        do = f"{other} ({flag}), or --force to replace it"
        python = f"{other}, or force=True to replace it"
        if not mark:
            raise InputError("the output file exists", where, do, python=python)
        with path.open("rb") as file:
            if mark.encode() not in file.read(2000):
                raise InputError(f"exists and is not a {kind}", where, do, python=python)
    if not path.absolute().parent.is_dir():
        raise InputError("the folder of this file does not exist", where, f"make {path.absolute().parent} first")


@contextmanager
def replacing(target: Path, force: bool) -> Iterator[Path]:
    """Yield a locked temporary file that replaces ``target``, or what it links to, if the block succeeds."""
    with disk.writing(target):
        target = Path(os.path.realpath(target)) if target.is_symlink() else target
        temporaries: list[tuple[Path, FileLock | None]] = []
        try:
            _make_temporary(target, temporaries)
            temporary, lock = temporaries[0]
            yield temporary
            _move_into_place(temporary, lock, target, force)
        finally:
            for temporary, lock in temporaries:
                if lock is None:
                    temporary.unlink(missing_ok=True)
                elif lock.held:  # else its name may be another command's by now
                    lock.remove(temporary)


def _make_temporary(target: Path, temporaries: list[tuple[Path, FileLock | None]]) -> None:
    """Create and lock a file next to ``target``, when no other command writes one; append both to a list."""
    temporary = target.with_name(
        f".{target.name}.partial"
    )  # relative as the target is: a folder may be renamed meanwhile
    until = time.monotonic() + WAIT_S
    while True:
        if not _is_being_written(target, temporary):
            try:
                with disk.defer_interrupts():
                    temporaries.append((temporary, FileLock(temporary, new=True)))
                return
            except BlockingIOError:
                pass
            except FileExistsError:
                if not _can_be_locked(temporary):
                    temporaries.append((_make_unlocked(target), None))
                    return
            except OSError:  # no locks here, or no file can be made
                temporaries.append((_make_unlocked(target), None))
                return
        if time.monotonic() > until:
            raise InputError("another command is writing this file", str(target), "wait until that command has ended")
        time.sleep(LOOK_EVERY_S)


def _make_unlocked(target: Path) -> Path:
    """Create a file next to ``target`` under a name that no other command uses."""
    handle, name = tempfile.mkstemp(prefix=f".{target.name}.", suffix=".partial", dir=target.absolute().parent)
    os.close(handle)
    return target.with_name(Path(name).name)


def _can_be_locked(path: Path) -> bool:
    """Return whether a file can be locked sooner or later: neither a link nor another user's."""
    if path.is_symlink():
        return False
    try:
        FileLock(path).release()
    except (BlockingIOError, FileNotFoundError):
        return True
    except OSError:
        return False
    return True


def _is_being_written(target: Path, temporary: Path) -> bool:
    """Return whether another command writes this target; remove the files of killed commands."""
    locked = False
    for candidate in (temporary, *target.parent.glob(f".{glob.escape(target.name)}.*.partial")):
        if candidate != temporary and "." in candidate.name[len(target.name) + 2 : -len(".partial")]:
            continue  # of another target, NAME.x
        try:
            lock = FileLock(candidate)
        except BlockingIOError:
            locked = True
        except OSError:  # no locks here, another user's, or another command has removed it
            with contextlib.suppress(OSError):
                if candidate.lstat().st_mtime < time.time() - ABANDONED_S:
                    candidate.unlink()
        else:
            if lock.is_of(candidate):
                lock.remove(candidate)
            else:
                lock.release()
    return locked


def _move_into_place(temporary: Path, lock: FileLock | None, target: Path, force: bool) -> None:
    mask = os.umask(0)
    os.umask(mask)
    temporary.chmod(target.stat().st_mode & 0o777 if target.exists() else 0o666 & ~mask)
    with temporary.open("rb+") as stream:
        os.fsync(stream.fileno())
    refuse_existing(target, force)
    size = temporary.stat().st_size
    if lock is None:
        temporary.replace(target)
    else:
        lock.rename(temporary, target)
    logger.info("wrote %s, %d bytes", target, size)
    disk.sync_folder(target)
