"""`rank`: fits the laws to a smoothed record and ranks them; returns the best, or the set of compatible ones.

Evidence and set rule: `fitting.selection.evidence`.
"""

import logging
import time as clock
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from daq.runfile.rig import Rig
from fitting.adequacy.assess import Assessment, assess, measure
from fitting.competitors import ALL_LAWS, Competitors
from fitting.data import frame
from fitting.estimation.result import Parameter
from fitting.law import Bound, Law
from fitting.model.problem import Run
from fitting.selection import answer, law_fits, screening
from fitting.selection.answer import Contest, Decision
from fitting.selection.asked import Asked
from fitting.selection.contradictions import LawParameters, find_contradictions
from fitting.selection.given import known_rest, with_given
from fitting.selection.judgement import compete
from fitting.selection.one_contact import find_other_contact
from fitting.selection.result import RankedLaws
from fitting.selection.rivals import fit_formulas, name_better_limit, unfitted
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

    def refit(free: Sequence[Run]) -> Sequence[LawParameters]:
        try:
            return [own for _, own in _contest(replace(asked, progress=None), records, free).described()]
        except (law_fits.NoLawError, DataError):
            return []

    try:
        contest = _contest(asked, records, runs)
    except law_fits.NoLawError as refused:
        contradicted = find_contradictions([], runs, records, refit)
        if refused.stick_slip:
            return answer.without_law(refused.reason, contradicted, asked, runs, records, begun)
        raise screening.refusal(refused.reason, contradicted, runs, records) from None
    contradicted = find_contradictions([own for _, own in contest.described()], contest.runs, records, refit)
    other_contact = None
    if contest.rejected and len(runs) > 1:
        alone = [_described_alone(asked, record, run) for record, run in zip(records, contest.runs, strict=True)]
        other_contact = find_other_contact(alone)
    first, motions = contest.competition.judged[contest.best.law], [run.motion for run in contest.runs]
    count, revolution = len(competitors.six), _revolution(records)
    explain = other_contact is None and not any(contradicted)
    assessed = assess(contest.measured, contest.competition.fits, first, motions, count, revolution, explain=explain)
    _log(contest, assessed)
    return answer.ranking(Decision(contest, assessed, contradicted, other_contact), begun)


def _described_alone(asked: Asked, record: Kinematics, run: Run) -> dict[int | str, Mapping[str, Parameter]]:
    """Return the laws that describe one run of several alone, best first, with its parameters."""
    try:
        contest = _contest(replace(asked, progress=None), [record], [run])
    except (law_fits.NoLawError, DataError):
        return {}
    return {law: own[0] for law, own in contest.described()}


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


def _contest(asked: Asked, records: Sequence[Kinematics], runs: Sequence[Run]) -> Contest:
    """Fit all laws to the runs, and let them compete.

    Raises NoLawError: no law comes near the record.
    """
    competitors = asked.competitors
    six, runs, sustained, doubt = law_fits.fit_runs(
        competitors.searched,
        runs,
        records,
        asked.jobs,
        asked.progress,
        asked.scheduler,
        custom=bool(competitors.formulas),
    )
    measured = measure(six, [run.motion for run in runs], asked.alpha)
    formulas = fit_formulas(competitors, measured.curve, six)
    direct = [fit for fit in six if fit.law in competitors.laws and competitors.by_kernel(fit.law)]
    lost = {fit.law: name_better_limit(fit, six) for fit in direct}
    fits = [*(fit for fit in direct if not lost[fit.law]), *formulas.fits]
    if doubt and not screening.comes_near(formulas.fits, runs):
        law_fits.refuse(doubt, records)
    if sustained:
        followed = {*lost, *(law for law in competitors.laws if not competitors.by_kernel(law))}
        lost |= {law: "its motion cannot be followed" for law in competitors.laws if law not in followed}
    missing = (*(unfitted(law, why) for law, why in lost.items() if why), *formulas.unfitted)
    if not any(competitors.asks(fit.law) for fit in fits):
        reasons = "; ".join(f"law {row.law}: {row.reason}" for row in missing if row.asked)
        where = ", ".join(record.recording.where for record in records)
        raise DataError(f"none of the requested laws can be fitted ({reasons})", where, "add laws, as --laws 1-6")
    competition = compete(fits, measured.noise, measured.judged, runs, asked.alpha, sustained=sustained)
    return Contest(asked, records, runs, measured, competition, missing, sustained, formulas.warnings)


def _revolution(records: Sequence[Kinematics]) -> float | None:
    """Return the encoder's travel per revolution, m, if the same in all runs, else None."""
    found = set()
    for record in records:
        pitch, counts = record.recording.rig.metres_per_count, record.recording.rig.counts_per_revolution
        found.add(None if pitch is None or counts is None else abs(pitch.value) * counts)
    return found.pop() if len(found) == 1 else None


def _log(contest: Contest, assessed: Assessment) -> None:
    for fit in contest.competition.fits:
        member = "in the set" if fit.law in contest.competition.members else "not in the set"
        logger.info("law %s: %.4g um rms, %s, %s, %.2f s", fit.law.name, 1e6 * fit.rms, fit.outcome, member, fit.cpu_s)
    logger.info("goodness of fit: %s", assessed.together.said)
