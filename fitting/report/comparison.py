"""The comparison of separately fitted runs: a page with their verdicts and parameters."""

import html
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fitting.judge.parameters import Parameter
from fitting.palette import INK, law_styles
from fitting.report import page, symbols
from stickslip.errors import InputError, StickslipError
from stickslip.output import atomic
from stickslip.version import VERSION

SUFFIX = ".each.html"
MARK = '<meta name="generator" content="stickslip fit-friction --each'
SHOWN = ("k/m", "Fs/m", "v_dr", "gamma", "G_slip/m", "d", "x0", "c/m")  # per unit mass: every run has these
NOT_SHOWN = ("k", "c", "m", "wear", "droop", "ripple", "ripple_hz")  # parameters of the rig
COLUMNS = 2
Styles = Mapping[int | str, Mapping[str, Any]]
HEAD, PER_RUN = 0.8, 0.23  # inches of a panel: its title and labels, and each run


@dataclass(frozen=True)
class ComparedRun:
    """A run with the document of its fit, or with the failure."""

    file: Path
    document: Mapping[str, Any]
    failure: StickslipError | None = None

    @property
    def law(self) -> int | str | None:
        """The best law; None if no law came near or the fit failed."""
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
        best = self._best or {}
        parameters = best.get("parameters", {})
        others = (name for name in parameters if name not in (*NOT_SHOWN, *SHOWN) and f"{name}/m" not in parameters)
        return [name for name in SHOWN if name in parameters] + (list(others) if "formula" in best else [])

    def as_json(self) -> dict[str, Any]:
        if self.failure is None:
            return {"file": self.file, **self.document}
        return {"file": self.file, "error": self.failure.as_json()} | self.failure.data

    def parameter(self, name: str) -> Parameter | None:
        """Return a parameter of the best law, if it has it; errors are NaN where withheld."""
        item = None if self._best is None else self._best["parameters"].get(name)
        if item is None:
            return None
        stderr, lo, hi = (math.nan if item[key] is None else item[key] for key in ("stderr", "lo", "hi"))
        trusted = item["stderr"] is not None
        return page.in_shown_unit(Parameter(item["value"], stderr, lo, hi, item["unit"], trusted=trusted))


def refuse_foreign_file(path: Path, files: Sequence[Path], *, force: bool = False) -> None:
    """Raise InputError if ``path`` cannot be written or, without ``force``, is not a comparison of these runs."""
    atomic.refuse_existing(path, force, mark=MARK, kind="comparison of runs", flag="--report")
    if path.exists() and not force and _mark(files) not in path.read_text(encoding="utf-8", errors="replace"):
        do = "choose another name (--report), or --force to replace it"
        raise InputError("exists and compares other runs", str(path), do)


def _mark(files: Sequence[Path]) -> str:
    """Return the head lines that identify the page of these runs."""
    names = html.escape(", ".join(file.name for file in files))
    return f'{MARK} {html.escape(VERSION)}">\n<meta name="runs" content="{names}">'


def write(runs: Sequence[ComparedRun], path: Path, alpha: float, summary: str, *, force: bool = False) -> None:
    """Write the comparison, in place of an older one of the same runs."""
    refuse_foreign_file(path, [run.file for run in runs], force=force)
    page.put(render(runs, alpha, summary), path)


def render(runs: Sequence[ComparedRun], alpha: float, summary: str) -> str:
    from markupsafe import Markup

    known = dict.fromkeys(name for run in runs for name in run.names)
    names = [name for name in SHOWN if name in known] + [name for name in known if name not in SHOWN]
    units = {name: next(parameter.unit for run in runs if (parameter := run.parameter(name))) for name in names}
    styles = law_styles(dict.fromkeys(run.law for run in runs if run.law is not None))
    return page.template("comparison.html").render(
        mark=Markup(_mark([run.file for run in runs])),
        rows=[_row(number, run, names, styles) for number, run in enumerate(runs, start=1)],
        names=[(name, symbols.pretty(units[name])) for name in names],
        picture=Markup(draw(runs, names, units, styles)) if names else "",
        symbols=symbols.symbols(names),
        summary=summary,
        confidence=f"{100 * (1 - alpha):g} %",
        version=VERSION,
        now=page.now(),
    )


def _row(number: int, run: ComparedRun, names: Sequence[str], styles: Styles) -> dict[str, Any]:
    return {
        "number": number,
        "file": run.file.name,
        "laws": ", ".join(map(str, run.members)) or "–",
        "verdict": symbols.pretty(run.document["verdict"]) if run.failure is None else f"error: {run.failure.what}",
        "colour": styles[run.law]["color"] if run.law is not None else "",
        "parameters": [run.parameter(name) for name in names] if run.law is not None else [],
    }


def draw(runs: Sequence[ComparedRun], names: Sequence[str], units: Mapping[str, str], styles: Styles) -> str:
    """Draw a panel for each parameter, with value and interval of each run."""
    from fitting import drawing
    from fitting.report import pictures

    lines = -(-len(names) // COLUMNS)
    with drawing.look():
        height = lines * (HEAD + PER_RUN * len(runs))
        drawn, cells = drawing.panels(drawing.WIDE, height, lines, COLUMNS, gap=0.2, sharey=True)
        drawn.subplots_adjust(hspace=HEAD / (PER_RUN * len(runs)))
        panels = cells.flat
        for axes, name in zip(panels, names, strict=False):
            for number, run in enumerate(runs, start=1):
                item = run.parameter(name)
                if item is not None:
                    colour = styles[run.law]["color"] if run.law is not None else INK
                    filled = colour if run.decided else "white"
                    axes.plot([item.lo, item.hi], [number, number], color=colour, lw=2.2)
                    axes.plot(item.value, number, "o", color=colour, mfc=filled, ms=5)
            axes.locator_params(axis="x", nbins=6)
            axes.set_xlabel(f"{symbols.mathtext(name)} ({symbols.pretty(units[name])})")
        for axes in panels:
            axes.remove()
        drawn.axes[0].set_yticks(range(1, len(runs) + 1), [f"run {number}" for number in range(1, len(runs) + 1)])
        drawn.axes[0].set_ylim(len(runs) + 0.6, 0.4)
        return pictures.embed(drawn, f"Values and intervals of {', '.join(names)} of each run.", "comparison")
