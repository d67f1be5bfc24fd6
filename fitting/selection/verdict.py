"""The verdict in words."""

import math
from collections.abc import Sequence

from fitting import noise_levels
from fitting.adequacy.goodness import REJECTED
from fitting.adequacy.result import NONE_FITTED, NOT_JUDGED, Adequacy
from fitting.competitors import ALL_LAWS
from fitting.departures.result import FoundDeparture
from fitting.model.parameters import Global
from fitting.selection.contradictions import UNITS
from fitting.selection.result import LawResult, Ranking
from processing.record.finding import Finding
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
    """Return the verdict: the law, or the compatible laws, and why; else what is known where no law describes the runs.

    contradicted: What of each run's calibration its record contradicts.
    """
    if ranking.members:
        return name_contradictions(_compatible(ranking), contradicted)
    cause = next((finding.text for finding in ranking.findings if finding.code == "not-one-contact"), "")
    if not cause and not any(contradicted):
        cause = _instead(ranking.adequacy)
    words = _no_law(ranking, cause)
    return name_contradictions(words, contradicted)


def name_contradictions(verdict: str, contradicted: Sequence[Sequence[Finding]]) -> str:
    """Return a verdict with the calibrations that its law contradicts, each once."""
    clauses = {}
    for one in (one for own in contradicted for one in own):
        unit, name = UNITS[one.code], one.code.replace("-", " ")
        if one.code not in clauses:
            clauses[one.code] = f"{name} (stated {one.expected:.3g} {unit}, the record shows {one.value:.3g} {unit})"
    return f"{verdict}; it contradicts the stated {' and '.join(clauses.values())}" if clauses else verdict


def _compatible(ranking: Ranking) -> str:
    rows, not_excluded = ranking.rows, ranking.not_excluded
    members = [row for row in rows if row.in_set]
    six = [row for row in members if isinstance(row.law, int)]
    others = [row for row in members if not isinstance(row.law, int)]
    runs, motions = len(ranking.sides), [side.motion for side in ranking.sides]
    cycles = f"{rows[0].cycles} cycles" if runs == 1 else f"{rows[0].cycles} cycles of {runs} runs"
    measured = all(motion.belt_measured for motion in motions)
    of_six = [row for row in rows if isinstance(row.law, int)]
    if rows[0].formula is not None:
        words = _of_formula(rows, members, cycles)
    elif ranking.sustained:
        alone = len([row for row in rows if row.asked]) == 1
        words = f"{_of_six(of_six, six, cycles, measured=measured, runs=runs, alone=alone)}{_as_well(others)}"
    else:
        words = f"{_constant_friction(of_six, six, measured=measured)}{_as_well(others)}"
    equal = next((row for row in rows if row.law in not_excluded[:1]), None)
    if equal is not None and f"; {equal.label} " not in words:  # unless it was named as the next best
        words += f"; {equal.called} fits equally well"
    rest_known = all(motion.datum_prior is not None for motion in motions)
    if not rest_known and any(not isinstance(law, int) for law in (*(row.law for row in others), *not_excluded)):
        words += ": the spring's rest position (--x0) would help to distinguish them"
    return words


def _of_six(
    rows: Sequence[LawResult], members: Sequence[LawResult], cycles: str, *, measured: bool, runs: int, alone: bool
) -> str:
    """Return the verdict on the six, of which some are in the set."""
    best, fit = rows[0], f"{cycles} fit to {format_length(rows[0].rms_m)} rms"
    if len(members) > 1:
        others = " or ".join(row.called for row in members[1:])
        split = SPLITS.get(frozenset(int(row.law) for row in members[:2]), f"more cycles{OTHER_SPEEDS}")
        if runs > 1:
            split = split.removesuffix(OTHER_SPEEDS)
        if _is_compliant(best) and not measured:
            return (
                f"{best.called} on a belt that slows under load, or {others}: equivalent, the record cannot "
                f"distinguish them ({fit}); {split} would"
            )
        gap = abs(_lag(members[1]) - _lag(best))
        return (
            f"{best.called} or {others}: {cycles} cannot distinguish them (their errors differ by "
            f"{100 * math.expm1(gap):.0f} %, within the scatter between cycles); {split} would"
        )
    rest = [row for row in rows if not row.in_set]
    if not rest:
        return f"{best.called}{', the only law fitted' if alone else ''}: {fit}"
    return f"{best.called}: {fit}; {_behind(best, rest[0])}"


def _lag(row: LawResult) -> float:
    """Return the mean log error behind the best law's."""
    return 0.0 if row.behind is None else row.behind[0]


def _behind(best: LawResult, other: LawResult) -> str:
    """Return the lead over the next law in words."""
    ratio = other.rms_m / best.rms_m
    if ratio > 1.2:
        return f"the next best, {other.label}, has {ratio:.3g} times the error"
    more = other.fit.law_parameters > best.fit.law_parameters
    lag = "does not fit better despite its extra parameter" if more else "fits slightly worse"
    return f"{other.label} {lag}"


