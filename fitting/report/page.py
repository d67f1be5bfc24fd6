"""The report: one static page with its pictures inside, nothing fetched from anywhere, made to be printed."""

import html
import math
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

from daq.errors import InputError
from daq.output import atomic
from daq.version import VERSION
from fitting.adequacy.result import Adequacy
from fitting.drawing.palette import COLOURS
from fitting.estimation.result import Parameter
from fitting.report import symbols
from fitting.selection.result import Ranking
from fitting.selection.verdict import format_length, format_probability
from processing.record.kinematics import Kinematics
from processing.statistics import from_kinematics

TEMPLATES = Path(__file__).with_name("templates")
MARK = '<meta name="generator" content="stickslip fit-friction'


def default_path(run: Path) -> Path:
    """Return where the report of a run goes: RUN.report.html beside it."""
    return run.with_name(run.stem + ".report.html")


def report_paths(runs: Sequence[Path], report: Path | None) -> list[Path]:
    """Return where the reports of several runs go: each beside its run, or FILE, FILE-2, FILE-3 ... in that order.

    Raises
    ------
    InputError
        When two are the same.
    """
    if report is None:
        found = [default_path(run) for run in runs]
    else:
        found = [report, *(report.with_stem(f"{report.stem}-{n}") for n in range(2, len(runs) + 1))]
    if len({place.absolute() for place in found}) < len(found):
        raise InputError("two runs share one report", ", ".join(map(str, found)), "give a name with --report")
    return found


def refuse_foreign_file(path: Path, digest: str, *, force: bool = False) -> None:
    """Raise InputError when ``path`` cannot be written, or without ``force`` holds no report of the run of this digest.

    A report of any release contains the sha256 of the raw record that it was made from.
    """
    atomic.refuse_existing(path, force, own=MARK, kind="report", flag="--report")
    if path.exists() and not force and digest not in path.read_text(encoding="utf-8", errors="replace"):
        do = "give another name (--report), or --force to replace it"
        raise InputError("exists and is the report of another run", str(path), do)


def write(page: str, path: Path, digest: str, *, force: bool = False) -> None:
    """Write a report that `render` made.

    Parameters
    ----------
    page : str
        The HTML that `render` returned.
    path : Path
        An older report of the same run there is replaced, any other file only by ``force``.
    digest : str
        Of the run's raw data.
    force : bool

    Raises
    ------
    InputError
        When ``path`` holds something else.
    RefusedError
        The disk refuses; an older report still stands.
    """
    refuse_foreign_file(path, digest, force=force)
    with atomic.replacing(path, force=True) as temporary:
        temporary.write_text(page, encoding="utf-8")


def render(ranking: Ranking, kinematics: Kinematics, alpha: float) -> str:
    """Return the report as HTML."""
    import jinja2
    from markupsafe import Markup

    from fitting.report import plot

    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(TEMPLATES), autoescape=True, undefined=jinja2.StrictUndefined
    )
    recording = kinematics.recording
    cut, motion = ranking.cut, ranking.motion
    counted = from_kinematics(kinematics)
    return environment.get_template("report.html").render(
        mark=Markup(f'{MARK} {html.escape(VERSION)}">'),
        title=recording.title or recording.source.name,
        file=recording.source.name,
        started=recording.started,
        remarks=recording.remarks(),
        now=datetime.now().astimezone().isoformat(timespec="minutes"),
        version=VERSION,
        digest=recording.digest,
        verdict=_pretty(ranking.verdict),
        alone=len(ranking.laws_in_set) == 1 and ranking.adequacy.adequate,
        rows=[_row(row, ranking) for row in ranking.rows],
        best=ranking.best if ranking.rows else None,
        parameters=[
            (name, *format_interval(item)) for row in ranking.rows[:1] for name, item in row.parameters.items()
        ],
        motion=symbols.MOTION,
        formulas=[(row.law, row.name, symbols.formula(row.law)) for row in ranking.rows],
        symbols=symbols.symbols({name for row in ranking.rows for name in row.parameters}),
        confidence=f"{100 * (1 - alpha):g} %",
        events=[_event(event) for event in ranking.events],
        warnings=[_pretty(warning) for warning in ranking.warnings],
        statistics=counted.rows(kinematics.unit),
        adequacy=ranking.adequacy,
        adequacy_facts=_adequacy_facts(ranking.adequacy),
        forms=_forms(ranking.adequacy),
        pictures={name: Markup(text) for name, text in plot.draw(ranking, counted).items()},
        facts=[
            (
                "record",
                f"{motion.span:.4g} s at {recording.rate_hz:g} Hz, {motion.time.size} samples, from "
                f"{motion.time[0]:.4g} to {motion.time[-1]:.4g} s of the run",
            ),
            ("break-aways", f"{len(cut.cycles)} found, {len(cut.used)} fitted"),
            ("in stick", f"{100 * cut.plateau_fraction:.0f} % of the record"),
            ("standard error of a position", format_length(motion.resolution)),
            (
                "smoothing",
                f"{kinematics.method}, window {kinematics.window}, order {kinematics.order} (starting values only)",
            ),
            ("CPU time", f"{ranking.cpu_s:.2f} s for {len(ranking.rows)} laws"),
        ],
    )


