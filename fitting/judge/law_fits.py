"""Fits of the six laws to records divided into cycles, with the belt's ripple if there is one."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

from fitting import noise_levels
from fitting.judge import evidence, screening
from fitting.judge.adequacy import describes
from fitting.judge.parameters import remove_level_errors
from fitting.laws import SIX, Law
from fitting.model.problem import Run
from fitting.options import Options
from fitting.record import cycles, ripple
from fitting.record.motion import MeasuredMotion
from fitting.search import exchange
from fitting.search.fit import Fit
from processing.record.kinematics import Kinematics
from stickslip.errors import DataError, InputError

# Error in the start-up drag of a fit with a steady belt over that with a ripple: a larger ratio is a ripple.  A ripple
# of 2 % gives 1.5 to 79, three unnecessary parameters 1.2.
STEADY_DRAG_ERROR = 1.3
CONSTANT = (SIX[1], SIX[2])  # laws of constant friction: only with these the mass grazes the belt


class NoLawError(Exception):
    """No law fits the record; a result of `rank` if the record is stick-slip, else an error."""

    def __init__(self, reason: str, *, stick_slip: bool) -> None:
        super().__init__(reason)
        self.reason = reason
        self.stick_slip = stick_slip


def cut_run(motion: MeasuredMotion, excluded: frozenset[int]) -> Run:
    """Divide a record into cycles, with the belt's ripple removed where the mass sticks often."""
    cut = cycles.segment_cycles(motion, excluded)
    unknown_numbers = sorted(excluded - {cycle.number for cycle in cut.cycles})
    if unknown_numbers and cut.cycles:
        message = (
            f"cycle {', '.join(map(str, unknown_numbers[:5]))} does not exist: the run has {len(cut.cycles)} cycles"
        )
        raise InputError(message, "--exclude-cycles", f"use numbers from 1 to {len(cut.cycles)}")
    if len(excluded) == len(cut.cycles) >= noise_levels.FEWEST:
        message = f"all {len(cut.cycles)} cycles are excluded, but a verdict needs {noise_levels.FEWEST}"
        raise InputError(message, "--exclude-cycles", "exclude fewer cycles")
    run = Run(motion, cut)
    return _remove_ripple(run) if cut.sustained else run


def _remove_ripple(run: Run) -> Run:
    """Return a run with the ripple found in its sticks, if any, cut as on a steady belt."""
    wave = ripple.find_ripple(run.motion, run.cut)
    if wave is None:
        return run
    return replace(run, cut=cycles.segment_cycles(wave.remove_from(run.motion), _exclusions(run)), ripple=wave)


def _exclusions(run: Run) -> frozenset[int]:
    return frozenset(cycle.number for cycle in run.cut.cycles if cycle.flag == "excluded")


def fit_runs(
    options: Options,
    runs: Sequence[Run],
    records: Sequence[Kinematics],
    progress: Callable[[float], None] | None = None,
) -> tuple[list[Fit], list[Run], bool, str]:
    """Fit those of the six that may describe the records.

    Also returns their runs, whether the mass sticks repeatedly, and the reason to reject the records unless another law
    fits them: a record that none of the six fits roughly is rejected only if no custom law was requested.
    """
    laws = options.competitors.searched
    sustained = _check_cycles(laws, runs, records)
    record_sticks = sustained  # from the record alone, before any law is fitted
    doubt = screening.reject_by_coarse_fits(laws, runs, sustained=sustained)
    if not options.competitors.formulas or doubt == screening.SINE_ALONE:
        refuse(doubt, records)
    fit_to = partial(_fit_laws, jobs=options.jobs, progress=progress, scheduler=options.scheduler)
    if sustained:
        fits = fit_to(laws, runs)
    else:
        fits, runs, sustained = _fit_grazing(laws, runs, fit_to)
    fits = [fit for fit in fits if fit.law in laws]
    if not sustained and not fits:
        raise DataError(
            "without a sustained stick friction is constant, but neither law 1 nor law 2 was requested",
            records[0].recording.where,
            "add --laws 1,2",
        )
    # Residuals of a law that does not fit even roughly say nothing about missing frames.
    doubt = screening.reject_by_misfit(fits, runs, sustained=record_sticks) or doubt
    if not fits:
        refuse(doubt, records)
    if not doubt:
        screening.refuse_missing_frames(fits, records)
    if not record_sticks and not any(record.sticks for record in records) and not is_described(fits, runs):
        refuse(screening.NOT_DESCRIBED, records)
    if not sustained and not any(run.cut.uses_start for run in runs):
        refuse(screening.SINE_ALONE, records)
    return fits, list(runs), sustained, doubt


def _fit_laws(
    laws: Sequence[Law], runs: Sequence[Run], among: Sequence[Law] = tuple(SIX.values()), **how: Any
) -> list[Fit]:
    return [remove_level_errors(fit) for fit in exchange.fit_laws(laws, runs, among, **how)]


