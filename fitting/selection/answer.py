"""The answer of a ranking: its rows, sentences and warnings, from the decision about the laws."""

import math
import time as clock
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fitting.adequacy.assess import Assessment, known_mass
from fitting.adequacy.result import NONE_FITTED, NONE_OF_SIX, Adequacy
from fitting.competitors import ALL_LAWS
from fitting.curve.formula_fit import FormulaFit
from fitting.curve.formula_parameters import formula_level_error, formula_parameters
from fitting.curve.measure import furthest_exit
from fitting.curve.result import BandExit
from fitting.departures.ageing import find_ageing
from fitting.estimation import break_aways, derived
from fitting.estimation.fit import Fit
from fitting.estimation.result import Parameter
from fitting.model.problem import Run
from fitting.selection import rig_intervals, verdict, verdict_warnings
from fitting.selection.asked import Asked
from fitting.selection.contradictions import (
    CONTRADICTED_BY,
    contradicted_by_all_laws,
    find_contradictions,
    name_contradictions,
    without_those_of_the_law,
)
from fitting.selection.phase_distance import MeasuredOrbit
from fitting.selection.result import LawResult, RankedLaws
from fitting.selection.rivals import Competition
from fitting.selection.verdict_warnings import JudgedRun
from processing.record.finding import Finding
from processing.record.kinematics import Kinematics
from rig_sim.friction.law import LAWS

Contradictions = list[list[Finding]]  # of each run


@dataclass(frozen=True, eq=False)
class Decision:
    """The decision about the laws, and its basis."""

    asked: Asked
    records: Sequence[Kinematics]  # as smoothed, and in the fit's frame
    runs: Sequence[Run]
    fits: Sequence[Fit | FormulaFit]  # best first
    competition: Competition
    assessed: Assessment
    described: frozenset[int | str]  # the laws given as formulas that leave no more than noise
    sustained: bool  # whether the mass sticks in the long run
    said: tuple[str, ...] = ()  # what is to be said of formulas that could not be fitted, or not in all

    @property
    def rejected(self) -> bool:
        """Whether none of the requested laws describes the runs."""
        return self.assessed.together.rejected

    @property
    def beaten(self) -> bool:
        """Whether rivals describe the runs better than each requested law, which noise may not rule out."""
        return self.competition.beaten and self.assessed.beaten

    @property
    def best(self) -> Fit | FormulaFit:
        """The best of the requested laws, one of the six where any are in the set, as in the verdict."""
        law = self.competition.best
        return next(fit for fit in self.fits if fit.law == law)

    def trusts(self, fit: Fit | FormulaFit) -> bool:
        """Return whether a law's intervals hold: it, or a law of its kind, describes the runs."""
        if isinstance(fit, FormulaFit) and fit.law in self.competition.members:
            return fit.law in self.described
        return not self.rejected


@dataclass(frozen=True, eq=False)
class Rows:
    runs: tuple[tuple[LawResult, ...], ...]  # those of each run
    together: tuple[LawResult, ...]  # those of all runs together; of a single run its own
    depends: tuple[tuple[str, ...], ...]  # of each run: what of it depends on the law, in words


def ranking(decision: Decision, begun: float) -> RankedLaws:
    """Return the ranking; ``begun`` is the process's CPU time when it began, s."""
    rows = _rows(decision)
    contradicted, kept_away = _contradicted(decision, rows)
    words = _words(decision, rows, contradicted, kept_away=kept_away)
    sides = [_side(decision, number, rows, words, contradicted[number]) for number in range(len(decision.runs))]
    return _together(decision, rows, words, sides, clock.process_time() - begun)


def without_law(
    reason: str,
    contradicted: Contradictions,
    asked: Asked,
    runs: Sequence[Run],
    records: Sequence[Kinematics],
    begun: float,
) -> RankedLaws:
    """Return the verdict on stick-slip that no law fits: no rows, and what is known without a law."""
    words = name_contradictions(verdict.refused_sentence(reason, asked.competitors), contradicted)
    outcome = NONE_OF_SIX if asked.competitors.laws == ALL_LAWS else NONE_FITTED
    sides = []
    for run, record, contradictions in zip(runs, records, contradicted, strict=True):
        adequacy = Adequacy(outcome, run.motion.resolution)
        findings = (*record.findings, *contradictions)
        warned = tuple(finding.text for finding in findings)
        cpu_s = clock.process_time() - begun
        side = RankedLaws(words, (), (), (), warned, run.motion, run.cut, adequacy, cpu_s, findings=findings)
        sides.append(replace(side, records=(record,), alpha=asked.alpha))
    if len(sides) == 1:
        return sides[0]
    warnings, findings = _merged(sides, records)
    return replace(sides[0], warnings=warnings, findings=findings, runs=tuple(sides), records=tuple(records))


