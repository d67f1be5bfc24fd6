"""The tables in docs/reliability.md: rows of campaigns that have run replace their own, the others stay."""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from .campaign import CAMPAIGNS, Result

BEGIN, END = "<!-- begin: {} -->", "<!-- end: {} -->"
TABLES = {
    "results": ("campaign", "promise", "tried", "measured", "test"),
    "runs": ("campaign", "date", "version", "processor", "minutes", "CPU minutes"),
}


@dataclass(frozen=True)
class Rows:
    """What one campaign found, and when, with what and for how long."""

    name: str
    results: tuple[Result, ...]
    date: str
    version: str
    processor: str
    minutes: float
    cpu_minutes: float


def replace_rows(path: Path, found: Rows) -> None:
    """Put the rows of a campaign into the page, in the order of `CAMPAIGNS`.

    Raises
    ------
    ValueError
        The page has no such table.
    """
    text = path.read_text(encoding="utf-8")
    for table, headings in TABLES.items():
        begin, end = BEGIN.format(table), END.format(table)
        before, inside, after = _parts(text, begin, end)
        kept = [line for line in inside.splitlines() if line.startswith("| ")][1:]
        rows = {name: [line for line in kept if line.startswith(f"| {name} |")] for name in CAMPAIGNS}
        rows[found.name] = _results(found) if table == "results" else [_run(found)]
        lines = [_row(headings), "|---" * len(headings) + "|", *(line for name in rows for line in rows[name])]
        text = "\n".join([before + begin, "", *lines, "", end + after])
    path.write_text(_with_total(text), encoding="utf-8")


def _with_total(text: str) -> str:
    """State below the table of the runs how much CPU time all of them took."""
    begin, end = BEGIN.format("total"), END.format("total")
    before, _, after = _parts(text, begin, end)
    runs = _parts(text, BEGIN.format("runs"), END.format("runs"))[1]
    cells = [[cell.strip() for cell in line.split("|")[1:-1]] for line in runs.splitlines()]
    minutes = {row[0]: float(row[-1]) for row in cells if row and row[0] in CAMPAIGNS and row[-1] != "nan"}
    missing = [name for name in CAMPAIGNS if name not in minutes]
    but = f", without {', '.join(missing)}" if missing else ""
    line = (
        f"All campaigns together took {sum(minutes.values()):.1f} minutes of CPU time{but}; the longest one "
        f"{max(minutes.values(), default=0.0):.1f}."
    )
    return "\n".join([before + begin, "", line, "", end + after])


def _parts(text: str, begin: str, end: str) -> tuple[str, str, str]:
    before, found, rest = text.partition(begin)
    inside, found_end, after = rest.partition(end)
    if not (found and found_end):
        raise ValueError(f"the page has no {begin} ... {end}")
    return before, inside, after


def _row(cells: Iterable[str]) -> str:
    return "| " + " | ".join(cell.replace("|", "\\|").replace("\n", " ") for cell in cells) + " |"


def _results(found: Rows) -> list[str]:
    rows = []
    for result in found.results:
        broken = f"; **{len(result.faults)} faults**" if result.faults else ""
        rows.append(_row((found.name, result.promise, result.tried, result.measured + broken, f"`{result.test}`")))
    return rows


def _run(found: Rows) -> str:
    return _row(
        (found.name, found.date, found.version, found.processor, f"{found.minutes:.1f}", f"{found.cpu_minutes:.1f}")
    )
