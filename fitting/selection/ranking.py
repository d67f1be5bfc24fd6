"""`rank`: fits the laws to a smoothed record and ranks them; returns one, or the set that cannot be distinguished.

What is evidence and who is in the set: `fitting.selection.evidence`.
"""

import logging
import math
import time as clock
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from daq.base.errors import InputError
from daq.base.measured import Measured
from daq.runfile.rig import Rig
from fitting.adequacy.assess import Assessment, assess
from fitting.adequacy.result import NONE_FITTED, NONE_OF_SIX, Adequacy
from fitting.data import frame
from fitting.departures.ageing import find_ageing
from fitting.estimation import break_aways, derived
from fitting.estimation.fit import Fit
from fitting.model.problem import Run
from fitting.selection import candidates, equivalence, evidence, rig_intervals, rivals, screening, verdict
from fitting.selection.contradictions import (
    find_contradictions,
    name_contradictions,
    without_those_of_the_law,
)
from fitting.selection.evidence import Evidence, ModelSet
from fitting.selection.phase_distance import MeasuredOrbit
from fitting.selection.result import LawResult
from fitting.selection.result import Ranking as Ranking
from processing.record.kinematics import Kinematics
from rig_sim.friction.law import LAWS

logger = logging.getLogger(__name__)
ALL_LAWS = (1, 2, 3, 4, 5, 6)


LEAST_ALPHA = 1e-9  # surer is no interval


