"""An output file: refused where one stands, written beside its place, and put there whole."""

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from daq.errors import InputError
from daq.output import disk


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

    Raises
    ------
    RefusedError
        The disk refuses (`daq.output.disk`); nothing is left behind, and what stood there before still does.
    """
    with disk.writing(target):
        handle, name = tempfile.mkstemp(prefix=f".{target.name}.", suffix=".partial", dir=target.absolute().parent)
        os.close(handle)
        with _taking_its_place(Path(name), target, force) as temporary:
            yield temporary


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
        if hasattr(os, "O_DIRECTORY"):
            folder = os.open(target.absolute().parent, os.O_RDONLY | os.O_DIRECTORY)
            try:
                os.fsync(folder)
            finally:
                os.close(folder)
    finally:
        temporary.unlink(missing_ok=True)
