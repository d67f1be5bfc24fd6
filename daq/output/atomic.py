"""An output file: refused where one stands, written beside its place, and put there whole."""

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from daq.errors import InputError
from daq.output import disk


def refuse_existing(path: Path, force: bool, source: Path | None = None) -> None:
    """Raise InputError when ``path`` exists and ``force`` was not given, or when it cannot be written to.

    Not even ``force`` lets an output replace the ``source`` it is made from.
    """
    if source is not None and path.exists() and source.exists() and path.samefile(source):
        raise InputError("would replace its own source", str(path), "give another name (-o)")
    if path.is_dir():
        raise InputError("is a folder", str(path), "give a file name")
    if path.exists() and not path.is_file():
        raise InputError("is a device, not a file", str(path), "give a file name")
    if path.exists() and not force:
        raise InputError("the output file exists", str(path), "give another name (-o), or --force to replace it")
    if not path.absolute().parent.is_dir():
        raise InputError("its folder does not exist", str(path), f"make {path.absolute().parent} first")


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
