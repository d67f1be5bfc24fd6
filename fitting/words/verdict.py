"""The verdict in words."""

import math
import re
from collections.abc import Sequence

from fitting import noise_levels
from fitting.judge.adequacy import NONE_FITTED, NOT_JUDGED, Adequacy
from fitting.judge.calibrations import UNITS
from fitting.judge.evidence import slows_under_load
from fitting.judge.goodness import REJECTED
from fitting.laws import ALL_LAWS
from fitting.result import LawResult, Ranking
from processing.record.motion import Finding
from stickslip.output.lengths import format_length

OTHER_SPEEDS = " or runs at other belt speeds"
SPLITS = {
    frozenset((1, 2)): "a start-up recorded from rest",
    frozenset((3, 4)): f"a belt tachometer{OTHER_SPEEDS}",
    frozenset((5, 6)): f"a belt tachometer{OTHER_SPEEDS}",
    frozenset((3, 5)): "slips over a wider range of speeds (a faster belt or a weaker spring)",
    frozenset((4, 6)): "slips over a wider range of speeds (a faster belt or a weaker spring)",
}


def write_verdict(ranking: Ranking, contradicted: Sequence[Sequence[Finding]]) -> str:
    """Return the law, or the compatible laws, and why; else what is known where no law describes the runs."""
    if ranking.members:
        return name_contradictions(_compatible(ranking), contradicted)
    for finding in ranking.findings:
        if finding.code == "not-one-contact":
            return finding.text
    return name_contradictions(_no_law(ranking, "" if any(contradicted) else _instead(ranking.adequacy)), contradicted)


def name_contradictions(verdict: str, contradicted: Sequence[Sequence[Finding]]) -> str:
    """Add the calibrations that the law contradicts, each once."""
    clauses = {}
    for one in (one for own in contradicted for one in own):
        unit, name = UNITS[one.code], one.code.replace("-", " ")
        if one.code not in clauses:
            clauses[one.code] = f"{name} ({one.expected:.3g} {unit}; the fit gives {one.value:.3g} {unit})"
    if not clauses:
        return verdict
    return f"{verdict.removesuffix('.')}. This contradicts the stated {' and '.join(clauses.values())}."


def _compatible(ranking: Ranking) -> str:
    formulas = [row for row in ranking.rivals if row.in_set]
    if ranking.best.formula is not None:
        sentences = _of_formula(ranking)
    else:
        sentences = _of_six(ranking) if ranking.sustained else [_constant_friction(ranking), _fit(ranking)]
        if formulas:
            named = " or ".join(f"{row.called} ({row.shown})" for row in formulas)
            sentences.append(f"{named} describes the record as well")
    equal = next((row for row in ranking.rows if row.law in ranking.not_excluded[:1]), None)
    if equal is not None and not any(_names(sentence, equal) for sentence in sentences[1:]):
        sentences.append(f"{equal.called} fits equally well")
    rest_known = all(side.motion.datum_prior is not None for side in ranking.sides)
    others = (*ranking.members[1:], *ranking.not_excluded)
    if others and not rest_known and (formulas or any(isinstance(law, str) for law in others)):
        sentences.append("the rest position (--x0) would help to distinguish them")
    return _join(sentences)


def _join(sentences: Sequence[str]) -> str:
    """Return sentences as a text; the first begins in lower case, after "verdict:"."""
    first, *others = sentences
    return ". ".join([first, *(sentence[:1].upper() + sentence[1:] for sentence in others)]) + "."


def _names(sentence: str, row: LawResult) -> bool:
    return re.search(rf"{re.escape(row.label)}(?![\w-])", sentence) is not None


def _cycles(ranking: Ranking) -> str:
    runs = f" of {len(ranking.runs)} runs" if ranking.runs else ""
    return f"{ranking.best.cycles} cycles{runs}"


def _fit(ranking: Ranking, subject: str = "it") -> str:
    best = ranking.best
    clear = best.misfit > noise_levels.CLEARLY_ABOVE
    noise = f"{best.misfit:.3g} times the noise" if clear else "the noise level"
    return f"{subject} fits {_cycles(ranking)} to {format_length(best.rms_m)} rms, {noise}"


def _of_six(ranking: Ranking) -> list[str]:
    best = ranking.best
    members = [row for row in ranking.rows if row.in_set and isinstance(row.law, int)]
    if len(members) > 1:
        others = " or ".join(row.called for row in members[1:])
        split = SPLITS.get(frozenset(int(row.law) for row in members[:2]), f"more cycles{OTHER_SPEEDS}")
        if ranking.runs:
            split = split.removesuffix(OTHER_SPEEDS)
        if slows_under_load(ranking.best.fit):
            head = f"{best.called} on a belt that slows under load, or {others}: the record cannot distinguish them"
            return [head, _fit(ranking, best.label), f"{split} would distinguish them"]
        lag, best_lag = (0.0 if row.behind is None else row.behind[0] for row in (members[1], best))
        return [
            f"{best.called} or {others}: {_cycles(ranking)} cannot distinguish them (their errors differ by "
            f"{100 * math.expm1(abs(lag - best_lag)):.0f} %, within the scatter between cycles)",
            f"{split} would distinguish them",
        ]
    alone = ", the only law fitted" if len([row for row in ranking.rows if row.asked]) == 1 else ""
    rest = next((row for row in ranking.rows if isinstance(row.law, int) and not row.in_set), None)
    return [_with_parameters(best, alone), _fit(ranking), *([] if rest is None else [_behind(best, rest)])]


