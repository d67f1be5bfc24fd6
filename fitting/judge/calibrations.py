"""The user's values in the units of the fit, and calibrations that the data contradict.

The fit is per unit mass, and its belt runs forward: values in newtons are divided by the mass, and a belt speed or a
position gets the sign of the run's belt.

A calibration is contradicted only if a law describes the record without it and no law describes the record with it.
A law that describes the record but is far from a calibration is fitted again without it.  Runs are of several contacts
if no law describes them together and one law describes each separately, with different parameters.
"""

import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from typing import Any

from daq.runfile.rig import Rig
from fitting import noise_levels
from fitting.judge.parameters import RUN_PARAMETERS, Parameter
from fitting.laws import PER_MASS, Competitors, Given, Law
from fitting.model.problem import Run, UserValue
from fitting.model.unknowns import Global
from fitting.record.motion import MeasuredMotion
from processing.record.kinematics import Kinematics
from processing.record.motion import Finding
from stickslip.errors import InputError
from stickslip.units import Measured, with_error

UNKNOWNS = {
    "k": Global.K,
    "Fs": Global.LOG_F,
    "gamma": Global.SHAPE,
    "d": Global.D,
    "static": Global.STATIC,
    "v_dr": Global.V_DR,
    "x0": Global.DATUM,
    "c": Global.DAMPING,
}
IN_NEWTONS, SIGNED = ("k", "Fs", "c"), ("v_dr", "x0")


def apply_user_values(runs: Sequence[Run], competitors: Competitors) -> list[Run]:
    """Return the runs with the user's values; InputError for a belt speed of several, or newtons without mass."""
    of_laws = {
        law.name: {
            name: values
            for name, values in competitors.of_law(law).items()
            if law.number or name.removesuffix(PER_MASS) not in law.parameters
        }
        for law in competitors.laws
    }
    if len(runs) > 1 and any("v_dr" in values for values in of_laws.values()):
        raise InputError(
            "a joint fit does not accept one belt speed for all runs",
            "v_dr",
            "omit it: a belt speed is fitted for each run",
        )
    mass = runs[0].motion
    if competitors.in_newtons and mass.mass is None and mass.stiffness is None:
        name = competitors.in_newtons[0]
        raise InputError(f"{name} has a unit that contains newtons, but the mass is not known", name, "add --mass")
    return [
        replace(
            run, user_values={law: _convert(values, run.motion.sign, mass) for law, values in of_laws.items() if values}
        )
        for run in runs
    ]


def apply_to_formula(law: Law, values: Mapping[str, Given], motion: MeasuredMotion) -> Law:
    """Return a law with the user's values of its formula's parameters, per unit mass."""
    fix, bounds, start = {}, {}, {}
    for name, value in values.items():
        plain = name.removesuffix(PER_MASS)
        if plain not in law.parameters:
            continue
        power = 0 if name.endswith(PER_MASS) else law.mass_power(plain)
        factor = _newtons(plain, motion) ** -power if power else 1.0
        if value.fixed:
            fix[plain] = factor * value.low
            continue
        ends = zip((value.low, value.high), (law.bounds or {}).get(plain, (None, None)), strict=True)
        low, high = (before if math.isinf(end) else factor * end for end, before in ends)
        bounds[plain] = low, high
        if value.start is not None:
            start[plain] = factor * value.start
    return law.given(fix, bounds, start)


def _convert(values: Mapping[str, Given], sign: float, motion: MeasuredMotion) -> tuple[UserValue, ...]:
    unknowns = []
    for name, value in values.items():
        slot = UNKNOWNS.get(name.removesuffix(PER_MASS))
        if slot is None:
            continue
        factor = 1.0 / _newtons(name, motion) if name in IN_NEWTONS else 1.0
        factor *= sign if name in SIGNED else 1.0
        ends = [
            None if end is None else _to_unknown(slot, factor * end) for end in (value.low, value.high, value.start)
        ]
        low, high = sorted((ends[0], ends[1]))  # type: ignore[type-var]
        unknowns.append(UserValue(slot, float(low), float(high), ends[2]))  # type: ignore[arg-type]
    return tuple(unknowns)


def _to_unknown(slot: Global, value: float) -> float:
    if slot != Global.LOG_F:
        return value
    return math.log(value) if value > 0 else -math.inf


def _newtons(name: str, motion: MeasuredMotion) -> float:
    """Return the factor from a value per unit mass to ``name``: the mass, or 1 where it is unknown."""
    if motion.mass is None and motion.stiffness is not None:
        do = f"give {name}{PER_MASS}, per unit mass, or --mass instead of --stiffness"
        raise InputError(
            f"{name} cannot be converted: with a stated stiffness the mass depends on k/m, which is fitted", name, do
        )
    return 1.0 if motion.mass is None else motion.mass.value


UNITS = {"belt-speed": "m/s", "datum": "m", "x0": "m", "damping": "N s/m", "stiffness": "N/m"}
LawParameters = Sequence[Mapping[str, Parameter]]  # parameters of a law that describes the runs, run by run
Refit = Callable[[Sequence[Run]], Sequence[LawParameters]]  # laws that describe runs with other calibrations


