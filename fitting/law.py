"""`Law`: a friction curve with its contact: one of the six, a published one, or a custom one.

``s`` is the slip speed, m/s; every other name of the formula is a parameter, per unit mass as Fs/m is.
"""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from numbers import Real
from typing import Any, NamedTuple

from rig_sim.friction.formula import SPEED, Formula
from rig_sim.friction.law import LAWS, NESTED
from rig_sim.friction.law import Law as Kind
from stickslip import units
from stickslip.errors import InputError, nearest

NAME = re.compile(r"[A-Za-z][\w-]*")
CONSTANT, LINEAR, HYPERBOLIC = "Fs", "Fs - G_slip*s", "Fs/(1 + gamma*s)"  # curves of the six
FORMULAS = {"constant": CONSTANT, "linear": LINEAR, "hyperbolic": HYPERBOLIC}
OF_SIX = [(str(kind.number), FORMULAS[kind.curve], bool(kind.ramp)) for kind in LAWS.values()]
SPEED_WORDS = re.compile(r"[svuwx]|[vu]_?(rel|r|slip)|speed|vel\w*|slip\w*|[sx]_?dot", re.IGNORECASE)  # meant as s
# Part of a derivative beside those by other parameters, over the whole, or singular value over the largest: below,
# derivatives are dependent; above 1e-6 they are not.
DEPENDENT_BELOW = 1e-8
UNIT_DRAWS = 3  # sets of parameters at which a formula's units are found: one would let a chance zero decide
Bound = tuple[float | None, float | None]


def check_values(given: Any, kind: str) -> Mapping[str, Any]:
    """Return a caller's parameter values, numbers or text with a unit (bounds may be infinite), or raise InputError."""
    example = "{'gamma': (0, 20)}, with None for no bound" if kind == "bounds" else "{'gamma': 9.6}"
    do = f"give a dictionary, as in {kind}={example}"
    if given is None:
        return {}
    if not isinstance(given, Mapping) or not all(isinstance(name, str) for name in given):
        raise InputError(f"is {given!r:.40}", kind, do)
    for name, value in given.items():
        pair = kind == "bounds" and isinstance(value, tuple | list) and len(value) == 2
        parts = [part for part in value if part is not None] if pair else [value]
        if pair != (kind == "bounds") or not all(isinstance(part, Real) or _has_unit(part) for part in parts):
            raise InputError(f"of {name} is {value!r:.40}", kind, do)
        if not all(isinstance(part, str) or _is_number(part, finite=not pair) for part in parts):
            raise InputError(f"{name} is {value!r:.40}", kind, "give a finite number, or text with a unit")
    return given


def _has_unit(value: Any) -> bool:
    return isinstance(value, str) and bool(units.typed_unit(value))


def _is_number(value: Any, *, finite: bool) -> bool:
    try:
        return math.isfinite(value) or not (finite or math.isnan(value))
    except OverflowError:
        return False


def in_unit(value: Any, unit: str, name: str, where: str) -> Any:
    """Return a parameter's value or bounds as numbers in its unit."""
    if isinstance(value, tuple | list):
        return tuple(in_unit(end, unit, name, where) for end in value)
    return units.in_unit(value, unit, name, where) if isinstance(value, str) else value


