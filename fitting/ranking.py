"""`rank`: fits the laws to a smoothed record and says which it was, or which it cannot tell apart.

Evidence.  Residuals are correlated over tens of samples, so the unit is the cycle: its log error, paired over cycles
between laws.  A law pays for what it may adjust: (p/2n) log n in log error for p parameters and n cycles, and for the
strain it puts on the calibrations, spread over the cycles.

Set rule.  The winner has the smallest mean.  A law joins its set when the t-interval of its mean difference reaches
zero.  Inside the set a law is preferred to the winner only when it is nested in the winner (1 in 3 and 5, 2 in 4 and 6,
each jump law in its ramp law): then the winner's extra freedom bought nothing.
"""

import math
import time as clock
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from daq.errors import DataError, InputError
from daq.rig import Rig
from fitting import cycles as break_aways
from fitting import motion as frame
from fitting import trajectory, twin, uncertainty, verdict, windows
from fitting.motion import Array, Motion
from fitting.result import LawResult
from fitting.result import Ranking as Ranking
from fitting.trajectory import Fit
from fitting.windows import Cut
from processing.kinematics import Kinematics
from rig_sim.friction.law import LAWS

ALL_LAWS = (1, 2, 3, 4, 5, 6)
NESTED = {1: (), 2: (1,), 3: (1,), 4: (3, 2, 1), 5: (1,), 6: (5, 2, 1)}  # laws that are a limit of the key
FEWEST_CYCLES = 4
SUSTAINED = 0.15  # plateau fraction: below it the mass only grazes the belt
WORST_FIT = 0.05  # of a slip's length: a best law that errs by more describes something else
STUCK = 0.9  # a ramp law with next to no ramp that errs by so much less than its jump law found a better place
CONTENDER = 3.0  # times the best law's error: up to there a law is fitted to every sample, beyond to the thinned record
DRAG_BLOCKS = 8


@dataclass(frozen=True, eq=False)
class Evidence:
    """Paired evidence: log error of each unit for each law, penalty included; shapes (laws, units) and (laws,)."""

    laws: tuple[int, ...]
    penalised: Array


