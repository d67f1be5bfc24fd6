"""The answer of a ranking: its rows, sentences and warnings, from the competition of the laws."""

import math
import time as clock
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from fitting.adequacy.result import NONE_FITTED, NONE_OF_SIX, Adequacy
from fitting.departures.ageing import find_other_break_away
from fitting.drawing import curves
from fitting.driver.fit import Fit
from fitting.estimation import break_aways, derived
from fitting.estimation.result import Parameter
from fitting.law import SIX
from fitting.model.problem import Run
from fitting.options import Options
from fitting.selection import rig_intervals, verdict, verdict_warnings
from fitting.selection.judgement import Competition
from fitting.selection.phase_distance import MeasuredOrbit
from fitting.selection.result import LawResult, Ranking
from processing.record.finding import Finding
from processing.record.kinematics import Kinematics
from stickslip.units import Measured

Contradictions = Sequence[Sequence[Finding]]  # of each run


def build_ranking(
    competition: Competition,
    options: Options,
    records: Sequence[Kinematics],
    adequacies: Sequence[Adequacy],
    contradicted: Contradictions,
    other_contact: Finding | None,
    begun: float,
) -> Ranking:
    """Return the ranking.

    adequacies: Of all runs together and, where there are several, of each.
    contradicted: What of each run's calibration its record contradicts.
    other_contact: That the runs are not of one contact.
    begun: CPU time of the process when the ranking began, s.
    """
    orbits, together = [MeasuredOrbit.of(run.motion) for run in competition.runs], adequacies[0]
    of_law = (_rows_of(fit, competition, options, orbits, together) for fit in competition.fits)
    tables = list(zip(*of_law, strict=True))
    shared = [] if other_contact is None else [other_contact]
    if together.fluctuation is not None:
        share = 100 * together.fluctuation
        text = f"friction fluctuates at random within slips, by about {share:.2g} % of Fs: no law can describe it"
        shared.insert(0, Finding("random-within-slips", text, together.fluctuation, 0.0, 0.0))
    sides = []
    for number, record in enumerate(records):
        findings = [*contradicted[number], *shared]
        adequacy = adequacies[number + 1] if len(adequacies) > 1 else together
        side = _side(competition, options, number, record, tables[number], findings, adequacy)
        depends = rig_intervals.law_dependent(tables[number], competition.compatible)
        warnings = verdict_warnings.warnings(side, (*competition.warnings, *depends), together)
        sides.append(replace(side, warnings=warnings))
    rows = tuple(rig_intervals.over_compatible_laws(tables[-1], competition.compatible))
    events = tuple(event for side in sides for event in side.events)
    return _complete(sides, contradicted, begun, rows=rows, events=events, adequacy=together)


def without_law(
    reason: str,
    contradicted: Contradictions,
    options: Options,
    runs: Sequence[Run],
    records: Sequence[Kinematics],
    begun: float,
) -> Ranking:
    """Return the verdict on stick-slip that no law fits: no rows, and what is known without a law."""
    outcome = NONE_OF_SIX if len(options.competitors.six) == len(SIX) else NONE_FITTED
    laws = "none of the six laws" if outcome == NONE_OF_SIX else outcome
    words = verdict.name_contradictions(f"stick-slip, but {laws}: {reason}", contradicted)
    sides = []
    for run, record, contradictions in zip(runs, records, contradicted, strict=True):
        findings = (*record.findings, *contradictions)
        side = Ranking(
            verdict=words,
            members=(),
            rows=(),
            events=(),
            warnings=tuple(finding.text for finding in findings),
            motion=run.motion,
            cut=run.cut,
            adequacy=Adequacy(outcome, run.motion.resolution),
            findings=findings,
            records=(record,),
            alpha=options.alpha,
        )
        sides.append(side)
    return _complete(sides, contradicted, begun)


def describing(competition: Competition, options: Options) -> dict[int | str, list[dict[str, Parameter]]]:
    """Return the laws that describe the runs, best first, each with its parameters of each run."""
    return {
        fit.law.key: [_parameters(fit, competition, options, number) for number in range(len(competition.runs))]
        for fit in competition.fits
        if competition.describes(fit.law)
    }


