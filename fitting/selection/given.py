"""The user's values of parameters in the units of the fit: of the shared unknowns, and of formulas.

The fit is per unit mass, and its belt runs forward: values in newtons are divided by the mass, and a belt speed or a
position has the sign of the run's belt.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

from daq.runfile.rig import Rig
from fitting.competitors import PER_MASS, Competitors, Given
from fitting.data.frame import MeasuredMotion
from fitting.law import Law
from fitting.model.parameters import Global
from fitting.model.problem import GivenUnknown, Run
from stickslip.errors import InputError
from stickslip.units import Measured

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


def known_rest(rig: Rig, competitors: Competitors) -> Rig:
    """Return a run's calibration with the fixed rest position, if any."""
    fixed = competitors.fix.get("x0")
    return rig if fixed is None else rig.resting_at(Measured(fixed, 0.0))


def with_given(runs: Sequence[Run], competitors: Competitors) -> list[Run]:
    """Return the runs with the user's values of each law's shared unknowns.

    Raises InputError for a belt speed of several runs, or a force in newtons without a mass.
    """
    of_laws = {
        law.name: {
            name: given
            for name, given in competitors.of_law(law).items()
            if law.number or name.removesuffix(PER_MASS) not in law.curve.parameters
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
        if plain not in law.curve.parameters:
            continue
        power = 0 if name.endswith(PER_MASS) else law.dimensions.get(plain, (0, 0))[0]
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
    """Return the values of the shared unknowns."""
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
