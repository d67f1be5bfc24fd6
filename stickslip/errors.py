"""The errors of all commands and the exit codes they end in.

::

    StickslipError            what was wrong, where, what to do; exit 1 is left to bugs
    ├── InputError     2      a flag, a file, a scene, a column: the caller's side
    ├── DeviceError    3      a port, a board, a cable, a disk
    └── DataError      4      the record itself: too few cycles, no stick-slip, lost counts

Exit codes: 0 done (also after the first Ctrl-C), 1 a bug, 2 usage or bad input, 3 device, 4 data quality,
5 the fit could not decide between laws, 6 stick-slip that none of the laws describes (both results, not errors),
130 second Ctrl-C.

A message names what its reader can write.  A command's reader types flags; the public functions take the same flags as
keywords.  So a message is written once, with its flags as they are typed, and shown in two ways::

    error.as_line(), error.as_json()    on a terminal: --max-steps, --method=dop853
    str(error)                          from Python:   max_steps, method='dop853'

Where the call from Python is another one than that keyword, the error has it: ``python``.
"""

import re
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

# Flags whose keyword has another name.
KEYWORDS = {
    "bound": "bounds",
    "law": "laws",
    "exclude-cycles": "excluded",
    "from": "begin",
    "to": "end",
    "report": "path",
    "save-scene": "path",
}
_FLAG = re.compile(r"(?<![\w-])--([a-z][a-z0-9]*(?:-[a-z0-9]+)*)(?:[= ]('[^']*')|=([^\s,;:()]*[^\s,;:().]))?")


class StickslipError(Exception):
    """An error a user can act on.

    Attributes
    ----------
    what : str
        What was wrong, with the offending value.
    where : str
        The file, key, flag, port or sample it was found at.
    do : str
        What to do about it.
    python : str
        The same for a caller from Python, where `in_python` of ``do`` does not name the call to make: a scene, a file
        or a result is made by another function, or ``do`` names a command.
    data : dict
        What was found out all the same: keys that stand beside ``error`` in the JSON document.
    lines : list of str
        The same in words, printed before the error.
    """

    exit_code = EXIT_BUG

    def __init__(self, what: str, where: str = "", do: str = "", *, python: str = "") -> None:
        super().__init__(what, where, do)
        self.what = what
        self.where = where
        self.do = do
        self.python = python
        self.data: dict[str, Any] = {}
        self.lines: list[str] = []

    def add_result(self, data: Mapping[str, Any], lines: Sequence[str]) -> None:
        """Add what was computed before the error, as JSON keys and as text."""
        self.data |= data
        self.lines += lines

    def as_json(self) -> dict[str, str]:
        """Return the content of ``error`` in a JSON document."""
        return {"what": self.what, "where": self.where, "do": self.do}

    def as_line(self) -> str:
        """Return one line for a terminal: ``where: what; do``."""
        return _join_parts(self.what, self.where, self.do)

    def __str__(self) -> str:
        """One line for a caller from Python: flags are keywords, and ``python`` stands in place of ``do``."""
        return _join_parts(in_python(self.what), in_python(self.where), self.python or in_python(self.do))


class InputError(StickslipError):
    """Usage or bad input: the caller can correct it."""

    exit_code = EXIT_INPUT


class DeviceError(StickslipError):
    """A port, board, cable or disk failed."""

    exit_code = EXIT_DEVICE


class DataError(StickslipError):
    """The recorded data cannot bear what was asked of them."""

    exit_code = EXIT_DATA


def in_python(text: str) -> str:
    """Write flags as keywords: ``--method=dop853`` as ``method='dop853'``; numbers and CAPITALS stay bare."""
    return _FLAG.sub(_format_keyword, text)


def _format_keyword(flag: "re.Match[str]") -> str:
    name, quoted, value = KEYWORDS.get(flag[1], flag[1].replace("-", "_")), flag[2], flag[3]
    if quoted is not None:
        return f"{name}={quoted}"
    if value is None:
        return name
    return f"{name}={value if value.isupper() or _is_number(value) else repr(value)}"


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _join_parts(what: str, where: str, do: str) -> str:
    line = f"{where}: {what}" if where else what
    return f"{line}; {do}" if do else line


def check_type(
    value: object, kind: "type | tuple[type, ...]", name: str, where: str, form: str, *, required: bool = False
) -> None:
    """Raise InputError for an argument from Python of a wrong type, None if ``required``; ``form`` is what to give."""
    if (required or value is not None) and (
        not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool)
    ):
        raise InputError(f"{name} is a {type(value).__name__}", where, f"give {form}")


def check_known(name: str, names: "list[str] | tuple[str, ...]", what: str, where: str) -> None:
    """Raise InputError, which names the nearest word, when ``name`` is unknown; ``what`` is its kind."""
    if name not in names:
        raise InputError(f"unknown {what} {name!r}", where, nearest(name, names))


def nearest(word: object, names: "list[str] | tuple[str, ...]") -> str:
    """Return "did you mean 'X'?" for the closest name, or all names where none is close."""
    from difflib import get_close_matches

    similar = get_close_matches(str(word), names, n=1, cutoff=0.5)
    return f"did you mean {similar[0]!r}?" if similar else f"known: {', '.join(names)}"