def rank(
    kinematics: Kinematics,
    rig: Rig | None = None,
    laws: Sequence[int] = ALL_LAWS,
    *,
    belt_speed: float | str | None = None,
    excluded: Sequence[int] = (),
    alpha: float = 0.05,
    progress: Callable[[float], None] | None = None,
) -> Ranking:
    """Fit the laws to a record and rank them.

    Parameters
    ----------
    kinematics : Kinematics
        The smoothed record (`processing.smooth`); plain differences are smoothed again, in memory.
    rig : Rig, optional
        Calibration; the recording's own by default.
    laws : sequence of int
        Which of the laws 1 to 6 compete.
    belt_speed : float or "channel", optional
        m/s, signed, when it is known better than the calibration knows it.  By default the belt's own counts are used
        where the run has any; "channel" asks for them.
    excluded : sequence of int
        Numbers of cycles to leave out (1 is the first break-away).
    alpha : float
        1 - confidence of the intervals and of the set rule.
    progress : callable, optional
        Called with the number of laws done.

    Returns
    -------
    Ranking

    Raises
    ------
    InputError
        For no or unknown laws, alpha outside (0, 1), a record in counts, or a belt speed of zero.
    DataError
        When the record shows no belt stick-slip, or fewer than four complete cycles.

    Notes
    -----
    A belt that slows under load looks like a ramp.  With the belt's own counts its give is measured and part of the
    flow; without, a ramp narrow enough to be such a belt brings its jump law into the set (`fitting.twin`).

    Not modelled: ripple of the belt's speed, friction that remembers.
    """
    begun = clock.process_time()
    laws = tuple(dict.fromkeys(laws))
    if not laws or any(law not in LAWS for law in laws):
        raise InputError(f"laws are {list(laws)}", "--laws", "choose from 1 to 6, such as 1-6 or 3,5")
    if not 0 < alpha < 1:
        raise InputError(f"alpha is {alpha}", "--alpha", "give a number between 0 and 1, such as 0.05")
    recording = kinematics.recording
    if kinematics.method == "fd":
        from processing.smoothing import smooth

        kinematics = smooth(recording, times=kinematics.times)
    rig = recording.rig if rig is None else rig
    motion = frame.of(kinematics, rig, belt_speed)
    cut = windows.cut(motion, frozenset(excluded))
    source = str(recording.source)
    sustained = cut.plateau_fraction >= SUSTAINED
    _check(cut, sustained, source)
    competing = laws if sustained else tuple(law for law in laws if law in (1, 2))
    if not competing:
        raise DataError(
            "no sustained stick: constant friction, and neither law 1 nor law 2 was to be fitted",
            source,
            "add --laws 1,2",
        )
    fits = _fit_all(competing, motion, cut, progress)
    if not fits or min(fit.rms for fit in fits) > WORST_FIT * _slip_length(motion, cut):
        raise DataError(
            "no belt stick-slip in this record: no law comes near it",
            source,
            "check the calibration and the belt speed, or look at it with 'process inspect'",
        )
    if not sustained and (cut.drag == (0, 0) or cut.cycles[0].flag):
        raise DataError(
            "no belt stick-slip in this record: a sine without a start-up; constant friction is possible",
            source,
            "record again from before the belt starts: the first drag tells law 1 from law 2",
        )
    penalised = np.array([_penalised(fit, _unit_errors(fit, motion, cut, sustained=sustained)) for fit in fits])
    chosen = choose(Evidence(tuple(fit.law for fit in fits), penalised), alpha)
    double = twin.of(fits, chosen.members, motion, cut)
    if double is not None:
        place, ramp = (next(i for i, fit in enumerate(fits) if fit.law == law) for law in (double.law, double.law + 1))
        errors = [_unit_errors(fit, motion, cut, sustained=sustained) for fit in (double, fits[ramp])]
        if twin.as_good(*errors):  # one observable, one piece of evidence
            fits[place], penalised[place] = double, penalised[ramp]
            chosen = choose(Evidence(tuple(fit.law for fit in fits), penalised), alpha)
    best = next(fit for fit in fits if fit.law == chosen.order[0])
    rows = tuple(
        _row(next(fit for fit in fits if fit.law == law), chosen, motion, alpha, penalised.shape[1])
        for law in chosen.order
    )
    words = verdict.sentence(rows, chosen.members, sustained=sustained, measured=motion.belt_measured)
    warnings = verdict.warnings(rows, chosen.members, motion, cut, kinematics, sustained=sustained)
    return Ranking(
        verdict=words,
        laws_in_set=chosen.members,
        rows=rows,
        events=break_aways.events(best, motion, cut),
        warnings=warnings,
        motion=motion,
        cut=cut,
        cpu_s=clock.process_time() - begun,
    )


def _fit_all(laws: Sequence[int], motion: Motion, cut: Cut, progress: Callable[[float], None] | None) -> list[Fit]:
    """Search every law on the thinned record, then polish on the whole one those that are anywhere near the best."""
    found: dict[int, Fit] = {}
    for done, law in enumerate(sorted(laws, key=lambda law: (LAWS[law].ramp, law))):
        fit = trajectory.search(law, motion, cut, found.get(law - 1) if LAWS[law].ramp else None)
        if fit is not None:
            found[law] = fit
        if progress is not None:
            progress(done + 1.0)
    for ramp in (law for law in found if LAWS[law].ramp and law - 1 in found):
        # A ramp can lead round an obstacle in which its jump law got stuck: from there the jump law tries again.
        narrow = found[ramp].u[trajectory.D] < trajectory.NARROW * motion.belt_speed
        if narrow and found[ramp].rms < STUCK * found[ramp - 1].rms:
            again = trajectory.search(ramp - 1, motion, cut, found[ramp])
            found[ramp - 1] = again if again is not None else found[ramp - 1]
    nearest = min((fit.rms for fit in found.values()), default=0.0)
    return [trajectory.polish(fit, motion, cut) if fit.rms < CONTENDER * nearest else fit for fit in found.values()]


def _check(cut: Cut, sustained: bool, source: str) -> None:
    """Raise DataError unless the record holds enough cycles of one kind or the other."""
    if not cut.cycles:
        raise DataError(
            "no belt stick-slip in this record: no slip between two sticks",
            source,
            "record several cycles with the belt running",
        )
    count = len(cut.used)
    if count < FEWEST_CYCLES:
        left = len(cut.cycles) - count
        out = f", {left} more left out" if left else ""
        raise DataError(
            f"{count} complete stick-slip cycle{'' if count == 1 else 's'}{out}; a verdict needs {FEWEST_CYCLES}",
            source,
            "record longer" if sustained or not left else "record longer, or exclude fewer cycles",
        )


