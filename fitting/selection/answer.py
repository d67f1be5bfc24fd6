"""The answer of a ranking: its rows, sentences and warnings, from what was decided about the laws."""

import math
import time as clock
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fitting.adequacy.assess import Assessment
from fitting.adequacy.result import NONE_FITTED, NONE_OF_SIX, Adequacy
from fitting.departures.ageing import find_ageing
from fitting.estimation import break_aways, derived
from fitting.estimation.fit import Fit
from fitting.model.problem import Run
from fitting.selection import rig_intervals, verdict, verdict_warnings
from fitting.selection.asked import Asked
from fitting.selection.contradictions import (
    find_contradictions,
    name_contradictions,
    without_those_of_the_law,
)
from fitting.selection.evidence import ModelSet
from fitting.selection.phase_distance import MeasuredOrbit
from fitting.selection.result import LawResult, Ranking
from fitting.selection.rivals import Competition
from fitting.selection.verdict_warnings import JudgedRun
from processing.record.finding import Finding
from processing.record.kinematics import Kinematics
from rig_sim.friction.law import LAWS

Contradictions = list[list[Finding]]  # of each run


@dataclass(frozen=True, eq=False)
class Decision:
    """What was decided about the laws, and from what.

    Attributes
    ----------
    asked : Asked
    records, runs : sequence
        As smoothed, and in the fit's frame.
    fits : sequence of Fit
        Best first.
    chosen : ModelSet
    assessed : Assessment
    competition : Competition or None
        With the published forms that the measured curve prefers.
    sustained : bool
        Whether the mass sticks in the long run.
    beaten : bool
        Whether rivals describe the runs better than each of the laws, which noise may not rule out.
    """

    asked: Asked
    records: Sequence[Kinematics]
    runs: Sequence[Run]
    fits: Sequence[Fit]
    chosen: ModelSet
    assessed: Assessment
    competition: Competition | None
    sustained: bool
    beaten: bool

    @classmethod
    def of(
        cls,
        asked: Asked,
        records: Sequence[Kinematics],
        runs: Sequence[Run],
        fits: Sequence[Fit],
        chosen: ModelSet,
        assessed: Assessment,
        competition: Competition | None,
        *,
        sustained: bool,
    ) -> "Decision":
        """Return the decision: where rivals describe the record and beat every law, none of these is adequate."""
        chosen = chosen if competition is None else competition.chosen
        beaten = competition is not None and competition.beaten and not assessed.together.rejected
        assessed = assessed.beaten(len(asked.laws)) if beaten else assessed
        ordered = [next(fit for fit in fits if fit.law == law) for law in chosen.order]
        return cls(asked, records, runs, ordered, chosen, assessed, competition, sustained, beaten)

    @property
    def rejected(self) -> bool:
        """Whether no law describes the runs."""
        return self.assessed.together.rejected


@dataclass(frozen=True, eq=False)
class Rows:
    """The rows of the laws, best first.

    Attributes
    ----------
    runs : tuple of tuple of LawResult
        Those of each run.
    together : tuple of LawResult
        Those of all runs together; of a single run its own.
    depends : tuple of tuple of str
        Of each run: what of it depends on the law, in words.
    """

    runs: tuple[tuple[LawResult, ...], ...]
    together: tuple[LawResult, ...]
    depends: tuple[tuple[str, ...], ...]


def ranking(decision: Decision, begun: float) -> Ranking:
    """Return the ranking; ``begun`` is the process's CPU time when it began, s."""
    rows = _rows(decision)
    contradicted = _contradicted(decision, rows)
    words = _words(decision, rows, contradicted)
    sides = [_side(decision, number, rows, words, contradicted[number]) for number in range(len(decision.runs))]
    return _together(decision, rows, words, sides, clock.process_time() - begun)


def without_law(reason: str, asked: Asked, runs: Sequence[Run], records: Sequence[Kinematics], begun: float) -> Ranking:
    """Return the verdict on stick-slip that no law comes near: no rows, and what is known without any law."""
    words = verdict.refused_sentence(reason, asked.laws)
    outcome = NONE_OF_SIX if len(asked.laws) == len(LAWS) else NONE_FITTED
    sides = []
    for run, record in zip(runs, records, strict=True):
        adequacy = Adequacy(outcome, run.motion.resolution)
        warned = tuple(finding.text for finding in record.findings)
        cpu_s = clock.process_time() - begun
        sides.append(Ranking(words, (), (), (), warned, run.motion, run.cut, adequacy, cpu_s, findings=record.findings))
    if len(sides) == 1:
        return sides[0]
    warnings, findings = _merged(sides, records)
    return replace(sides[0], warnings=warnings, findings=findings, runs=tuple(sides))


def _rows(decision: Decision) -> Rows:
    """Return the rows of every law, each run's and those of all together."""
    orbits = [MeasuredOrbit.of(run.motion) for run in decision.runs]
    tables = list(zip(*(_rows_of(fit, decision, orbits) for fit in decision.fits), strict=True))
    depends = [() if decision.rejected else rig_intervals.law_dependent(own) for own in tables]
    found = [tuple(rig_intervals.over_the_set(own)) for own in tables]
    return Rows(tuple(found[: len(decision.runs)]), found[-1], tuple(depends[: len(decision.runs)]))