def rank(
    kinematics: Kinematics | Sequence[Kinematics],
    rig: Rig | Sequence[Rig] | None = None,
    laws: Sequence[int] = ALL_LAWS,
    *,
    belt_speed: Measured | float | str | None = None,
    excluded: Sequence[int] = (),
    alpha: float = 0.05,
    jobs: int = 1,
    progress: Callable[[float], None] | None = None,
    scheduler: str | None = None,
) -> Ranking:
    """Fit the laws to a record, or to several records of one contact together, and rank them.

    Parameters
    ----------
    kinematics : Kinematics or sequence of Kinematics
        The smoothed record (`processing.smooth`); plain differences are smoothed again, in memory.  Several are taken
        as runs of one contact, at other belt speeds say: k/m, Fs/m, the curve, the ramp and the damping are one for
        all; belt speed, rest position, wear and the belt's compliance are each run's own.
    rig : Rig or sequence of Rig, optional
        Calibration; the recording's own by default, one for all, or one for each run.
    laws : sequence of int
        Which of the laws 1 to 6 compete.
    belt_speed : Measured, float or "channel", optional
        m/s, signed, if known better than from the calibration.  By default belt counts are used if the run contains
        them; "channel" requires them.
    excluded : sequence of int
        Numbers of cycles to leave out (1 is the first break-away); of a run that is fitted alone.
    alpha : float
        1 - confidence of the intervals and of the set rule.
    jobs : int
        Processes to fit in: up to three are of use, one for each curve.  The result is the same to the last bit.
    progress : callable, optional
        Called with the number of laws done.
    scheduler : str, optional
        Address of a dask scheduler, ``tcp://host:8786``, whose workers fit instead of processes on this machine.

    Returns
    -------
    Ranking

    Raises
    ------
    InputError
        For no or unknown laws, alpha outside (0, 1), fewer than one job, a scheduler that cannot be used,
        a record in counts, a belt speed of zero, belt
        counts asked for that are not there, or a speed or cycles to exclude beside several runs.
    DataError
        When a record shows no stick-slip, when a slip has fewer than eight samples, when there are fewer than four
        complete cycles, when some of the runs stick and others do not, or when frames were lost or doubled among even
        times.

    Notes
    -----
    A belt that slows under load looks like a ramp.  With the belt's own counts its compliance is measured and part of
    the flow; without, a ramp narrow enough to be such a belt brings its jump law into the set
    (`fitting.selection.equivalence`).

    A belt whose speed ripples at one frequency is seen in the sticks, and its ripple is also fitted
    (`fitting.data.ripple`).

    Not modelled: a ripple of several frequencies, friction that remembers, a mass or spring that changes between runs.
    """
    begun = clock.process_time()
    laws = tuple(dict.fromkeys(laws))
    unknown = [law for law in laws if law not in LAWS]
    if not laws or unknown:
        what = f"unknown law {unknown[0]}" if unknown else "no law to fit"
        raise InputError(what, "--laws", "choose 1 to 6, such as 1-6 or 3,5")
    if not LEAST_ALPHA <= alpha < 1:
        raise InputError(f"alpha is {alpha}", "--alpha", f"give a number from {LEAST_ALPHA:g} to 1, such as 0.05")
    if jobs < 1:
        raise InputError(f"jobs is {jobs}", "--jobs", "give 1 or more")
    records = [_smoothed(one) for one in ([kinematics] if isinstance(kinematics, Kinematics) else kinematics)]
    _check_together(records, belt_speed, excluded)
    for record in records:
        screening.refuse_wrong_times(record)
    rigs = [None] * len(records) if rig is None else [rig] * len(records) if isinstance(rig, Rig) else rig
    runs = []
    for record, known in zip(records, rigs, strict=True):
        motion = frame.from_kinematics(record, record.recording.rig if known is None else known, belt_speed)
        screening.refuse_few_samples(motion, record)
        runs.append(candidates.cut_run(motion, frozenset(excluded)))
        found = runs[-1].cut
        logger.info("%s: %d cycles, %d to fit", record.recording.name, len(found.cycles), len(found.used))
    try:
        fits, runs, sustained = candidates.fit_runs(laws, runs, records, jobs, progress, scheduler)
    except candidates.NoLawError as refused:
        return _without_law(refused.reason, laws, runs, records, begun)
    fits, chosen = _judge(fits, runs, alpha, sustained=sustained)
    ordered = [next(fit for fit in fits if fit.law == law) for law in chosen.order]
    assessed = assess(ordered, chosen.members, [run.motion for run in runs], len(laws), alpha, _revolution(records))
    competition = _with_rivals(fits, chosen, assessed, runs, alpha) if sustained else None
    if competition is not None:
        chosen = competition.chosen
        ordered = [next(fit for fit in fits if fit.law == law) for law in chosen.order]
    for fit in ordered:
        member = "in the set" if fit.law in chosen.members else "not in the set"
        logger.info("law %d: %.4g um rms, %s, %s, %.2f s", fit.law, 1e6 * fit.rms, fit.outcome, member, fit.cpu_s)
    beaten = competition is not None and competition.beaten
    described = not assessed.together.rejected
    if beaten and described:
        assessed = assessed.beaten(len(laws))
    rejected = assessed.together.rejected
    logger.info("goodness of fit: %s", assessed.together.said)
    outside = assessed.together.outside_band
    orbits = [MeasuredOrbit.of(run.motion) for run in runs]
    tables = [
        [
            replace(row, outside_band=outside.get(fit.law))
            for row in _rows(fit, chosen, runs, orbits, alpha, sustained=sustained, trusted=not rejected)
        ]
        for fit in ordered
    ]
    by_run = list(zip(*tables, strict=True))
    depends = [() if rejected else rig_intervals.law_dependent(own) for own in by_run]
    tables = [list(own) for own in zip(*map(rig_intervals.over_the_set, by_run), strict=True)]
    rows = tuple(table[-1] for table in tables)
    contradicted = find_contradictions(ordered[0], [run.motion for run in runs], tables[0], records)
    if competition is not None:
        contradicted = without_those_of_the_law(contradicted, competition.inside_band(assessed.together.curve))
    if competition is not None and beaten and described:
        words = verdict.rival_sentence(rows, competition)
    elif not rejected:
        measured = all(run.motion.belt_measured for run in runs)
        words = verdict.verdict_sentence(rows, chosen.members, sustained=sustained, measured=measured, runs=len(runs))
        words = verdict.with_rivals(words, competition)
        words = name_contradictions(words, contradicted)
    else:
        words = verdict.no_law_sentence(rows, assessed.together)
    sides = []
    for number, (run, record) in enumerate(zip(runs, records, strict=True)):
        own = tuple(table[number] for table in tables)
        events = break_aways.find_break_aways(own[0].fit, run.motion, run.cut)
        # The fitted belt speed is compared with the stated one more exactly than the sticks that smoothing found.
        seen = (finding for finding in record.findings if finding.code != "belt-speed")
        findings = (*seen, *contradicted[number])
        said = verdict.warnings(own, chosen.members, run.motion, run.cut, record, findings, sustained=sustained)
        adequacy = assessed.runs[number]
        said = (*said, *depends[number], *verdict.not_judged(adequacy), *verdict.level_of_curve(assessed.together))
        # a mass that merely grazes the belt does not break away from rest
        aged = None
        if sustained and not rejected:
            aged = find_ageing(events, run.cut, derived.break_away_level_error(ordered[0], run.motion, number))
        if aged is not None:
            adequacy = replace(adequacy, departures=(*adequacy.departures, aged))
        side = Ranking(words, chosen.members, own, events, said, run.motion, run.cut, adequacy, findings=findings)
        side = replace(side, rivals=() if competition is None else competition.rivals)
        sides.append(side)
    cpu_s = clock.process_time() - begun
    if len(sides) == 1:
        return replace(sides[0], cpu_s=cpu_s)
    names = [record.recording.source.name for record in records]
    warnings = verdict.merge_warnings([side.warnings for side in sides], names)
    return Ranking(
        verdict=words,
        laws_in_set=chosen.members,
        rows=rows,
        events=tuple(event for side in sides for event in side.events),
        warnings=warnings,
        motion=runs[0].motion,
        cut=runs[0].cut,
        adequacy=assessed.together,
        cpu_s=cpu_s,
        findings=tuple(finding for side in sides for finding in side.findings),
        runs=tuple(replace(side, warnings=warnings, cpu_s=cpu_s) for side in sides),
        rivals=() if competition is None else competition.rivals,
    )


