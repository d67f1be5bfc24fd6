"""Friction laws of the slip speed s (m/s), which of them compete for a record, and the conditions on their parameters.

A `Law` is one of the six, a published curve or a custom one; parameters of its formula are per unit mass, as Fs/m is.
A formula may have parameters only together, as ``a*b*s`` or ``Fs - (a + b)*s``: the derivatives by them, each over its
size, are then linearly dependent at every set of values.  Several sets are compared, of the sizes that the units allow:
a fall of no height leaves its speed undetermined, but the formula does not.

Fixed values, bounds and first values name a parameter as the results do, in the same unit.  ``LAW.NAME`` is that of one
law, as ``5.gamma`` or ``mine.v_s``; a name alone is that of every law that has it.

==================  ==================================  ============================================================
name                of                                  remarks
==================  ==================================  ============================================================
k/m, v_dr, x0, c/m  every law                           v_dr of a single run
Fs/m                laws 1 to 6
gamma               laws 5 and 6
G_slip/m            laws 3 and 4                        the law is then fitted as its formula
d                   laws 2, 4, 6, formulas on a ramp
static              laws 2, 4, 6
those of a formula  that law                            ``NAME/m`` too where its unit has a force
k, c, Fs, G_slip    as k/m, c/m, Fs/m, G_slip/m         in newtons where the mass is known, else per unit mass
==================  ==================================  ============================================================

What follows from other parameters (Fs/k, wear, droop, x0 + Fs/k) cannot be given.
"""

import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from numbers import Integral, Real
from typing import Any, NamedTuple

import numpy as np

from rig_sim.friction.formula import SPEED, Formula
from rig_sim.friction.law import LAWS, NESTED
from rig_sim.friction.law import Law as Kind
from rig_sim.friction.memory import MEMORY_LAWS
from rig_sim.friction.pair import STATE
from stickslip import units
from stickslip.compute.arrays import Array
from stickslip.errors import InputError, check_known, nearest

NAME = re.compile(r"[A-Za-z][\w-]*")
CONSTANT, LINEAR, HYPERBOLIC = "Fs", "Fs - G_slip*s", "Fs/(1 + gamma*s)"  # curves of the six
FORMULAS = {"constant": CONSTANT, "linear": LINEAR, "hyperbolic": HYPERBOLIC}
OF_SIX = [(str(kind.number), FORMULAS[kind.curve], bool(kind.ramp)) for kind in LAWS.values()]
SPEED_WORDS = re.compile(r"[svuwx]|[vu]_?(rel|r|slip)|speed|vel\w*|slip\w*|[sx]_?dot", re.IGNORECASE)  # meant as s
DEPENDENT_BELOW = 1e-8  # relative size of a derivative beside others, or of a singular value; independent ones: > 1e-6
RATE = re.compile(rf"\s*{STATE}\s*'\s*=")
UNIT_DRAWS = 3  # sets of parameters at which a formula's units are found: one would let a chance zero decide
Bound = tuple[float | None, float | None]
Chance = np.random.Generator


def check_values(given: Any, kind: str) -> Mapping[str, Any]:
    """Return parameter values if they are numbers or text with a unit (bounds may be infinite); else InputError."""
    example = "{'gamma': (0, 20)}, with None for no bound" if kind == "bounds" else "{'gamma': 9.6}"
    do = f"write {kind}={example}"
    if given is None:
        return {}
    if not isinstance(given, Mapping) or not all(isinstance(name, str) for name in given):
        raise InputError(f"must be a dictionary, not {given!r:.40}", kind, do)
    for name, value in given.items():
        pair = kind == "bounds" and isinstance(value, tuple | list) and len(value) == 2
        parts = [part for part in value if part is not None] if pair else [value]
        valid = (isinstance(part, Real) or (isinstance(part, str) and units.typed_unit(part)) for part in parts)
        if pair != (kind == "bounds") or not all(valid):
            raise InputError(f"the value of {name} is {value!r:.40}", kind, do)
        if not all(isinstance(part, str) or _is_number(part, finite=not pair) for part in parts):
            raise InputError(f"the value of {name} is {value!r:.40}", kind, "use a finite number, or text with a unit")
    return given


def _is_number(value: Any, *, finite: bool) -> bool:
    try:
        return math.isfinite(value) or not (finite or math.isnan(value))
    except OverflowError:
        return False


def in_unit(value: Any, unit: str, name: str, where: str) -> Any:
    if isinstance(value, tuple | list):
        return tuple(in_unit(end, unit, name, where) for end in value)
    return units.in_unit(value, unit, name, where) if isinstance(value, str) else value


# Of the parameters of a law with memory, per unit mass: powers of friction and of speed (`Law.dimensions`).
POWERS = {"force": (1, 0), "stiffness": (2, -2), "damping": (1, -1), "length": (-1, 2), "speed": (0, 1)}
# Those that are per unit mass in a fit.
IN_NEWTONS = {POWERS["force"]: "N", POWERS["stiffness"]: "N/m", POWERS["damping"]: "N s/m"}
VISCOUS = "s2"  # of bristles: only its sum with the damping is determined, so it is counted as damping
OF_MEMORY = {
    name: {own: POWERS[about.dimension] for own, about in law.parameters.items() if own != VISCOUS}
    for name, law in MEMORY_LAWS.items()
}


