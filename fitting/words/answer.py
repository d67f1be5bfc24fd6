"""The answer of a ranking: its rows, intervals, sentences and warnings, from the competition of the laws.

A law's interval holds if that law does.  Where several laws are compatible, the true belt speed may lie far outside the
interval of the best one: on a ramp the mass lags behind the belt, so a jump law finds a slower belt.  So intervals of
the rig's parameters contain those of every compatible law; one that leaves a parameter undetermined contains all
values.
"""

import math
import time as clock
from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from fitting.judge import breaks
from fitting.judge.adequacy import NONE_FITTED, NONE_OF_SIX, Adequacy
from fitting.judge.friction import MeasuredOrbit, mass, unit
from fitting.judge.judgement import Competition
from fitting.judge.parameters import (
    RUN_PARAMETERS,
    UNDETERMINED_WITH,
    Parameter,
    break_away_level_error,
    derived_parameters,
)
from fitting.laws import SIX
from fitting.model.problem import Run
from fitting.options import Options
from fitting.result import LawResult, Ranking, UnfittedLaw
from fitting.search.fit import Fit
from fitting.words import verdict
from fitting.words import warnings as verdict_warnings
from processing.record.kinematics import Kinematics
from processing.record.motion import Finding

RIG = ("k/m", "v_dr", "x0", "c/m", "k", "c", "m")  # the others are parameters of a law, each with a meaning in it alone
GROUPS = {group[0]: group for group in UNDETERMINED_WITH.values() if group[0] in RIG}  # what goes with each of them


def over_compatible_laws(rows: Sequence[LawResult], compatible: Collection[int | str]) -> list[LawResult]:
    """Return one run's rows; intervals of the rig's parameters contain those of every compatible law.

    The standard error becomes that of the longer half of the interval. Rows outside the set do not change.
    """
    others = [row.parameters for row in rows if row.law in compatible]
    withheld = {name for lead, _ in _undetermined(rows, compatible) for name in GROUPS[lead]}
    found = []
    for row in rows:
        parameters = dict(row.parameters)
        for name, item in row.parameters.items() if row.in_set else ():
            own = name.split(" (")[0]  # of several runs: "v_dr (2)"
            if own in withheld and not item.fixed:
                parameters[name] = replace(item, trusted=False)
            elif own in RIG:
                parameters[name] = _widened(item, [other[name] for other in others if name in other])
        found.append(replace(row, parameters=parameters))
    return found


def law_dependent(rows: Sequence[LawResult], compatible: Collection[int | str]) -> tuple[str, ...]:
    """Return the warnings that belt speed or k/m depend on the law, or that a law leaves a parameter undetermined."""
    warned = [
        f"law {law}, which the record does not exclude, leaves {name} undetermined, so its interval is withheld"
        for name, law in _undetermined(rows, compatible)
    ]
    for name in ("v_dr", "k/m"):
        known = {row.law: row.parameters[name] for row in rows if row.law in compatible and name in row.parameters}
        if any(not (one.lo <= other.value <= one.hi) for one in known.values() for other in known.values()):
            unit = next(iter(known.values())).unit
            values = ", ".join(f"{item.value:.4g} under law {law}" for law, item in known.items())
            warned.append(f"{name} (in {unit}) depends on the law: {values}. Its interval covers all of them")
    return tuple(warned)


def _undetermined(rows: Sequence[LawResult], compatible: Collection[int | str]) -> list[tuple[str, int | str]]:
    """Return the rig's parameters that one law of the set has and another compatible law has not, with that law."""
    names = {row.law: {name.split(" (")[0] for name in row.parameters} for row in rows if row.law in compatible}
    members = [row.law for row in rows if row.in_set]
    return [
        (lead, next(law for law, has in names.items() if lead not in has))
        for lead in GROUPS
        if any(lead in names[law] for law in members) and any(lead not in has for has in names.values())
    ]


