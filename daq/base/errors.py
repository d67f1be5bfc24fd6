"""The errors of all four commands and the exit codes they end in.

::

    StickslipError            what was wrong, where, what to do; exit 1 is left to bugs
    ├── InputError     2      a flag, a file, a scene, a column: the caller's side
    ├── DeviceError    3      a port, a board, a cable, a disk
    └── DataError      4      the record itself: too few cycles, no stick-slip, lost counts

Exit codes: 0 done (also after the first Ctrl-C), 1 a bug, 2 usage or bad input, 3 device, 4 data quality,
5 the fit could not decide between laws, 6 stick-slip that none of the laws describes (both results, not errors),
130 second Ctrl-C.
"""

from collections.abc import Mapping, Sequence
from typing import Any

EXIT_DONE = 0
EXIT_BUG = 1
EXIT_INPUT = 2
EXIT_DEVICE = 3
EXIT_DATA = 4
EXIT_UNDECIDED = 5
EXIT_NO_LAW = 6
EXIT_INTERRUPTED = 130


class StickslipError(Exception):
    """An error a user can act on.

    Parameters
    ----------
    what : str
        What was wrong, with the offending value.
    where : str
        The file, key, flag, port or sample it was found at.
    do : str
        What to do about it.

    Attributes
    ----------
    data : dict
        What was found out all the same: keys that stand beside ``error`` in the JSON document.
    lines : list of str
        The same in words, printed before the error.
    """

    exit_code = EXIT_BUG

    def __init__(self, what: str, where: str = "", do: str = "") -> None:
        super().__init__(what, where, do)
        self.what = what
        self.where = where
        self.do = do
        self.data: dict[str, Any] = {}
        self.lines: list[str] = []

    def add_result(self, data: Mapping[str, Any], lines: Sequence[str]) -> None:
        """Add what was found out in spite of the error, as JSON keys and in words."""
        self.data |= data
        self.lines += lines

    def as_json(self) -> dict[str, str]:
        """Return what a JSON document has under ``error``."""
        return {"what": self.what, "where": self.where, "do": self.do}

    def __str__(self) -> str:
        """One line: ``where: what; do``."""
        line = f"{self.where}: {self.what}" if self.where else self.what
        return f"{line}; {self.do}" if self.do else line


class InputError(StickslipError):
    """Usage or bad input: the caller can correct it."""

    exit_code = EXIT_INPUT


class DeviceError(StickslipError):
    """A port, board, cable or disk failed."""

    exit_code = EXIT_DEVICE


class DataError(StickslipError):
    """The recorded data cannot bear what was asked of them."""

    exit_code = EXIT_DATA


def check_known(name: str, known: "list[str] | tuple[str, ...]", what: str, where: str) -> None:
    """Raise InputError, which names the nearest known word, when ``name`` is unknown; ``what`` is its kind."""
    if name not in known:
        raise InputError(f"unknown {what} {name!r}", where, nearest(name, known))


def nearest(word: str, known: "list[str] | tuple[str, ...]") -> str:
    """Return ``'; did you mean X?'`` for the closest known word, or an empty string."""
    from difflib import get_close_matches

    found = get_close_matches(word, known, n=1, cutoff=0.5)
    return f"did you mean {found[0]!r}?" if found else f"known: {', '.join(known)}"