def is_described(fits: Sequence[Fit], runs: Sequence[Run]) -> bool:
    return describes([min(fits, key=lambda fit: fit.geometric_mean_rms)], [run.motion for run in runs])


def _fit_grazing(
    laws: Sequence[Law], steady_runs: Sequence[Run], fit_to: Callable[..., list[Fit]]
) -> tuple[list[Fit], Sequence[Run], bool]:
    """Fit the laws to a mass that grazes the belt; also return the runs and whether the mass sticks repeatedly.

    Short apparent sticks may be the tops of a sine, so a ripple is tried first only if the start-up drag contains one.
    Laws with sticks are tried if constant friction does not fit the record.
    """
    attempts = [(fit_to(CONSTANT, steady_runs, CONSTANT), steady_runs)]
    rippled_runs = [_remove_ripple(run) for run in steady_runs]
    if any(run.ripple is not None for run in rippled_runs):
        attempts.append((fit_to(CONSTANT, rippled_runs, CONSTANT), rippled_runs))
        steady_error, ripple_error = (evidence.drag_error(*attempt) for attempt in attempts)
        if steady_error > STEADY_DRAG_ERROR * ripple_error:
            attempts.reverse()
    for fits, runs in attempts:
        if not _rejects_constant_friction(fits, runs):
            return fits, runs, False
    rejected = []
    for _, choice in attempts:
        fits = fit_to(laws, choice)
        if fits and is_described(fits, choice):
            return fits, choice, True
        rejected.append((min((fit.geometric_mean_rms for fit in fits), default=math.inf), fits, choice))
    _, fits, runs = min(rejected, key=lambda attempt: attempt[0])
    return fits, runs, True


def _rejects_constant_friction(fits: Sequence[Fit], runs: Sequence[Run]) -> bool:
    """Return whether the residuals of laws 1 and 2 exceed the noise, on a motion without sustained sticks."""
    if not fits or evidence.rules_out_constant_friction(fits, runs):
        return True
    # A record that may be a sine is rejected elsewhere; for several runs the drags of all decide.
    alone = len(runs) == 1 and runs[0].cut.uses_start
    return alone and not describes(fits, [run.motion for run in runs])


def _check_cycles(laws: Sequence[Law], runs: Sequence[Run], records: Sequence[Kinematics]) -> bool:
    """Return whether the mass sticks repeatedly; DataError unless there are enough cycles of one kind."""
    kinds = [run.cut.sustained for run in runs]
    sustained = all(kinds)
    for run, record in zip(runs, records, strict=True):
        refuse(screening.reject_by_cycles(run.motion, run.cut), [record])
    sources = [record.recording.where for record in records]
    if any(kinds) and not sustained:
        grazing = ", ".join(source for source, kind in zip(sources, kinds, strict=True) if not kind)
        raise DataError(
            "this run has no sustained stick, but other runs have",
            grazing,
            "fit runs of one contact only, or fit this run separately",
        )
    count = sum(len(run.cut.used) for run in runs)
    if count < noise_levels.FEWEST:
        if not any(run.cut.starts_at_rest or record.sticks for run, record in zip(runs, records, strict=True)):
            refuse(f"it has {count} complete swing{'' if count == 1 else 's'}, but no stick", records)
        if count:  # recording longer would not help if this is not stick-slip
            refuse(screening.reject_by_coarse_fits(laws, runs, sustained=sustained), records)
        excluded = sum(len(run.cut.cycles) for run in runs) - count
        out = f" ({excluded} more are excluded)" if excluded else ""
        raise DataError(
            f"the record has {count} complete stick-slip cycle{'' if count == 1 else 's'}{out}, but a verdict "
            f"needs {noise_levels.FEWEST}",
            ", ".join(sources),
            _remedy(runs, sustained=sustained),
        )
    for run, record in zip(runs, records, strict=True):
        if run.cut.shows_belt:
            screening.refuse_impossible_rest(run.motion, record)
    return sustained


def _remedy(runs: Sequence[Run], *, sustained: bool) -> str:
    if any(map(_exclusions, runs)):
        return "exclude fewer cycles (--exclude-cycles)"
    if not sustained and all(run.cut.starts_at_rest and screening.dies_away(run.motion.velocity) for run in runs):
        return (
            "the oscillation dies away after the belt starts, so a longer record does not help; record "
            "several starts of the belt and fit them jointly, or reduce the damping"
        )
    return "record longer"


def refuse(why: str, records: Sequence[Kinematics]) -> None:
    """Raise NoLawError unless the reason is empty."""
    if why:
        stick_slip = why != screening.SINE_ALONE and all(screening.is_stick_slip(record) for record in records)
        raise NoLawError(why, stick_slip=stick_slip)