@dataclass(frozen=True)
class Law:
    """A friction law as a formula of the slip speed, and of a state where it has memory.

    Parameters
    ----------
    name : str
        A letter, then letters, digits, ``_`` and ``-``.
    formula : str
        As `rig_sim.friction.formula` reads it.
    ramp : bool
        Whether slip begins beyond a ramp, as under laws 2, 4 and 6; else friction jumps.
    rate : str
        Rate z' of a state z, as a formula of s (0 or more) and z; ``formula`` may then contain z.  Friction acts as the
        belt pulls where the belt is faster, and against that where the mass is; z is not 0 in steady slip.  Of a
        published law with memory, ``formula`` is friction of steady slip.
    start : mapping of str to float or str, optional
        First values of parameters, as text with a unit (``"30 mm/s"``) or in SI; those left out are found.
    bounds : mapping of str to (low, high), optional
        None for no bound.
    fix : mapping of str to float, optional
        Parameters that are known and not fitted.

    Raises
    ------
    InputError
        For a name or a formula that cannot be read, the place marked by a caret; for values that are not finite, not
        within their bounds, or of no parameter.

    Examples
    --------
    >>> import fitting
    >>> law = fitting.Law("mine", "Fc + (Fs - Fc)*exp(-(s/v_s)**2)", bounds={"v_s": (0, None)}, fix={"Fc": 1.5})
    >>> law.free, law.unit("v_s")
    (('Fs', 'v_s'), 'm/s')
    >>> fitting.Law("aged", "F0 + a*log(s/v0) + b*log(z*v0/D)", rate="1 - s*z/D").parameters
    ('F0', 'a', 'v0', 'b', 'D')
    """

    name: str
    formula: str
    ramp: bool = field(default=False, kw_only=True)
    rate: str = field(default="", kw_only=True)
    start: Mapping[str, float] | None = field(default=None, kw_only=True, hash=False)
    bounds: Mapping[str, Bound] | None = field(default=None, kw_only=True, hash=False)
    fix: Mapping[str, float] | None = field(default=None, kw_only=True, hash=False)

    def __post_init__(self) -> None:
        if not (isinstance(self.name, str) and isinstance(self.formula, str)):
            what = f"name and formula must be texts, not {self.name!r:.40} and {self.formula!r:.40}"
            raise InputError(what, "law", 'write fitting.Law("mine", "Fs/(1 + s/v_s)")')
        if not NAME.fullmatch(self.name) and (self.name, self.formula, self.ramp) not in OF_SIX:
            raise InputError(f"{self.name!r} is no name of a law", "law", "begin with a letter; use letters, digits, -")
        if self.rate and self.ramp:
            raise InputError(f"law {self.name} has memory and cannot have a ramp", "--ramp", "omit --ramp")
        if self.own_memory:
            self._check_memory()
        known = self.parameters
        if not known:
            raise InputError(
                f"law {self.name} has no parameter", "formula", "include at least the friction level, such as Fs"
            )
        for kind in ("start", "bounds", "fix"):
            values = check_values(getattr(self, kind), kind)
            for name in values:
                if name not in known:
                    what = f"law {self.name} has no parameter {name}"
                    raise InputError(what, kind, nearest(name, list(known)))
            if values:
                numbers = {name: in_unit(value, self.unit(name), name, kind) for name, value in values.items()}
                object.__setattr__(self, kind, numbers)
        for name, (low, high) in (self.bounds or {}).items():
            if low is not None and high is not None and not low < high:
                raise InputError(
                    f"the lower bound of {name}, {low:g}, is not below the upper one, {high:g}",
                    "bounds",
                    "write the lower bound first",
                )
        for kind in ("start", "fix"):
            for name, value in (getattr(self, kind) or {}).items():
                low, high = self.limits(name)
                if not (math.isfinite(value) and low <= value <= high):
                    what = f"{name} = {value:g} is outside the allowed range, {low:g} to {high:g}"
                    raise InputError(what, kind, "choose a value within this range")

    def _check_memory(self) -> None:
        if not isinstance(self.rate, str):
            raise InputError(f"must be a text, not {self.rate!r:.40}", "rate", 'write a formula: rate="1 - s*z/D"')
        for formula, what in ((self.curve, "formula"), (self.state_rate, "rate")):
            if STATE not in formula.parameters:
                do = f"write {STATE} for the state, as in F0 + b*log(z/t0); z' = 1 - s*z/D"
                raise InputError(f"that of law {self.name} does not contain the state {STATE}", what, do)

    @cached_property
    def curve(self) -> Formula:
        return Formula.parse(self.formula)

    @cached_property
    def state_rate(self) -> Formula:
        return Formula.parse(self.rate)

    @property
    def written(self) -> str:
        """The formula, and the rate of a law of one's own, as ``--law`` reads them behind the name."""
        return f"{self.formula}; {STATE}' = {self.rate}" if self.own_memory else self.formula

    @property
    def own_memory(self) -> bool:
        """Whether it has a state and is no published law."""
        return bool(self.rate) and self.name not in OF_MEMORY

    @property
    def parameters(self) -> tuple[str, ...]:
        if self.own_memory:
            names = dict.fromkeys((*self.curve.parameters, *self.state_rate.parameters))
            return tuple(name for name in names if name != STATE)
        return tuple(OF_MEMORY[self.name]) if self.rate else self.curve.parameters

    @property
    def number(self) -> int | None:
        return int(self.name) if self.name.isdecimal() else None

    @property
    def key(self) -> int | str:
        return self.number or self.name

    @property
    def words(self) -> str:
        if self.rate and not self.own_memory:
            return MEMORY_LAWS[self.name].title
        return LAWS[self.number].name if self.number else self.name.replace("-", " ")

    @property
    def has_kernel(self) -> bool:
        """Whether its own kernel integrates it; other curves are integrated as a spline."""
        return self.number is not None and self == SIX[self.number]

    @property
    def kind(self) -> Kind:
        """The law of the six that it is or, for a formula, by which its contact is regressed."""
        return LAWS[self.number or (6 if self.ramp else 5)]

    def is_ramp_of(self, other: "Law") -> bool:
        same = self.formula == other.formula and bool(self.number) == bool(other.number)
        return same and self.ramp and not other.ramp

    def contains(self, other: "Law") -> bool:
        """Return whether the other law is a limit of this one; the limits of a formula are on either contact."""
        if self.rate:
            return other.name in MEMORY_LIMITS.get(self.name, ())
        if self.number:
            return other.number in NESTED[self.number]
        return self.name in ABOUT and other.formula in ABOUT[self.name].limits

    @property
    def free(self) -> tuple[str, ...]:
        return tuple(name for name in self.parameters if name not in (self.fix or {}))

    @cached_property
    def dimensions(self) -> dict[str, tuple[int, int]]:
        """Powers of friction and of speed in each parameter; empty where a number of the formula has a unit."""
        if self.rate and not self.own_memory:
            return OF_MEMORY[self.name]
        return {name: (force, speed) for name, (force, speed, _) in self._powers.items()}

    @cached_property
    def _powers(self) -> dict[str, tuple[int, int, int]]:
        """Powers a of friction f, b of speed and m of the mass in each parameter p, or none.

        Euler's theorem on homogeneous functions: sum a_j p_j df/dp_j = f and sum b_j p_j df/dp_j + s df/ds = 0.  A
        state counts as a parameter; its rate g has its powers, and one more of f/s: sum a_j p_j dg/dp_j - a_z g = g and
        sum b_j p_j dg/dp_j - b_z g + s dg/ds = -g.  Friction grows with the mass, but time does not: m is a without a
        rate, and sum m_j p_j dg/dp_j - m_z g = 0 with one.
        """
        rng = np.random.default_rng(len(self.formula))
        names = (*self.parameters, STATE) if self.rate else self.parameters
        rows, targets = [], []
        for _ in range(UNIT_DRAWS):
            values: dict[str, Any] = {name: float(rng.uniform(0.5, 2.0)) for name in names}
            s = rng.uniform(0.1, 2.0, 4 * len(names))
            if self.rate:
                values[STATE] = rng.uniform(0.5, 2.0, s.size)
            try:
                for formula in (self.curve, self.state_rate) if self.rate else (self.curve,):
                    own, value = formula.gradient(s, values, names), formula.value(s, values)
                    columns = np.stack([own[:, k] * values[name] for k, name in enumerate(names)], axis=1)
                    if formula is not self.curve:
                        columns[:, -1] -= value
                    rows.append(columns)
                    fall, of_rate = -s * formula.slope(s, values), formula is not self.curve
                    targets.append(np.stack((value, fall - value * of_rate, value * (not of_rate)), axis=1))
            except InputError:
                return {}
        table, target = np.concatenate(rows), np.concatenate(targets)
        # The first of parameters that enter only together has the unit: halves for two would round either way.
        kept: list[int] = []
        for k, column in enumerate(table.T):
            others = table[:, kept]
            left = column - others @ np.linalg.lstsq(others, column, rcond=None)[0] if kept else column
            kept += [k] if np.linalg.norm(left) > DEPENDENT_BELOW * np.linalg.norm(column) else []
        whole = np.zeros((len(names), 3))
        whole[kept] = np.rint(np.linalg.lstsq(table[:, kept], target, rcond=None)[0])
        if not np.allclose(table @ whole, target, rtol=0.0, atol=1e-6 * float(np.abs(target).max())):
            return {}
        return {name: (int(a), int(b), int(m)) for name, (a, b, m) in zip(names, whole, strict=True)}

    def unit(self, name: str, *, newtons: bool = False) -> str:
        """Return the unit of a parameter, per unit mass unless ``newtons``; empty if unknown."""
        force, speed = self.dimensions.get(name, (0, 0))
        if newtons and self.mass_power(name) == 1:
            return IN_NEWTONS.get((force, speed)) or f"N (m/s)^{speed}"
        words = {(0, 1): "m/s", (0, -1): "s/m"}
        powers = sorted((("m", force + speed), ("s", -2 * force - speed)), key=lambda part: -part[1])
        composed = " ".join(f"{base}^{power}" if power != 1 else base for base, power in powers if power)
        return words.get((force, speed), composed)

    def mass_power(self, name: str) -> int:
        """Return the power of the mass by which a parameter per unit mass is one in newtons."""
        if self.rate and not self.own_memory:
            return int(self.dimensions[name] in IN_NEWTONS)
        return self._powers.get(name, (0, 0, 0))[2]

    def limits(self, name: str) -> tuple[float, float]:
        low, high = (self.bounds or {}).get(name, (None, None))
        return -math.inf if low is None else low, math.inf if high is None else high

    def allows(self, values: Mapping[str, float]) -> bool:
        return all(low <= values[name] <= high for name in self.free for low, high in [self.limits(name)])

    @property
    def depends_on_speed(self) -> bool:
        return bool(self.rate) or any(step.name == SPEED for step in self.curve.steps)

    def refuse_without_speed(self) -> None:
        """Raise InputError for a curve without the slip speed, unless it is one level: its name may be misspelt."""
        names = self.curve.parameters
        meant = next((name for name in names if SPEED_WORDS.fullmatch(name)), None)
        if self.depends_on_speed or (meant is None and len(names) == 1):
            return
        hint = (
            "write the slip speed as s; for constant friction use law 1"
            if meant is None
            else f"did you mean {SPEED} for {meant}?"
        )
        raise InputError(f"law {self.name} does not depend on the slip speed {SPEED}", "formula", hint)

    def behind_ramp(self) -> "Law":
        """Return the law behind a ramp."""
        return replace(self, ramp=True)

    def given(
        self,
        fix: Mapping[str, float] | None = None,
        bounds: Mapping[str, Bound] | None = None,
        start: Mapping[str, float] | None = None,
    ) -> "Law":
        """Return the law with these conditions in addition; they take precedence."""
        fixed = {**(self.fix or {}), **(fix or {})}
        first = {**(self.start or {}), **(start or {})}
        return replace(
            self,
            fix=fixed or None,
            bounds={**(self.bounds or {}), **(bounds or {})} or None,
            start={name: value for name, value in first.items() if name not in fixed} or None,
        )

    def __str__(self) -> str:
        return f"{self.name}: {self.written}"