def _adequacy_facts(adequacy: Adequacy) -> list[tuple[str, str]]:
    """Return goodness of fit as names and values."""
    found = adequacy.goodness
    if found is None:
        return []
    facts = [
        ("verdict", adequacy.verdict),
        ("noise of one position", format_length(found.noise_m)),
        ("residuals of the best law", f"{found.misfit:.3g} times the noise"),
        ("share that repeats in every cycle", f"{found.repeat:.2g}"),
        ("probability by noise alone", format_probability(found.p_value).removeprefix("= ")),
    ]
    if adequacy.smallest_visible is not None:
        facts.append(("smallest departure of friction to be seen", f"{adequacy.smallest_visible:.2g} % of Fs"))
    if adequacy.curve is not None:
        K = adequacy.curve.k_over_m
        interval = f"{K.lo:.6g} … {K.hi:.6g}" if K.trusted else "interval withheld"
        facts.append(("k/m of the measured curve", f"{K.value:.6g} s⁻² ({interval})"))
        facts.append(("residuals of the measured curve", f"{adequacy.curve.chi:.3g} times the noise"))
    return facts


def _forms(adequacy: Adequacy) -> list[tuple[str, str, str, str, str, str]]:
    """Return the published forms fitted to the measured curve, best first; none where the curve does not hold."""
    if adequacy.curve is None or not adequacy.of_speed:
        return []
    return [
        (
            form.name,
            _pretty(form.formula),
            ", ".join(
                f"{name} = {item.value:.4g} ± {item.stderr:.2g} {_pretty(item.unit)}"
                for name, item in form.parameters.items()
            ),
            f"{form.chi:.2f}",
            "yes" if form.inside_band else "no",
            form.source,
        )
        for form in adequacy.curve.forms
    ]


def _row(row: Any, ranking: Ranking) -> dict[str, Any]:
    mean, half = row.behind
    return {
        "law": row.law,
        "name": row.name,
        "in_set": row.in_set,
        "rms": format_length(row.rms_m),
        "score": f"{row.score:.1f}",
        "weight": f"{row.weight:.2f}" if row.weight >= 0.005 else "< 0.01",
        "behind": "best" if row.score == 0 else f"{mean:.2f} ± {half:.2f}",
        "orbit": f"{100 * row.orbit:.2g} %",
        "cpu": f"{row.cpu_s:.2f} s",
        "colour": COLOURS[row.law],
    }


def _event(event: Any) -> tuple[str, str, str, str, str]:
    def shown(value: float) -> str:
        return "–" if math.isnan(value) else f"{value:.4f}"

    return str(event.number), f"{event.t:.3f}", shown(event.break_away_level), shown(event.kinetic_scale), event.flag


def format_interval(item: Parameter) -> tuple[str, str, str, str]:
    """Return value, standard error and interval with as many digits as the error deserves, and the unit.

    Of a law that does not describe the record error and interval are withheld, and the value has four digits.
    """
    if not item.trusted:
        return f"{item.value:.4g}", "–", "withheld", _pretty(item.unit)
    digits = item.decimals
    value = f"{item.value:.{digits}f}"
    return value, f"{item.stderr:.2g}", f"{item.lo:.{digits}f} … {item.hi:.{digits}f}", _pretty(item.unit)


def _pretty(text: str) -> str:
    """Return words or a unit with raised exponents."""
    for plain, raised in (("^-1", "⁻¹"), ("^-2", "⁻²"), ("^2", "²"), ("^3", "³"), (" +- ", " ± ")):
        text = text.replace(plain, raised)
    return text