def _with_rivals(
    fits: Sequence[Fit], chosen: ModelSet, assessed: Assessment, runs: Sequence[Run], alpha: float
) -> rivals.Competition | None:
    """Judge the laws beside the published forms that the measured curve prefers; None where it prefers none."""
    curve = assessed.together.curve
    found = [] if curve is None else rivals.fit_rivals(curve)
    for fit in found:
        logger.info("%s: %.4g um rms, %s, %.2f s", fit.law, 1e6 * fit.rms, fit.solution.outcome, fit.cpu_s)
    return rivals.compete(fits, chosen, found, runs, runs[0].motion, alpha) if found else None


def _revolution(records: Sequence[Kinematics]) -> float | None:
    """Return the travel per revolution of the encoder, m, where the runs have the same; None otherwise."""
    found = set()
    for record in records:
        pitch, counts = record.recording.rig.metres_per_count, record.recording.rig.counts_per_revolution
        found.add(None if pitch is None or counts is None else abs(pitch.value) * counts)
    return found.pop() if len(found) == 1 else None


def _without_law(
    reason: str, laws: Sequence[int], runs: Sequence[Run], records: Sequence[Kinematics], begun: float
) -> Ranking:
    """Return the verdict on stick-slip that no law comes near: no rows, and what is known without any law."""
    words = verdict.refused_sentence(reason, laws)
    outcome = NONE_OF_SIX if len(laws) == len(LAWS) else NONE_FITTED
    sides = []
    for run, record in zip(runs, records, strict=True):
        adequacy = Adequacy(outcome, run.motion.resolution)
        warned = tuple(finding.text for finding in record.findings)
        cpu_s = clock.process_time() - begun
        sides.append(Ranking(words, (), (), (), warned, run.motion, run.cut, adequacy, cpu_s, findings=record.findings))
    if len(sides) == 1:
        return sides[0]
    names = [record.recording.source.name for record in records]
    warnings = verdict.merge_warnings([side.warnings for side in sides], names)
    findings = tuple(finding for side in sides for finding in side.findings)
    return replace(sides[0], warnings=warnings, findings=findings, runs=tuple(sides))


