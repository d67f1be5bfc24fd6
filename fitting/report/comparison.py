"""The comparison of separately fitted runs: a page with their verdicts and parameters."""

import html
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fitting.drawing.palette import INK, WIDE, law_colours
from fitting.estimation.result import Parameter
from fitting.report import page, symbols
from fitting.report.chart import Axes, picture
from fitting.report.scale import AxisScale
from stickslip.errors import InputError
from stickslip.output import atomic
from stickslip.version import VERSION

SUFFIX = ".each.html"
MARK = '<meta name="generator" content="stickslip fit-friction --each'
SHOWN = ("k/m", "Fs/m", "v_dr", "gamma", "G_slip/m", "d", "x0", "c/m")  # per unit mass: every run has these
NOT_SHOWN = ("k", "c", "m", "wear", "droop", "ripple", "ripple_hz")  # beside the parameters of a formula
COLUMNS = 2
Colours = Mapping[int | str, str]
HEAD, PER_RUN = 76.0, 22.0  # px of a panel: its title and labels, and each run


@dataclass(frozen=True)
class ComparedRun:
    """One run: its file, the document of its fit (empty where it failed), and the error."""

    file: Path
    document: Mapping[str, Any]
    problem: str = ""

    @property
    def law(self) -> int | str | None:
        """The law of the first row; None where no law came near, or the fit failed."""
        return None if self._best is None else self._best["law"]

    @property
    def _best(self) -> Mapping[str, Any] | None:
        return next(iter(self.document.get("ranking", ())), None)

    @property
    def members(self) -> tuple[int | str, ...]:
        return (*self.document.get("set", ()), *self.document.get("rivals", ()))

    @property
    def decided(self) -> bool:
        """Whether exactly one compatible law describes the record."""
        shown = (self.parameter(name) for name in SHOWN)
        return self.members == (self.law,) and all(p is None or p.trusted for p in shown)

    @property
    def names(self) -> list[str]:
        """The parameters of the best law that are shown, per unit mass."""
        best = self._best or {}
        parameters = best.get("parameters", {})
        others = (name for name in parameters if name not in (*NOT_SHOWN, *SHOWN) and f"{name}/m" not in parameters)
        return [name for name in SHOWN if name in parameters] + (list(others) if "formula" in best else [])

    def parameter(self, name: str) -> Parameter | None:
        """Return a parameter of the best law; None if it has no such parameter."""
        item = None if self._best is None else self._best["parameters"].get(name)
        return None if item is None else _parameter(item)


def _parameter(item: Mapping[str, Any]) -> Parameter:
    """Return a parameter from its form in the document, NaN where withheld."""
    stderr, lo, hi = (math.nan if item[key] is None else item[key] for key in ("stderr", "lo", "hi"))
    return Parameter(item["value"], stderr, lo, hi, item["unit"], trusted=item["stderr"] is not None)


def refuse_foreign_file(path: Path, files: Sequence[Path], *, force: bool = False) -> None:
    """Raise InputError when ``path`` cannot be written or, without ``force``, is not a comparison of these runs."""
    atomic.refuse_existing(path, force, mark=MARK, kind="comparison of runs", flag="--report")
    if path.exists() and not force and _mark(files) not in path.read_text(encoding="utf-8", errors="replace"):
        do = "give another name (--report), or --force to replace it"
        raise InputError("exists and is the comparison of other runs", str(path), do)


def _mark(files: Sequence[Path]) -> str:
    """Return the head lines that identify the page of these runs."""
    names = html.escape(", ".join(file.name for file in files))
    return f'{MARK} {html.escape(VERSION)}">\n<meta name="runs" content="{names}">'


def write(runs: Sequence[ComparedRun], path: Path, alpha: float, summary: str, *, force: bool = False) -> None:
    """Write the comparison, in place of an older one of the same runs.

    Raises InputError where ``path`` is another file, and RefusedError where it cannot be written; an older page then
    remains.
    """
    refuse_foreign_file(path, [run.file for run in runs], force=force)
    page.put(render(runs, alpha, summary), path)


def render(runs: Sequence[ComparedRun], alpha: float, summary: str) -> str:
    from markupsafe import Markup

    known = dict.fromkeys(name for run in runs for name in run.names)
    names = [name for name in SHOWN if name in known] + [name for name in known if name not in SHOWN]
    units = {name: next(parameter.unit for run in runs if (parameter := run.parameter(name))) for name in names}
    colours = law_colours(dict.fromkeys(run.law for run in runs if run.law is not None))
    return page.template("comparison.html").render(
        mark=Markup(_mark([run.file for run in runs])),
        rows=[_row(number, run, names, colours) for number, run in enumerate(runs, start=1)],
        names=[f"{name} ({symbols.pretty(units[name])})" for name in names],
        picture=Markup(draw(runs, names, units, colours)) if names else "",
        symbols=symbols.symbols(names),
        summary=summary,
        confidence=f"{100 * (1 - alpha):g} %",
        version=VERSION,
        now=page.now(),
    )


def _row(number: int, run: ComparedRun, names: Sequence[str], colours: Colours) -> dict[str, Any]:
    return {
        "number": number,
        "file": run.file.name,
        "laws": ", ".join(map(str, run.members)) or "–",
        "verdict": symbols.pretty(run.document["verdict"]) if run.document else f"error: {run.problem}",
        "colour": colours[run.law] if run.law is not None else "",
        "parameters": [_value(run.parameter(name)) for name in names] if run.law is not None else [],
    }


def _value(item: Parameter | None) -> tuple[str, str]:
    if item is None:
        return "–", ""
    value, _, interval, _ = page.format_interval(item)
    return value, interval


def draw(runs: Sequence[ComparedRun], names: Sequence[str], units: Mapping[str, str], colours: Colours) -> str:
    """Draw a panel for each parameter: a line of each run, with its value and interval."""
    rows = tuple(f"run {number}" for number in range(len(runs), 0, -1))
    down = AxisScale(-0.6, len(runs) - 0.4, names=rows)
    width, height = WIDE / COLUMNS, HEAD + PER_RUN * len(runs)
    drawn = []
    for place, name in enumerate(names):
        shown = [
            (len(runs) - 1 - k, run, parameter) for k, run in enumerate(runs) if (parameter := run.parameter(name))
        ]
        ends = np.array([[item.value, item.lo, item.hi] for _, _, item in shown])
        line, column = divmod(place, COLUMNS)
        axes = Axes(column * width, line * height, width, height, AxisScale.around(ends), down, rows=0)
        axes.title = name
        axes.xlabel = f"{name} ({symbols.pretty(units[name])})"
        for y, run, item in shown:
            colour = colours[run.law] if run.law is not None else INK
            axes.line(np.array([item.lo, item.hi]), np.full(2, float(y)), colour, width=2.2)
            sign = "o" if run.decided else "c"
            axes.marks(np.array([item.value]), np.array([float(y)]), colour, sign=sign, size=3.6)
        drawn.append(axes)
    about = f"Values and intervals of {', '.join(names)} of each run."
    return picture("comparison", WIDE, height * -(-len(names) // COLUMNS), drawn, about)
