"""The stated rig: the user's values in the units of the fit, and contradictions between them and the record.

The fit is per unit mass, and its belt runs forward: values in newtons are divided by the mass, and a belt speed or a
position has the sign of the run's belt.

A calibration is contradicted only where a law that was fitted without it describes the record, and none does with it.
A law that describes the record with a calibration as a prior, but far from it, is fitted again without it.  Runs that
no law describes together are of several contacts where one law describes each of them alone, with other parameters.
"""

import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from typing import Any

from daq.runfile.rig import Rig
from fitting import noise_levels
from fitting.judge.parameters import RUNS_OWN, Parameter
from fitting.laws import PER_MASS, Competitors, Given, Law
from fitting.model.problem import GivenUnknown, Run
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


def with_given(runs: Sequence[Run], competitors: Competitors) -> list[Run]:
    """Return the runs with the user's values; InputError for a belt speed of several, or newtons without mass."""
    of_laws = {
        law.name: {
            name: given
            for name, given in competitors.of_law(law).items()
            if law.number or name.removesuffix(PER_MASS) not in law.parameters
        }
        for law in competitors.laws
    }
    if len(runs) > 1 and any("v_dr" in given for given in of_laws.values()):
        raise InputError("one belt speed for several runs", "v_dr", "leave it out: each run finds its own")
    mass = runs[0].motion
    if competitors.in_newtons and mass.mass is None and mass.stiffness is None:
        name = competitors.in_newtons[0]
        raise InputError(f"{name} has a unit with newtons, and the mass is not known", name, "give --mass as well")
    return [
        replace(run, given={law: _unknowns(given, run.motion.sign, mass) for law, given in of_laws.items() if given})
        for run in runs
    ]


def formula_given(law: Law, given: Mapping[str, Given], motion: MeasuredMotion) -> Law:
    """Return a law with the user's values of its formula's parameters, per unit mass."""
    fix, bounds, start = {}, {}, {}
    for name, own in given.items():
        plain = name.removesuffix(PER_MASS)
        if plain not in law.parameters:
            continue
        power = 0 if name.endswith(PER_MASS) else law.mass_power(plain)
        factor = _newtons(plain, motion) ** -power if power else 1.0
        if own.fixed:
            fix[plain] = factor * own.low
            continue
        ends = zip((own.low, own.high), (law.bounds or {}).get(plain, (None, None)), strict=True)
        low, high = (before if math.isinf(end) else factor * end for end, before in ends)
        bounds[plain] = low, high
        if own.start is not None:
            start[plain] = factor * own.start
    return law.given(fix, bounds, start)


def _unknowns(given: Mapping[str, Given], sign: float, motion: MeasuredMotion) -> tuple[GivenUnknown, ...]:
    found = []
    for name, own in given.items():
        slot = UNKNOWNS.get(name.removesuffix(PER_MASS))
        if slot is None:
            continue
        factor = 1.0 / _newtons(name, motion) if name in IN_NEWTONS else 1.0
        factor *= sign if name in SIGNED else 1.0
        values = [None if end is None else _in_units(slot, factor * end) for end in (own.low, own.high, own.start)]
        low, high = sorted((values[0], values[1]))  # type: ignore[type-var]
        found.append(GivenUnknown(slot, float(low), float(high), values[2]))  # type: ignore[arg-type]
    return tuple(found)


def _in_units(slot: Global, value: float) -> float:
    if slot != Global.LOG_F:
        return value
    return math.log(value) if value > 0 else -math.inf


def _newtons(name: str, motion: MeasuredMotion) -> float:
    """Return the factor from a value per unit mass to ``name``: the mass, or 1 where it is unknown."""
    if motion.mass is None and motion.stiffness is not None:
        do = f"give {name}{PER_MASS}, per unit mass, or --mass instead of --stiffness"
        raise InputError(f"{name} depends on k/m, which is fitted, where the stiffness is known", name, do)
    return 1.0 if motion.mass is None else motion.mass.value


UNITS = {"belt-speed": "m/s", "datum": "m", "x0": "m", "damping": "N s/m", "stiffness": "N/m"}
LawParameters = Sequence[Mapping[str, Parameter]]  # of a law that describes the runs, its parameters of each run
Refit = Callable[[Sequence[Run]], Sequence[LawParameters]]  # what describes runs with other calibrations


