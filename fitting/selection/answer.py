"""The answer of a ranking: its rows, sentences and warnings, from the decision about the laws."""

import math
import time as clock
from collections.abc import Sequence
from dataclasses import dataclass, replace
from operator import attrgetter

import numpy as np

from fitting.adequacy.assess import Assessment, Measurement
from fitting.adequacy.result import NONE_FITTED, NONE_OF_SIX, Adequacy
from fitting.curve.result import FormFit
from fitting.departures.ageing import find_other_break_away
from fitting.drawing import curves
from fitting.driver.fit import Fit
from fitting.estimation import break_aways, derived
from fitting.estimation.result import Parameter
from fitting.law import PUBLISHED, SIX, SOURCES
from fitting.model.problem import Run
from fitting.selection import rig_intervals, verdict, verdict_warnings
from fitting.selection.asked import Asked
from fitting.selection.contradictions import name_contradictions
from fitting.selection.judgement import Competition
from fitting.selection.phase_distance import MeasuredOrbit
from fitting.selection.result import LawResult, RankedLaws, UnfittedLaw
from fitting.selection.verdict_warnings import JudgedRun
from processing.record.finding import Finding
from processing.record.kinematics import Kinematics
from stickslip.units import Measured

Contradictions = list[list[Finding]]  # of each run


@dataclass(frozen=True, eq=False)
class Contest:
    """All laws fitted to runs, and what their competition decided."""

    asked: Asked
    records: Sequence[Kinematics]  # as smoothed, and in the fit's frame
    runs: Sequence[Run]
    measured: Measurement
    competition: Competition
    unfitted: tuple[UnfittedLaw, ...]  # the laws that were not fitted
    sustained: bool  # whether the mass sticks in the long run
    warnings: tuple[str, ...] = ()  # about formulas that could not be fitted, or not in all their parameters

    @property
    def rejected(self) -> bool:
        """Whether no law describes the runs."""
        return not self.competition.described

    @property
    def best(self) -> Fit:
        """The law of the first row."""
        return self.competition.best

    def described(self) -> list[tuple[int | str, list[dict[str, Parameter]]]]:
        """Return the laws that describe the runs, best first, each with its parameters of each run."""
        return [
            (fit.law.key, [_parameters(fit, self, number) for number in range(len(self.runs))])
            for fit in self.competition.fits
            if self.competition.describes(fit.law)
        ]


@dataclass(frozen=True, eq=False)
class Decision:
    """A contest with the goodness of fit of its best law, and what contradicts the record."""

    contest: Contest
    assessed: Assessment
    contradicted: "Contradictions"  # what of each run's calibration its record contradicts
    other_contact: Finding | None = None  # that the runs are not of one contact

    @property
    def asked(self) -> Asked:
        """What was asked for."""
        return self.contest.asked

    @property
    def records(self) -> Sequence[Kinematics]:
        """The smoothed runs."""
        return self.contest.records

    @property
    def runs(self) -> Sequence[Run]:
        """The runs in the fit's frame."""
        return self.contest.runs

    @property
    def competition(self) -> Competition:
        """The laws in order."""
        return self.contest.competition


@dataclass(frozen=True, eq=False)
class Rows:
    runs: tuple[tuple[LawResult, ...], ...]  # those of each run
    together: tuple[LawResult, ...]  # those of all runs together; of a single run its own
    depends: tuple[tuple[str, ...], ...]  # of each run: what of it depends on the law, in words


def ranking(decision: Decision, begun: float) -> RankedLaws:
    """Return the ranking; ``begun`` is the process's CPU time when it began, s."""
    rows = _rows(decision)
    words = _words(decision, rows)
    sides = [_side(decision, number, rows, words) for number in range(len(decision.runs))]
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
    outcome = NONE_OF_SIX if len(asked.competitors.six) == len(SIX) else NONE_FITTED
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
    tables = list(zip(*(_rows_of(fit, decision, orbits) for fit in decision.competition.fits), strict=True))
    compatible = [law.key for law in decision.competition.compatible]
    depends = [rig_intervals.law_dependent(own, compatible) for own in tables]
    found = [tuple(rig_intervals.over_compatible_laws(own, compatible)) for own in tables]
    return Rows(tuple(found[: len(decision.runs)]), found[-1], tuple(depends[: len(decision.runs)]))