@dataclass(frozen=True)
class Law:
    """A friction curve as a formula of the slip speed.

    Parameters
    ----------
    name : str
        A letter, then letters, digits, ``_`` and ``-``.
    formula : str
        As `rig_sim.friction.formula` reads it.
    ramp : bool
        Whether slip begins beyond a ramp, as under laws 2, 4 and 6; else friction jumps.
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
    """

    name: str
    formula: str
    ramp: bool = field(default=False, kw_only=True)
    start: Mapping[str, float] | None = field(default=None, kw_only=True, hash=False)
    bounds: Mapping[str, Bound] | None = field(default=None, kw_only=True, hash=False)
    fix: Mapping[str, float] | None = field(default=None, kw_only=True, hash=False)

    def __post_init__(self) -> None:
        if not (isinstance(self.name, str) and isinstance(self.formula, str)):
            what = f"name and formula are {self.name!r:.40} and {self.formula!r:.40}"
            raise InputError(what, "law", 'give two texts: fitting.Law("mine", "Fs/(1 + s/v_s)")')
        if not NAME.fullmatch(self.name) and (self.name, self.formula, self.ramp) not in OF_SIX:
            raise InputError(f"{self.name!r} is no name of a law", "law", "begin with a letter; use letters, digits, -")
        known = self.curve.parameters
        if not known:
            raise InputError(f"law {self.name} has no parameter", "formula", "name at least the friction level")
        for kind in ("start", "bounds", "fix"):
            values = check_values(getattr(self, kind), kind)
            for name in values:
                if name not in known:
                    what = f"{name} is no parameter of law {self.name}"
                    raise InputError(what, kind, nearest(name, list(known)))
            if values:
                numbers = {name: in_unit(value, self.unit(name), name, kind) for name, value in values.items()}
                object.__setattr__(self, kind, numbers)
        for name, (low, high) in (self.bounds or {}).items():
            if low is not None and high is not None and not low < high:
                raise InputError(f"bounds of {name} are {low:g} and {high:g}", "bounds", "give the lower one first")
        for kind in ("start", "fix"):
            for name, value in (getattr(self, kind) or {}).items():
                low, high = self.limits(name)
                if not (math.isfinite(value) and low <= value <= high):
                    what = f"{name} is {value:g}, not within {low:g} and {high:g}"
                    raise InputError(what, kind, f"give one that law {self.name} allows")

    @cached_property
    def curve(self) -> Formula:
        return Formula.parse(self.formula)

    @property
    def number(self) -> int | None:
        """That of one of the six."""
        return int(self.name) if self.name.isdecimal() else None

    @property
    def key(self) -> int | str:
        """The law in results: its number, or its name."""
        return self.number or self.name

    @property
    def words(self) -> str:
        """Its name in words."""
        return LAWS[self.number].name if self.number else self.name.replace("-", " ")

    @property
    def has_kernel(self) -> bool:
        """Whether a kernel of its own follows it; other curves are followed through a spline."""
        return self.number is not None and self == SIX[self.number]

    @property
    def kind(self) -> Kind:
        """The law of the six that it is, or by which a formula on this contact is regressed."""
        return LAWS[self.number or (6 if self.ramp else 5)]

    def is_ramp_of(self, other: "Law") -> bool:
        """Return whether this is the other law with a ramp."""
        same = self.formula == other.formula and bool(self.number) == bool(other.number)
        return same and self.ramp and not other.ramp

    def contains(self, other: "Law") -> bool:
        """Return whether the other law is a limit of this one; a formula has those of either contact."""
        if self.number:
            return other.number in NESTED[self.number]
        return self.name in ABOUT and other.formula in ABOUT[self.name].limits

    @property
    def free(self) -> tuple[str, ...]:
        """The fitted parameters, in order of first appearance."""
        return tuple(name for name in self.curve.parameters if name not in (self.fix or {}))

    @cached_property
    def dimensions(self) -> dict[str, tuple[int, int]]:
        """Powers of friction and of speed in each parameter, by Euler's theorem on homogeneous functions.

        Friction f has an independent unit, so that sum a_j p_j df/dp_j = f; the unit of speed is arbitrary, so that sum
        b_j p_j df/dp_j + s df/ds = 0.  Empty without whole powers a, b: a number of the formula then has a unit.
        """
        import numpy as np

        rng = np.random.default_rng(len(self.formula))
        names = self.curve.parameters
        rows, level, fall = [], [], []
        for _ in range(UNIT_DRAWS):
            values = {name: float(rng.uniform(0.5, 2.0)) for name in names}
            s = rng.uniform(0.1, 2.0, 4 * len(names))
            try:
                rows.append(self.curve.gradient(s, values) * np.array(list(values.values())))
                level.append(self.curve.value(s, values))
                fall.append(-s * self.curve.slope(s, values))
            except InputError:
                return {}
        table = np.concatenate(rows)
        target = np.stack((np.concatenate(level), np.concatenate(fall)), axis=1)
        # Of parameters that enter only together the first has the unit: halves of it for two would round either way.
        kept: list[int] = []
        for k, column in enumerate(table.T):
            others = table[:, kept]
            left = column - others @ np.linalg.lstsq(others, column, rcond=None)[0] if kept else column
            kept += [k] if np.linalg.norm(left) > DEPENDENT_BELOW * np.linalg.norm(column) else []
        whole = np.zeros((len(names), 2))
        whole[kept] = np.rint(np.linalg.lstsq(table[:, kept], target, rcond=None)[0])
        if not np.allclose(table @ whole, target, rtol=0.0, atol=1e-6 * float(np.abs(target).max())):
            return {}
        return {name: (int(a), int(b)) for name, (a, b) in zip(names, whole, strict=True)}

    def unit(self, name: str, *, newtons: bool = False) -> str:
        """Return the unit of a parameter, per unit mass or with friction in newtons; empty if unknown."""
        force, speed = self.dimensions.get(name, (0, 0))
        if newtons and force == 1:
            return {0: "N", -1: "N s/m"}.get(speed) or f"N (m/s)^{speed}"
        words = {(0, 1): "m/s", (0, -1): "s/m"}
        powers = sorted((("m", force + speed), ("s", -2 * force - speed)), key=lambda part: -part[1])
        composed = " ".join(f"{base}^{power}" if power != 1 else base for base, power in powers if power)
        return words.get((force, speed), composed)

    def limits(self, name: str) -> tuple[float, float]:
        low, high = (self.bounds or {}).get(name, (None, None))
        return -math.inf if low is None else low, math.inf if high is None else high

    def refuse_without_speed(self) -> None:
        """Raise InputError for a curve without the slip speed, unless it is one level: its name may be misspelt."""
        names = self.curve.parameters
        meant = next((name for name in names if SPEED_WORDS.fullmatch(name)), None)
        if any(step.name == SPEED for step in self.curve.steps) or (meant is None and len(names) == 1):
            return
        hint = "write s for it; law 1 is constant friction" if meant is None else f"did you mean {SPEED} for {meant}?"
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
        """Return the law with more parameters fixed, bounded or started; these take precedence."""
        fixed = {**(self.fix or {}), **(fix or {})}
        first = {**(self.start or {}), **(start or {})}
        return replace(
            self,
            fix=fixed or None,
            bounds={**(self.bounds or {}), **(bounds or {})} or None,
            start={name: value for name, value in first.items() if name not in fixed} or None,
        )

    def __str__(self) -> str:
        return f"{self.name}: {self.formula}"


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
    """A published curve in a sentence, its source, its formula, and the curves that are its limits."""

    title: str
    source: str
    formula: str
    limits: tuple[str, ...]


# An exponential fall, a logarithm and a power include the straight line; a Gaussian fall without a viscous term does
# not.
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


def read_law(spec: str, where: str = "--law") -> Law:
    """Return the law of ``NAME``, published, or ``NAME: FORMULA``; unknown or invalid ones raise InputError."""
    name, colon, formula = (part.strip() for part in spec.partition(":"))
    if not colon:
        if name in PUBLISHED:
            return PUBLISHED[name]
        if re.fullmatch(r"[\d\s,-]+", name):
            raise InputError(f"{name!r} is a number of a law, not a name", where, f"did you mean --laws {name}?")
        do = f'{nearest(name, list(PUBLISHED))}; a law of your own is "NAME: FORMULA", such as "mine: Fs/(1 + s/v)"'
        raise InputError(f"{name!r} is no published law", where, do)
    if name in PUBLISHED and formula != PUBLISHED[name].formula:
        what = f"{name} is the name of a published law, {PUBLISHED[name].formula}"
        raise InputError(what, where, "give a law of your own another name")
    return PUBLISHED.get(name) or Law(name, formula)
