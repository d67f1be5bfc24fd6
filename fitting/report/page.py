"""The report: one static, printable page that includes its pictures and loads nothing."""

import html
import math
import re
from collections.abc import Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from daq.runfile import store
from daq.runfile.recording import Recording
from fitting.adequacy.result import Adequacy
from fitting.drawing.palette import law_colours, run_colour
from fitting.estimation.result import Parameter
from fitting.report import mathml, symbols
from fitting.selection.result import LawResult, Ranking
from fitting.selection.verdict import format_probability
from processing.record.kinematics import Kinematics
from processing.statistics import StickSlipStatistics, pooled
from stickslip.errors import InputError
from stickslip.output import atomic
from stickslip.output.lengths import format_length
from stickslip.text import storable
from stickslip.version import VERSION

if TYPE_CHECKING:
    from jinja2 import Template

SUFFIX = ".report.html"
NAMED = re.compile("sha256 of the raw record ([0-9a-f]{64})")
TEMPLATES = Path(__file__).with_name("templates")
STRONG, MOST_NAMED = 0.9, 4  # correlations that are named in words: above 0.9 a parameter's error doubles by them
MARK = '<meta name="generator" content="stickslip fit-friction'


def default_path(run: Path) -> Path:
    return run.with_name(run.stem + SUFFIX)


def report_paths(runs: Sequence[Path], report: Path | None) -> list[Path]:
    """Return the paths of the reports: next to each run, or FILE, FILE-2, ...; two equal ones are an InputError."""
    if report is None:
        places = [default_path(run) for run in runs]
    else:
        places = [report, *(report.with_stem(f"{report.stem}-{n}") for n in range(2, len(runs) + 1))]
    if len({place.absolute() for place in places}) < len(places):
        raise InputError("two runs share one report", ", ".join(map(str, places)), "give a name with --report")
    return places


def refuse_foreign_file(path: Path, digests: Sequence[str], *, files: Sequence[Path] = (), force: bool = False) -> None:
    """Raise InputError when ``path`` cannot be written or, without ``force``, is not a report of these runs.

    A report contains the sha256 of each of its raw records. The one named after a run of ``files`` may also be that of
    an earlier run of this name which no run in the folder holds.
    """
    atomic.refuse_existing(path, force, mark=MARK, kind="report", flag="--report")
    if not path.exists() or force:
        return
    text = path.read_text(encoding="utf-8", errors="replace")
    named = set(NAMED.findall(text))
    if all(digest in text for digest in digests) and named <= set(digests):
        return
    what, do = "exists and is the report of another run", "give another name (--report), or --force to replace it"
    if len(files) == 1 and named and path.absolute() == default_path(files[0]).absolute():
        kept = _holder(named, files[0])
        if kept is None:
            return
        what += f", {kept.name}"
    raise InputError(what, str(path), do, python="give another name, or force=True to replace it")


def _holder(digests: set[str], file: Path) -> Path | None:
    """Return the run next to ``file`` that holds one of these raw records, None where they are gone."""
    for other in sorted(file.absolute().parent.glob("*.h5")):
        if other.name == file.name:
            continue
        try:
            with store.open_reader(other) as reader:
                digest = reader.load(slice(1)).digest
        except (InputError, OSError):  # no run
            continue
        if digest in digests:
            return other
    return None


def write(page: str, path: Path, digests: Sequence[str], *, files: Sequence[Path] = (), force: bool = False) -> None:
    """Write a page of `render`, in place of a report of the same runs, or of any file with ``force``.

    Raises InputError where ``path`` is another file, and RefusedError where it cannot be written; an older report then
    remains.
    """
    refuse_foreign_file(path, digests, files=files, force=force)
    put(page, path)


def put(page: str, path: Path) -> None:
    with atomic.replacing(path, force=True) as temporary:
        temporary.write_text(storable(page), encoding="utf-8")


def template(name: str) -> "Template":
    """Return a template of this folder; inserted text is escaped."""
    import jinja2

    loader = jinja2.FileSystemLoader(TEMPLATES)
    return jinja2.Environment(loader=loader, autoescape=True, undefined=jinja2.StrictUndefined).get_template(name)


def now() -> str:
    return datetime.now().astimezone().isoformat(" ", timespec="minutes")