SIX = {
    int(name): Law(name, formula, ramp=ramp, bounds=dict.fromkeys(Formula.parse(formula).parameters, (0.0, None)))
    for name, formula, ramp in OF_SIX
}
STRIBECK, GAUSSIAN = "Fc + (Fs - Fc)*exp(-s/v_s)", "Fc + (Fs - Fc)*exp(-(s/v_s)**2)"
TUSTIN = "A. Tustin, J. IEE 94 (1947) 143"
ARMSTRONG = "B. Armstrong-Helouvry, P. Dupont, C. Canudas de Wit, Automatica 30 (1994) 1083"
DIETERICH = "J. Dieterich, J. Geophys. Res. 84 (1979) 2161"  # steady state
RABINOWICZ = "E. Rabinowicz, Proc. Phys. Soc. 71 (1958) 668"


class About(NamedTuple):
    """A published curve."""

    title: str
    source: str
    formula: str
    limits: tuple[str, ...]  # curves: the straight line too, but for a Gaussian fall without a viscous term


ABOUT = {
    "stribeck": About("a Stribeck curve", TUSTIN, STRIBECK, (CONSTANT, LINEAR)),
    "stribeck-viscous": About(
        "a Stribeck curve with a viscous term", TUSTIN, f"{STRIBECK} + Fv*s", (CONSTANT, LINEAR, STRIBECK)
    ),
    "stribeck-gaussian": About("a Gaussian Stribeck curve", ARMSTRONG, GAUSSIAN, (CONSTANT,)),
    "stribeck-gaussian-viscous": About(
        "a Gaussian Stribeck curve with a viscous term", ARMSTRONG, f"{GAUSSIAN} + Fv*s", (CONSTANT, LINEAR, GAUSSIAN)
    ),
    "logarithmic": About("a logarithmic curve", DIETERICH, "Fs - b*log(1 + s/v_0)", (CONSTANT, LINEAR)),
    "power": About("a power curve", RABINOWICZ, "Fs - b*(s/v_1)**p", (CONSTANT, LINEAR)),
}
POSITIVE, UNIT_SPEED = ("Fs", "Fc", "v_s", "v_0", "p"), "v_1"
PUBLISHED = {
    name: Law(
        name,
        about.formula,
        bounds={own: (0.0, None) for own in Formula.parse(about.formula).parameters if own in POSITIVE},
        fix={UNIT_SPEED: 1.0} if UNIT_SPEED in about.formula else None,
    )
    for name, about in ABOUT.items()
}


