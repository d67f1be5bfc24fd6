"""The verdict in words."""

import math
from collections.abc import Sequence

from fitting import noise_levels
from fitting.adequacy.goodness import REJECTED
from fitting.adequacy.result import NONE_FITTED, NOT_JUDGED, Adequacy
from fitting.competitors import ALL_LAWS, Competitors
from fitting.curve.result import FormFit
from fitting.departures.result import FoundDeparture
from fitting.estimation.fit import Fit
from fitting.model.parameters import Global
from fitting.selection.result import LawResult
from fitting.selection.rivals import Competition
from stickslip.output.lengths import format_length

OTHER_SPEEDS = " or runs at other belt speeds"
# Chi of a published form.  The true one is outside the 95 % band in one record of twenty, at 1.3 to 2.0, other forms at
# 4 and more.
NEAR_FORM = 2.5
SPLITS = {
    frozenset((1, 2)): "a start-up recorded from rest",
    frozenset((3, 4)): f"a belt tachometer{OTHER_SPEEDS}",
    frozenset((5, 6)): f"a belt tachometer{OTHER_SPEEDS}",
    frozenset((3, 5)): "slips over a wider range of speeds (a faster belt or a weaker spring)",
    frozenset((4, 6)): "slips over a wider range of speeds (a faster belt or a weaker spring)",
}


def verdict_sentence(
    rows: Sequence[LawResult],
    competition: Competition,
    *,
    sustained: bool,
    measured: bool = False,
    runs: int = 1,
) -> str:
    """Return the verdict: the law, or the compatible laws, and why; rows are best first.

    Without ``sustained`` sticks friction is constant; ``measured`` is whether the belt's counts were used.
    """
    members = [row for row in rows if row.in_set]
    six = [row for row in members if isinstance(row.law, int)]
    others = [row for row in members if not isinstance(row.law, int)]
    cycles = f"{rows[0].cycles} cycles" if runs == 1 else f"{rows[0].cycles} cycles of {runs} runs"
    if not six:
        return _named_sentence(rows, others, competition, cycles)
    asked = [row for row in rows if isinstance(row.law, int)]
    if sustained:
        alone = len([row for row in rows if row.asked]) == 1
        words = _of_six(asked, six, cycles, measured=measured, runs=runs, alone=alone)
    else:
        words = _constant_friction(asked, six, measured=measured)
    return f"{words}{_as_well(others)}"


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
        gap = abs(members[1].behind[0] - best.behind[0])
        return (
            f"{best.called} or {others}: {cycles} cannot distinguish them (their errors differ by "
            f"{100 * math.expm1(gap):.0f} %, within the scatter between cycles); {split} would"
        )
    rest = [row for row in rows if not row.in_set]
    if not rest:
        return f"{best.called}{', the only law fitted' if alone else ''}: {fit}"
    rival = min(rest, key=lambda row: row.score)
    return f"{best.called}: {fit}; {_behind(best, rival)}"


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
    return isinstance(row.fit, Fit) and Global.COMPLIANCE in row.fit.active


def _named_sentence(
    rows: Sequence[LawResult], members: Sequence[LawResult], competition: Competition, cycles: str
) -> str:
    """Return the verdict where requested formulas exclude all six from the set."""
    best = members[0]
    head = f"{best.called}: {cycles} fit to {format_length(best.rms_m)} rms, {best.shown}"
    if len(members) > 1:
        others = " or ".join(f"{row.called} ({row.shown})" for row in members[1:])
        head = f"{head}; or {others}: the record cannot distinguish them"
    six = next((row for row in rows if isinstance(row.law, int)), None)
    if six is None:
        rest = [row for row in rows if not row.in_set]
        return f"{head}; {_behind(best, min(rest, key=lambda row: row.score))}" if rest else head
    lead = competition.lead(best.law, six.law)
    whole = len([row for row in rows if isinstance(row.law, int)]) == len(ALL_LAWS)
    return f"{head}; {six.called}{', the best of the six,' if whole else ''} is behind by {lead:.3g} in log evidence"


