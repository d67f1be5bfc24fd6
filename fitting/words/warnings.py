"""Warnings of a verdict, each a condition with its sentence."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

from daq.runfile.rest_position import question_rest_position
from fitting.judge.adequacy import Adequacy
from fitting.model.problem import NARROWEST_RAMP
from fitting.model.unknowns import Global
from fitting.result import Ranking

POOR_ERROR = 0.003  # error over the motion's range: five times what 12 % scatter, ripple and jitter leave over


def warnings(run: Ranking, others: Sequence[str], together: Adequacy) -> tuple[str, ...]:
    """Return one run's warnings, the weightiest first; ``others`` are of its laws, ``together`` of all runs."""
    findings = [finding.text for finding in run.findings]
    doubts = (*_of_fit(run), *others, *_of_calibration(run), *_of_ramp(run), *level_of_curve(together))
    return (*findings, *doubts, *_of_cycles(run), *not_judged(run.adequacy), *_of_belt(run))


def _percent(run: Ranking, name: str) -> str:
    return f"{100 * run.best.parameters[name].value / run.motion.belt_speed:.2g} %"


def _of_fit(run: Ranking) -> Iterator[str]:
    motion, fit = run.motion, run.best.fit
    if fit.misfit > POOR_ERROR * motion.travel:
        yield (
            f"no law fits well: the typical error of the best one is {100 * fit.misfit / motion.travel:.2g} % of the "
            "motion"
        )
    failed = [row.law for row in run.rows if row.asked and row.fit.outcome not in ("converged", "step limit")]
    if failed:
        yield f"the fit of law {', '.join(map(str, failed))} did not converge: its error is an upper bound"
    if not run.sustained:
        yield (
            "no sustained stick: Fs is the friction level of the one drag at the start-up; its interval excludes "
            "the scatter of levels between break-aways, nor that of v_dr the belt's varying speed"
        )
    if not run.sustained and not run.cut.shows_belt:
        yield (
            "the drag at the start-up is too short to show the belt's speed or a ramp: without a calibration v_dr is "
            "the highest sustained velocity, with an error of 100 %"
        )


def _of_ramp(run: Ranking) -> Iterator[str]:
    if not run.motion.belt_measured and any(row.fit.problem.ramp for row in run.rows if row.in_set):
        yield (
            "a ramp and a belt that slows under load look the same: laws 2, 4, 6 may be laws 1, 3, 5 on such a belt. "
            "Measure the belt's speed"
        )
    width = _hidden_ramp(run)
    if width is not None:
        yield f"a ramp narrower than {1e3 * width:.2g} mm/s (law {int(run.best.law) + 1}) would look the same"


def _of_calibration(run: Ranking) -> Iterator[str]:
    motion, parameters = run.motion, run.best.parameters
    if motion.datum_prior is None:
        yield (
            "rest position x0 not given, so it was fitted: for laws 1 and 3 only x0 + Fs/k is then known. "
            'Give --x0 "60 mm +- 0.1 mm"'
        )
    else:
        stated = replace(motion.datum_prior, value=motion.sign * motion.datum_prior.value)
        ends = motion.sign * motion.measured.min(), motion.sign * motion.measured.max()
        if question := question_rest_position(stated, float(min(ends)), float(max(ends))):
            yield question
    fixed = any(name in parameters and parameters[name].fixed for name in ("c/m", "c"))
    if (motion.damping_prior is None or motion.per_mass) and not fixed:
        yield (
            "damping not given: assumed 0 +- 1 % of critical, so laws 3 and 4 determine only G_slip - c. "
            'Measure it with daq calibrate, or give --damping "0.02 +- 0.001" and --mass'
        )
    if motion.per_mass:
        yield "no mass: forces are per kilogram. Give --mass or --stiffness for newtons"


def _of_cycles(run: Ranking) -> Iterator[str]:
    omitted = [cycle for cycle in run.cut.cycles if cycle.flag not in ("", "excluded", "surplus")]  # not by the user
    if omitted:
        yield f"cycles left out: {', '.join(f'{cycle.number} ({cycle.flag})' for cycle in omitted)}"
    if more := run.cut.surplus:
        used = len(run.cut.used)
        yield f"{used} of {used + more} cycles are fitted, evenly spread (--from and --to select others)"
    if lost := run.records[0].lost_counts:
        yield f"counts seem to be lost at {lost} sample(s): the fit corrects them"


def _of_belt(run: Ranking) -> Iterator[str]:
    motion, parameters = run.motion, run.best.parameters
    if motion.compliance is not None:
        yield f"the belt slows under load, by {_percent(run, 'droop')} at Fs: measured, part of every law"
    if "ripple" in parameters:
        yield (
            f"the belt's speed varies by {_percent(run, 'ripple')} at {parameters['ripple_hz'].value:.3g} Hz: detected "
            "in the sticks, included in every law"
        )
    elif motion.speed_variation > 0:
        yield (
            f"the measured belt speed varies by {100 * motion.speed_variation / motion.belt_speed:.2g} % rms apart "
            "from load: the fit assumes it constant"
        )


def _hidden_ramp(side: Ranking) -> float | None:
    """Return the width (m/s) below which the best law may have a hidden ramp; None where not tested."""
    jump = side.best.fit.law
    if not jump.has_kernel or jump.ramp or not side.sustained:
        return None
    row = next((row for row in side.rows if row.fit.law.is_ramp_of(jump)), None)
    if row is None or row.in_set or "d" not in row.parameters or row.parameters["d"].fixed:
        return None
    near = row.rms_m < 1.05 * side.best.rms_m
    seen = row.fit.u[Global.D] > 10 * NARROWEST_RAMP * side.motion.belt_speed
    return row.parameters["d"].hi if near and seen else None


def not_judged(adequacy: Adequacy) -> tuple[str, ...]:
    """Warn of what the goodness of fit does not judge: some cycles, or the whole record."""
    goodness = adequacy.goodness
    if goodness is None:
        return ()
    if not goodness.judged:
        return ("goodness of fit not judged: too few slips, or noise that repeats exactly",)
    if not goodness.left_out:
        return ()
    listed = ", ".join(map(str, goodness.left_out))
    several = len(goodness.left_out) > 1
    omitted, pronoun = (f"cycles {listed} are", "they contain") if several else (f"cycle {listed} is", "it contains")
    return (f"{omitted} left out of the goodness-of-fit test: {pronoun} a velocity step (belt joint?)",)


def level_of_curve(adequacy: Adequacy) -> tuple[str, ...]:
    """Warn where the record does not determine the level of the measured curve."""
    curve = adequacy.curve
    if curve is None or curve.level_known:
        return ()
    if curve.level_assumed:
        return (
            "the level of the measured curve assumes that the spring is relaxed where the record begins at rest, or at "
            "the lowest position; its band contains every level. Give --x0 with its error",
        )
    return (
        "the level of the measured curve is hardly determined, only differences of friction. Give --x0 with its error",
    )


def merge_warnings(warned: Sequence[Sequence[str]], names: Sequence[str]) -> tuple[str, ...]:
    """Return the warnings of several runs, each once, after the names of its files unless all have it."""
    files: dict[str, list[str]] = {}
    for name, texts in zip(names, warned, strict=True):
        for text in dict.fromkeys(texts):
            files.setdefault(text, []).append(name)
    return tuple(text if len(of) == len(names) else f"{', '.join(of)}: {text}" for text, of in files.items())
