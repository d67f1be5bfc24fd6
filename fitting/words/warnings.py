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
    """Return one run's warnings, with ``others`` of its laws; ``together`` is of all runs."""
    findings = [finding.text for finding in run.findings]
    of_record = (*_of_record(run), *others, *not_judged(run.adequacy), *level_of_curve(together))
    return (*_of_fit(run), *findings, *of_record)


def _of_fit(run: Ranking) -> Iterator[str]:
    motion, fit, parameters = run.motion, run.best.fit, run.best.parameters

    def percent(name: str) -> str:
        return f"{100 * parameters[name].value / motion.belt_speed:.2g} %"

    if fit.misfit > POOR_ERROR * motion.travel:
        yield (
            f"no law fits well: the typical error of the best one is {100 * fit.misfit / motion.travel:.2g} % of the "
            "motion, so the friction may follow none of the six"
        )
    if not run.sustained:
        yield (
            "no sustained stick: Fs is the friction level of the one drag at the start-up; its interval leaves out how "
            "far levels differ from one break-away to the next, and that of v_dr how the belt's speed varies"
        )
    if not run.sustained and not run.cut.shows_belt:
        yield (
            "the drag at the start-up is too short to show the belt's speed or a ramp: without a calibration v_dr is "
            "the highest sustained velocity, with an error of 100 %"
        )
    if not motion.belt_measured and any(row.fit.problem.ramp for row in run.rows if row.in_set):
        yield (
            "a ramp and a belt that slows under load look the same: without a belt-speed channel laws 2, 4, 6 "
            "may be laws 1, 3, 5 on such a belt"
        )
    if motion.compliance is not None:
        yield (f"the belt slows under load, by {percent('droop')} at Fs: measured by its encoder, part of every law")
    if "ripple" in parameters:
        yield (
            f"the belt's speed varies by {percent('ripple')} at {parameters['ripple_hz'].value:.3g} Hz: detected in "
            "the sticks, included in every law"
        )
    elif motion.speed_variation > 0:
        yield (
            f"the measured belt speed varies by {100 * motion.speed_variation / motion.belt_speed:.2g} % rms apart "
            "from load: the fit assumes it steady"
        )
    if motion.datum_prior is None:
        yield (
            "no x0: the spring's rest position was also fitted; laws 1 and 3 then determine only x0 + Fs/k "
            '(give --x0, as in --x0 "60 mm +- 0.1 mm")'
        )
    else:
        stated = replace(motion.datum_prior, value=motion.sign * motion.datum_prior.value)
        ends = motion.sign * motion.measured.min(), motion.sign * motion.measured.max()
        if question := question_rest_position(stated, float(min(ends)), float(max(ends))):
            yield question
    fixed = any(name in parameters and parameters[name].fixed for name in ("c/m", "c"))
    if (motion.damping_prior is None or motion.per_mass) and not fixed:
        yield (
            "no damping calibration: c assumed 0 +- 1 % of critical; laws 3 and 4 then determine only G_slip - c "
            "(give --damping and --damping-sd with --mass)"
        )
    if motion.per_mass:
        yield "no mass: forces are given per kilogram (give --mass or --stiffness for newtons)"


def _of_record(run: Ranking) -> Iterator[str]:
    left = [cycle for cycle in run.cut.cycles if cycle.flag not in ("", "excluded", "surplus")]  # not by the user
    if left:
        yield f"cycles left out: {', '.join(f'{cycle.number} ({cycle.flag})' for cycle in left)}"
    if more := run.cut.surplus:
        used = len(run.cut.used)
        yield f"{used} of {used + more} cycles are fitted, evenly spread (--from and --to select others)"
    if lost := run.records[0].lost_counts:
        yield f"counts seem to be lost at {lost} sample(s): the fit has them put back"
    stuck = [row.law for row in run.rows if row.asked and row.fit.outcome not in ("converged", "step limit")]
    if stuck:
        yield f"the fit of law {', '.join(map(str, stuck))} did not converge: its error is an upper bound"
    width = _hidden_ramp(run)
    if width is not None:
        yield f"a ramp narrower than {width:.2g} m/s cannot be excluded"


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
    found = adequacy.goodness
    if found is None:
        return ()
    if not found.judged:
        return (
            "goodness of fit not judged: too few slips, or noise leaves the same in every repetition of the record",
        )
    if not found.left_out:
        return ()
    listed = ", ".join(map(str, found.left_out))
    return (f"cycles not judged: {listed} (a velocity step, as of the belt's joint, or another single disturbance)",)


def level_of_curve(adequacy: Adequacy) -> tuple[str, ...]:
    """Warn where the record does not determine the level of the measured curve."""
    curve = adequacy.curve
    if curve is None or curve.level_known:
        return ()
    if curve.level_assumed:
        return (
            "no x0, and friction levels that do not scatter: the record determines differences of friction alone. "
            "The measured curve assumes that the spring is relaxed where the record begins at rest, or at the lowest "
            "position; its band contains every level (give --x0 with its error)",
        )
    return (
        "the record hardly determines the level of the measured curve, only differences of friction (give --x0 with "
        "its error)",
    )


def merge_warnings(warned: Sequence[Sequence[str]], names: Sequence[str]) -> tuple[str, ...]:
    """Return the warnings of several runs: common ones once, others after the file's name."""
    common = [text for text in warned[0] if all(text in own for own in warned)]
    apart = ((name, text) for name, own in zip(names, warned, strict=True) for text in own if text not in common)
    return (*common, *(f"{name}: {text}" for name, text in apart))