def _rows_of(fit: Fit, decision: Decision, orbits: Sequence[MeasuredOrbit]) -> list[LawResult]:
    """Return a law's row for each run, and last the row for all of them together; one row for a single run."""
    runs, competition = decision.runs, decision.competition
    chosen, competitors = competition.chosen, decision.asked.competitors
    parts = [fit.for_run(number) for number in range(len(runs))]
    parameters = [_parameters(fit, decision.contest, number) for number in range(len(runs))]
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
            outside_band=decision.assessed.together.outside_band.get(fit.law.key),
            formula=None if fit.law.number else fit.law.formula,
            asked=competitors.asks(fit.law),
        )
        for part, own, distance, motion in zip(parts, parameters, distances, motions, strict=True)
    ]


def _parameters(fit: Fit, contest: Contest, run: int) -> dict[str, Parameter]:
    """Return a law's parameters of a run; those that were given as they were given."""
    motion, alpha = contest.runs[run].motion, contest.asked.alpha
    own = derived.derived_parameters(fit, motion, alpha, run, sustained=contest.sustained)
    trusted = contest.competition.describes(fit.law)
    found = {name: replace(item, trusted=trusted and item.trusted) for name, item in own.items()}
    for name, value in contest.asked.fixed(fit.law).items():
        shown = name if name in found or f"{name}/m" not in found else f"{name}/m"
        unit = found[shown].unit if shown in found else ""  # that of a ramp's break-away level, which has none
        found[shown] = Parameter(value, 0.0, value, value, unit, fixed=True)
        if shown.endswith("/m") and motion.per_mass and shown.removesuffix("/m") in found:  # the same again
            found[shown.removesuffix("/m")] = found[shown]
    return found


def _words(decision: Decision, rows: Rows) -> str:
    """Return the verdict."""
    if decision.contest.rejected:
        known = "" if any(decision.contradicted) else None
        cause = known if decision.other_contact is None else decision.other_contact.text
        words = verdict.no_law_sentence(rows.together, decision.assessed.together, cause)
    else:
        words = verdict.verdict_sentence(
            rows.together,
            [law.key for law in decision.competition.not_excluded],
            sustained=decision.contest.sustained,
            measured=all(run.motion.belt_measured for run in decision.runs),
            rest_known=all(run.motion.datum_prior is not None for run in decision.runs),
            runs=len(decision.runs),
        )
    return name_contradictions(words, decision.contradicted)


def _side(decision: Decision, number: int, rows: Rows, words: str) -> RankedLaws:
    """Return one run's side: its rows, break-aways, findings and warnings."""
    run, record, own = decision.runs[number], decision.records[number], rows.runs[number]
    best = own[0]
    events = break_aways.find_break_aways(best.fit, run.motion, run.cut)
    # The fitted belt speed is compared with the stated one more exactly than the sticks that smoothing found.
    findings = [
        *(finding for finding in record.findings if finding.code != "belt-speed"),
        *decision.contradicted[number],
        *_fluctuation(decision.assessed.together),
        *([] if decision.other_contact is None else [decision.other_contact]),
    ]
    # a mass that merely grazes the belt does not break away from rest
    if decision.contest.sustained and not decision.contest.rejected:
        friction = best.fit.values.F * curves.mass(run.motion, best.fit)
        error = derived.break_away_level_error(decision.contest.best, run.motion, number)
        findings += find_other_break_away(
            events, run.cut, Measured(friction, error * friction), curves.unit(run.motion)
        )
    given = decision.asked.given(best.fit.law)
    judged = JudgedRun(own, best, run.motion, run.cut, record, findings, decision.contest.sustained, given)
    together, adequacy = decision.assessed.together, decision.assessed.runs[number]
    warnings = (
        *verdict_warnings.warnings(judged),
        *decision.contest.warnings,
        *rows.depends[number],
        *verdict_warnings.not_judged(adequacy),
        *verdict_warnings.level_of_curve(together),
    )
    if len(decision.runs) == 1:
        adequacy = _with_forms(adequacy, own, decision.contest.unfitted)
    return RankedLaws(
        verdict=words,
        members=tuple(law.key for law in decision.competition.members),
        rows=own,
        events=tuple(replace(event, t=run.motion.begin + event.t) for event in events),
        warnings=warnings,
        motion=run.motion,
        cut=run.cut,
        adequacy=adequacy,
        findings=tuple(findings),
        records=(record,),
        alpha=decision.asked.alpha,
        unfitted=decision.contest.unfitted,
        not_excluded=tuple(law.key for law in decision.competition.not_excluded),
    )