def _rows(decision: Decision) -> Rows:
    """Return the rows of every law, each run's and those of all together."""
    orbits = [MeasuredOrbit.of(run.motion) for run in decision.runs]
    tables = list(zip(*(_rows_of(fit, decision, orbits) for fit in decision.fits), strict=True))
    depends = [() if decision.rejected else rig_intervals.law_dependent(own) for own in tables]
    found = [tuple(rig_intervals.over_the_set(own)) for own in tables]
    return Rows(tuple(found[: len(decision.runs)]), found[-1], tuple(depends[: len(decision.runs)]))


def _rows_of(fit: Fit | FormulaFit, decision: Decision, orbits: Sequence[MeasuredOrbit]) -> list[LawResult]:
    """Return a law's row for each run, and last the row for all; one row for a single run.

    Where no law describes the runs, intervals are withheld.
    """
    runs, found = decision.runs, decision.competition
    parts = [fit.for_run(number) for number in range(len(runs))]
    parameters = [_parameters(fit, decision, number) for number in range(len(runs))]
    distances = [orbit.distance(part) for part, orbit in zip(parts, orbits, strict=True)]
    motions = [run.motion for run in runs]
    if len(runs) > 1:
        together = {name: item for name, item in parameters[0].items() if name not in derived.RUNS_OWN}
        for number, own in enumerate(parameters, start=1):
            together |= {f"{name} ({number})": own[name] for name in derived.RUNS_OWN if name in own}
        parts, parameters, motions = [*parts, fit], [*parameters, together], [*motions, motions[0]]
        distances.append(math.sqrt(float(np.mean(np.square(distances)))))
    formula = None if isinstance(fit, Fit) or fit.number is not None else fit.asked_for.formula
    return [
        LawResult(
            law=fit.law,
            name=LAWS[fit.law].name if isinstance(fit.law, int) else fit.law.replace("-", " "),
            score=found.score[fit.law],
            weight=found.weight[fit.law],
            in_set=fit.law in found.members,
            rms_m=part.rms,
            cycles=len(part.rows),
            parameters=own,
            cpu_s=fit.cpu_s,
            behind=found.behind[fit.law],
            orbit=distance,
            fit=part,
            motion=motion,
            outside_band=_outside_band(fit, decision),
            formula=formula,
            asked=fit.law in found.asked,
        )
        for part, own, distance, motion in zip(parts, parameters, distances, motions, strict=True)
    ]


def _parameters(fit: Fit | FormulaFit, decision: Decision, run: int) -> dict[str, Parameter]:
    """Return a law's parameters of a run; fixed ones as stated."""
    motion, alpha = decision.runs[run].motion, decision.asked.alpha
    own: dict[str, Parameter]
    if isinstance(fit, Fit):
        own = derived.derived_parameters(fit, motion, alpha, run, sustained=decision.sustained)
    else:
        own = formula_parameters(fit, motion, alpha, run, sustained=decision.sustained)
    trusted = decision.trusts(fit)
    found = {name: replace(item, trusted=trusted and item.trusted) for name, item in own.items()}
    for name, value in decision.asked.fixed(fit.law).items():
        shown = name if name in found or f"{name}/m" not in found else f"{name}/m"
        unit = found[shown].unit if shown in found else ""  # that of a ramp's break-away level, which has none
        found[shown] = Parameter(value, 0.0, value, value, unit, fixed=True)
        if shown.endswith("/m") and motion.per_mass and shown.removesuffix("/m") in found:  # the same again
            found[shown.removesuffix("/m")] = found[shown]
    return found


def _outside_band(fit: Fit | FormulaFit, decision: Decision) -> BandExit | None:
    """Return the largest exit of a law from the band of the measured curve."""
    adequacy = decision.assessed.together
    if isinstance(fit, Fit):
        return adequacy.outside_band.get(fit.law)
    if adequacy.curve is None:
        return None
    mass = known_mass(decision.runs[0].motion, adequacy.curve)
    return furthest_exit(adequacy.curve, np.abs(fit.force(-adequacy.curve.speed, mass or 1.0)))


