"""Tables of the documentation that benchmarks write.

A marked table stands between two comments.  The first names the benchmark, which of its tables it is where it writes
several, and the command that writes it::

    <!-- begin: velocity methods; python benchmarks/velocity.py 6 --write -->
    | method | ... |
    |---|---|
    | `fd` | ... |
    <!-- end: velocity methods -->

A benchmark writes with the flag ``--write``, at its end.  `write` puts rows in place of those with the same first cell
and leaves the others: a benchmark that has not run, or has run a part of its cases, changes no other row.
"""

import re
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

BENCHMARKS = Path(__file__).resolve().parent
DOCS = BENCHMARKS.parent / "docs"
BEGIN = re.compile(r"<!-- begin: ([^;>]+?)(?:; ([^>]+?))? -->")


def write(page: str, name: str, rows: Mapping[str, Sequence[str]], docs: Path = DOCS) -> None:
    """Put rows into a marked table of a page.

    Parameters
    ----------
    page : str
        The page, below ``docs``.
    name : str
        The table, as its marker names it.
    rows : mapping of str to sequence of str
        The cells of each row after the first, by the first.
    docs : Path, optional
        The folder of the pages.

    Raises
    ------
    ValueError
        The page has no such table, or a row has more or fewer cells than the table has columns.
    """
    path = docs / page
    path.write_text(with_rows(path.read_text(encoding="utf-8"), name, rows), encoding="utf-8")


def with_rows(text: str, name: str, rows: Mapping[str, Sequence[str]]) -> str:
    """Return the text of a page with these rows in a table, as `write` puts them there; new ones stand at its end."""
    begin = next((found for found in BEGIN.finditer(text) if found[1] == name), None)
    before, inside, after = text[: begin.end()] if begin else "", "", ""
    if begin:
        inside, found, after = text[begin.end() :].partition(end := f"<!-- end: {name} -->")
        after = found and end + after
    if not after:
        raise ValueError(f"the page has no <!-- begin: {name} --> ... <!-- end: {name} --> around a table")
    lines = {_cells(line)[0]: line for line in inside.strip().splitlines()}
    columns = len(_cells(next(iter(lines.values()), "")))
    for first, cells in rows.items():
        if len(cells) + 1 != columns:
            raise ValueError(f"row {first!r} of table {name!r} has {len(cells) + 1} cells; the table has {columns}")
        lines[first] = f"| {' | '.join([first, *cells])} |"
    return "\n".join([before, "", *lines.values(), "", after])


def marked(text: str) -> list[tuple[str, str]]:
    """Return the tables that a page marks: the name of each, and the command that writes it, "" where none is named."""
    return [(found[1], found[2] or "") for found in BEGIN.finditer(text)]


def asked() -> tuple[list[str], bool]:
    """Return the words of the command line without ``--write``, and whether that was among them."""
    words = sys.argv[1:]
    return [word for word in words if word != "--write"], "--write" in words


def significant(value: float, digits: int = 2) -> str:
    """Return a number with so many significant digits and without an exponent, thousands apart: 0.029, 0.3, 9 360."""
    if not value:
        return "0"
    rounded = float(f"{value:.{digits - 1}e}")
    places = max(0, digits - 1 - int(f"{rounded:e}".partition("e")[2]))
    return f"{rounded:,.{places}f}".replace(",", " ")


def processor() -> str:
    """Return the name of this machine's processor; "unknown" where the system does not tell."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return "unknown"
    return next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), "unknown")


def _cells(line: str) -> list[str]:
    return [cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]] or [""]
