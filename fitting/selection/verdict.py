"""The verdict and its warnings in words."""

import math
from collections.abc import Sequence
from dataclasses import replace

from daq.base.output.lengths import format_length
from daq.runfile.rest_position import question
from fitting.adequacy.goodness import REJECTED
from fitting.adequacy.result import NONE_FITTED, NOT_JUDGED, Adequacy
from fitting.curve.result import FormFit
from fitting.data.cycles import CycleSegmentation
from fitting.data.frame import MeasuredMotion
from fitting.departures.result import FoundDeparture
from fitting.model.parameters import Global
from fitting.model.problem import NARROWEST_RAMP
from fitting.selection.result import LawResult
from fitting.selection.rivals import Competition, RivalResult
from processing.record.finding import Finding
from processing.record.kinematics import Kinematics
from rig_sim.friction.law import LAWS

OTHER_SPEEDS = " or runs at other belt speeds"
POOR_FIT = 0.003  # of the motion's range: five times what 12 % scatter, ripple and jitter leave over
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


def warnings(
    rows: Sequence[LawResult],
    members: Sequence[int],
    motion: MeasuredMotion,
    cut: CycleSegmentation,
    kinematics: Kinematics,
    findings: Sequence[Finding],
    *,
    sustained: bool,
) -> tuple[str, ...]:
    """Return the warnings that belong to a verdict."""
    best = rows[0]
    warned = []
    if best.fit.misfit > POOR_FIT * motion.travel:
        share = 100 * best.fit.misfit / motion.travel
        warned.append(
            f"no law fits well: the typical error of the best one is {share:.2g} % of the motion, "
            "so the friction may follow none of the six"
        )
    if not sustained:
        warned.append(
            "no sustained stick: Fs is the friction level of the one drag at the start-up; its interval leaves out how "
            "far levels differ from one break-away to the next, and that of v_dr how the belt's speed varies"
        )
    if not sustained and not cut.shows_belt:
        warned.append(
            "the drag at the start-up is too short to show the belt's speed or a ramp: without a calibration v_dr is "
            "the highest sustained velocity, with an error of 100 %"
        )
    if any(LAWS[law].ramp for law in members) and not motion.belt_measured:
        warned.append(
            "a ramp and a belt that slows under load look the same: without a belt-speed channel laws 2, 4, 6 "
            "may be laws 1, 3, 5 on such a belt"
        )
    if motion.compliance is not None:
        droop = best.parameters["droop"]
        share = 100 * droop.value / motion.belt_speed
        warned.append(f"the belt slows under load, by {share:.2g} % at Fs: measured by its encoder, part of every law")
    if "ripple" in best.parameters:
        share, hertz = 100 * best.parameters["ripple"].value / motion.belt_speed, best.parameters["ripple_hz"].value
        warned.append(
            f"the belt's speed varies by {share:.2g} % at {hertz:.3g} Hz: detected in the sticks, included in every law"
        )
    elif motion.speed_variation > 0:
        share = 100 * motion.speed_variation / motion.belt_speed
        warned.append(f"the measured belt speed varies by {share:.2g} % rms apart from load: the fit assumes it steady")
    if motion.datum_prior is None:
        warned.append(
            "no x0: the spring's rest position was also fitted; laws 1 and 3 then determine only x0 + Fs/k "
            '(give --x0, as in --x0 "60 mm +- 0.1 mm")'
        )
    else:
        rest, place = motion.datum_prior, motion.sign * motion.measured
        asked = question(replace(rest, value=motion.sign * rest.value), float(place.min()), float(place.max()))
        warned += [asked] if asked else []
    if motion.damping_prior is None or motion.per_mass:
        warned.append(
            "no damping calibration: c assumed 0 +- 1 % of critical; laws 3 and 4 then determine only G_slip - c "
            "(give --damping and --damping-sd with --mass)"
        )
    if motion.per_mass:
        warned.append("no mass: forces are given per kilogram (give --mass or --stiffness for newtons)")
    warned += [finding.text for finding in findings]
    left = [cycle for cycle in cut.cycles if cycle.flag and cycle.flag != "excluded"]
    if left:
        reasons = ", ".join(f"{cycle.number} ({cycle.flag})" for cycle in left)
        warned.append(f"cycles left out: {reasons}")
    if kinematics.lost_counts:
        warned.append(f"counts seem to be lost at {kinematics.lost_counts} sample(s): the fit has them put back")
    stuck = [row.law for row in rows if row.fit.outcome not in ("converged", "step limit")]
    if stuck:
        warned.append(f"the fit of law {', '.join(map(str, stuck))} did not converge: its error is an upper bound")
    row = next((row for row in rows if row.law == best.law + 1), None)
    if sustained and not LAWS[best.law].ramp and row is not None and row.in_set is False and "d" in row.parameters:
        width = row.parameters["d"]
        if row.rms_m < 1.05 * best.rms_m and row.fit.u[Global.D] > 10 * NARROWEST_RAMP * motion.belt_speed:
            warned.append(f"a ramp narrower than {width.hi:.2g} m/s cannot be excluded")
    return tuple(warned)


def not_judged(adequacy: Adequacy) -> tuple[str, ...]:
    """Return the warnings of what the goodness of fit does not judge: some cycles, or the whole record."""
    found = adequacy.goodness
    if found is None:
        return ()
    if not found.judged:
        return (
            "goodness of fit not judged: too few slips, or noise leaves the same in every repetition of the record",
        )
    if not found.left_out:
        return ()
    listed = ", ".join(map(str, found.left_out))
    return (f"cycles not judged: {listed} (a velocity step, as of the belt's joint, or another single disturbance)",)


def level_of_curve(adequacy: Adequacy) -> tuple[str, ...]:
    """Return the warning that the record does not determine the level of the measured curve; none where it does."""
    curve = adequacy.curve
    if curve is None or curve.level_known:
        return ()
    if curve.level_assumed:
        return (
            "no x0, and friction levels that do not scatter: the record determines differences of friction alone. "
            "The measured curve assumes that the spring is relaxed where the record begins at rest, or at the lowest "
            "position; its band contains every level (give --x0 with its error)",
        )
    return (
        "the record hardly determines the level of the measured curve, only differences of friction (give --x0 with "
        "its error)",
    )


def merge_warnings(warned: Sequence[Sequence[str]], names: Sequence[str]) -> tuple[str, ...]:
    """Return the warnings of several runs: what holds for all of them once, the rest with the file's name before it."""
    common = [text for text in warned[0] if all(text in own for own in warned)]
    apart = ((name, text) for name, own in zip(names, warned, strict=True) for text in own if text not in common)
    return (*common, *(f"{name}: {text}" for name, text in apart))


def format_probability(p: float | None) -> str:
    """Return a probability as "= 0.3", or as "< 1e-06": the tails of a null distribution are known roughly."""
    if p is None:
        return NOT_JUDGED
    return f"= {p:.2g}" if p >= REJECTED else f"< {REJECTED:g}"