def find_contradictions(
    laws: Sequence[LawParameters], runs: Sequence[Run], records: Sequence[Kinematics], refit: Refit
) -> list[list[Finding]]:
    """Return the calibrations of each run that its record contradicts, in the record's signs and SI units.

    ``laws`` are the laws that describe the runs; ``records`` have the calibration of the positions.
    """
    contradictions = _compare_runs(laws, runs, records)
    doubted_codes = {finding.code for findings in contradictions for finding in findings} if laws else set(UNITS)
    free_runs = [_free_calibrations(run, doubted_codes) for run in runs]
    if all(freed is run for freed, run in zip(free_runs, runs, strict=True)):
        return contradictions
    laws_without = refit(free_runs)
    contradictions_without = _compare_runs(laws_without, runs, records) if laws_without else [[] for _ in runs]
    return [[finding for finding in findings if finding.code in doubted_codes] for findings in contradictions_without]


def _free_calibrations(run: Run, codes: Collection[str]) -> Run:
    """Return a run without the calibrations of these codes; the run itself where it has none of them."""
    changes: dict[str, Any] = {}
    motion = run.motion
    if motion.datum_prior is not None and {"x0", "datum"} & set(codes):
        changes["datum_prior"] = None
    if motion.damping_prior is not None and "damping" in codes:
        changes["damping_prior"] = None
    if motion.belt_prior is not None and not motion.belt_measured and "belt-speed" in codes:
        changes["belt_prior"] = None
    return replace(run, motion=replace(motion, **changes)) if changes else run


def _compare_runs(
    laws: Sequence[LawParameters], runs: Sequence[Run], records: Sequence[Kinematics]
) -> list[list[Finding]]:
    """Return the calibrations of each run that contradict every law, with the values of the first law."""
    contradictions: list[list[Finding]] = []
    for number, (run, record) in enumerate(zip(runs, records, strict=True)):
        by_law = [
            [
                finding
                for finding in _compare(run.motion, parameters[number], record.recording.rig)
                if finding.sigmas > noise_levels.SHOWN
            ]
            for parameters in laws
        ]
        shared = set.intersection(*({finding.code for finding in findings} for findings in by_law)) if by_law else set()
        contradictions.append([finding for findings in by_law[:1] for finding in findings if finding.code in shared])
    return contradictions


def _compare(motion: MeasuredMotion, parameters: Mapping[str, Parameter], recorded: Rig) -> Iterator[Finding]:
    """Yield each calibration with its estimate from a law."""
    if motion.stated_speed is not None and not parameters["v_dr"].fixed:
        speed = parameters["v_dr"]
        error = math.hypot(speed.stderr, motion.length_error * speed.value)
        yield _make_finding("belt-speed", Measured(speed.value, error), with_error(motion.stated_speed))
    if motion.datum_prior is not None and "x0" in parameters and not parameters["x0"].fixed:
        measured = Measured(parameters["x0"].value, parameters["x0"].stderr)
        stated = replace(motion.datum_prior, value=motion.sign * motion.datum_prior.value)
        if motion.rest_stated_as == "datum":
            # The datum is the position of count zero, not of rest.
            measured, stated = (replace(rest, value=recorded.offset - rest.value) for rest in (measured, stated))
        yield _make_finding(motion.rest_stated_as, measured, stated)
    damping, ratio = parameters.get("c/m"), parameters["k/m"]
    mass = motion.mass.value if motion.mass else motion.stiffness.value / ratio.value if motion.stiffness else None
    if motion.damping_prior is not None and mass is not None and damping is not None and not damping.fixed:
        yield _make_finding("damping", Measured(mass * damping.value, mass * damping.stderr), motion.damping_prior)
    if motion.mass is not None and motion.stiffness is not None:
        given_mass = with_error(motion.mass)
        value = ratio.value * given_mass.value
        spread = value * math.hypot(ratio.stderr / ratio.value, given_mass.sd / given_mass.value)
        yield _make_finding("stiffness", Measured(value, spread), with_error(motion.stiffness))


def _make_finding(code: str, measured: Measured, stated: Measured) -> Finding:
    spread, unit = math.hypot(measured.sd, stated.sd), UNITS[code]
    sigmas = abs(measured.value - stated.value) / spread if spread > 0 else 0.0
    text = (
        f"{code.replace('-', ' ')}: the stated value, {stated.value:.4g} {unit}, differs from the fitted one, "
        f"{measured.value:.4g} +- {measured.sd:.2g} {unit}, by {sigmas:.3g} standard deviations. No law "
        "describes the record with the stated value"
    )
    return Finding(code, text, measured.value, stated.value, sigmas)


def find_other_contact(each: Sequence[Mapping[int | str, Mapping[str, Parameter]]]) -> Finding | None:
    """Return the parameter in which two runs differ most, if one law describes each separately (best law first)."""
    law = next((law for law in each[0] if all(law in laws for laws in each)), None)
    if law is None:
        return None
    distances = [
        (_distance(each[i][law][name], each[j][law][name]), name, i, j)
        for i, j in combinations(range(len(each)), 2)
        for name in each[i][law]
        if name in each[j][law] and name not in RUN_PARAMETERS
    ]
    sigmas, name, i, j = max(distances)
    if sigmas <= noise_levels.SHOWN:
        return None
    first, second = each[i][law][name], each[j][law][name]
    text = (
        f"these runs do not share one contact: law {law} describes each run separately, but with {name} = "
        f"{first.value:.4g} +- {first.stderr:.2g} {first.unit} in run {i + 1} and {second.value:.4g} +- "
        f"{second.stderr:.2g} {second.unit} in run {j + 1}"
    )
    return Finding("not-one-contact", text, second.value, first.value, sigmas)


def _distance(parameter: Parameter, other: Parameter) -> float:
    spread = math.hypot(parameter.stderr, other.stderr)
    return abs(parameter.value - other.value) / spread if spread > 0 else 0.0