def _with_parameters(row: LawResult, remark: str = "") -> str:
    law = row.fit.law
    curve = law.formula.replace("*", " ") if law.number else law.written
    return f"{row.called}{remark}, F = {curve}" + (f": {row.shown}" if row.shown else "")


def _behind(best: LawResult, other: LawResult) -> str:
    ratio = other.rms_m / best.rms_m
    if ratio > 1.2:
        return f"the next best, {other.label}, has {ratio:.3g} times the error"
    if other.fit.law.is_ramp_of(best.fit.law):
        return f"a ramp ({other.label}) does not improve the fit"
    more = other.fit.law_parameters > best.fit.law_parameters
    return f"{other.label} {'does not fit better despite its extra parameter' if more else 'fits slightly worse'}"


def _constant_friction(ranking: Ranking) -> str:
    six, best = [row for row in ranking.rows if isinstance(row.law, int)], ranking.best
    head = "without a sustained stick, friction is constant: "
    if len([row for row in six if row.in_set]) == 1:
        return head + f"{_with_parameters(best)}, from the start-up drag"
    if len(six) == 1:
        return head + f"{best.called}, the only law fitted"
    if slows_under_load(ranking.best.fit):
        return head + f"{best.called} on a belt that slows under load, or law 2: a belt tachometer would distinguish"
    return head + "law 1 or law 2: the start-up drag does not distinguish a jump from a ramp"


def _of_formula(ranking: Ranking) -> list[str]:
    best, six = ranking.best, [row for row in ranking.rows if isinstance(row.law, int)]
    sentences = [_with_parameters(best), _fit(ranking)]
    others = [row for row in ranking.rows if row.in_set and row is not best]
    if others:
        named = " or ".join(f"{row.called} ({row.shown})" for row in others)
        sentences.append(f"the record cannot distinguish it from {named}")
    if not six:
        rest = next((row for row in ranking.rows if not row.in_set), None)
        return sentences if rest is None else [*sentences, _behind(best, rest)]
    if six[0].in_set:
        return sentences
    whole = ", the best of the six," if len(six) == len(ALL_LAWS) else ""
    lead = 0.5 * ((six[0].score or 0.0) - (best.score or 0.0))
    return [*sentences, f"{six[0].called}{whole} is worse by {float(f'{lead:.3g}'):g} in log evidence"]


def _no_law(ranking: Ranking, cause: str) -> str:
    rows, adequacy = ranking.rows, ranking.adequacy
    asked = [row for row in rows if row.asked]
    if len(asked) == 1:
        head = f"{asked[0].called} does not describe this record"
    else:
        custom = adequacy.verdict == NONE_FITTED or any(row.formula is not None for row in asked)
        head = f"none of the {'laws fitted' if custom else 'six laws'} describes this record"
    residual = _residual_of(rows[0], adequacy, len(rows))
    return _join([f"{head}, nor does a published curve", *([cause] if cause else []), residual])


def _instead(adequacy: Adequacy) -> str:
    if adequacy.departures:
        first = adequacy.departures[0]
        size = f"{first.parameter} = {first.value:.3g} +- {first.stderr:.2g} {first.unit}"
        return f"law {first.law} describes it together with {first.text} ({size})"
    if adequacy.of_speed:
        return "friction follows a different curve of relative speed"
    if adequacy.fluctuation is not None:
        return (
            f"friction fluctuates at random within slips, by about {100 * adequacy.fluctuation:.2g} % of Fs "
            "(no part of the residual repeats from cycle to cycle)"
        )
    return "the residual repeats from cycle to cycle, so all of these models lack a deterministic effect"


def _residual_of(best: LawResult, adequacy: Adequacy, laws: int) -> str:
    named = f"the closest, {best.called}," if laws > 1 else "it"
    residual = f"{named} has residuals of {format_length(best.rms_m)} rms"
    goodness, outside = adequacy.goodness, best.outside_band
    if goodness is None:
        return residual
    clear = goodness.misfit > noise_levels.CLEARLY_ABOVE
    times = f"{goodness.misfit:.3g} times the noise" if clear else "too regular for noise"
    band = ""
    if adequacy.of_speed and outside is not None and outside.half_widths > 1:
        band = f", and is outside the measured band by {outside.half_widths:.2g} half-widths at {outside.speed:.2g} m/s"
    return f"{residual}, {times}{band} (p {format_probability(goodness.p_value)})"


def format_probability(p: float | None) -> str:
    """Return a p-value as "= 0.3", or as "< 1e-06": the tails of a null distribution are rough."""
    if p is None:
        return NOT_JUDGED
    return f"= {p:.2g}" if p >= REJECTED else f"< {REJECTED:g}"