# Laws with memory (`rig_sim.friction.memory`): friction of steady slip, and the rate of the state z.
STEADY = "F0 + (a - b)*log(s/v0)"
MEMORY = {
    name: Law(
        name,
        formula,
        rate=rate,
        bounds=dict.fromkeys(OF_MEMORY[name], (0.0, None)),
        # m/s, a gauge: F0 is the friction of steady slip at that speed
        fix={"v0": 1.0} if "v0" in OF_MEMORY[name] else None,
    )
    for name, formula, rate in (
        ("lugre", GAUSSIAN, f"s - s0*s*z/({GAUSSIAN})"),
        ("dahl", "Fc", "s - s0*s*z/Fc"),
        ("ageing", STEADY, "v0/D*exp(-z) - s/D"),
        ("slip", STEADY, "-s/D*(log(s/v0) + z)"),
    )
}
NAMED = PUBLISHED | MEMORY
MEMORY_LIMITS = {"lugre": ("stribeck-gaussian", "dahl", "1"), "dahl": ("1",), "ageing": (), "slip": ()}


def read_law(spec: str, where: str = "--law") -> Law:
    """Return the law of ``NAME``, published, or ``NAME: FORMULA``."""
    name, colon, formula = (part.strip() for part in spec.partition(":"))
    if not colon:
        if name in NAMED:
            return NAMED[name]
        if re.fullmatch(r"[\d\s,-]+", name):
            raise InputError(
                f"{name!r} is the number of a law, but --law expects a name or a formula",
                where,
                f"did you mean --laws {name}?",
            )
        for number, kind in LAWS.items():
            if name == kind.name:
                raise InputError(f"{name!r} is law {number} of the six", where, f"did you mean --laws {number}?")
        do = f'{nearest(name, list(NAMED))}; a law of your own is "NAME: FORMULA", such as "mine: Fs/(1 + s/v)"'
        raise InputError(f"{name!r} is no published law", where, do)
    formula, semicolon, rate = formula.partition(";")
    begin = RATE.match(rate)
    if semicolon and begin is None:
        do = f"write {STATE}' = and the rate: \"mine: F0 + b*log(z/t0); z' = 1 - s*z/D\""
        raise InputError(f"the part after ; is not the rate of a state {STATE}", where, do)
    formula, rate = formula.strip(), rate[begin.end() :].strip() if begin else ""
    if name in NAMED and formula != NAMED[name].formula:
        what = f"{name} is the name of a published law, {NAMED[name].formula}"
        raise InputError(what, where, "give a law of your own another name")
    return NAMED.get(name) or Law(name, formula, rate=rate)