def _fluctuation(adequacy: Adequacy) -> list[Finding]:
    """Return that friction fluctuates at random within slips, with the share of Fs, where it does."""
    share = adequacy.fluctuation
    if share is None:
        return []
    text = f"friction fluctuates at random within slips, by about {100 * share:.2g} % of Fs: no law can describe it"
    return [Finding("random-within-slips", text, share, 0.0, 0.0)]


def _with_forms(adequacy: Adequacy, rows: Sequence[LawResult], unfitted: Sequence[UnfittedLaw]) -> Adequacy:
    """Return what is known of a record, with the published laws as they were fitted to it."""
    forms = [
        FormFit(
            name=str(row.law),
            formula=str(row.formula),
            source=SOURCES[str(row.law)],
            parameters={name: row.parameters[name] for name in PUBLISHED[str(row.law)].free},
            chi=row.misfit,
            inside_band=row.outside_band is not None and row.outside_band.half_widths <= 1,
        )
        for row in sorted(rows, key=attrgetter("misfit"))
        if row.law in PUBLISHED
    ]
    forms += [
        FormFit(name, str(one.formula), SOURCES[name], dict.fromkeys(PUBLISHED[name].free), None, inside_band=False)
        for one in unfitted
        if (name := str(one.law)) in PUBLISHED
    ]
    return replace(adequacy, forms=tuple(forms))


def _together(decision: Decision, rows: Rows, words: str, sides: Sequence[RankedLaws], cpu_s: float) -> RankedLaws:
    """Return the ranking of all runs together; of a single run its side."""
    if len(sides) == 1:
        return replace(sides[0], cpu_s=cpu_s)
    warnings, findings = _merged(sides, decision.records)
    return RankedLaws(
        verdict=words,
        members=tuple(law.key for law in decision.competition.members),
        rows=rows.together,
        events=tuple(event for side in sides for event in side.events),
        warnings=warnings,
        motion=decision.runs[0].motion,
        cut=decision.runs[0].cut,
        adequacy=_with_forms(decision.assessed.together, rows.together, decision.contest.unfitted),
        cpu_s=cpu_s,
        findings=findings,
        runs=tuple(replace(side, warnings=warnings, cpu_s=cpu_s) for side in sides),
        records=tuple(decision.records),
        alpha=decision.asked.alpha,
        unfitted=decision.contest.unfitted,
        not_excluded=tuple(law.key for law in decision.competition.not_excluded),
    )


def _merged(sides: Sequence[RankedLaws], records: Sequence[Kinematics]) -> tuple[tuple[str, ...], tuple[Finding, ...]]:
    """Return the warnings and the findings of several runs."""
    names = [record.recording.source.name for record in records]
    warnings = verdict_warnings.merge_warnings([side.warnings for side in sides], names)
    return warnings, tuple(dict.fromkeys(finding for side in sides for finding in side.findings))