def _as_well(others: Sequence[LawResult]) -> str:
    """Return the statement about formulas that are compatible like the six."""
    if not others:
        return ""
    named = " or ".join(f"{row.called} ({row.shown})" for row in others)
    return f"; {named} describes the record as well"


def no_law_sentence(rows: Sequence[LawResult], adequacy: Adequacy) -> str:
    """Return the verdict where no law fits: what friction does instead, and how far off the laws are."""
    asked = [row for row in rows if row.asked]
    best = asked[0]
    if len(asked) == 1:
        head = f"{best.called} does not describe this record"
    else:
        which = "laws fitted" if adequacy.verdict == NONE_FITTED or best.formula is not None else "six laws"
        head = f"none of the {which} describes this record"
    parts = [part for part in (_instead(adequacy), _left_over(best, adequacy, len(asked))) if part]
    return f"{head}: {'; '.join(parts)}"


def rival_sentence(rows: Sequence[LawResult], competition: Competition) -> str:
    """Return the verdict where rivals describe a record better than each law, which noise may not rule out."""
    best = next(row for row in rows if row.asked)
    rival, *others = [row for row in rows if row.in_set]
    six = [row for row in rows if isinstance(row.law, int)]
    which = "of the six" if len(six) == len(ALL_LAWS) and best in six else "of the laws fitted"
    equal = f"; {' and '.join(row.called for row in others)} cannot be distinguished from it" if others else ""
    return (
        f"{best.called} is the best {which}; {rival.called} describes the record better "
        f"(by {competition.lead(rival.law, best.law):.3g} in log evidence): {rival.shown}{equal}"
    )


def _instead(adequacy: Adequacy) -> str:
    """Return what the record shows instead of a law."""
    departures, curve = adequacy.departures, adequacy.curve
    strongest = ""
    if departures:
        first = departures[0]
        host = f"law {first.law} describes it together with" if first.refitted and first.law else "strongest departure:"
        strongest = f"{host} {first.text} ({_size(first)})"
    if adequacy.of_speed and curve is not None:
        follows = "friction follows a curve of relative speed"
        inside = next((form for form in curve.forms if form.inside_band), None)
        if inside is not None:
            return f"{follows}, {_named(inside)}"
        if strongest:
            return strongest
        nearest = min(curve.forms, key=lambda form: form.bic)
        if nearest.chi < NEAR_FORM:
            return f"{follows} that is nearly {_named(nearest)}, but outside its band"
        return f"{follows} that is none of the published forms"
    memory = "friction that remembers, or an effect that was not tested, is possible"
    return f"no curve of relative speed on a constant spring describes it either; {strongest or memory}"


def _named(form: FormFit) -> str:
    values = ", ".join(f"{name} = {item.value:.3g} {item.unit}" for name, item in form.determined.items())
    return f"{form.name.replace('-', ' ')} ({values})"


def _size(departure: FoundDeparture) -> str:
    sure = f"{departure.sigmas:.2g} standard deviations"
    if not departure.parameter:
        return sure
    return f"{departure.parameter} = {departure.value:.3g} +- {departure.stderr:.2g} {departure.unit}, {sure}"


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


def refused_sentence(reason: str, competitors: Competitors) -> str:
    """Return the verdict on stick-slip that was rejected before or after its laws were fitted."""
    which = "none of the six laws" if competitors.laws == ALL_LAWS else "none of the laws fitted"
    return f"stick-slip, but {which}: {reason}"


def format_probability(p: float | None) -> str:
    """Return a p-value as "= 0.3", or as "< 1e-06": the tails of a null distribution are rough."""
    if p is None:
        return NOT_JUDGED
    return f"= {p:.2g}" if p >= REJECTED else f"< {REJECTED:g}"
