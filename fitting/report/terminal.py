"""Printed texts: the ranking of `fit-friction`, and the best law in the form of lmfit, whose users know it."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fitting import noise_levels
from fitting.judge.adequacy import Adequacy
from fitting.report import page
from fitting.report.symbols import MOTION, formula
from fitting.result import LawResult, Ranking, UnfittedLaw
from fitting.words.verdict import format_probability
from processing.statistics import pooled
from stickslip.console import application
from stickslip.output.lengths import format_length

if TYPE_CHECKING:
    from rich.table import Table


LEAST_CORRELATION = 0.1  # listed, as in lmfit
INTERVAL = 3  # column of the table of parameters that may be broken over two lines


def of_ranking(ranking: Ranking, written: Sequence[Path | None]) -> list[Any]:
    """Return the lines and tables of a ranking; ``written`` are the files of joint fit and report."""
    lines: list[Any] = []
    if ranking.rows:
        law = f"{ranking.best.label}: {formula(ranking.best.fit.law)}; {MOTION}"
        unfitted = [f"law {row.law} was not fitted: {row.reason}" for row in ranking.unfitted]
        lines += [_laws(ranking), *unfitted, _parameters(ranking), law, *_adequacy(ranking.adequacy)]
    lines += pooled(ranking.statistics).sentences("m")
    lines += [f"{kind}: {path}" for kind, path in zip(("joint fit", "report"), written, strict=True) if path]
    lines += [f"warning: {warning}" for warning in ranking.warnings]
    lines.append(application.verdict(ranking.verdict, len(ranking.members)))
    return lines


def _laws(ranking: Ranking) -> "Table":
    table = application.table(
        "friction laws, best first", ("law", "rms error", "misfit", "Δ log error", "weight", "compatible")
    )
    for row in ranking.rows:
        style = "bold" if row.in_set else None
        member = "yes" if row.in_set else "-"
        shown = (format_length(row.rms_m), f"{row.misfit:.3g}", *page.format_evidence(row), member)
        table.add_row(_title(row), *shown, style=style)
    for law in ranking.unfitted:
        table.add_row(_title(law), "not fitted", *["-"] * 4)
    return table


def _title(row: LawResult | UnfittedLaw) -> str:
    return row.title if row.formula is None else str(row.law)


def _adequacy(adequacy: Adequacy) -> list[Any]:
    lines: list[Any] = []
    goodness = adequacy.goodness
    if goodness is not None:
        noise_words = f"noise of {1e6 * goodness.noise_m:.2g} um"
        clear = goodness.misfit > noise_levels.CLEARLY_ABOVE
        residual = f"{goodness.misfit:.3g} times the {noise_words}" if clear else f"at the {noise_words}"
        p_value = format_probability(goodness.p_value)
        lines.append(f"goodness of fit: {adequacy.said}; residual {residual}" + f", p {p_value}" * goodness.judged)
        if adequacy.smallest_visible is not None and not adequacy.rejected:
            smallest = page.smallest_departure(adequacy)
            lines.append(f"a deviation from this law above {smallest} would have been detected")
    if adequacy.departures:
        title = (
            "departures with which a law describes the record"
            if adequacy.rejected
            else "departures that improve the fit of the law"
        )
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


def fit_report(ranking: Ranking) -> str:
    best = ranking.best
    lines = ["[[Model]]", f"    {best.called}, F = {best.fit.law.written}", "[[Fit Statistics]]"]
    numbers = {
        "data points": best.fit.residual.size,
        "cycles": best.cycles,
        "rms residual": f"{best.rms_m:.4g} m",
        "misfit": f"{best.misfit:.4g} (rms over noise)",
        "Akaike info crit": f"{best.aic:.8g}",
        "Bayesian info crit": f"{best.bic:.8g}",
    }
    lines += [f"    {name:18} = {number}" for name, number in numbers.items()]
    lines.append("[[Variables]]")
    width = max(map(len, best.parameters)) + 1
    lines += [f"    {f'{name}:':{width}} {item.brief}" for name, item in best.parameters.items()]
    correlations = ranking.correlations()
    if correlations is not None:
        lines.append(f"[[Correlations]] (unreported correlations are < {LEAST_CORRELATION:.3f})")
        names, matrix = correlations.names, correlations.matrix
        pairs = [(i, j) for j in range(len(names)) for i in range(j) if abs(matrix[i, j]) >= LEAST_CORRELATION]
        for i, j in sorted(pairs, key=lambda pair: -abs(matrix[pair])):
            lines.append(f"    C({names[i]}, {names[j]}) = {matrix[i, j]:+.4f}")
    return "\n".join(lines)


def ci_report(ranking: Ranking) -> str:
    confidence = f"{100 * (1 - ranking.alpha):g}%"
    rows = [("", confidence, "best", confidence)]
    for name, item in ranking.best.parameters.items():
        digits = item.decimals
        ends = (f"{item.lo:.{digits}f}", f"{item.value:.{digits}f}", f"{item.hi:.{digits}f}")
        withheld = ("withheld", f"{item.value:.4g}", "withheld")
        rows.append((f"{name}:", *(ends if item.trusted else withheld)))
    widths = [max(len(row[column]) for row in rows) for column in range(4)]
    return "\n".join(
        "  ".join([f"{row[0]:{widths[0]}}", *(f"{row[k]:>{widths[k]}}" for k in (1, 2, 3))]) for row in rows
    )
