"""Opening of files that somebody else may have made: a pipe would block for ever, and a device has no end."""

import os
import stat
from pathlib import Path
from typing import BinaryIO

from stickslip.errors import InputError


def regular_file(path: Path, do: str) -> BinaryIO:
    """Open a file for reading; ``do`` says what to give in place of a folder.

    Raises InputError: it is missing, a folder, a pipe or a device, or may not be read.
    """
    where = str(path)
    try:
        number = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    except FileNotFoundError:
        raise InputError("no such file", where, "check the path") from None
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
    raise InputError(what, where, "save the data to a file first, and give its name")
