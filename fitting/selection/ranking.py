"""`rank`: fits the laws to a smoothed record and ranks them; returns the best, or the set of compatible ones.

Evidence and set rule: `fitting.selection.evidence`.
"""

import logging
import time as clock
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from daq.runfile.rig import Rig
from fitting.adequacy.assess import Measurement, assess, describes_all, measure
from fitting.competitors import ALL_LAWS, Competitors
from fitting.curve.formula_fit import FormulaFit
from fitting.data import frame
from fitting.estimation.fit import Fit
from fitting.law import Bound, Law
from fitting.model.problem import Run
from fitting.selection import answer, law_fits, screening
from fitting.selection.answer import Decision
from fitting.selection.asked import Asked
from fitting.selection.contradictions import contradicted_by_all_laws
from fitting.selection.evidence import ModelSet
from fitting.selection.given import known_rest, with_given
from fitting.selection.judgement import judge
from fitting.selection.result import RankedLaws, UnfittedLaw
from fitting.selection.rivals import Competition, Formulas, compete, fit_formulas, unfitted
from processing.record.kinematics import Kinematics
from stickslip.errors import DataError
from stickslip.units import Measured

logger = logging.getLogger(__name__)


def rank(
    kinematics: Kinematics | Sequence[Kinematics],
    rig: Rig | Sequence[Rig] | None = None,
    laws: int | str | Law | Sequence[int | str | Law] | Competitors = ALL_LAWS,
    *,
    fix: Mapping[str, float] | None = None,
    bounds: Mapping[str, Bound] | None = None,
    start: Mapping[str, float] | None = None,
    belt_speed: Measured | float | str | None = None,
    excluded: Sequence[int] = (),
    alpha: float = 0.05,
    jobs: int = 1,
    progress: Callable[[float], None] | None = None,
    scheduler: str | None = None,
) -> RankedLaws:
    """Fit the laws to a record, or to several of one contact together, and rank them.

    Plain differences are smoothed again, in memory; ``rig`` is by default the recordings' own, ``belt_speed`` in m/s,
    signed. Other arguments, errors and limits as in `fitting.rank`.
    """
    begun = clock.process_time()
    competitors = laws if isinstance(laws, Competitors) else Competitors.of(laws, fix, bounds, start)
    asked = Asked(competitors, belt_speed, tuple(excluded), alpha, jobs, progress, scheduler)
    records = [_smoothed(one) for one in ([kinematics] if isinstance(kinematics, Kinematics) else kinematics)]
    asked.check_together(records)
    runs = _cut(records, rig, asked)
    try:
        fits, runs, sustained, doubt = law_fits.fit_runs(
            competitors.searched, runs, records, jobs, progress, scheduler, formulas=bool(competitors.formulas)
        )
        fits, chosen = judge(fits, competitors.direct, runs, alpha, sustained=sustained)
        measured = measure(fits, chosen.members, [run.motion for run in runs], alpha)
        formulas = fit_formulas(competitors, measured.curve, rivals=sustained)
        if doubt and not screening.comes_near(formulas.fits, runs):
            law_fits.refuse(doubt, records)
    except law_fits.NoLawError as refused:
        effect = "no law comes near the record with the stated one"
        contradicted = contradicted_by_all_laws(asked, runs, records, effect)
        if refused.stick_slip:
            return answer.without_law(refused.reason, contradicted, asked, runs, records, begun)
        raise screening.refusal(refused.reason, contradicted, runs, records) from None
    missing = _list_unfitted(fits, formulas, asked, records, sustained=sustained)
    competition = _compete(fits, chosen, formulas.fits, asked, runs, sustained=sustained)
    decision = _decided(asked, records, runs, fits, formulas, measured, competition, sustained=sustained)
    _log(decision)
    ranking = answer.ranking(decision, begun)
    return replace(ranking, unfitted=missing, runs=tuple(replace(side, unfitted=missing) for side in ranking.runs))


def _smoothed(kinematics: Kinematics) -> Kinematics:
    """Return the record smoothed well enough to start from."""
    if kinematics.method != "fd":
        return kinematics
    from processing.smoothing import smooth

    return smooth(kinematics.recording, times=kinematics.times)