def render(
    ranking: Ranking, motions: Sequence[Kinematics], statistics: Sequence[StickSlipStatistics], alpha: float
) -> str:
    """Return the report as HTML; motions and statistics are those of each run."""
    from markupsafe import Markup

    from fitting.report import plot

    first, colours = motions[0].recording, law_colours(row.law for row in ranking.rows)
    title = first.title or first.source.name
    if ranking.runs:
        title = ", ".join(motion.recording.source.name for motion in motions)
    return template("report.html").render(
        mark=Markup(f'{MARK} {html.escape(VERSION)}">'),
        title=title,
        joint=bool(ranking.runs),
        runs=[
            _run(number, side, motion)
            for number, (side, motion) in enumerate(zip(ranking.sides, motions, strict=True), start=1)
        ],
        now=now(),
        version=VERSION,
        said=ranking.verdict,
        verdict=symbols.pretty(ranking.verdict),
        alone=len(ranking.members) == 1 and not ranking.adequacy.rejected,
        rows=[_row(row, colours) for row in ranking.rows if _is_on_first_screen(row, ranking)],
        unfitted=[row for row in ranking.unfitted if row.asked],
        best=ranking.best if ranking.rows else None,
        parameters=[(name, *format_interval(item)) for name, item in _best(ranking).items()],
        rivals=[_rival(row) for row in ranking.rivals if row.in_set and row is not ranking.best],
        correlations=_correlations(ranking),
        motion=symbols.MOTION,
        formulas=[_formula(row) for row in ranking.rows],
        symbols=symbols.symbols({name for side in ranking.sides for row in side.rows for name in row.parameters}),
        confidence=f"{100 * (1 - alpha):g} %",
        warnings=[symbols.pretty(warning) for warning in ranking.warnings],
        statistics=pooled(statistics).rows(motions[0].unit),
        adequacy=ranking.adequacy,
        pretty=symbols.pretty,
        adequacy_facts=_adequacy_facts(ranking.adequacy),
        forms=_forms(ranking.adequacy),
        pictures={name: Markup(text) for name, text in plot.draw(ranking, statistics).items()},
        cpu=f"{ranking.cpu_s:.2f} s",
    )


def _best(ranking: Ranking) -> dict[str, Parameter]:
    return ranking.best.parameters if ranking.rows else {}


def _formula(row: LawResult) -> tuple[str, str, Any, str]:
    """Return number or name of a law, its name in words, its curve typeset, and its contact."""
    from markupsafe import Markup

    curve, contact = symbols.typeset(row)
    return str(row.law), row.name if row.formula is None else "", Markup(curve), contact


def _rival(row: LawResult) -> dict[str, Any]:
    """Return name and parameters of a compatible formula that is not the best requested law."""
    shown = [(name, *format_interval(item)) for name, item in row.parameters.items()]
    return {"label": row.label, "asked": row.asked, "parameters": shown}


def _run(number: int, side: Ranking, kinematics: Kinematics) -> dict[str, Any]:
    """Return the page's data of one run: its source, what was fitted, and how well."""
    recording, cut, motion = kinematics.recording, side.cut, side.motion
    best = side.best if side.rows else None
    return {
        "number": number,
        "file": recording.source.name,
        "when": _when(recording),
        "remarks": recording.remarks(),
        "digest": recording.digest,
        "colour": run_colour(number),
        "adequacy": side.adequacy.said,
        "rms": symbols.pretty(format_length(best.rms_m)) if best else "",
        "cycles": best.cycles if best else "",
        "speed": " ± ".join(format_interval(best.parameters["v_dr"])[:2]) if best else "",
        "events": [_event(event) for event in side.events],
        "facts": [
            (
                "record",
                f"{motion.span:.4g} s at {recording.rate_hz:g} Hz, {motion.time.size} samples, from "
                f"{motion.begin + motion.time[0]:.4g} to {motion.begin + motion.time[-1]:.4g} s of the run",
            ),
            ("break-aways", f"{len(cut.cycles)} found, {len(cut.used)} fitted"),
            ("in stick", f"{100 * cut.plateau_fraction:.0f} % of the record"),
            ("standard error of a position", symbols.pretty(format_length(motion.resolution))),
            (
                "smoothing",
                f"{kinematics.method}, window {kinematics.window}, order {kinematics.order} (starting values only)",
            ),
        ],
    }


def _adequacy_facts(adequacy: Adequacy) -> list[tuple[str, str]]:
    """Return goodness of fit as names and values."""
    goodness = adequacy.goodness
    if goodness is None:
        return []
    facts = [
        ("verdict", adequacy.said),
        ("noise of one position", symbols.pretty(format_length(goodness.noise_m))),
        ("residuals of the best law", f"{goodness.misfit:.3g} times the noise"),
        ("share that repeats in every cycle", f"{goodness.repeat:.2g}"),
        ("probability by noise alone", format_probability(goodness.p_value).removeprefix("= ")),
    ]
    facts.append(("smallest departure of friction to be seen", smallest_departure(adequacy)))
    if adequacy.curve is not None:
        K = adequacy.curve.k_over_m
        interval = f"{K.lo:.6g} … {K.hi:.6g}" if K.trusted else "interval withheld"
        facts.append(("k/m of the measured curve", f"{K.value:.6g} s⁻² ({interval})"))
        facts.append(("residuals of the measured curve", f"{adequacy.curve.chi:.3g} times the noise"))
    return facts


def smallest_departure(adequacy: Adequacy) -> str:
    """Return the smallest detectable departure of friction in words."""
    visible = adequacy.smallest_visible
    return f"{visible:.2g} % of Fs" if visible is not None else "not determined by this record"