def _rows_of(
    fit: Fit,
    competition: Competition,
    options: Options,
    orbits: Sequence[MeasuredOrbit],
    adequacy: Adequacy,
) -> list[LawResult]:
    """Return a law's row for each run, and last the row for all of them together; one row for a single run."""
    runs, chosen, competitors = competition.runs, competition.chosen, options.competitors
    parts = [fit.for_run(number) for number in range(len(runs))]
    parameters = [_parameters(fit, competition, options, number) for number in range(len(runs))]
    distances = [orbit.distance(part) for part, orbit in zip(parts, orbits, strict=True)]
    motions = [run.motion for run in runs]
    if len(runs) > 1:
        together = {name: item for name, item in parameters[0].items() if name not in derived.RUNS_OWN}
        for number, own in enumerate(parameters, start=1):
            together |= {f"{name} ({number})": own[name] for name in derived.RUNS_OWN if name in own}
        parts, parameters, motions = [*parts, fit], [*parameters, together], [*motions, motions[0]]
        distances.append(math.sqrt(float(np.mean(np.square(distances)))))
    return [
        LawResult(
            law=fit.law.key,
            name=fit.law.words,
            score=chosen.score.get(fit.law),
            weight=chosen.weight.get(fit.law),
            in_set=fit.law in chosen.members,
            rms_m=part.rms,
            misfit=competition.misfit[fit.law],
            cycles=len(part.rows),
            parameters=own,
            cpu_s=fit.cpu_s,
            behind=chosen.behind.get(fit.law),
            orbit=distance,
            fit=part,
            motion=motion,
            outside_band=adequacy.outside_band.get(fit.law.key),
            formula=None if fit.law.number else fit.law.formula,
            asked=competitors.asks(fit.law),
        )
        for part, own, distance, motion in zip(parts, parameters, distances, motions, strict=True)
    ]


def _parameters(fit: Fit, competition: Competition, options: Options, run: int) -> dict[str, Parameter]:
    """Return a law's parameters of a run; those that were given as they were given."""
    motion = competition.runs[run].motion
    own = derived.derived_parameters(fit, motion, options.alpha, run, sustained=competition.sustained)
    trusted = competition.describes(fit.law)
    found = {name: replace(item, trusted=trusted and item.trusted) for name, item in own.items()}
    for name, value in options.fixed(fit.law).items():
        shown = name if name in found or f"{name}/m" not in found else f"{name}/m"
        unit = found[shown].unit if shown in found else ""  # that of a ramp's break-away level, which has none
        found[shown] = Parameter(value, 0.0, value, value, unit, fixed=True)
        if shown.endswith("/m") and motion.per_mass and shown.removesuffix("/m") in found:  # the same again
            found[shown.removesuffix("/m")] = found[shown]
    return found


def _side(
    competition: Competition,
    options: Options,
    number: int,
    record: Kinematics,
    table: Sequence[LawResult],
    findings: Sequence[Finding],
    adequacy: Adequacy,
) -> Ranking:
    """Return one run's side, without verdict and warnings: its rows, break-aways and findings."""
    run, rows = competition.runs[number], tuple(rig_intervals.over_compatible_laws(table, competition.compatible))
    events = break_aways.find_break_aways(rows[0].fit, run.motion, run.cut)
    # The fitted belt speed is compared with the stated one more exactly than the sticks that smoothing found.
    findings = [*(finding for finding in record.findings if finding.code != "belt-speed"), *findings]
    # a mass that merely grazes the belt does not break away from rest
    if competition.sustained and competition.described:
        friction = rows[0].fit.values.F * curves.mass(run.motion, rows[0].fit)
        error = derived.break_away_level_error(competition.best, run.motion, number)
        findings += find_other_break_away(
            events, run.cut, Measured(friction, error * friction), curves.unit(run.motion)
        )
    return Ranking(
        verdict="",
        members=tuple(law.key for law in competition.members),
        rows=rows,
        events=tuple(replace(event, t=run.motion.begin + event.t) for event in events),
        warnings=(),
        motion=run.motion,
        cut=run.cut,
        adequacy=adequacy,
        findings=tuple(findings),
        records=(record,),
        alpha=options.alpha,
        unfitted=competition.unfitted,
        not_excluded=tuple(law.key for law in competition.not_excluded),
        sustained=competition.sustained,
    )


def _complete(sides: Sequence[Ranking], contradicted: Contradictions, begun: float, **of_all: Any) -> Ranking:
    """Return the ranking of all runs, of which a single one is its own side; ``of_all`` is what they have together."""
    ranking, cpu_s = replace(sides[0], **of_all), clock.process_time() - begun
    if len(sides) > 1:
        records = tuple(record for side in sides for record in side.records)
        names = [record.recording.source.name for record in records]
        warnings = verdict_warnings.merge_warnings([side.warnings for side in sides], names)
        findings = tuple(dict.fromkeys(finding for side in sides for finding in side.findings))
        ranking = replace(ranking, warnings=warnings, findings=findings, runs=tuple(sides), records=records)
    words = ranking.verdict or verdict.write_verdict(ranking, contradicted)
    runs = tuple(replace(side, verdict=words, cpu_s=cpu_s) for side in ranking.runs)
    return replace(ranking, verdict=words, runs=runs, cpu_s=cpu_s)