DRAWS = 4  # sets of values at which parameters have to be dependent
LEAST_PART = 0.1  # part of a direction over its largest: less is rounding


class Undetermined(NamedTuple):
    """Parameters that the formula has only together, and how many of them may have any value."""

    names: tuple[str, ...]
    free: int

    def __str__(self) -> str:
        *others, last = self.names
        return (
            f"friction depends only on a combination of {', '.join(others)} and {last}"
            if others
            else f"friction does not depend on {last}"
        )


def natural_size(law: Law, name: str, friction: float, speed: float) -> float:
    """Return a parameter's size (> 0) by its unit for curves of this friction (m/s^2) and speed (m/s); 1 if unknown."""
    force, power = law.dimensions.get(name, (0, 0))
    return float(abs(friction) ** force * speed**power)


def undetermined(law: Law, friction: float, fastest: float) -> tuple[Undetermined, ...]:
    """Return the parameters that a formula has only together, at this friction (m/s^2) up to a speed (m/s)."""
    rng = np.random.default_rng(len(law.formula))
    speeds = fastest * np.linspace(0.0, 1.0, 12 * len(law.free) + 1)
    sizes = np.array([natural_size(law, name, friction, fastest) for name in law.free])
    draws = []
    for _ in range(DRAWS):
        drawn = sizes * rng.uniform(0.5, 2.0, sizes.size)
        values = dict(zip(law.free, drawn.tolist(), strict=True)) | dict(law.fix or {})
        try:
            draws.append(_groups(_effects(law, speeds, values, friction, fastest, rng) * drawn))
        except InputError:
            continue
    everywhere = set.intersection(*(set(groups) for groups in draws)) if draws else set()
    return tuple(
        Undetermined(tuple(law.free[i] for i in group), min(groups[group] for groups in draws))
        for group in sorted(everywhere)
    )