def _judge(fits: list[Fit], runs: Sequence[Run], alpha: float, *, sustained: bool) -> tuple[list[Fit], ModelSet]:
    """Compare the laws; a jump law on a compliant belt that is equivalent to the best ramp law takes its place."""
    units = evidence.common_units(fits, runs, sustained=sustained)
    errors = {fit.law: evidence.unit_errors(fit, runs, units) for fit in fits}
    for jump, ramp in equivalence.closed_ramps(fits):
        if errors[ramp].mean() < errors[jump].mean():
            errors[ramp] = errors[jump]
    place = {fit.law: i for i, fit in enumerate(fits)}
    penalised = np.array([evidence.penalised(fit, errors[fit.law], units) for fit in fits])

    def choose() -> ModelSet:
        return evidence.model_confidence_set(Evidence(tuple(place), penalised, units.samples), alpha)

    chosen = choose()
    double = equivalence.equivalent_jump_law(fits, chosen.members, runs)
    if double is not None:
        jump, ramp = double.law, double.law + 1
        own = evidence.unit_errors(double, runs, units)
        lag = equivalence.mean_excess(own, errors[ramp])
        if lag < equivalence.SAME:  # one observable, one piece of evidence, unless runs at several speeds split it
            apart = len(runs) > 1 and lag < -equivalence.SAME
            fits = [double if fit.law == jump else fit for fit in fits]
            penalised[place[jump]] = evidence.penalised(double, own, units) if apart else penalised[place[ramp]]
            chosen = choose()
    if (
        not sustained
        and chosen.members == (2,)
        and 1 in place
        and equivalence.explained_by_belt_ripple(fits[place[2]], errors[2], runs)
    ):
        penalised[place[1]] = penalised[place[2]]
        chosen = choose()
    return fits, equivalence.with_open_ramps(chosen, fits, runs, alpha, units.samples, sustained=sustained)


def _smoothed(kinematics: Kinematics) -> Kinematics:
    """Return the record smoothed well enough to start from."""
    if kinematics.method != "fd":
        return kinematics
    from processing.smoothing import smooth

    return smooth(kinematics.recording, times=kinematics.times)


def _check_together(
    records: Sequence[Kinematics], belt_speed: Measured | float | str | None, excluded: Sequence[int]
) -> None:
    """Raise InputError for what means nothing beside several runs."""
    if not records:
        raise InputError("no run", "command line", "name at least one run file")
    if len(records) == 1:
        return
    if belt_speed is not None and belt_speed != "channel":
        raise InputError("one belt speed for several runs", "--belt-speed", "leave it out: each run finds its own")
    if excluded:
        raise InputError(
            "cycles to exclude from several runs", "--exclude-cycles", "fit that run alone, or leave it out"
        )


def _rows(
    fit: Fit,
    chosen: ModelSet,
    runs: Sequence[Run],
    orbits: Sequence[MeasuredOrbit],
    alpha: float,
    *,
    sustained: bool,
    trusted: bool,
) -> list[LawResult]:
    """Return a law's row for each run, and last the row for all of them together; one row for a single run.

    ``trusted`` is whether a law describes the runs: else no interval is given.
    """
    parts = [fit.for_run(number) for number in range(len(runs))]
    parameters = [
        derived.derived_parameters(fit, run.motion, alpha, number, sustained=sustained)
        for number, run in enumerate(runs)
    ]
    distances = [orbit.distance(part) for part, orbit in zip(parts, orbits, strict=True)]
    if len(runs) > 1:
        together = {name: item for name, item in parameters[0].items() if name not in derived.RUNS_OWN}
        for number, own in enumerate(parameters, start=1):
            together |= {f"{name} ({number})": own[name] for name in derived.RUNS_OWN if name in own}
        parts, parameters = [*parts, fit], [*parameters, together]
        distances.append(math.sqrt(float(np.mean(np.square(distances)))))
    return [
        LawResult(
            law=fit.law,
            name=LAWS[fit.law].name,
            score=chosen.score[fit.law],
            weight=chosen.weight[fit.law],
            in_set=fit.law in chosen.members,
            rms_m=part.rms,
            cycles=len(part.rows),
            parameters={name: replace(item, trusted=trusted) for name, item in own.items()},
            cpu_s=fit.cpu_s,
            behind=chosen.behind[fit.law],
            orbit=distance,
            fit=part,
        )
        for part, own, distance in zip(parts, parameters, distances, strict=True)
    ]
