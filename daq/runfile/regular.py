"""Opening of files that somebody else may have made: a pipe would block for ever, and a device has no end."""

import os
import stat
from pathlib import Path
from typing import BinaryIO

from stickslip.errors import InputError

SIMILAR = 0.75  # ratio of difflib: a slip of two letters in a name of eight


def open_regular(path: Path, do: str) -> BinaryIO:
    """Open a file for reading, not a folder, pipe or device; ``do`` says what to give in place of a folder."""
    where = str(path)
    try:
        number = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    except FileNotFoundError:
        raise InputError("no such file", where, _name_similar(path)) from None
    except IsADirectoryError:
        raise InputError("is a folder", where, do) from None
    except OSError as error:
        what = f"cannot be read: {error.strerror}"
        raise InputError(what, where, do if path.is_dir() else "check its permissions") from error
    kind = os.fstat(number).st_mode
    if stat.S_ISREG(kind):
        return os.fdopen(number, "rb")
    os.close(number)
    if stat.S_ISDIR(kind):
        raise InputError("is a folder", where, do)
    what = "is a pipe, not a file" if stat.S_ISFIFO(kind) else "is a device, not a file"
    raise InputError(what, where, "save the data to a file first, and use that file")


def _name_similar(path: Path) -> str:
    """Return what to do about a file that does not exist: name the most similar one beside it."""
    from difflib import get_close_matches

    try:
        names = os.listdir(path.parent)
    except OSError:
        return "check the path"
    longer = sorted((name for name in names if path.name and name.startswith(f"{path.name}.")), key=len)
    similar = longer or get_close_matches(path.name, names, n=1, cutoff=SIMILAR)
    return f"did you mean {str(path.with_name(similar[0]))!r}?" if similar else "check the path"
