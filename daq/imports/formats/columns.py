"""Columns read by a library of C, which may crash: in a child process, on the bytes of `daq.imports.source`."""

import json
import os
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from daq.imports.lines import TOGETHER, Rows, number_lines
from daq.imports.source import MOST_BYTES, Source, check_size, read, shorten
from daq.imports.table import Table
from daq.runfile.isolation import BrokenOffError, Work, run_isolated
from daq.runfile.regular import open_regular
from stickslip.compute.arrays import Array
from stickslip.errors import InputError


@dataclass(frozen=True)
class Column:
    name: str
    values: Array
    clock: tuple[float, float] | None = None  # of a waveform: time of its first value and interval, s


def require(library: str, path: Path) -> None:
    """Raise InputError, which says how to install it, where a library of the extra ``formats`` is missing."""
    if find_spec(library) is None:
        what = f"{library}, which reads {path.suffix} files, is not installed"
        do = "install the extra 'formats': pip install 'stickslip[formats]', or export the table as CSV"
        raise InputError(what, str(path), do)


@contextmanager
def refuse_unreadable(kind: str, path: Path, do: str) -> Iterator[None]:
    """Turn any error of a library that reads a file into an InputError."""
    try:
        yield
    except (MemoryError, InputError):
        raise
    except Exception as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(f"is not a {kind} ({reason[:200]})", str(path), do) from error


def parse_isolated(work: Work, path: Path, seconds: float, memory: int, kind: str, do: str) -> bytes:
    """Return what a child makes of a file; ``memory``, bytes, is what it may use in addition to the file's size."""
    with open_regular(path, "choose a file in it") as file:
        size = os.fstat(file.fileno()).st_size
    try:
        return run_isolated(work, path, seconds, memory + 3 * min(size, MOST_BYTES))
    except BrokenOffError as error:
        raise InputError(f"cannot be read as a {kind}: it {error}", str(path), do) from error


def pack_columns(parser: Callable[[Source], tuple[str, list[Column]]], path: Path, kind: str, do: str) -> bytes:
    """Return, in the child, when a file was recorded and its columns, as a parser reads them, for `build_table`."""
    source = read(path, "choose a file in it")
    with refuse_unreadable(kind, path, do):
        recorded, columns = parser(source)
    check_size(1, len(columns), str(path))
    check_size(sum(column.values.size for column in columns), 1, str(path))
    descriptions = [(_clean_name(column.name), column.values.size, column.clock) for column in columns]
    head = json.dumps([source.sha256, source.modified_s, recorded, descriptions])
    return b"\n".join([head.encode(), b"".join(column.values.astype("<f8").tobytes() for column in columns)])


def build_table(path: Path, message: bytes, kind: str, content: str) -> Table:
    """Return the table of the columns that have the usual length, with their waveforms' times before them.

    ``content`` is what a file without columns lacks.
    """
    head, _, numbers = message.partition(b"\n")
    sha256, modified_s, recorded, descriptions = json.loads(head)
    if not descriptions:
        raise InputError(f"has no {content}", str(path), "use a file with times and positions")
    ends = 8 * np.cumsum([0, *(size for _, size, _ in descriptions)])
    every = [
        Column(name, np.frombuffer(numbers[first:last], "<f8"), None if clock is None else (clock[0], clock[1]))
        for (name, _, clock), first, last in zip(descriptions, ends[:-1], ends[1:], strict=True)
    ]
    length = Counter(column.values.size for column in every).most_common(1)[0][0]
    columns = [column for column in every if column.values.size == length]
    clocks = list(dict.fromkeys(column.clock for column in columns if column.clock is not None))
    names = ["Time (s)"] if len(clocks) == 1 else []
    for clock in clocks if len(clocks) > 1 else ():
        first_name = next(column.name for column in columns if column.clock == clock)
        names.append(f"Time of {first_name.split(' (')[0]} (s)")
    values = [*(begin + step * np.arange(length) for begin, step in clocks), *(column.values for column in columns)]
    names += [column.name for column in columns]
    texts = []
    for first in range(0, length, TOGETHER):
        cells = (map(repr, each[first : first + TOGETHER].tolist()) for each in values)
        texts.append("\n".join(map("\t".join, zip(*cells, strict=True))))
    lines = number_lines("\n".join(texts))
    return Table(
        path,
        tuple(names),
        Rows(lines, "\t"),
        lines.number,
        len(names),
        delimiter="",
        decimal=".",
        kind=kind,
        recorded=recorded,
        sha256=sha256,
        modified_s=modified_s,
        clocks=(*[None] * len(clocks), *(c.clock if c.clock is None else clocks.index(c.clock) for c in columns)),
        left_out=shorten(column.name for column in every if column.values.size != length),
    )


def _clean_name(name: str | bytes) -> str:
    """Return a name without bytes that are not UTF-8."""
    text = name.decode("utf-8", "replace") if isinstance(name, bytes) else name.encode("utf-8", "replace").decode()
    return "".join(letter if letter.isprintable() else "?" for letter in text)