def _widened(item: Parameter, others: Sequence[Parameter]) -> Parameter:
    lo, hi = min(other.lo for other in (item, *others)), max(other.hi for other in (item, *others))
    half = max(item.hi - item.value, item.value - item.lo)
    longer = max(hi - item.value, item.value - lo)
    return replace(item, lo=lo, hi=hi, stderr=item.stderr * longer / half if half > 0 else item.stderr)


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
    """Return the ranking; ``adequacies`` of all runs together, then of each; ``begun`` is a CPU time, s."""
    orbits, together = [MeasuredOrbit.of(run.motion) for run in competition.runs], adequacies[0]
    of_law = (_rows_of(fit, competition, options, orbits, together) for fit in competition.fits)
    tables = list(zip(*of_law, strict=True))
    shared = [*([] if other_contact is None else [other_contact]), *_other_break_away(competition)]
    if together.fluctuation is not None:
        share = 100 * together.fluctuation
        text = f"friction fluctuates at random within slips, by about {share:.2g} % of Fs, which no law can describe"
        shared.insert(0, Finding("random-within-slips", text, together.fluctuation, 0.0, 0.0))
    sides = []
    for number, record in enumerate(records):
        findings = [*contradicted[number], *shared]
        adequacy = adequacies[number + 1] if len(adequacies) > 1 else together
        side = _side(competition, options, number, record, tables[number], findings, adequacy)
        depends = law_dependent(tables[number], competition.compatible)
        warnings = verdict_warnings.warnings(side, (*competition.warnings, *depends), together)
        sides.append(replace(side, warnings=warnings))
    rows = tuple(over_compatible_laws(tables[-1], competition.compatible))
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
    outcome = NONE_OF_SIX if len(options.competitors.six) == len(SIX) else NONE_FITTED
    laws = "none of the six laws describes it" if outcome == NONE_OF_SIX else outcome
    words = verdict.name_contradictions(f"the record shows stick-slip, but {laws}: {reason}", contradicted)
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
    runs, chosen, competitors = competition.runs, competition.model_set, options.competitors
    parts = [fit.for_run(number) for number in range(len(runs))]
    parameters = [_parameters(fit, competition, options, number) for number in range(len(runs))]
    distances = [orbit.distance(part) for part, orbit in zip(parts, orbits, strict=True)]
    motions = [run.motion for run in runs]
    if len(runs) > 1:
        together = {name: item for name, item in parameters[0].items() if name not in RUN_PARAMETERS}
        for number, own in enumerate(parameters, start=1):
            together |= {f"{name} ({number})": own[name] for name in RUN_PARAMETERS if name in own}
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
            alpha=options.alpha,
        )
        for part, own, distance, motion in zip(parts, parameters, distances, motions, strict=True)
    ]


def _parameters(fit: Fit, competition: Competition, options: Options, run: int) -> dict[str, Parameter]:
    """Return a law's parameters of a run, with the fixed ones as the user gave them."""
    motion = competition.runs[run].motion
    own = derived_parameters(fit, motion, options.alpha, run, sustained=competition.sustained)
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
    """Return one run's rows, break-aways and findings, without verdict and warnings."""
    run, rows = competition.runs[number], tuple(over_compatible_laws(table, competition.compatible))
    events = breaks.find_break_aways(rows[0].fit, run.motion, run.cut)
    # The fitted belt speed is compared with the stated one more exactly than the sticks that smoothing found.
    findings = [*(finding for finding in record.findings if finding.code != "belt-speed"), *findings]
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
        unfitted=tuple(
            UnfittedLaw(law.key, law.words, reason, None if law.number else law.formula, asked, law.rate)
            for law, reason, asked in competition.unfitted
        ),
        not_excluded=tuple(law.key for law in competition.not_excluded),
        sustained=competition.sustained,
    )


def _other_break_away(competition: Competition) -> list[Finding]:
    """Return that the break-aways disagree with friction at rest under every law that is not excluded."""
    if not (competition.sustained and competition.described):
        return []  # a mass that merely grazes the belt does not break away from rest
    motion, found = competition.runs[0].motion, []
    for fit in competition.fits:
        if fit.law.rate and fit.law.key in competition.compatible:
            return []  # its motion contains the break-aways
        if fit.law.key in competition.compatible:
            runs = [
                breaks.BreakAways(
                    breaks.find_break_aways(fit.for_run(number), run.motion, run.cut),
                    breaks.find_stick_starts(fit.for_run(number), run.cut),
                    break_away_level_error(fit, run.motion, number),
                )
                for number, run in enumerate(competition.runs)
            ]
            found.append(breaks.find_other_break_away(runs, fit.values.F * mass(motion, fit), unit(motion)))
    return found[0] if all(found) else []


def _complete(sides: Sequence[Ranking], contradicted: Contradictions, begun: float, **of_all: Any) -> Ranking:
    """Return the ranking of all runs, of which a single one is its own side; ``of_all`` is of all together."""
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
