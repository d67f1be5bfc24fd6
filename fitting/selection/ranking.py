"""`rank`: fits the laws to a smoothed record and ranks them; returns one, or the set that cannot be distinguished.

What is evidence and who is in the set: `fitting.selection.evidence`.
"""

import logging
import time as clock
from collections.abc import Callable, Sequence

from daq.base.measured import Measured
from daq.runfile.rig import Rig
from fitting.adequacy.assess import Assessment, assess
from fitting.data import frame
from fitting.estimation.fit import Fit
from fitting.model.problem import Run
from fitting.selection import answer, candidates, rivals, screening
from fitting.selection.answer import Decision
from fitting.selection.asked import ALL_LAWS, Asked
from fitting.selection.evidence import ModelSet
from fitting.selection.judgement import judge
from fitting.selection.result import Ranking as Ranking
from processing.record.kinematics import Kinematics

logger = logging.getLogger(__name__)


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
    asked = Asked(tuple(dict.fromkeys(laws)), belt_speed, tuple(excluded), alpha, jobs, progress, scheduler)
    records = [_smoothed(one) for one in ([kinematics] if isinstance(kinematics, Kinematics) else kinematics)]
    asked.check_together(records)
    runs = _cut(records, rig, asked)
    try:
        fits, runs, sustained = candidates.fit_runs(asked.laws, runs, records, jobs, progress, scheduler)
    except candidates.NoLawError as refused:
        return answer.without_law(refused.reason, asked, runs, records, begun)
    fits, chosen = judge(fits, runs, alpha, sustained=sustained)
    assessed = _assessed(fits, chosen, asked, runs, records)
    competition = _with_rivals(fits, chosen, assessed, runs, alpha) if sustained else None
    decision = Decision.of(asked, records, runs, fits, chosen, assessed, competition, sustained=sustained)
    _log(decision)
    return answer.ranking(decision, begun)


def _smoothed(kinematics: Kinematics) -> Kinematics:
    """Return the record smoothed well enough to start from."""
    if kinematics.method != "fd":
        return kinematics
    from processing.smoothing import smooth

    return smooth(kinematics.recording, times=kinematics.times)


def _cut(records: Sequence[Kinematics], rig: Rig | Sequence[Rig] | None, asked: Asked) -> list[Run]:
    """Return each record in the fit's frame, cut into cycles."""
    for record in records:
        screening.refuse_wrong_times(record)
    rigs = [None] * len(records) if rig is None else [rig] * len(records) if isinstance(rig, Rig) else rig
    runs = []
    for record, known in zip(records, rigs, strict=True):
        motion = frame.from_kinematics(record, record.recording.rig if known is None else known, asked.belt_speed)
        screening.refuse_few_samples(motion, record)
        runs.append(candidates.cut_run(motion, frozenset(asked.excluded)))
        found = runs[-1].cut
        logger.info("%s: %d cycles, %d to fit", record.recording.name, len(found.cycles), len(found.used))
    return runs


def _assessed(
    fits: Sequence[Fit], chosen: ModelSet, asked: Asked, runs: Sequence[Run], records: Sequence[Kinematics]
) -> Assessment:
    """Return whether a law of the set describes the runs, and the friction curve without a law."""
    ordered = [next(fit for fit in fits if fit.law == law) for law in chosen.order]
    motions = [run.motion for run in runs]
    return assess(ordered, chosen.members, motions, len(asked.laws), asked.alpha, _revolution(records))


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


def _log(decision: Decision) -> None:
    for fit in decision.fits:
        member = "in the set" if fit.law in decision.chosen.members else "not in the set"
        logger.info("law %d: %.4g um rms, %s, %s, %.2f s", fit.law, 1e6 * fit.rms, fit.outcome, member, fit.cpu_s)
    logger.info("goodness of fit: %s", decision.assessed.together.said)