def _contradicted(decision: Decision, rows: Rows) -> tuple[Contradictions, bool]:
    """Return each run's contradicted calibrations, and whether they keep all laws away from it.

    They are those of the best requested law or, where a law holds without the calibration, of that one.
    """
    best = [next(row.parameters for row in own if row.law == decision.best.law) for own in rows.runs]
    motions = [run.motion for run in decision.runs]
    found = find_contradictions(decision.best, motions, best, decision.records)
    rivals = [
        fit
        for fit in decision.fits
        if isinstance(fit, FormulaFit) and fit is not decision.best and fit.law in decision.competition.members
    ]
    holding = [fit for fit in rivals if fit.law in decision.described]
    found = without_those_of_the_law(found, holding)
    far = np.any(np.abs(decision.best.calibration_deviations) > CONTRADICTED_BY)
    if decision.rejected and not holding and (far or any(found)):
        effect = "no law describes the record with the stated one"
        own = contradicted_by_all_laws(decision.asked, decision.runs, decision.records, effect)
        if any(own):
            return own, True
    return found, False


def _words(decision: Decision, rows: Rows, contradicted: Contradictions, *, kept_away: bool) -> str:
    if decision.beaten:
        return verdict.rival_sentence(rows.together, decision.competition)
    if decision.rejected:
        words = verdict.no_law_sentence(rows.together, decision.assessed.together)
        return name_contradictions(words, contradicted) if kept_away else words
    measured = all(run.motion.belt_measured for run in decision.runs)
    words = verdict.verdict_sentence(
        rows.together,
        decision.competition,
        sustained=decision.sustained,
        measured=measured,
        runs=len(decision.runs),
    )
    return name_contradictions(words, contradicted)


def _side(decision: Decision, number: int, rows: Rows, words: str, contradicted: Sequence[Finding]) -> RankedLaws:
    """Return one run's side: its rows, break-aways, findings and warnings."""
    run, record, own = decision.runs[number], decision.records[number], rows.runs[number]
    best = next(row for row in own if row.law == decision.best.law)
    events = break_aways.find_break_aways(best.fit, run.motion, run.cut)
    # The fitted belt speed is compared with the stated one more exactly than the sticks that smoothing found.
    findings = (*(finding for finding in record.findings if finding.code != "belt-speed"), *contradicted)
    given = decision.asked.given(best.law)
    members = decision.competition.members
    judged = JudgedRun(own, best, members, run.motion, run.cut, record, findings, decision.sustained, given)
    together, adequacy = decision.assessed.together, decision.assessed.runs[number]
    warnings = (
        *verdict_warnings.warnings(judged),
        *decision.said,
        *rows.depends[number],
        *verdict_warnings.not_judged(adequacy),
        *verdict_warnings.level_of_curve(together),
    )
    if decision.sustained and not decision.rejected:  # a mass that merely grazes the belt does not break away from rest
        aged = find_ageing(events, run.cut, _level_error(decision.best, run, number))
        if aged is not None:
            adequacy = replace(adequacy, departures=(*adequacy.departures, aged))
    return RankedLaws(
        verdict=words,
        members=members,
        rows=own,
        events=tuple(replace(event, t=run.motion.begin + event.t) for event in events),
        warnings=warnings,
        motion=run.motion,
        cut=run.cut,
        adequacy=adequacy,
        findings=findings,
        records=(record,),
        alpha=decision.asked.alpha,
    )


def _level_error(fit: Fit | FormulaFit, run: Run, number: int) -> float:
    """Return the error of a run's break-away level that all cycles share."""
    if isinstance(fit, Fit):
        return derived.break_away_level_error(fit, run.motion, number)
    return formula_level_error(fit, number)


def _together(decision: Decision, rows: Rows, words: str, sides: Sequence[RankedLaws], cpu_s: float) -> RankedLaws:
    """Return the ranking of all runs together; of a single run its side."""
    if len(sides) == 1:
        return replace(sides[0], cpu_s=cpu_s)
    warnings, findings = _merged(sides, decision.records)
    return RankedLaws(
        verdict=words,
        members=decision.competition.members,
        rows=rows.together,
        events=tuple(event for side in sides for event in side.events),
        warnings=warnings,
        motion=decision.runs[0].motion,
        cut=decision.runs[0].cut,
        adequacy=decision.assessed.together,
        cpu_s=cpu_s,
        findings=findings,
        runs=tuple(replace(side, warnings=warnings, cpu_s=cpu_s) for side in sides),
        records=tuple(decision.records),
        alpha=decision.asked.alpha,
    )


def _merged(sides: Sequence[RankedLaws], records: Sequence[Kinematics]) -> tuple[tuple[str, ...], tuple[Finding, ...]]:
    """Return the warnings and the findings of several runs."""
    names = [record.recording.source.name for record in records]
    warnings = verdict_warnings.merge_warnings([side.warnings for side in sides], names)
    return warnings, tuple(finding for side in sides for finding in side.findings)
