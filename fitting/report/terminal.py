"""The printed ranking of `fit-friction`: verdict, laws, parameters, goodness of fit, warnings."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fitting.judge.adequacy import Adequacy
from fitting.report import page
from fitting.report.symbols import MOTION, formula
from fitting.result import Ranking
from fitting.words.verdict import format_probability
from processing.statistics import pooled
from stickslip.console import application
from stickslip.output.lengths import format_length

if TYPE_CHECKING:
    from rich.table import Table


INTERVAL = 3  # column of the table of parameters that may be broken over two lines


def of_ranking(ranking: Ranking, written: Sequence[Path | None]) -> list[Any]:
    """Return the lines and tables of a ranking; ``written`` are the files of joint fit and report."""
    # The last line is the verdict too: it is what a long output ends on, and what scripts read.
    lines: list[Any] = [f"verdict: {ranking.verdict}"]
    if ranking.rows:
        law = f"{ranking.best.label}: {formula(ranking.best.fit.law)}; {MOTION}"
        unfitted = [f"law {row.law} was not fitted: {row.reason}" for row in ranking.unfitted]
        lines += [_laws(ranking), *unfitted, _parameters(ranking), law, *_adequacy(ranking.adequacy)]
    lines += [f"warning: {warning}" for warning in ranking.warnings]
    lines += pooled(ranking.statistics).sentences("m")
    named = [f"; {kind}: {path}" for kind, path in zip(("joint fit", "report"), written, strict=True) if path]
    cycles = f"{ranking.best.cycles} cycles, " if ranking.rows else ""
    lines.append(f"{cycles}{ranking.cpu_s:.1f} s of CPU time{''.join(named)}")
    lines.append(f"verdict: {ranking.verdict}")
    return lines


def _laws(ranking: Ranking) -> "Table":
    table = application.table("friction laws, best first", ("law", "rms error", "misfit", "behind", "weight", "in set"))
    for row in ranking.rows:
        style = "bold" if row.in_set else None
        member = "yes" if row.in_set else "-"
        shown = (format_length(row.rms_m), f"{row.misfit:.3g}", *page.format_evidence(row), member)
        table.add_row(row.title, *shown, style=style)
    for law in ranking.unfitted:
        table.add_row(law.title, "not fitted", *["-"] * 4)
    return table


def _adequacy(adequacy: Adequacy) -> list[Any]:
    lines: list[Any] = []
    goodness = adequacy.goodness
    if goodness is not None:
        lines.append(
            f"goodness of fit: {adequacy.said}; residuals {goodness.misfit:.3g} times the noise of "
            f"{1e6 * goodness.noise_m:.3g} um, repeating share {goodness.repeat:.2g}, "
            f"p {format_probability(goodness.p_value)}; "
            f"smallest visible departure of friction: {page.smallest_departure(adequacy)}"
        )
    if adequacy.departures:
        title = "with a departure of the rig" if adequacy.rejected else "beside the law"
        table = application.table(title, ("departure", "sigmas", "size", "std. error", "unit", "explained"))
        table.columns[0].justify, table.columns[0].overflow = "left", "fold"
        for one in adequacy.departures:
            size = (f"{one.value:.4g}", f"{one.stderr:.2g}", one.unit, f"{100 * one.explained:.0f} %")
            table.add_row(one.name, f"{one.sigmas:.1f}", *size)
        lines.append(table)
    return lines


def _parameters(ranking: Ranking) -> "Table":
    headings = ("parameter", "value", "std. error", f"{100 * (1 - ranking.alpha):g} % interval", "unit")
    table = application.table(ranking.best.label, headings)
    rows = [(name, *page.format_interval(item)[:3], item.unit) for name, item in ranking.best.parameters.items()]
    for row in rows:
        table.add_row(*row)
    # A narrow terminal breaks the intervals and the headings between words, and never a name or a number.
    for place, column in enumerate(table.columns):
        cells = [row[place] for row in rows]
        whole = [word for cell in cells for word in cell.split()] if place == INTERVAL else cells
        column.no_wrap = False
        column.min_width = max(map(len, (*whole, *headings[place].split())))
    return table
