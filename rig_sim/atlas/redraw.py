"""Redraw figures into a folder: a PNG each, and ``atlas.md``, which shows them with their tables."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from rig_sim.atlas.figure import Drawing, StatementCheck
from rig_sim.atlas.registry import ENTRIES, NOT_REDRAWN
from stickslip.errors import InputError, nearest
from stickslip.output import atomic

PAGE = "atlas.md"
HEAD = """# Atlas

The figures of the thesis whose rig, laws and analyses this project implements, recomputed by `rig-sim atlas`.  Each
table compares the thesis with the computation.  Most numbers of the thesis were read from plots, so a difference of one
unit in the last digit counts as agreement.  Quantities are dimensionless (m = k = Fs = 1) unless an axis names a unit.
"""


def select_figures(requested: Iterable[str] | None) -> list[str]:
    """Return the numbers of the requested figures: '2.7', or '2' for a chapter; all of them for None."""
    all_numbers = sorted([*ENTRIES, *NOT_REDRAWN], key=sort_key)
    figures: list[str] = []
    for name in requested or [number.partition(".")[0] for number in all_numbers]:
        numbers = [number for number in all_numbers if name in (number, number.partition(".")[0])]
        if not numbers:
            raise InputError(f"the atlas has no figure {name!r}", "FIGURE", nearest(name, all_numbers))
        figures += [number for number in numbers if number not in figures]
    return sorted(figures, key=sort_key)


def sort_key(number: str) -> tuple[int, ...]:
    """Return the key that sorts figures as in the thesis: 2.9 before 2.10."""
    return tuple(int(part) for part in number.split("."))


def redraw(
    numbers: Iterable[str],
    folder: Path,
    *,
    force: bool = False,
    progress: Callable[[float], None] = lambda redrawn: None,
) -> list[Drawing]:
    """Redraw figures into a folder, as ``figure-2.7.png`` ... and ``atlas.md``; the folder is made if missing.

    The page lists ``numbers`` that are not redrawn with the reason.  ``force`` replaces files that exist; ``progress``
    is called with the number of figures done.
    """
    numbers = list(numbers)
    files = {number: folder / f"figure-{number}.png" for number in numbers if number in ENTRIES}
    if folder.exists() and not folder.is_dir():
        raise InputError("is not a folder", str(folder), "use the name of a folder (-o)")
    if not folder.exists() and not folder.absolute().parent.is_dir():
        raise InputError("the parent folder does not exist", str(folder), f"make {folder.absolute().parent} first")
    for file in (*files.values(), folder / PAGE):
        if folder.exists():
            atomic.refuse_existing(file, force)
    from rig_sim.atlas.plot import render_picture

    folder.mkdir(exist_ok=True)
    redrawn: list[Drawing] = []
    for number, file in files.items():
        drawing = replace(ENTRIES[number](), file=file)
        with atomic.replacing(file, force) as temporary:
            temporary.write_bytes(render_picture(drawing))
        redrawn.append(drawing)
        progress(len(redrawn))
    missing = {number: NOT_REDRAWN[number] for number in numbers if number in NOT_REDRAWN}
    with atomic.replacing(folder / PAGE, force) as temporary:
        temporary.write_text(format_page(redrawn, missing), encoding="utf-8")
    return redrawn


def format_page(drawn: Sequence[Drawing], not_redrawn: Mapping[str, str]) -> str:
    """Return the page of figures with their pictures, and of the reasons why others are not redrawn."""
    parts = [HEAD, format_differences(drawn)]
    for drawing in drawn:
        parts.append(f"## Figure {drawing.number}: {drawing.title}\n")
        parts += [f"![Figure {drawing.number}]({drawing.file.name})\n", drawing.sentence + "\n"]
        if drawing.choices:
            parts.append(f"The thesis does not state the following; it is chosen here: {drawing.choices}\n")
        if drawing.table:
            parts.append(format_table(drawing.table))
    if not_redrawn:
        parts.append("## Not redrawn\n")
        parts.append("\n".join(f"- {number}: {why}" for number, why in not_redrawn.items()) + "\n")
    return "\n".join(part for part in parts if part)


def format_differences(drawn: Sequence[Drawing]) -> str:
    rows = [(drawing.number, row) for drawing in drawn for row in drawing.table if not row.agrees]
    if not rows:
        return ""
    lines = ["## Where the thesis and the computation differ\n", "| figure | quantity | thesis says | computed |"]
    lines.append("| --- | --- | --- | --- |")
    lines += [f"| {number} | {row.quantity} | {row.thesis} | {row.computed} |" for number, row in rows]
    return "\n".join(lines) + "\n"


def format_table(rows: Iterable[StatementCheck]) -> str:
    lines = ["| quantity | thesis says | computed | why they differ |", "| --- | --- | --- | --- |"]
    for row in rows:
        why = "they agree" if row.agrees else row.why or "not explained"
        lines.append(f"| {row.quantity} | {row.thesis} | {row.computed} | {why} |")
    return "\n".join(lines) + "\n"
