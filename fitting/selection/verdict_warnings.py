"""Warnings of a verdict: a table of conditions, each with its sentence."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

from daq.runfile.rest_position import question_rest_position
from fitting.adequacy.result import Adequacy
from fitting.model.parameters import Global
from fitting.model.problem import NARROWEST_RAMP
from fitting.selection.result import Ranking

POOR_ERROR = 0.003  # error over the motion's range: five times what 12 % scatter, ripple and jitter leave over


def _has_ramp(side: Ranking) -> bool:
    return any(row.fit.problem.ramp for row in side.rows if row.in_set)


def _ripples(side: Ranking) -> bool:
    return "ripple" in side.best.parameters


def _is_fixed(side: Ranking, *names: str) -> bool:
    return any(name in side.best.parameters and side.best.parameters[name].fixed for name in names)


def _percent_of_belt(side: Ranking, speed: float) -> str:
    return f"{100 * speed / side.motion.belt_speed:.2g} %"


def _percent_of_travel(side: Ranking) -> str:
    return f"{100 * side.best.fit.misfit / side.motion.travel:.2g} %"


def _question_rest(side: Ranking) -> str:
    """Return the question about a stated rest position, or ""."""
    rest, place = side.motion.datum_prior, side.motion.sign * side.motion.measured
    if rest is None:
        return ""
    stated = replace(rest, value=side.motion.sign * rest.value)
    return question_rest_position(stated, float(place.min()), float(place.max()))


def _left_out(side: Ranking) -> str:
    """Return the omitted cycles, each with its reason, without those that the user excluded."""
    left = (cycle for cycle in side.cut.cycles if cycle.flag and cycle.flag not in ("excluded", "surplus"))
    return ", ".join(f"{cycle.number} ({cycle.flag})" for cycle in left)


def _unfinished(side: Ranking) -> str:
    """Return the laws whose fits did not converge."""
    stuck = (row.law for row in side.rows if row.asked and row.fit.outcome not in ("converged", "step limit"))
    return ", ".join(map(str, stuck))


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


class Warned(NamedTuple):
    """A warning: its condition and its text."""

    when: Callable[[Ranking], object]
    says: Callable[[Ranking], str]


OF_THE_FIT = (
    Warned(
        lambda run: run.best.fit.misfit > POOR_ERROR * run.motion.travel,
        lambda run: (
            f"no law fits well: the typical error of the best one is {_percent_of_travel(run)} of the motion, "
            "so the friction may follow none of the six"
        ),
    ),
    Warned(
        lambda run: not run.sustained,
        lambda _: (
            "no sustained stick: Fs is the friction level of the one drag at the start-up; its interval leaves out how "
            "far levels differ from one break-away to the next, and that of v_dr how the belt's speed varies"
        ),
    ),
    Warned(
        lambda run: not run.sustained and not run.cut.shows_belt,
        lambda _: (
            "the drag at the start-up is too short to show the belt's speed or a ramp: without a calibration v_dr is "
            "the highest sustained velocity, with an error of 100 %"
        ),
    ),
    Warned(
        lambda run: _has_ramp(run) and not run.motion.belt_measured,
        lambda _: (
            "a ramp and a belt that slows under load look the same: without a belt-speed channel laws 2, 4, 6 "
            "may be laws 1, 3, 5 on such a belt"
        ),
    ),
    Warned(
        lambda run: run.motion.compliance is not None,
        lambda run: (
            f"the belt slows under load, by {_percent_of_belt(run, run.best.parameters['droop'].value)} at Fs: "
            "measured by its encoder, part of every law"
        ),
    ),
    Warned(
        _ripples,
        lambda run: (
            f"the belt's speed varies by {_percent_of_belt(run, run.best.parameters['ripple'].value)} at "
            f"{run.best.parameters['ripple_hz'].value:.3g} Hz: detected in the sticks, included in every law"
        ),
    ),
    Warned(
        lambda run: not _ripples(run) and run.motion.speed_variation > 0,
        lambda run: (
            f"the measured belt speed varies by {_percent_of_belt(run, run.motion.speed_variation)} rms apart from "
            "load: the fit assumes it steady"
        ),
    ),
    Warned(
        lambda run: run.motion.datum_prior is None,
        lambda _: (
            "no x0: the spring's rest position was also fitted; laws 1 and 3 then determine only x0 + Fs/k "
            '(give --x0, as in --x0 "60 mm +- 0.1 mm")'
        ),
    ),
    Warned(_question_rest, _question_rest),
    Warned(
        lambda run: (run.motion.damping_prior is None or run.motion.per_mass) and not _is_fixed(run, "c/m", "c"),
        lambda _: (
            "no damping calibration: c assumed 0 +- 1 % of critical; laws 3 and 4 then determine only G_slip - c "
            "(give --damping and --damping-sd with --mass)"
        ),
    ),
    Warned(
        lambda run: run.motion.per_mass,
        lambda _: "no mass: forces are given per kilogram (give --mass or --stiffness for newtons)",
    ),
)
OF_THE_RECORD = (  # after the findings
    Warned(_left_out, lambda run: f"cycles left out: {_left_out(run)}"),
    Warned(
        lambda run: run.cut.surplus,
        lambda run: (
            f"{len(run.cut.used)} of {len(run.cut.used) + run.cut.surplus} cycles are fitted, evenly spread over the "
            "record (fit parts with --from and --to for the others)"
        ),
    ),
    Warned(
        lambda run: run.records[0].lost_counts,
        lambda run: f"counts seem to be lost at {run.records[0].lost_counts} sample(s): the fit has them put back",
    ),
    Warned(
        _unfinished,
        lambda run: f"the fit of law {_unfinished(run)} did not converge: its error is an upper bound",
    ),
    Warned(
        lambda run: _hidden_ramp(run) is not None,
        lambda run: f"a ramp narrower than {_hidden_ramp(run):.2g} m/s cannot be excluded",
    ),
)


def warnings(run: Ranking, others: Sequence[str], together: Adequacy) -> tuple[str, ...]:
    """Return the warnings of one run's side, with ``others`` of its laws; ``together`` is known of all runs."""
    of_fit, of_record = ([one.says(run) for one in table if one.when(run)] for table in (OF_THE_FIT, OF_THE_RECORD))
    findings = [finding.text for finding in run.findings]
    return (*of_fit, *findings, *of_record, *others, *not_judged(run.adequacy), *level_of_curve(together))


def not_judged(adequacy: Adequacy) -> tuple[str, ...]:
    """Return the warnings of what the goodness of fit does not judge: some cycles, or the whole record."""
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
    """Return the warning that the record does not determine the level of the measured curve, if so."""
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