def _effects(law: Law, s: Array, values: dict[str, Any], friction: float, fastest: float, rng: Chance) -> Array:
    """Return the derivatives of friction, and of the rate at states of any age, by the free parameters."""
    if not law.rate:
        return law.curve.gradient(s, values, law.free)
    size = natural_size(law, STATE, friction, fastest)
    values[STATE] = size * rng.uniform(0.5, 2.0, s.size - 1)
    found = []
    for formula, unit in ((law.curve, friction), (law.state_rate, size * friction / fastest)):
        own = [name for name in law.free if name in formula.parameters]
        columns = np.zeros((s.size - 1, len(law.free)))
        columns[:, [law.free.index(name) for name in own]] = formula.gradient(s[1:], values, tuple(own)) / unit
        found.append(columns)
    return np.concatenate(found)


def hold_confounded(law: Law, friction: float, fastest: float) -> tuple[tuple[Undetermined, ...], Law]:
    """Return the groups of `undetermined`, and the law with as many parameters held as have no value of their own."""
    groups, first = undetermined(law, friction, fastest), law.start or {}
    names = [name for group in groups for name in group.names[len(group.names) - group.free :]]
    return groups, law.given(fix={name: first.get(name, natural_size(law, name, friction, fastest)) for name in names})


def _groups(columns: Array) -> dict[tuple[int, ...], int]:
    """Return groups of dependent columns, each with the number of directions along which they cancel."""
    size = np.linalg.norm(columns, axis=0)
    seen = size > DEPENDENT_BELOW * float(size.max(initial=0.0))
    groups: dict[tuple[int, ...], int] = {(i,): 1 for i in np.flatnonzero(~seen).tolist()}
    index = np.flatnonzero(seen)
    if not index.size:
        return groups
    _, singular, axes = np.linalg.svd(columns[:, index] / size[index], full_matrices=False)
    null = axes[singular < DEPENDENT_BELOW * float(singular.max())]
    beside = np.einsum("ri,rj->ij", null, null)
    left = [i for i in range(index.size) if beside[i, i] > LEAST_PART**2]
    while left:
        group: list[int] = []
        more = left[:1]
        while more:
            group += more
            more = [i for i in left if i not in group and np.any(np.abs(beside[i, group]) > LEAST_PART**2)]
        left = [i for i in left if i not in group]
        groups[tuple(index[sorted(group)].tolist())] = round(float(np.trace(beside[np.ix_(group, group)])))
    return groups


ALL_LAWS = tuple(SIX)  # numbers of the six laws
LEAST_VALUES: dict[str, tuple[float, bool]] = {  # of parameters of rig and contact, and whether allowed itself
    "k": (0.0, False),
    "Fs": (0.0, False),
    "gamma": (0.0, True),
    "G_slip": (0.0, True),
    "d": (0.0, False),
    "static": (1.0, True),
    "c": (0.0, True),
}
OF_EVERY_LAW = {"k/m": "s^-2", "k": "N/m", "c/m": "s^-1", "c": "N s/m", "v_dr": "m/s", "x0": "m"}
PER_MASS = "/m"
LAST_CYCLE = 100_000  # largest number of a cycle: no record holds as many


class Given(NamedTuple):
    """Conditions on a parameter."""

    low: float = -math.inf
    high: float = math.inf  # low where it is fixed
    start: float | None = None  # first value

    @property
    def fixed(self) -> bool:
        return self.low == self.high