def _cut(records: Sequence[Kinematics], rig: Rig | Sequence[Rig] | None, asked: Asked) -> list[Run]:
    """Return each record in the fit's frame, divided into cycles."""
    for record in records:
        screening.refuse_wrong_times(record)
    rigs = [None] * len(records) if rig is None else [rig] * len(records) if isinstance(rig, Rig) else rig
    runs = []
    for record, known in zip(records, rigs, strict=True):
        calibration = known_rest(record.recording.rig if known is None else known, asked.competitors)
        motion = frame.from_kinematics(record, calibration, asked.belt_speed)
        screening.refuse_few_samples(motion, record)
        runs.append(law_fits.cut_run(motion, frozenset(asked.excluded)))
        found = runs[-1].cut
        logger.info("%s: %d cycles, %d to fit", record.recording.name, len(found.cycles), len(found.used))
    return with_given(runs, asked.competitors)


def _compete(
    fits: Sequence[Fit],
    chosen: ModelSet,
    formulas: Sequence[FormulaFit],
    asked: Asked,
    runs: Sequence[Run],
    *,
    sustained: bool,
) -> Competition:
    """Return the set: of the six alone, or of all laws together."""
    six = [fit for fit in fits if fit.law in asked.competitors.direct]
    if not formulas:
        return Competition.of_six(chosen)
    named: frozenset[int | str] = frozenset((*asked.competitors.laws, *asked.competitors.names))
    return compete(six, chosen if six else None, formulas, runs, asked.alpha, named, sustained=sustained)


def _list_unfitted(
    fits: Sequence[Fit], formulas: Formulas, asked: Asked, records: Sequence[Kinematics], *, sustained: bool
) -> tuple[UnfittedLaw, ...]:
    """Return the requested laws that could not be fitted; DataError where no other was requested.

    Laws with sticks are not fitted to a mass without, and are not listed.
    """
    direct, followed = asked.competitors.direct, {fit.law for fit in fits}
    lost = [unfitted(law, "its motion cannot be followed") for law in direct if law not in followed and sustained]
    missing = (*lost, *formulas.unfitted)
    if not followed.intersection(direct) and not {fit.law for fit in formulas.fits}.intersection(
        (*asked.competitors.names, *asked.competitors.restated)
    ):
        reasons = "; ".join(f"law {law.law}: {law.reason}" for law in missing)
        where = ", ".join(record.recording.where for record in records)
        raise DataError(f"none of the requested laws can be fitted ({reasons})", where, "add laws, as --laws 1-6")
    return missing


def _decided(
    asked: Asked,
    records: Sequence[Kinematics],
    runs: Sequence[Run],
    fits: Sequence[Fit],
    formulas: Formulas,
    measured: Measurement,
    competition: Competition,
    *,
    sustained: bool,
) -> Decision:
    """Return the decision: which laws describe the runs, and the assessment of the others."""
    motions = [run.motion for run in runs]
    by_law: dict[int | str, Fit | FormulaFit] = {fit.law: fit for fit in fits}
    by_law |= {fit.law: fit for fit in formulas.fits}
    ordered = [by_law[law] for law in competition.order]
    members = [by_law[law] for law in competition.members if law in competition.asked]
    # where rivals leave none of them, those that were asked for are judged as if they were alone
    alone = [fit for fit in ordered if fit.law in competition.asked]
    named = [fit for fit in alone[:1] if isinstance(fit, FormulaFit)]
    judged = members or [*named, *(fit for fit in alone if fit.law in measured.members)] or alone[:1]
    count = len(asked.competitors.laws)
    assessed = assess(measured, judged, motions, count, _revolution(records))
    if competition.beaten and not assessed.together.rejected:
        assessed = assessed.by_others(count)
    described = describes_all([fit for fit in formulas.fits if fit.law in competition.members], motions)
    return Decision(asked, records, runs, ordered, competition, assessed, described, sustained, formulas.warnings)


def _revolution(records: Sequence[Kinematics]) -> float | None:
    """Return the encoder's travel per revolution, m, if the same in all runs, else None."""
    found = set()
    for record in records:
        pitch, counts = record.recording.rig.metres_per_count, record.recording.rig.counts_per_revolution
        found.add(None if pitch is None or counts is None else abs(pitch.value) * counts)
    return found.pop() if len(found) == 1 else None


def _log(decision: Decision) -> None:
    for fit in decision.fits:
        member = "in the set" if fit.law in decision.competition.members else "not in the set"
        logger.info("law %s: %.4g um rms, %s, %s, %.2f s", fit.law, 1e6 * fit.rms, fit.outcome, member, fit.cpu_s)
    logger.info("goodness of fit: %s", decision.assessed.together.said)