def _constant_friction(rows: Sequence[LawResult], members: Sequence[LawResult], *, measured: bool) -> str:
    best = rows[0]
    head = "no sustained stick: constant friction, "
    if len(members) == 1:
        return head + f"{best.called} by the start-up drag"
    if len(rows) == 1:
        return head + f"{best.called}, the only law fitted"
    if _is_compliant(best) and not measured:
        return head + f"{best.called} on a belt that slows under load, or law 2: a belt tachometer would distinguish"
    return head + "law 1 or law 2: the start-up drag does not distinguish a jump from a ramp"


def _is_compliant(row: LawResult) -> bool:
    """Return whether one of the six was fitted on a belt that slows under load."""
    return row.formula is None and Global.COMPLIANCE in row.fit.places


def _of_formula(rows: Sequence[LawResult], members: Sequence[LawResult], cycles: str) -> str:
    """Return the verdict where a law given as a formula is the best."""
    best = rows[0]
    head = f"{best.called}: {cycles} fit to {format_length(best.rms_m)} rms, {best.shown}"
    if len(members) > 1:
        others = " or ".join(f"{row.called} ({row.shown})" for row in members[1:])
        head = f"{head}; or {others}: the record cannot distinguish them"
    six = next((row for row in rows if isinstance(row.law, int)), None)
    if six is None or six.in_set:
        rest = [row for row in rows if not row.in_set]
        return f"{head}; {_behind(best, rest[0])}" if rest and six is None else head
    whole = len([row for row in rows if isinstance(row.law, int)]) == len(ALL_LAWS)
    lead = 0.5 * ((six.score or 0.0) - (best.score or 0.0))
    return f"{head}; {six.called}{', the best of the six,' if whole else ''} is behind by {lead:.3g} in log evidence"


def _as_well(others: Sequence[LawResult]) -> str:
    """Return the statement about formulas that are compatible like the six."""
    if not others:
        return ""
    named = " or ".join(f"{row.called} ({row.shown})" for row in others)
    return f"; {named} describes the record as well"


def _no_law(ranking: Ranking, cause: str) -> str:
    """Return the verdict on a record that no law describes, with its cause, and how far off the laws are."""
    rows, adequacy = ranking.rows, ranking.adequacy
    asked = [row for row in rows if row.asked]
    if len(asked) == 1:
        head = f"{asked[0].called} does not describe this record"
    else:
        custom = adequacy.verdict == NONE_FITTED or any(row.formula is not None for row in asked)
        head = f"none of the {'laws fitted' if custom else 'six laws'} describes this record"
    parts = [cause, _left_over(rows[0], adequacy, len(rows))]
    return f"{head}, nor does a published curve: {'; '.join(part for part in parts if part)}"


def _instead(adequacy: Adequacy) -> str:
    """Return what the record shows instead of a law."""
    if adequacy.departures:
        first = adequacy.departures[0]
        return f"law {first.law} describes it together with {first.text} ({_size(first)})"
    if adequacy.of_speed:
        return "friction follows a curve of relative speed that is none of these"
    if adequacy.fluctuation is not None:
        return (
            f"friction fluctuates at random within slips, by about {100 * adequacy.fluctuation:.2g} % of Fs (nothing "
            "of the residual repeats from cycle to cycle)"
        )
    return "a deterministic effect that none of these models has: the residual repeats from cycle to cycle"


def _size(departure: FoundDeparture) -> str:
    return f"{departure.parameter} = {departure.value:.3g} +- {departure.stderr:.2g} {departure.unit}"


def _left_over(best: LawResult, adequacy: Adequacy, laws: int) -> str:
    """Return the distance of the best law from the record in words."""
    named = f"{best.called}, the closest," if laws > 1 else "it"
    left = f"{named} leaves residuals of {format_length(best.rms_m)} rms"
    found, outside = adequacy.goodness, best.outside_band
    if found is None:
        return left
    times = (
        f", {found.misfit:.3g} times the noise"
        if found.misfit > noise_levels.CLEARLY_ABOVE
        else ", too regular for noise"
    )
    band = ""
    if adequacy.of_speed and outside is not None and outside.half_widths > 1:
        band = f", and leaves the measured band by {outside.half_widths:.2g} half-widths at {outside.speed:.2g} m/s"
    return f"{left}{times}{band} (p {format_probability(found.p_value)})"


def format_probability(p: float | None) -> str:
    """Return a p-value as "= 0.3", or as "< 1e-06": the tails of a null distribution are rough."""
    if p is None:
        return NOT_JUDGED
    return f"= {p:.2g}" if p >= REJECTED else f"< {REJECTED:g}"
