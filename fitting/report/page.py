"""The report: one static, printable page that includes its pictures and loads nothing."""

import html
import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from daq.runfile import store
from fitting.judge.adequacy import Adequacy
from fitting.judge.parameters import Correlations, Parameter
from fitting.palette import law_styles, run_colour
from fitting.report import symbols
from fitting.result import LawResult, Ranking
from fitting.words.verdict import format_probability
from processing.statistics import pooled
from stickslip.errors import InputError
from stickslip.output import atomic
from stickslip.output.lengths import format_length, shown_length
from stickslip.text import storable
from stickslip.version import VERSION

if TYPE_CHECKING:
    from jinja2 import Template
    from markupsafe import Markup


SUFFIX = ".report.html"
NAMED = re.compile("sha256 of the raw record ([0-9a-f]{64})")
TEMPLATES = Path(__file__).with_name("templates")
STRONG, MOST_NAMED = 0.9, 4  # correlations named in words: from 0.9 on they double a parameter's error
MARK = '<meta name="generator" content="stickslip fit-friction'


def default_path(run: Path) -> Path:
    return run.with_name(run.stem + SUFFIX)


def report_paths(runs: Sequence[Path], report: Path | None) -> list[Path]:
    """Return the paths of the reports: next to each run, or FILE, FILE-2, ..."""
    if report is None:
        places = [default_path(run) for run in runs]
    else:
        places = [report, *(report.with_stem(f"{report.stem}-{n}") for n in range(2, len(runs) + 1))]
    if len({place.absolute() for place in places}) < len(places):
        raise InputError(
            "two runs would have the same report", ", ".join(map(str, places)), "choose a name with --report"
        )
    return places


def refuse_foreign_file(path: Path, digests: Sequence[str], *, files: Sequence[Path] = (), force: bool = False) -> None:
    """Raise InputError if ``path`` cannot be written or, without ``force``, is not a report of these raw records.

    The report named after a single run may also be that of a former run of this name, which no run in the folder has.
    """
    atomic.refuse_existing(path, force, mark=MARK, kind="report", flag="--report")
    if not path.exists() or force:
        return
    text = path.read_text(encoding="utf-8", errors="replace")
    named = set(NAMED.findall(text))
    if all(digest in text for digest in digests) and named <= set(digests):
        return
    what, do = (
        "exists and contains the report of another run",
        "choose another name (--report), or --force to replace it",
    )
    if len(files) == 1 and named and path.absolute() == default_path(files[0]).absolute():
        kept = _holder(named, files[0])
        if kept is None:
            return
        what += f", {kept.name}"
    raise InputError(what, str(path), do, python="choose another name, or force=True to replace it")


def _holder(digests: set[str], file: Path) -> Path | None:
    """Return the run next to ``file`` that has one of these raw records."""
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


def write(ranking: Ranking, path: Path, text: str = "", *, force: bool = False) -> None:
    """Write the page of a ranking, or its ``text``, in place of a report of the same runs."""
    recordings = [record.recording for record in ranking.records]
    digests, files = [one.digest for one in recordings], [one.source for one in recordings if one.source.name]
    refuse_foreign_file(path, digests, files=files, force=force)
    put(text or render(ranking), path)


def put(page: str, path: Path) -> None:
    with atomic.replacing(path, force=True) as temporary:
        temporary.write_text(storable(page), encoding="utf-8")


def template(name: str) -> "Template":
    import jinja2

    loader = jinja2.FileSystemLoader(TEMPLATES)
    environment = jinja2.Environment(loader=loader, autoescape=True, undefined=jinja2.StrictUndefined)
    environment.filters |= FILTERS
    return environment.get_template(name)


def now() -> str:
    return datetime.now().astimezone().isoformat(" ", timespec="minutes")


def render(ranking: Ranking) -> str:
    from markupsafe import Markup

    from fitting.report import pictures

    recordings = [record.recording for record in ranking.records]
    best = ranking.best if ranking.rows else None
    return template("report.html").render(
        mark=Markup(f'{MARK} {html.escape(VERSION)}">'),
        title=", ".join(recording.source.name or recording.title for recording in recordings),
        ranking=ranking,
        adequacy=ranking.adequacy,
        goodness=ranking.adequacy.goodness,
        best=best,
        badge=_badge(ranking),
        headline=_headline(best) if best else {},
        rows=pictures.shown_rows(ranking),
        colours={law: style["color"] for law, style in law_styles(row.law for row in ranking.rows).items()},
        parameters=[row for row in ranking.rows if row is best or row.in_set],
        joint=bool(ranking.runs),
        runs=list(zip(range(1, len(recordings) + 1), ranking.sides, ranking.records, strict=True)),
        run_colour=run_colour,
        correlations=ranking.correlations(),
        motion=symbols.MOTION,
        symbols=symbols.symbols({name for side in ranking.sides for row in side.rows for name in row.parameters}),
        confidence=f"{100 * (1 - ranking.alpha):g} %",
        statistics=pooled(ranking.statistics).rows(ranking.records[0].unit),
        smallest_departure=smallest_departure(ranking.adequacy),
        pictures={name: Markup(text) for name, text in pictures.draw(ranking).items()},
        now=now(),
        version=VERSION,
    )


