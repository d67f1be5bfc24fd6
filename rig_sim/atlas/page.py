"""The atlas as pages of Markdown: a figure after the other, with its table."""

from collections.abc import Iterable, Mapping

from rig_sim.atlas.figure import Drawing, Entry, StatementCheck

HEAD = """# Atlas

The figures of the thesis whose rig, laws and analyses this project implements, computed anew by `rig-sim atlas`.  Each
table sets what the thesis states beside what is computed; most of its numbers were read off a plot, so that one unit of
the last digit counts as agreement.  Quantities are dimensionless (m = k = Fs = 1) unless an axis names a unit.
"""


def page(drawn: Iterable[tuple[Entry, Drawing, str]], not_redrawn: Mapping[str, str]) -> str:
    """Return the page of figures, each with the name of its picture, and of the reasons why others are not redrawn."""
    drawn = list(drawn)
    parts = [HEAD, differences(drawn)]
    for entry, drawing, picture in drawn:
        parts += [f"## Figure {entry.number}: {entry.title}\n", f"![Figure {entry.number}]({picture})\n"]
        parts.append(drawing.sentence + "\n")
        if drawing.choices:
            parts.append(f"Chosen here, as the thesis does not state it: {drawing.choices}\n")
        if drawing.table:
            parts.append(table(drawing.table))
    if not_redrawn:
        parts.append("## Not redrawn\n")
        parts.append("\n".join(f"- {number}: {why}" for number, why in not_redrawn.items()) + "\n")
    return "\n".join(part for part in parts if part)


def differences(drawn: Iterable[tuple[Entry, Drawing, str]]) -> str:
    """Return the list of the statements that do not hold."""
    rows = [(entry, row) for entry, drawing, _ in drawn for row in drawing.table if not row.agrees]
    if not rows:
        return ""
    lines = ["## Where the thesis and the computation differ\n", "| figure | quantity | thesis says | computed |"]
    lines.append("| --- | --- | --- | --- |")
    lines += [f"| {entry.number} | {row.quantity} | {row.thesis} | {row.computed} |" for entry, row in rows]
    return "\n".join(lines) + "\n"


def table(rows: Iterable[StatementCheck]) -> str:
    """Return a table of comparisons."""
    lines = ["| quantity | thesis says | computed | why they differ |", "| --- | --- | --- | --- |"]
    for row in rows:
        why = "they agree" if row.agrees else row.why or "not explained"
        lines.append(f"| {row.quantity} | {row.thesis} | {row.computed} | {why} |")
    return "\n".join(lines) + "\n"
