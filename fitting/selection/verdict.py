"""The verdict in words."""

import math
from collections.abc import Sequence

from daq.base.output.lengths import format_length
from fitting.adequacy.goodness import REJECTED
from fitting.adequacy.result import NONE_FITTED, NOT_JUDGED, Adequacy
from fitting.curve.result import FormFit
from fitting.departures.result import FoundDeparture
from fitting.model.parameters import Global
from fitting.selection.result import LawResult
from fitting.selection.rivals import Competition, RivalResult
from rig_sim.friction.law import LAWS

OTHER_SPEEDS = " or runs at other belt speeds"
# Chi of a published form.  The true one is outside the 95 % band in one record of twenty, at 1.3 to 2.0, other forms at
# 4 and more.
NEAR_FORM = 2.5
CLEARLY_ABOVE_NOISE = 1.1  # times the noise: a smaller excess is seen in what the residuals repeat, not in their size
SPLITS = {
    frozenset((1, 2)): "a start-up recorded from rest",
    frozenset((3, 4)): f"a belt tachometer{OTHER_SPEEDS}",
    frozenset((5, 6)): f"a belt tachometer{OTHER_SPEEDS}",
    frozenset((3, 5)): "slips over a wider range of speeds (a faster belt or a weaker spring)",
    frozenset((4, 6)): "slips over a wider range of speeds (a faster belt or a weaker spring)",
}


def verdict_sentence(
    rows: Sequence[LawResult], members: Sequence[int], *, sustained: bool, measured: bool = False, runs: int = 1
) -> str:
    """Return the verdict: the law, or the laws that the record cannot distinguish, and why.

    Parameters
    ----------
    rows : sequence of LawResult
        Best first.
    members : sequence of int
        The set, best first.
    sustained : bool
        Whether the record has sustained sticks; without them friction is constant.
    measured : bool
        Whether the belt's own counts were used.
    runs : int
        How many were fitted together.
    """
    best = rows[0]
    cycles = f"{best.cycles} cycles" if runs == 1 else f"{best.cycles} cycles of {runs} runs"
    named = f"law {best.law} ({best.name})"
    if not sustained:
        head = "no sustained stick: constant friction, "
        if len(members) == 1:
            return head + f"{named} by the start-up drag"
        if len(rows) == 1:
            return head + f"{named}, the only law fitted"
        if Global.COMPLIANCE in best.fit.active and not measured:
            return head + f"{named} on a belt that slows under load, or law 2: a belt tachometer would distinguish"
        return head + "law 1 or law 2: the start-up drag does not distinguish a jump from a ramp"
    if len(members) > 1:
        others = " or ".join(f"law {law} ({LAWS[law].name})" for law in members[1:])
        split = SPLITS.get(frozenset(members[:2]), f"more cycles{OTHER_SPEEDS}")
        if runs > 1:
            split = split.removesuffix(OTHER_SPEEDS)
        if Global.COMPLIANCE in best.fit.active and not measured:
            return (
                f"{named} on a belt that slows under load, or {others}: equivalent, the record cannot "
                f"distinguish them ({cycles} fit to {format_length(best.rms_m)} rms); {split} would"
            )
        row = next(row for row in rows if row.law == members[1])
        gap = abs(row.behind[0] - best.behind[0])
        return (
            f"{named} or {others}: {cycles} cannot distinguish them (their errors differ by "
            f"{100 * math.expm1(gap):.0f} %, within the scatter between cycles); {split} would"
        )
    fit = f"{cycles} fit to {format_length(best.rms_m)} rms"
    rest = [row for row in rows if row.law not in members]
    if not rest:
        return f"{named}, the only law fitted: {fit}"
    rival = min(rest, key=lambda row: row.score)
    ratio = rival.rms_m / best.rms_m
    if ratio > 1.2:
        return f"{named}: {fit}; the next best, law {rival.law}, has {ratio:.3g} times the error"
    more = rival.fit.law_parameters > best.fit.law_parameters
    lag = "does not fit better despite its extra parameter" if more else "fits slightly worse"
    return f"{named}: {fit}; law {rival.law} {lag}"


def no_law_sentence(rows: Sequence[LawResult], adequacy: Adequacy) -> str:
    """Return the verdict on a record that no law describes: what friction does instead, and how far off the laws are.

    Parameters
    ----------
    rows : sequence of LawResult
        Best first.
    adequacy : Adequacy
    """
    best = rows[0]
    named = f"law {best.law} ({best.name})"
    if len(rows) == 1:
        head = f"{named} does not describe this record"
    else:
        which = "six laws" if adequacy.verdict != NONE_FITTED else "laws fitted"
        head = f"none of the {which} describes this record"
    parts = [part for part in (_instead(adequacy), _left_over(best, adequacy, len(rows))) if part]
    return f"{head}: {'; '.join(parts)}"


def rival_sentence(rows: Sequence[LawResult], competition: Competition) -> str:
    """Return the verdict where rivals describe a record better than each of the laws, which noise may not rule out."""
    best, rival = rows[0], competition.rivals[0]
    which = "of the six" if len(rows) == len(LAWS) else "of the laws fitted"
    others = [f"a {own.name} curve" for own in competition.rivals[1:] if own.in_set]
    equal = f"; {' and '.join(others)} cannot be distinguished from it" if others else ""
    return (
        f"law {best.law} ({best.name}) is the best {which}; a {rival.name} curve describes the record better "
        f"(by {competition.lead:.3g} in log evidence): {_values(rival)}{equal}"
    )


def with_rivals(words: str, competition: Competition | None) -> str:
    """Return a verdict on the laws of a set that also names the rivals in it."""
    found = [] if competition is None else [row for row in competition.rivals if row.in_set]
    if not found:
        return words
    named = " or ".join(f"a {row.name} curve ({_values(row)})" for row in found)
    return f"{words}; {named} describes the record as well"


def _values(rival: RivalResult) -> str:
    found = ((name, rival.parameters[name]) for name in rival.fit.formula.free)
    return ", ".join(f"{name} = {item.value:.3g} {item.unit}".rstrip() for name, item in found)


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
    """Return how far the best law is from the record."""
    named = f"law {best.law} ({best.name}), the closest," if laws > 1 else "it"
    left = f"{named} leaves residuals of {format_length(best.rms_m)} rms"
    found, outside = adequacy.goodness, best.outside_band
    if found is None:
        return left
    times = f", {found.misfit:.3g} times the noise" if found.misfit > CLEARLY_ABOVE_NOISE else ", too regular for noise"
    band = ""
    if adequacy.of_speed and outside is not None and outside.half_widths > 1:
        band = f", and leaves the measured band by {outside.half_widths:.2g} half-widths at {outside.speed:.2g} m/s"
    return f"{left}{times}{band} (p {format_probability(found.p_value)})"


def refused_sentence(reason: str, laws: Sequence[int]) -> str:
    """Return the verdict on stick-slip that was refused before, or after, its laws were fitted."""
    which = "none of the six laws" if len(laws) == len(LAWS) else "none of the laws fitted"
    return f"stick-slip, but {which}: {reason}"


def format_probability(p: float | None) -> str:
    """Return a probability as "= 0.3", or as "< 1e-06": the tails of a null distribution are known roughly."""
    if p is None:
        return NOT_JUDGED
    return f"= {p:.2g}" if p >= REJECTED else f"< {REJECTED:g}"
