"""Contradictions between the stated rig and the record.

A calibration is a prior of the fit, so the fitted value lies between the two and hides the contradiction.  Each is
therefore compared with the estimate without the prior, by the best law (`fitting.estimation.covariance.without_prior`).
This is one Newton step, exact for a linear problem only; where no law holds, a correct damping may be contradicted.
There the laws are fitted again without the stated values.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

from daq.runfile.rig import Rig
from fitting.curve.formula_fit import FormulaFit
from fitting.data.frame import MeasuredMotion
from fitting.estimation.covariance import without_prior
from fitting.estimation.derived import derived_parameters
from fitting.estimation.fit import Fit
from fitting.estimation.result import Parameter
from fitting.model.parameters import PER_RUN, Global
from fitting.model.problem import Run
from fitting.selection import law_fits
from fitting.selection.asked import Asked
from processing.record.finding import Finding
from processing.record.kinematics import Kinematics
from rig_sim.friction.law import LAWS
from stickslip.errors import DataError
from stickslip.units import Measured, with_error

# Distance of a calibration from the fit, in standard deviations, that contradicts it.  At 3 one true calibration in 400
# would be reported, and as many again because an interval from 16 cycles is itself uncertain; at 5 a belt speed wrong
# by less than 5 % of its stated value would pass.
CONTRADICTED_BY = 4.0
UNITS = {"belt-speed": "m/s", "datum": "m", "x0": "m", "damping": "N s/m", "stiffness": "N/m"}


def find_contradictions(
    fit: Fit | FormulaFit,
    motions: Sequence[MeasuredMotion],
    parameters: Sequence[Mapping[str, Parameter]],
    records: Sequence[Kinematics],
    effect: str = "",
) -> list[list[Finding]]:
    """Return each run's calibrations that its record contradicts by more than `CONTRADICTED_BY` standard deviations.

    In the record's signs, SI units; ``records`` have the calibration that made their positions, ``effect`` is the
    consequence in words (by default which value the fit used).
    """
    return [
        _of_run(fit, motion, own, record.recording.rig, run, effect)
        for run, (motion, own, record) in enumerate(zip(motions, parameters, records, strict=False))
    ]


def _of_run(
    fit: Fit | FormulaFit,
    motion: MeasuredMotion,
    parameters: Mapping[str, Parameter],
    recorded: Rig,
    run: int,
    effect: str,
) -> list[Finding]:
    found = []
    for code, value, expected, used in _compared(fit, motion, parameters, recorded, run):
        unit = UNITS[code]
        spread = math.hypot(value.sd, expected.sd)
        sigmas = abs(value.value - expected.value) / spread if spread > 0 else 0.0
        if sigmas > CONTRADICTED_BY:
            text = (
                f"{code.replace('-', ' ')}: {expected.value:.4g} {unit} was stated, the record shows {value.value:.4g} "
                f"+- {value.sd:.2g} {unit} ({sigmas:.3g} standard deviations apart); {effect or f'the fit used {used}'}"
            )
            found.append(Finding(code, text, value.value, expected.value, sigmas))
    return found


def contradicted_by_all_laws(
    asked: Asked, runs: Sequence[Run], records: Sequence[Kinematics], effect: str
) -> list[list[Finding]]:
    """Return each run's rest position and damping that keep every law away from the runs.

    The laws are fitted without both; where the best then fits to within the noise, its values replace them. Empty where
    none fits.
    """
    nothing: list[list[Finding]] = [[] for _ in runs]
    if all(run.motion.datum_prior is None and run.motion.damping_prior is None for run in runs):
        return nothing
    free = [replace(run, motion=replace(run.motion, datum_prior=None, damping_prior=None)) for run in runs]
    try:
        found = law_fits.fit_runs(asked.competitors.searched, free, records, asked.jobs, None, asked.scheduler)
    except (law_fits.NoLawError, DataError):
        return nothing
    if not found.fits or not law_fits.is_described(found.fits, found.runs):
        return nothing
    best = min(found.fits, key=lambda fit: fit.geometric_mean_rms)
    parameters = [
        derived_parameters(best, run.motion, asked.alpha, number, sustained=found.sustained)
        for number, run in enumerate(free)
    ]
    return find_contradictions(best, [run.motion for run in runs], parameters, records, effect)


def without_those_of_the_law(
    contradicted: Sequence[Sequence[Finding]], rivals: Sequence[FormulaFit]
) -> list[list[Finding]]:
    """Return the contradictions without those of rest position or damping that a rival does not have.

    A wrong law moves the stated value to where its curve fits; a curve that fits as well without that shows no
    contradiction.
    """
    return [
        [one for one in own if not any(_agrees(fit, one.code, run) for fit in rivals)]
        for run, own in enumerate(contradicted)
    ]


def _agrees(fit: FormulaFit, code: str, run: int) -> bool:
    """Return whether a curve fits the record with a stated rest position or damping."""
    slot = {"datum": Global.DATUM, "x0": Global.DATUM, "damping": Global.DAMPING}.get(code)
    if slot is None:
        return False
    seen = fit.without_prior(slot, run)
    if seen is None:
        return True
    place, places, task = PER_RUN * run + slot, fit.places, fit.at.problem
    index = places.index(place if place in places else slot)
    spread = math.hypot(seen.sd, 1 / math.sqrt(float(task.precision[index])))
    return abs(seen.value - float(task.prior[index])) <= CONTRADICTED_BY * spread


def name_contradictions(verdict: str, contradicted: Sequence[Sequence[Finding]]) -> str:
    """Return a verdict with the calibrations that its law contradicts, each once."""
    clauses = {}
    for one in (one for own in contradicted for one in own):
        unit, name = UNITS[one.code], one.code.replace("-", " ")
        if one.code not in clauses:
            clauses[one.code] = f"{name} (stated {one.expected:.3g} {unit}, the record shows {one.value:.3g} {unit})"
    return f"{verdict}; it contradicts the stated {' and '.join(clauses.values())}" if clauses else verdict


def _compared(
    fit: Fit | FormulaFit, motion: MeasuredMotion, parameters: Mapping[str, Parameter], recorded: Rig, run: int
) -> Iterator[tuple[str, Measured, Measured, str]]:
    """Yield code, the record's value, the stated value, and which of them the fit used."""
    speed = None if motion.stated_speed is None else _seen(fit, Global.V_DR, run)
    if motion.stated_speed is not None and speed is not None:
        # Without sticks the belt's speed depends on the datum, which constant friction does not show.
        spread = parameters["v_dr"].stderr if _is_constant(fit) else 0.0
        error = math.hypot(max(speed.sd, spread), motion.length_error * speed.value)
        used = "the belt's counts" if motion.belt_measured else _used(motion.belt_prior)
        yield "belt-speed", Measured(motion.sign * speed.value, error), with_error(motion.stated_speed), used
    rest = None if motion.datum_prior is None or _is_constant(fit) else _seen(fit, Global.DATUM, run)
    if motion.datum_prior is not None and rest is not None:  # constant friction shows datum + Fs/k alone
        seen, stated = (Measured(motion.sign * one.value, one.sd) for one in (rest, motion.datum_prior))
        if motion.rest_stated_as == "datum":
            # Count zero's position, not the rest's.
            seen, stated = (Measured(recorded.offset - one.value, one.sd) for one in (seen, stated))
        yield motion.rest_stated_as, seen, stated, "both" if stated.sd > 0 else "the stated one"
    mass = motion.mass.value if motion.mass else motion.stiffness.value / fit.values.K if motion.stiffness else None
    damping = None if motion.damping_prior is None or mass is None else _seen(fit, Global.DAMPING, run)
    if motion.damping_prior is not None and mass is not None and damping is not None:
        stated = motion.damping_prior
        used = "both" if stated.sd > 0 else "the stated one"
        yield "damping", Measured(mass * damping.value, mass * damping.sd), stated, used
    if motion.mass is not None and motion.stiffness is not None:
        known, ratio = with_error(motion.mass), parameters["k/m"]
        value = ratio.value * known.value
        spread = value * math.hypot(ratio.stderr / ratio.value, known.sd / known.value)
        used = f"the mass of {known.value:.4g} kg and the record's k/m"
        yield "stiffness", Measured(value, spread), with_error(motion.stiffness), used


def _used(prior: Measured | None) -> str:
    """Return the use of a stated value in the fit: as a prior, as a first value, or not at all."""
    return "both" if prior is not None and prior.sd > 0 else "the record's"


def _seen(fit: Fit | FormulaFit, slot: Global, run: int) -> Measured | None:
    """Return a run's parameter as constrained by the record alone; None where fixed or unconstrained."""
    place = PER_RUN * run + slot
    if isinstance(fit, FormulaFit):
        return fit.without_prior(slot, run)
    return (
        None
        if fit.problem.held[place]
        else without_prior(fit, fit.active.index(place if place in fit.active else slot))
    )


def _is_constant(fit: Fit | FormulaFit) -> bool:
    return isinstance(fit, Fit) and LAWS[fit.law].curve == "constant"