def _badge(ranking: Ranking) -> tuple[str, str]:
    """Return the style of the badge and its text."""
    if not ranking.rows:
        return "open", "no law fitted"
    if ranking.adequacy.rejected:
        return "open", "no law describes the record"
    several = len(ranking.members) > 1
    if not ranking.adequacy.adequate:
        return "open", "several laws fit, goodness of fit not judged" if several else "goodness of fit not judged"
    return ("open", "several laws describe the record") if several else ("alone", "describes the record")


def _headline(best: LawResult) -> dict[str, Parameter]:
    """Return the parameters of curve, spring and belt, in newtons where those are known."""
    parameters = best.parameters
    names = (*filter(best.is_own, parameters), *(name for name in ("k/m", "v_dr") if name in parameters))
    shown = (short if (short := name.removesuffix("/m")) in parameters else name for name in names)
    return {name: parameters[name] for name in shown}


def in_shown_unit(item: Parameter) -> Parameter:
    """Return a parameter with a length in mm, as positions are shown."""
    if item.unit != "m":
        return item
    factor, unit = shown_length("m")
    ends = {name: factor * getattr(item, name) for name in ("value", "stderr", "lo", "hi")}
    return replace(item, unit=unit, **ends)


def _typeset(row: LawResult) -> "tuple[Markup, str]":
    """Return the curve of a law typeset, and its contact in words."""
    from markupsafe import Markup

    curve, contact = symbols.typeset(row.fit.law)
    return Markup(curve), contact


def smallest_departure(adequacy: Adequacy) -> str:
    visible = adequacy.smallest_visible
    return f"{visible:.2g} % of Fs" if visible is not None else "not determined by this record"


def _strongest(correlations: Correlations) -> list[str]:
    """Return the strong correlations in words, in descending order."""
    matrix, names = correlations.matrix, correlations.names
    pairs = sorted(((i, j) for i in range(len(names)) for j in range(i)), key=lambda pair: -abs(matrix[pair]))
    strong = [pair for pair in pairs if abs(matrix[pair]) >= STRONG][:MOST_NAMED]
    return [f"{names[i]} and {names[j]} ({_signed(matrix[i, j])})" for i, j in strong]


def _signed(value: float) -> str:
    return f"{value:+.2f}".replace("-", "\N{MINUS SIGN}")


def format_evidence(row: LawResult) -> tuple[str, str]:
    """Return the excess of a law's mean log error over the best one's, and its weight; dashes without."""
    if row.score is None or row.weight is None or row.behind is None:
        return "–", "–"
    behind = "best" if row.score == 0 else f"{row.behind[0]:.2f} ± {row.behind[1]:.2f}"
    return behind, f"{row.weight:.2f}" if row.weight >= 0.005 else "< 0.01"


def format_interval(item: Parameter) -> tuple[str, str, str, str]:
    """Return value, standard error, interval and unit, with the digits that the error determines."""
    unit = symbols.pretty(item.unit)
    if item.fixed:
        return f"{item.value:.6g}", "fixed", "–", unit
    if not item.trusted:
        return f"{item.value:.4g}", "–", "withheld", unit
    digits = item.decimals
    interval = f"{item.lo:.{digits}f} … {item.hi:.{digits}f}"
    return f"{item.value:.{digits}f}", f"{item.stderr:#.2g}".rstrip("."), interval, unit


FILTERS: dict[str, Callable[..., Any]] = {
    "estimate": lambda item: replace(in_shown_unit(item), unit="").brief.replace(" +- ", " ± "),
    "evidence": format_evidence,
    "interval": lambda item: format_interval(in_shown_unit(item)),
    "length_text": lambda value: symbols.pretty(format_length(value)),
    "pretty": symbols.pretty,
    "probability": format_probability,
    "shade": lambda value: f"rgba({'0,114,178' if value > 0 else '230,159,0'},{0.65 * abs(value):.2f})",
    "signed": _signed,
    "strongest": _strongest,
    "symbol": symbols.parameter,
    "typeset": _typeset,
}