def find_contradictions(
    described: Sequence[LawParameters], runs: Sequence[Run], records: Sequence[Kinematics], refit: Refit
) -> list[list[Finding]]:
    """Return what of each run's calibration its record contradicts, in the record's own signs, SI units.

    ``described`` has the laws that describe the runs; ``records`` the calibration that the positions were made with.
    """
    found = _of_runs(described, runs, records)
    doubted = {one.code for own in found for one in own} if described else set(UNITS)
    free = [_without(run, doubted) for run in runs]
    if all(one is run for one, run in zip(free, runs, strict=True)):
        return found
    alone = refit(free)
    shown = _of_runs(alone, runs, records) if alone else [[] for _ in runs]
    return [[one for one in own if one.code in doubted] for own in shown]


def _without(run: Run, codes: Collection[str]) -> Run:
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


def _of_runs(
    described: Sequence[LawParameters], runs: Sequence[Run], records: Sequence[Kinematics]
) -> list[list[Finding]]:
    """Return the calibrations of each run that none of the laws agrees with, as the first law shows them."""
    found: list[list[Finding]] = []
    for number, (run, record) in enumerate(zip(runs, records, strict=True)):
        by_law = [
            [one for one in _compared(run.motion, own[number], record.recording.rig) if one.sigmas > noise_levels.SHOWN]
            for own in described
        ]
        shared = set.intersection(*({one.code for one in own} for own in by_law)) if by_law else set()
        found.append([one for own in by_law[:1] for one in own if one.code in shared])
    return found


def _compared(motion: MeasuredMotion, parameters: Mapping[str, Parameter], recorded: Rig) -> Iterator[Finding]:
    """Yield each calibration with what a law shows of it."""
    if motion.stated_speed is not None and not parameters["v_dr"].fixed:
        speed = parameters["v_dr"]
        error = math.hypot(speed.stderr, motion.length_error * speed.value)
        yield _finding("belt-speed", Measured(speed.value, error), with_error(motion.stated_speed))
    if motion.datum_prior is not None and "x0" in parameters and not parameters["x0"].fixed:
        seen = Measured(parameters["x0"].value, parameters["x0"].stderr)
        stated = replace(motion.datum_prior, value=motion.sign * motion.datum_prior.value)
        if motion.rest_stated_as == "datum":
            # Count zero's position, not the rest's.
            seen, stated = (replace(one, value=recorded.offset - one.value) for one in (seen, stated))
        yield _finding(motion.rest_stated_as, seen, stated)
    damping, ratio = parameters.get("c/m"), parameters["k/m"]
    mass = motion.mass.value if motion.mass else motion.stiffness.value / ratio.value if motion.stiffness else None
    if motion.damping_prior is not None and mass is not None and damping is not None and not damping.fixed:
        yield _finding("damping", Measured(mass * damping.value, mass * damping.stderr), motion.damping_prior)
    if motion.mass is not None and motion.stiffness is not None:
        known = with_error(motion.mass)
        value = ratio.value * known.value
        spread = value * math.hypot(ratio.stderr / ratio.value, known.sd / known.value)
        yield _finding("stiffness", Measured(value, spread), with_error(motion.stiffness))


def _finding(code: str, seen: Measured, stated: Measured) -> Finding:
    spread, unit = math.hypot(seen.sd, stated.sd), UNITS[code]
    sigmas = abs(seen.value - stated.value) / spread if spread > 0 else 0.0
    text = (
        f"{code.replace('-', ' ')}: {stated.value:.4g} {unit} was stated, the record shows {seen.value:.4g} "
        f"+- {seen.sd:.2g} {unit} ({sigmas:.3g} standard deviations apart); no law describes the record with the "
        "stated one"
    )
    return Finding(code, text, seen.value, stated.value, sigmas)


def find_other_contact(each: Sequence[Mapping[int | str, Mapping[str, Parameter]]]) -> Finding | None:
    """Return the parameter in which two runs differ most, where one law describes each alone (best law first)."""
    law = next((law for law in each[0] if all(law in laws for laws in each)), None)
    if law is None:
        return None
    found = [
        (_distance(each[one][law][name], each[other][law][name]), name, one, other)
        for one, other in combinations(range(len(each)), 2)
        for name in each[one][law]
        if name in each[other][law] and name not in RUNS_OWN
    ]
    sigmas, name, one, other = max(found)
    if sigmas <= noise_levels.SHOWN:
        return None
    first, second = each[one][law][name], each[other][law][name]
    text = (
        f"these runs are not one contact: law {law} describes each of them alone, with {name} = {first.value:.4g} +- "
        f"{first.stderr:.2g} {first.unit} in run {one + 1} and {second.value:.4g} +- {second.stderr:.2g} {second.unit} "
        f"in run {other + 1}"
    )
    return Finding("not-one-contact", text, second.value, first.value, sigmas)


def _distance(one: Parameter, other: Parameter) -> float:
    spread = math.hypot(one.stderr, other.stderr)
    return abs(one.value - other.value) / spread if spread > 0 else 0.0
