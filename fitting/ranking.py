"""`rank`: fit smoothed records, compare all laws (`fitting.judge.evidence`), and put the answer in words."""

import logging
import time as clock
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial

from daq.runfile.rig import Rig
from fitting.judge import law_fits, screening
from fitting.judge.adequacy import assess, measure
from fitting.judge.calibrations import LawParameters, apply_user_values, find_contradictions, find_other_contact
from fitting.judge.formulas import fit_formulas, fit_memory_laws, name_better_limit
from fitting.judge.judgement import Competition, compete
from fitting.judge.parameters import Parameter
from fitting.model.problem import Run
from fitting.options import Options
from fitting.record.motion import from_kinematics
from fitting.result import Ranking
from fitting.search.fit import Unfitted
from fitting.words import answer
from processing.record.kinematics import Kinematics
from stickslip.errors import DataError
from stickslip.units import Measured

logger = logging.getLogger(__name__)


def rank(
    records: Sequence[Kinematics],
    rigs: Sequence[Rig],
    options: Options,
    progress: Callable[[float], None] | None = None,
) -> Ranking:
    """Rank the laws of one record, or of several records of one contact; raises the errors of `fitting.rank`."""
    begun = clock.process_time()
    if len(records) > 1:
        options.check_joint()
    runs = _cut(records, rigs, options)

    def list_describing_laws(records: Sequence[Kinematics], runs: Sequence[Run]) -> Mapping[int | str, LawParameters]:
        """Return the laws that describe other runs, best first, with their parameters of each run."""
        try:
            return answer.describing(_compete(options, records, runs), options)
        except (law_fits.NoLawError, DataError):
            return {}

    def refit(free: Sequence[Run]) -> Sequence[LawParameters]:
        return list(list_describing_laws(records, free).values())

    try:
        competition = _compete(options, records, runs, progress, memory=True)
    except law_fits.NoLawError as refused:
        contradictions = find_contradictions([], runs, records, refit)
        if refused.stick_slip:
            return answer.without_law(refused.reason, contradictions, options, runs, records, begun)
        raise screening.refusal(refused.reason, contradictions, runs, records) from None
    other_contact = None
    if len(runs) > 1 and (competition.runs_differ or not competition.described):
        laws_of_runs: list[Mapping[int | str, Mapping[str, Parameter]]] = []
        for record, run in zip(records, competition.runs, strict=True):
            laws_of_runs.append(
                {law: parameters[0] for law, parameters in list_describing_laws([record], [run]).items()}
            )
        other_contact = find_other_contact(laws_of_runs)
    if other_contact is not None:
        competition = competition.undescribed
    contradictions = [[] for _ in runs]
    if other_contact is None:  # otherwise each run was described with its calibrations
        describing_laws = list(answer.describing(competition, options).values())
        contradictions = find_contradictions(describing_laws, competition.runs, records, refit)
    adequacies = assess(
        competition.fits,
        competition.judgements[competition.best.law],
        competition.curve,
        competition.noise,
        [fit for fit in competition.fits if fit.law.has_kernel] or competition.six,
        [run.motion for run in competition.runs],
        len(options.competitors.six),
        _revolution(records),
        rejected=not competition.described,
        explain=other_contact is None and not any(contradictions),
    )
    for fit in competition.fits:
        member = "in the set" if fit.law in competition.members else "not in the set"
        logger.info("law %s: %.4g um rms, %s, %s, %.2f s", fit.law.name, 1e6 * fit.rms, fit.outcome, member, fit.cpu_s)
    logger.info("goodness of fit: %s", adequacies[0].said)
    return answer.build_ranking(competition, options, records, adequacies, contradictions, other_contact, begun)


def _cut(records: Sequence[Kinematics], rigs: Sequence[Rig], options: Options) -> list[Run]:
    """Return each record in the fit's frame, divided into cycles."""
    for record in records:
        screening.refuse_wrong_times(record)
    runs, rest = [], options.competitors.fix.get("x0")
    for record, rig in zip(records, rigs, strict=True):
        stated_rig = rig if rest is None else rig.resting_at(Measured(rest, 0.0))
        motion = from_kinematics(record, stated_rig, options.belt_speed)
        screening.refuse_few_samples(motion, record)
        runs.append(law_fits.cut_run(motion, frozenset(options.excluded)))
        cut = runs[-1].cut
        logger.info("%s: %d cycles, %d to fit", record.recording.name, len(cut.cycles), len(cut.used))
    return apply_user_values(runs, options.competitors)


def _compete(
    options: Options,
    records: Sequence[Kinematics],
    runs: Sequence[Run],
    progress: Callable[[float], None] | None = None,
    *,
    memory: bool = False,
) -> Competition:
    """Compare all laws; with ``memory`` also laws with memory. Raise NoLawError where no law fits roughly."""
    competitors = options.competitors
    six, runs, sustained, refusal = law_fits.fit_runs(options, runs, records, progress)
    nearest, curve = measure(six, [run.motion for run in runs], options.alpha)
    formulas, missing, warnings = fit_formulas(competitors, curve, six, sustained=sustained)
    fits_of_six = [fit for fit in six if fit.law in competitors.laws and competitors.by_kernel(fit.law)]
    reasons_lost = {fit.law: name_better_limit(fit, six) for fit in fits_of_six}
    fits = [*(fit for fit in fits_of_six if not reasons_lost[fit.law]), *formulas]
    if refusal and not screening.list_near(formulas, runs):
        law_fits.refuse(refusal, records)
    if sustained:
        fitted_laws = {*reasons_lost, *(law for law in competitors.laws if not competitors.by_kernel(law))}
        reasons_lost |= {law: "its motion could not be computed" for law in competitors.laws if law not in fitted_laws}
    missing = [*(Unfitted(law, why) for law, why in reasons_lost.items() if why), *missing]
    if not any(competitors.asks(fit.law) for fit in fits):
        reasons = "; ".join(f"law {law.key}: {reason}" for law, reason, requested in missing if requested)
        sources = ", ".join(record.recording.where for record in records)
        raise DataError(f"none of the requested laws can be fitted ({reasons})", sources, "add laws, as --laws 1-6")
    judge = partial(compete, noise=nearest.noise, runs=runs, alpha=options.alpha, sustained=sustained)
    competition = judge(fits, known=[nearest])
    if memory and sustained and not competition.described:
        laws_with_memory = fit_memory_laws(competitors, runs, six, nearest.noise)
        if laws_with_memory:
            with_memory = judge([*fits, *laws_with_memory], known=[nearest, *competition.judgements.values()])
            competition = with_memory if with_memory.described else competition
    return replace(
        competition,
        runs=tuple(runs),
        sustained=sustained,
        curve=curve,
        noise=nearest.noise,
        six=tuple(six),
        unfitted=tuple(missing),
        warnings=tuple(warnings),
    )


def _revolution(records: Sequence[Kinematics]) -> float | None:
    """Return the encoder's travel per revolution, m, if it is the same in all runs."""
    travels = set()
    for record in records:
        pitch, counts = record.recording.rig.metres_per_count, record.recording.rig.counts_per_revolution
        travels.add(None if pitch is None or counts is None else abs(pitch.value) * counts)
    return travels.pop() if len(travels) == 1 else None