def _slip_length(motion: Motion, cut: Cut) -> float:
    """Return the median distance covered in a slip window, m."""
    return float(np.median([np.ptp(motion.position[slice(*cycle.slip)]) for cycle in cut.used]))


def _log_error(residual: Array, motion: Motion) -> float:
    """Return the log of the rms, with the encoder's own error as the floor below which nothing is better."""
    return 0.5 * math.log(float(np.mean(residual**2)) + motion.resolution**2)


def _cycle_errors(fit: Fit, motion: Motion) -> Array:
    return np.array([_log_error(fit.residual[rows], motion) for rows in fit.rows])


def _unit_errors(fit: Fit, motion: Motion, cut: Cut, *, sustained: bool) -> Array:
    return _cycle_errors(fit, motion) if sustained else _drag_errors(fit, motion, cut.drag)


def _drag_errors(fit: Fit, motion: Motion, drag: tuple[int, int]) -> Array:
    """Return the log error of equal pieces of the start-up drag: the sine after it cannot tell law 1 from law 2."""
    _, riding, first, count, _ = fit.windows.table[0]
    if not riding or fit.cycles[0].stick != drag:
        raise RuntimeError("the first window is not the start-up drag")
    end = first + count
    return np.array([_log_error(part, motion) for part in np.array_split(fit.residual[first:end], DRAG_BLOCKS)])


def _penalised(fit: Fit, errors: Array) -> Array:
    n = errors.size
    return errors + (fit.free * math.log(n) + strain(fit)) / (2 * n)


def strain(fit: Fit) -> float:
    """Return what a fit pays for contradicting its calibrations, like a squared deviation where that is small.

    Student's t with 4 degrees of freedom: a calibration can be plainly wrong, and then must not decide alone.
    """
    return float(np.sum(5 * np.log1p(fit.deviations**2 / 4)))


@dataclass(frozen=True, eq=False)
class Choice:
    """Order of the laws, members of the set (best first), and score, weight and lag of each law."""

    order: tuple[int, ...]
    members: tuple[int, ...]
    score: dict[int, float]
    weight: dict[int, float]
    behind: dict[int, tuple[float, float]]


def choose(evidence: Evidence, alpha: float) -> Choice:
    """Apply the set rule to the evidence.

    Parameters
    ----------
    evidence : Evidence
        At least two units (cycles).
    alpha : float
        1 - confidence of the t-interval.
    """
    from scipy.stats import t as student

    laws, errors = evidence.laws, evidence.penalised
    n = errors.shape[1]
    mean = errors.mean(axis=1)
    winner = int(np.argmin(mean))
    quantile = float(student.ppf(1 - alpha / 2, n - 1))
    score = {law: float(2 * n * (mean[i] - mean[winner])) for i, law in enumerate(laws)}
    behind = {}
    for i, law in enumerate(laws):
        difference = errors[i] - errors[winner]
        half = quantile * float(np.std(difference, ddof=1)) / math.sqrt(n)
        behind[law] = (float(difference.mean()), half)
    members = [law for law in sorted(laws, key=score.__getitem__) if behind[law][0] - behind[law][1] <= 0]
    preferred = [law for law in members if law in NESTED[laws[winner]]]
    if preferred:
        first = preferred[0]
        members = [first, *(law for law in members if law != first)]
    others = [law for law in sorted(laws, key=score.__getitem__) if law not in members]
    total = sum(math.exp(-value / 2) for value in score.values())
    weight = {law: math.exp(-value / 2) / total for law, value in score.items()}
    return Choice((*members, *others), tuple(members), score, weight, behind)


def _row(fit: Fit, chosen: Choice, motion: Motion, alpha: float, units: int) -> LawResult:
    return LawResult(
        law=fit.law,
        name=LAWS[fit.law].name,
        score=chosen.score[fit.law],
        weight=chosen.weight[fit.law],
        in_set=fit.law in chosen.members,
        rms_m=fit.rms,
        cycles=len(fit.rows),
        parameters=uncertainty.parameters(fit, fit.precision, motion, alpha),
        cpu_s=fit.cpu_s,
        behind=chosen.behind[fit.law],
        fit=fit,
    )