def _rows_of(fit: Fit, decision: Decision, orbits: Sequence[MeasuredOrbit]) -> list[LawResult]:
    """Return a law's row for each run, and last the row for all of them together; one row for a single run.

    Where no law describes the runs, no interval is given.
    """
    runs, chosen, outside = decision.runs, decision.chosen, decision.assessed.together.outside_band
    parts = [fit.for_run(number) for number in range(len(runs))]
    parameters = [
        derived.derived_parameters(fit, run.motion, decision.asked.alpha, number, sustained=decision.sustained)
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
            parameters={name: replace(item, trusted=not decision.rejected) for name, item in own.items()},
            cpu_s=fit.cpu_s,
            behind=chosen.behind[fit.law],
            orbit=distance,
            fit=part,
            outside_band=outside.get(fit.law),
        )
        for part, own, distance in zip(parts, parameters, distances, strict=True)
    ]


def _contradicted(decision: Decision, rows: Rows) -> Contradictions:
    """Return what of each run's calibration its record contradicts."""
    best = [own[0] for own in rows.runs]
    found = find_contradictions(decision.fits[0], [run.motion for run in decision.runs], best, decision.records)
    if decision.competition is None:
        return found
    return without_those_of_the_law(found, decision.competition.inside_band(decision.assessed.together.curve))


def _words(decision: Decision, rows: Rows, contradicted: Contradictions) -> str:
    """Return the verdict."""
    if decision.competition is not None and decision.beaten:
        return verdict.rival_sentence(rows.together, decision.competition)
    if decision.rejected:
        return verdict.no_law_sentence(rows.together, decision.assessed.together)
    measured = all(run.motion.belt_measured for run in decision.runs)
    words = verdict.verdict_sentence(
        rows.together,
        decision.chosen.members,
        sustained=decision.sustained,
        measured=measured,
        runs=len(decision.runs),
    )
    return name_contradictions(verdict.with_rivals(words, decision.competition), contradicted)


def _side(decision: Decision, number: int, rows: Rows, words: str, contradicted: Sequence[Finding]) -> Ranking:
    """Return one run's side: its rows, break-aways, findings and warnings."""
    run, record, own = decision.runs[number], decision.records[number], rows.runs[number]
    events = break_aways.find_break_aways(own[0].fit, run.motion, run.cut)
    # The fitted belt speed is compared with the stated one more exactly than the sticks that smoothing found.
    findings = (*(finding for finding in record.findings if finding.code != "belt-speed"), *contradicted)
    judged = JudgedRun(own, decision.chosen.members, run.motion, run.cut, record, findings, decision.sustained)
    together, adequacy = decision.assessed.together, decision.assessed.runs[number]
    warnings = (
        *verdict_warnings.warnings(judged),
        *rows.depends[number],
        *verdict_warnings.not_judged(adequacy),
        *verdict_warnings.level_of_curve(together),
    )
    if decision.sustained and not decision.rejected:  # a mass that merely grazes the belt does not break away from rest
        error = derived.break_away_level_error(decision.fits[0], run.motion, number)
        aged = find_ageing(events, run.cut, error)
        if aged is not None:
            adequacy = replace(adequacy, departures=(*adequacy.departures, aged))
    return Ranking(
        verdict=words,
        laws_in_set=decision.chosen.members,
        rows=own,
        events=events,
        warnings=warnings,
        motion=run.motion,
        cut=run.cut,
        adequacy=adequacy,
        findings=findings,
        rivals=() if decision.competition is None else decision.competition.rivals,
    )


def _together(decision: Decision, rows: Rows, words: str, sides: Sequence[Ranking], cpu_s: float) -> Ranking:
    """Return the ranking of all runs together; of a single run its side."""
    if len(sides) == 1:
        return replace(sides[0], cpu_s=cpu_s)
    warnings, findings = _merged(sides, decision.records)
    return Ranking(
        verdict=words,
        laws_in_set=decision.chosen.members,
        rows=rows.together,
        events=tuple(event for side in sides for event in side.events),
        warnings=warnings,
        motion=decision.runs[0].motion,
        cut=decision.runs[0].cut,
        adequacy=decision.assessed.together,
        cpu_s=cpu_s,
        findings=findings,
        runs=tuple(replace(side, warnings=warnings, cpu_s=cpu_s) for side in sides),
        rivals=sides[0].rivals,
    )


def _merged(sides: Sequence[Ranking], records: Sequence[Kinematics]) -> tuple[tuple[str, ...], tuple[Finding, ...]]:
    """Return the warnings and the findings of several runs."""
    names = [record.recording.source.name for record in records]
    warnings = verdict_warnings.merge_warnings([side.warnings for side in sides], names)
    return warnings, tuple(finding for side in sides for finding in side.findings)