@dataclass(frozen=True, eq=False)
class Competitors:
    """The laws that compete, with conditions by the names of parameters; impossible ones raise InputError."""

    laws: tuple[Law, ...] = tuple(SIX.values())
    fix: Mapping[str, float] = field(default_factory=dict)
    bounds: Mapping[str, Bound] = field(default_factory=dict)
    start: Mapping[str, float] = field(default_factory=dict)
    in_newtons: tuple[str, ...] = field(default=(), init=False)  # names given with a unit that needs the mass

    def __post_init__(self) -> None:
        if not self.laws:
            raise InputError("no law was requested", "--laws", "use numbers from 1 to 6, such as 1-6 or 3,5")
        names = [law.name for law in self.laws]
        twice = [name for name in names if names.count(name) > 1]
        if twice:
            raise InputError(f"two laws have the name {twice[0]}", "--law", "give each law a different name")
        newtons: set[str] = set()
        for flag, kind in (("--fix", "fix"), ("--bound", "bounds"), ("--start", "start")):
            object.__setattr__(self, kind, self._in_numbers(getattr(self, kind), flag, newtons))
        object.__setattr__(self, "in_newtons", tuple(sorted(newtons)))
        for name, (low, high) in self.bounds.items():
            if low is not None and high is not None and not low < high:
                raise InputError(
                    f"the lower bound of {name}, {low:g}, is not below the upper one, {high:g}",
                    "--bound",
                    "write the lower bound first",
                )
            if name in self.fix:
                raise InputError(f"{name} has both a fixed value and bounds", "--bound", "state only one of the two")
        for law in self.laws:
            if not law.number:
                law.refuse_without_speed()
            self.of_law(law)

    @classmethod
    def of(
        cls,
        laws: "int | str | Law | Sequence[int | str | Law]" = ALL_LAWS,
        fix: Mapping[str, float | str] | None = None,
        bounds: Mapping[str, Bound] | None = None,
        start: Mapping[str, float | str] | None = None,
    ) -> "Competitors":
        """Return the competitors that Python code names."""
        found: list[Law] = []
        several = isinstance(laws, Iterable) and not isinstance(laws, str)
        for one in laws if several else [laws]:  # type: ignore[union-attr]
            if not isinstance(one, Integral | str | Law):
                do = "use numbers, names or fitting.Law, as in laws=(1, 5) or laws='1-6,stribeck'"
                raise InputError(f"{one!r:.40} is not a law", "laws", do)
            found += [one] if isinstance(one, Law) else _read(str(one), "--laws")
        given = [check_values(values, kind) for values, kind in ((fix, "fix"), (bounds, "bounds"), (start, "start"))]
        return cls(_each_once(found), *given)

    @classmethod
    def typed(
        cls,
        laws: str,
        law: Iterable[str] = (),
        ramp: Iterable[str] = (),
        fix: Iterable[str] = (),
        bound: Iterable[str] = (),
        start: Iterable[str] = (),
    ) -> "Competitors":
        """Return the competitors that flags name."""
        named = _each_once([*_read(laws, "--laws"), *map(read_law, law)])
        behind = list(ramp)
        for name in behind:
            check_known(name, [one.name for one in named if not one.number], "law", "--ramp")
        return cls(
            tuple(one.behind_ramp() if one.name in behind else one for one in named),
            dict(_pairs(fix, "--fix")),  # type: ignore[arg-type]
            {name: _interval(value, name) for name, value in _pairs(bound, "--bound")},  # type: ignore[misc]
            dict(_pairs(start, "--start")),  # type: ignore[arg-type]
        )

    @property
    def six(self) -> tuple[Law, ...]:
        return tuple(law for law in self.laws if law.number)

    @property
    def formulas(self) -> tuple[Law, ...]:
        return tuple(law for law in self.laws if not law.number)

    def asks(self, law: Law) -> bool:
        return any(own.name == law.name for own in self.laws)

    def by_kernel(self, law: Law) -> bool:
        """Return whether a law's own kernel integrates it: not with conditions on G_slip, no unknown of a kernel."""
        return law.has_kernel and not {"G_slip/m", "G_slip"} & self.of_law(law).keys()

    @property
    def searched(self) -> tuple[Law, ...]:
        """The fitted laws of the six: all where a formula competes, since it starts from them."""
        return self.laws if all(map(self.by_kernel, self.laws)) else tuple(SIX.values())

    def of_law(self, law: Law) -> dict[str, Given]:
        """Return the conditions on a law's parameters by their names without the law."""
        given_of: dict[str, Given] = {}
        for kind, given in (("bounds", self.bounds), ("start", self.start), ("fix", self.fix)):
            for name, value in given.items():
                own_name = _named(name, law)
                if own_name is not None:
                    given_of[own_name] = _with(given_of.get(own_name, Given()), kind, value)
        own_names = () if law.number else law.parameters
        for name, one in given_of.items():
            plain = "" if name in own_names else name.removesuffix(PER_MASS)
            _check(name, one, *LEAST_VALUES.get(plain, (-math.inf, True)))
        return given_of

    def _in_numbers(self, given: Mapping[str, Any], flag: str, newtons: set[str]) -> dict[str, Any]:
        """Return values in the units of the results; names whose unit has newtons are added to ``newtons``."""
        found: dict[str, Any] = {}
        for name, value in given.items():
            having = [law for law in self.laws if _named(name, law)]
            if not having:
                raise self._unknown(name, flag)
            ends = value if isinstance(value, tuple | list) else (value,)
            if not any(isinstance(end, str) for end in ends):
                found[name] = value
                continue
            typed = any(isinstance(end, str) and units.typed_unit(end) for end in ends)
            readings = {_read_value(name, value, law, flag, typed=typed) for law in having}
            if len(readings) > 1:
                what = f"the unit of {name} differs between the laws"
                raise InputError(what, flag, f"state the law too: {self.laws[-1].name}.{name}")
            own, number = readings.pop()
            if own in found or (own != name and own in given):
                raise InputError(f"{own} is given twice", flag, "omit one of them")
            found[own] = number
            if typed and any(f"{_named(own, law)}{PER_MASS}" in units_of(law) for law in self.laws):
                newtons.add(own)
        return found

    def _unknown(self, name: str, flag: str) -> InputError:
        prefix, dot, _ = name.partition(".")
        known = [law.name for law in self.laws]
        if dot and prefix not in known:
            return InputError(f"{name}: there is no law {prefix}", flag, nearest(prefix, known))
        choices = dict.fromkeys(own for law in self.laws if not dot or law.name == prefix for own in units_of(law))
        return InputError(f"none of the fitted laws has a parameter {name}", flag, nearest(name, list(choices)))


