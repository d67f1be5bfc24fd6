"""An output file: refused where one stands, written beside its place, and put there whole."""

import contextlib
import glob
import os
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from daq.errors import InputError
from daq.output import disk

# A temporary file that was not written to for so long belongs to no running command: a file of an hour at 5 kHz is
# written in 30 s.  Half is still ten times that; double keeps a dead file twice as long.
ABANDONED_S = 600.0


def refuse_existing(
    path: Path, force: bool = False, *sources: Path, own: str = "", kind: str = "", flag: str = "-o"
) -> None:
    """Raise InputError when ``path`` may not be written: the one rule about files that exist.

    Parameters
    ----------
    path : Path
        The output file.
    force : bool
        Replace an existing file.
    *sources : Path
        What the output is made from; not even ``force`` lets it replace one of them.
    own : str
        A mark in the first 2000 bytes of a file of this kind: such a file is replaced without ``force``.
    kind : str
        What such a file is called, for the message.
    flag : str
        The flag that names the output, for the message.
    """
    where = str(path)
    if path.exists() and any(source.exists() and path.samefile(source) for source in sources):
        raise InputError("would replace its own source", where, f"give another name ({flag})")
    if path.is_dir():
        raise InputError("is a folder", where, f"give a file name ({flag})")
    if path.exists() and not path.is_file():
        raise InputError("is a device, not a file", where, "give a file name")
    if path.exists() and not force:
        do = f"give another name ({flag}), or --force to replace it"
        if not own:
            raise InputError("the output file exists", where, do)
        with path.open("rb") as file:
            if own.encode() not in file.read(2000):
                raise InputError(f"exists and is no {kind}", where, do)
    if not path.absolute().parent.is_dir():
        raise InputError("its folder does not exist", where, f"make {path.absolute().parent} first")


@contextmanager
def replacing(target: Path, force: bool) -> Iterator[Path]:
    """Yield a temporary file beside ``target``; when the block succeeds it is synced and takes the target's name.

    Where ``target`` is a symbolic link, the file that it leads to is replaced.  Temporary files that a killed command
    left for this target are removed.

    Raises
    ------
    RefusedError
        The disk refuses (`daq.output.disk`); nothing is left behind, and what stood there before still does.
    """
    with disk.writing(target):
        target = Path(os.path.realpath(target)) if target.is_symlink() else target
        _remove_abandoned(target)
        handle, name = tempfile.mkstemp(prefix=f".{target.name}.", suffix=".partial", dir=target.absolute().parent)
        os.close(handle)
        with _taking_its_place(Path(name), target, force) as temporary:
            yield temporary


def _remove_abandoned(target: Path) -> None:
    """Remove the temporary files of commands that were killed while they wrote this target."""
    old = time.time() - ABANDONED_S
    for left in target.parent.glob(f".{glob.escape(target.name)}.*.partial"):
        with contextlib.suppress(OSError):  # another command may remove it at the same time
            if left.lstat().st_mtime < old:
                left.unlink()


@contextmanager
def _taking_its_place(temporary: Path, target: Path, force: bool) -> Iterator[Path]:
    try:
        yield temporary
        mask = os.umask(0)
        os.umask(mask)
        temporary.chmod(target.stat().st_mode & 0o777 if target.exists() else 0o666 & ~mask)
        with temporary.open("rb+") as stream:
            os.fsync(stream.fileno())
        refuse_existing(target, force)
        temporary.replace(target)
        disk.sync_folder(target)
    finally:
        temporary.unlink(missing_ok=True)
