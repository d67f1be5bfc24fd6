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
            f"no law fits well: the typical error of the best law is {100 * fit.misfit / motion.travel:.2g} % "
            "of the travel"
        )
    failed = [row.law for row in run.rows if row.asked and row.fit.outcome not in ("converged", "step limit")]
    if failed:
        yield f"the fit of law {', '.join(map(str, failed))} did not converge: its error is an upper bound"
    if not run.sustained:
        yield (
            "without a sustained stick, only the drag at the start-up determines Fs. Its interval does not "
            "include the scatter between break-aways, and that of v_dr does not include variations of the "
            "belt speed"
        )
    if not run.sustained and not run.cut.shows_belt:
        yield (
            "the drag at the start-up is too short to determine the belt speed or a ramp. Without a stated "
            "belt speed, v_dr is the highest sustained velocity, with an error of 100 %"
        )


def _of_ramp(run: Ranking) -> Iterator[str]:
    if not run.motion.belt_measured and any(row.fit.problem.ramp for row in run.rows if row.in_set):
        yield (
            "a ramp and a belt that slows under load look the same: laws 2, 4 and 6 may be laws 1, 3 and 5 on "
            "such a belt. Measure the belt's speed"
        )
    width = _hidden_ramp(run)
    if width is not None:
        yield f"a ramp narrower than {1e3 * width:.2g} mm/s (law {int(run.best.law) + 1}) would look the same"


def _of_calibration(run: Ranking) -> Iterator[str]:
    motion, parameters = run.motion, run.best.parameters
    if motion.datum_prior is None:
        yield (
            "the rest position x0 was not given, so it was fitted. For laws 1 and 3 only x0 + Fs/k is then "
            'known. Give --x0 "60 mm +- 0.1 mm"'
        )
    else:
        stated = replace(motion.datum_prior, value=motion.sign * motion.datum_prior.value)
        ends = motion.sign * motion.measured.min(), motion.sign * motion.measured.max()
        if question := question_rest_position(stated, float(min(ends)), float(max(ends))):
            yield question
    fixed = any(name in parameters and parameters[name].fixed for name in ("c/m", "c"))
    if (motion.damping_prior is None or motion.per_mass) and not fixed:
        yield (
            "the damping was not given, so 0 +- 1 % of the critical damping is assumed. Laws 3 and 4 then "
            'determine only G_slip - c. Measure the damping with daq calibrate, or give --damping "0.02 +- '
            '0.001" and --mass'
        )
    if motion.per_mass:
        yield "the mass is not known, so forces are per kilogram. Give --mass or --stiffness to obtain newtons"


def _of_cycles(run: Ranking) -> Iterator[str]:
    omitted = [cycle for cycle in run.cut.cycles if cycle.flag not in ("", "excluded", "surplus")]  # not by the user
    if omitted:
        yield f"the fit excludes these cycles: {', '.join(f'{cycle.number} ({cycle.flag})' for cycle in omitted)}"
    if more := run.cut.surplus:
        used = len(run.cut.used)
        yield (
            f"{used} of {used + more} cycles, evenly spread over the record, are fitted. Select others with "
            "--from and --to"
        )
    if lost := run.records[0].lost_counts:
        yield f"counts seem to be missing at {lost} sample(s). The fit corrects for them"


def _of_belt(run: Ranking) -> Iterator[str]:
    motion, parameters = run.motion, run.best.parameters
    if motion.compliance is not None:
        yield (
            f"the measured belt speed decreases under load, by {_percent(run, 'droop')} at Fs. Every law includes "
            "this effect"
        )
    if "ripple" in parameters:
        yield (
            f"the belt's speed varies by {_percent(run, 'ripple')} at {parameters['ripple_hz'].value:.3g} Hz "
            "during the sticks. Every law includes this effect"
        )
    elif motion.speed_variation > 0:
        yield (
            f"the measured belt speed varies by {100 * motion.speed_variation / motion.belt_speed:.2g} % rms "
            "for reasons other than load, but the fit assumes a constant speed"
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
        return ("the goodness of fit was not judged: there are too few slips, or the noise repeats exactly",)
    if not goodness.left_out:
        return ()
    listed = ", ".join(map(str, goodness.left_out))
    several = len(goodness.left_out) > 1
    omitted, pronoun = (f"cycles {listed} are", "they contain") if several else (f"cycle {listed} is", "it contains")
    return (f"{omitted} excluded from the goodness-of-fit test because {pronoun} a velocity step (belt joint?)",)


def level_of_curve(adequacy: Adequacy) -> tuple[str, ...]:
    """Warn where the record does not determine the level of the measured curve."""
    curve = adequacy.curve
    if curve is None or curve.level_known:
        return ()
    if curve.level_assumed:
        return (
            "the level of the measured curve assumes that the spring is relaxed at the start of the record, "
            "or at the lowest position. Its band covers every possible level. Give --x0 with its error",
        )
    return (
        "the record determines differences of friction, but hardly the level of the measured curve. Give --x0 "
        "with its error",
    )


def merge_warnings(warned: Sequence[Sequence[str]], names: Sequence[str]) -> tuple[str, ...]:
    """Return the warnings of several runs, each once, after the names of its files unless all have it."""
    files: dict[str, list[str]] = {}
    for name, texts in zip(names, warned, strict=True):
        for text in dict.fromkeys(texts):
            files.setdefault(text, []).append(name)
    return tuple(text if len(of) == len(names) else f"{', '.join(of)}: {text}" for text, of in files.items())