def units_of(law: Law) -> dict[str, str]:
    """Return the unit in the results of each parameter that can be given."""
    own = {name: law.unit(name, newtons=True) for name in law.parameters}
    per_mass = {f"{name}{PER_MASS}": law.unit(name) for name in own if law.mass_power(name)}
    ramp = ({"d": "m/s"} | ({"static": ""} if law.number else {})) if law.ramp else {}
    return {**OF_EVERY_LAW, **ramp, **per_mass, **own}


def _named(name: str, law: Law) -> str | None:
    """Return a parameter's name without the law's; None if the law has no such parameter."""
    prefix, dot, bare = name.partition(".")
    if dot and prefix != law.name:
        return None
    bare = bare if dot else name
    return bare if bare in units_of(law) else None


def _read_value(name: str, value: Any, law: Law, flag: str, *, typed: bool) -> tuple[str, Any]:
    """Return the name, per unit mass if the value's unit is, and the number."""
    own, known = str(_named(name, law)), units_of(law)
    if typed and f"{own}{PER_MASS}" in known:
        with suppress(InputError):
            return f"{name}{PER_MASS}", in_unit(value, known[f"{own}{PER_MASS}"], name, flag)
    return name, in_unit(value, known[own], name, flag)


def _with(given: Given, kind: str, value: float | Bound) -> Given:
    if kind == "bounds":
        low, high = value  # type: ignore[misc]
        low, high = -math.inf if low is None else float(low), math.inf if high is None else float(high)
        return given._replace(low=low, high=high)
    number = float(value)  # type: ignore[arg-type]
    return Given(number, number, number) if kind == "fix" else given._replace(start=number)


def _check(name: str, given: Given, least: float, itself: bool) -> None:
    for value in (given.high, given.start):
        if value is not None and (math.isnan(value) or value < least or (value == least and not itself)):
            do = f"it must be {'at least' if itself else 'above'} {least:g}"
            raise InputError(f"{name} is {value:g}", "--fix" if given.fixed else "--bound", do)
    if given.start is not None and not given.low <= given.start <= given.high:
        what = f"{name} = {given.start:g} is outside its bounds, {given.low:g} to {given.high:g}"
        raise InputError(what, "--start", "choose an initial value within the bounds")


def _each_once(laws: Iterable[Law]) -> tuple[Law, ...]:
    """Return the laws without repetitions, the six first."""
    return tuple(sorted(dict.fromkeys(laws), key=lambda law: law.number is None))


def _read(text: str, where: str) -> list[Law]:
    """Return the laws of a list such as ``1-3,stribeck``, or of one ``NAME: FORMULA``."""
    if ":" in text:
        return [read_law(text, where)]
    found: list[Law] = []
    for part in filter(None, (piece.strip() for piece in text.split(","))):
        if part[0].isalpha():
            found.append(read_law(part, where))
            continue
        listed = numbers(part, where)
        unknown = [number for number in listed if number not in SIX]
        if unknown:
            raise InputError(f"unknown law {unknown[0]}", where, "use numbers from 1 to 6, such as 1-6 or 3,5")
        found += [SIX[number] for number in listed]
    return found


def numbers(text: str, flag: str) -> list[int]:
    """Return the whole numbers of a list such as ``1-3,6``."""
    listed: list[int] = []
    for part in filter(None, (piece.strip() for piece in text.split(","))):
        first, dash, last = part.partition("-")
        try:
            low = int(first)
            high = int(last) if dash else low
        except ValueError:
            raise InputError(f"{part!r} is not a number or range", flag, "write, for example, 1-3,6") from None
        if not 1 <= low <= high <= LAST_CYCLE:
            raise InputError(
                f"{part!r} is not an increasing range of numbers above 0", flag, "write, for example, 1-3,6"
            )
        listed.extend(range(low, high + 1))
    return listed


def _pairs(typed: Iterable[str], flag: str) -> Iterator[tuple[str, str]]:
    """Yield name and value of each NAME=VALUE."""
    seen: set[str] = set()
    for text in typed:
        name, equals, value = (part.strip() for part in text.partition("="))
        if not equals or not name or not value:
            what = "LO:HI" if flag == "--bound" else "VALUE"
            do = f"write, for example, gamma={'0:20' if flag == '--bound' else '9.6'}"
            raise InputError(f"{text!r} does not have the form NAME={what}", flag, do)
        if name in seen:
            raise InputError(f"{name} is given twice", flag, "omit one of them")
        seen.add(name)
        yield name, value


def _interval(text: str, name: str) -> tuple[str | None, str | None]:
    """Return the bounds of LO:HI, either may be missing; a unit after HI alone is that of both."""
    low, colon, high = (part.strip() for part in text.partition(":"))
    if not colon or not (low or high):
        raise InputError(f"{text!r} is not a pair of bounds for {name}", "--bound", "write LO:HI, LO: or :HI")
    if low and units.typed_unit(high) and not units.typed_unit(low):
        low = f"{low} {units.typed_unit(high)}"
    return low or None, high or None
