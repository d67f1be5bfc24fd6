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
    path: Path, force: bool = False, *sources: Path, own: str = "", kind: str = "", flag: str = "-o"
) -> None:
    """Raise InputError when ``path`` may not be written: the one rule about files that exist.

    path: The output file.
    force: Replace an existing file.
    *sources: What the output is made from; not even ``force`` lets it replace one of them.
    own: A mark in the first 2000 bytes of a file of this kind: such a file is replaced without ``force``.
    kind: What such a file is called, for the message.
    flag: The flag that names the output, for the message.
    """
    where, other = str(path), "give another name"
    if path.exists() and any(source.exists() and path.samefile(source) for source in sources):
        raise InputError("would replace its own source", where, f"{other} ({flag})", python=other)
    if path.is_dir():
        raise InputError("is a folder", where, f"give a file name ({flag})", python="give a file name")
    if path.exists() and not path.is_file():
        raise InputError("is a device, not a file", where, "give a file name")
    if path.exists() and not force:
        do = f"{other} ({flag}), or --force to replace it"
        python = f"{other}, or force=True to replace it"
        if not own:
            raise InputError("the output file exists", where, do, python=python)
        with path.open("rb") as file:
            if own.encode() not in file.read(2000):
                raise InputError(f"exists and is no {kind}", where, do, python=python)
    if not path.absolute().parent.is_dir():
        raise InputError("its folder does not exist", where, f"make {path.absolute().parent} first")


@contextmanager
def replacing(target: Path, force: bool) -> Iterator[Path]:
    """Yield a temporary file beside ``target``; when the block succeeds it is synced and takes the target's name.

    Where ``target`` is a symbolic link, the file that it leads to is replaced.  Temporary files that a killed command
    left for this target are removed; one that another command is writing is waited for, up to `WAIT_S`.

    Raises RefusedError: the disk refuses (`stickslip.output.disk`); nothing is left behind, and what stood there before
        still does.
    Raises InputError: another command goes on writing the file.
    """
    with disk.writing(target):
        target = Path(os.path.realpath(target)) if target.is_symlink() else target
        made: list[tuple[Path, FileLock | None]] = []
        try:
            _make_temporary(target, made)
            temporary, lock = made[0]
            yield temporary
            _take_its_place(temporary, lock, target, force)
        finally:
            for temporary, lock in made:
                if lock is None:
                    temporary.unlink(missing_ok=True)
                elif lock.held:  # else its name may be another command's by now
                    lock.remove(temporary)


def _make_temporary(target: Path, made: list[tuple[Path, FileLock | None]]) -> None:
    """Create a file beside ``target`` and lock it, as soon as no other command writes one; ``made`` gets both.

    A signal that comes between finds it in ``made``.
    """
    own = target.with_name(f".{target.name}.partial")  # relative as the target is: a folder may be renamed meanwhile
    until = time.monotonic() + WAIT_S
    while True:
        if not _is_being_written(target, own):
            try:
                with disk.interrupts_later():
                    made.append((own, FileLock(own, new=True)))
                return
            except BlockingIOError:
                pass
            except FileExistsError:
                if not _can_be_locked(own):
                    made.append((_unlocked(target), None))
                    return
            except OSError:  # no locks here, or no file can be made
                made.append((_unlocked(target), None))
                return
        if time.monotonic() > until:
            raise InputError("another command is writing this file", str(target), "wait until that one has ended")
        time.sleep(LOOK_EVERY_S)


def _unlocked(target: Path) -> Path:
    """Create a file beside ``target`` under a name that no other command takes."""
    handle, name = tempfile.mkstemp(prefix=f".{target.name}.", suffix=".partial", dir=target.absolute().parent)
    os.close(handle)
    return target.with_name(Path(name).name)


def _can_be_locked(path: Path) -> bool:
    """Return whether a file that exists can be locked sooner or later: not a link, nor where it is another user's."""
    if path.is_symlink():
        return False
    try:
        FileLock(path).release()
    except (BlockingIOError, FileNotFoundError):
        return True
    except OSError:
        return False
    return True


def _is_being_written(target: Path, own: Path) -> bool:
    """Return whether another command writes this target; remove the files of those that were killed over it."""
    locked = False
    for left in (own, *target.parent.glob(f".{glob.escape(target.name)}.*.partial")):
        if left != own and "." in left.name[len(target.name) + 2 : -len(".partial")]:
            continue  # of another target, NAME.x
        try:
            lock = FileLock(left)
        except BlockingIOError:
            locked = True
        except OSError:  # no locks here, another user's, or another command has removed it
            with contextlib.suppress(OSError):
                if left.lstat().st_mtime < time.time() - ABANDONED_S:
                    left.unlink()
        else:
            if lock.is_of(left):
                lock.remove(left)
            else:
                lock.release()
    return locked


def _take_its_place(temporary: Path, lock: FileLock | None, target: Path, force: bool) -> None:
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