def _forms(adequacy: Adequacy) -> list[tuple[str, str, str, str, str, str]]:
    """Return the published laws as they were fitted, nearest first; none where no curve was measured."""
    if adequacy.curve is None:
        return []
    return [
        (
            form.name,
            symbols.pretty(form.formula),
            ", ".join(
                f"{name} = {item.value:.4g} {symbols.pretty(item.unit)}"
                for name, item in form.parameters.items()
                if item is not None
            ),
            "not fitted" if form.chi is None else f"{form.chi:.2f}",
            "yes" if form.inside_band else "no",
            form.source,
        )
        for form in adequacy.forms
    ]


def _when(recording: Recording) -> str:
    """Return the time of recording; of an imported table, that of its file's last change."""
    said = recording.when.removesuffix(recording.started) or "recorded "
    return said + moment(recording.started)


def moment(stated: str) -> str:
    """Return a date and time in ISO 8601 without fractions of a second."""
    try:
        return datetime.fromisoformat(stated).isoformat(" ", timespec="seconds")
    except ValueError:
        return stated


def _correlations(ranking: Ranking) -> dict[str, Any] | None:
    """Return the correlations of the parameters as a triangle of cells, and the strongest, in descending order."""
    correlations = ranking.correlations()
    if correlations is None:
        return None
    size = range(len(correlations.names))
    pairs = sorted(((i, j) for i in size for j in range(i)), key=lambda pair: -abs(correlations.matrix[pair]))
    strong = [pair for pair in pairs if abs(correlations.matrix[pair]) >= STRONG][:MOST_NAMED]
    cells = [
        (
            correlations.names[i],
            [(_signed(correlations.matrix[i, j]), _shade(correlations.matrix[i, j])) for j in range(i)],
        )
        for i in size[1:]
    ]
    named = [
        f"{correlations.names[i]} and {correlations.names[j]} ({_signed(correlations.matrix[i, j])})" for i, j in strong
    ]
    return {"names": correlations.names[:-1], "cells": cells, "strongest": named}


def _signed(value: float) -> str:
    return f"{value:+.2f}".replace("-", "\N{MINUS SIGN}")


def _shade(value: float) -> str:
    """Return the colour of a cell: blue for errors of the same sign, orange for those of opposite sign."""
    return f"rgba({'0,114,178' if value > 0 else '230,159,0'},{0.65 * abs(value):.2f})"


def _is_on_first_screen(row: LawResult, ranking: Ranking) -> bool:
    """Return whether a law was requested or may be the contact's; the table of published laws has the others."""
    return row.asked or row.in_set or row is ranking.best or row.law in ranking.not_excluded


def _row(row: LawResult, colours: Mapping[int | str, str]) -> dict[str, Any]:
    from markupsafe import Markup

    behind, weight = format_evidence(row)
    return {
        "law": row.law,
        "name": row.name if row.formula is None else Markup(mathml.typeset(row.formula)),
        "asked": row.asked,
        "in_set": row.in_set,
        "rms": symbols.pretty(format_length(row.rms_m)),
        "misfit": f"{row.misfit:.3g}",
        "score": "–" if row.score is None else f"{row.score:.1f}",
        "weight": weight,
        "behind": behind,
        "orbit": f"{100 * row.orbit:.2g} %",
        "cpu": f"{row.cpu_s:.2f} s",
        "colour": colours[row.law],
    }


def format_evidence(row: LawResult) -> tuple[str, str]:
    """Return how far a law is behind the best one in mean log error, and its weight; dashes without an evidence."""
    if row.score is None or row.weight is None or row.behind is None:
        return "–", "–"
    behind = "best" if row.score == 0 else f"{row.behind[0]:.2f} ± {row.behind[1]:.2f}"
    return behind, f"{row.weight:.2f}" if row.weight >= 0.005 else "< 0.01"


def _event(event: Any) -> tuple[str, str, str, str, str]:
    def shown(value: float) -> str:
        return "–" if math.isnan(value) else f"{value:.4f}"

    return str(event.number), f"{event.t:.3f}", shown(event.break_away_level), shown(event.kinetic_scale), event.flag


def format_interval(item: Parameter) -> tuple[str, str, str, str]:
    """Return value, standard error and interval with as many digits as the error deserves, and the unit.

    Withheld error and interval are empty, and the value has four digits.
    """
    if item.fixed:
        return f"{item.value:.6g}", "fixed", "–", symbols.pretty(item.unit)
    if not item.trusted:
        return f"{item.value:.4g}", "–", "withheld", symbols.pretty(item.unit)
    digits = item.decimals
    value = f"{item.value:.{digits}f}"
    return (
        value,
        f"{item.stderr:#.2g}".rstrip("."),
        f"{item.lo:.{digits}f} … {item.hi:.{digits}f}",
        symbols.pretty(item.unit),
    )
