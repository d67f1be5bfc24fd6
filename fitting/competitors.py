"""Which laws compete for a record, and what is given of their parameters: fixed values, bounds and first values.

A parameter is named as the results name it, in the unit that they give it there.  ``LAW.NAME`` is that of one law, as
``5.gamma`` or ``mine.v_s``; a name alone is that of every law that has it.

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
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from numbers import Integral
from typing import Any, NamedTuple

from fitting.law import SIX, Bound, Law, check_values, in_unit, read_law
from stickslip import units
from stickslip.errors import InputError, check_known, nearest

ALL_LAWS = tuple(SIX)  # numbers of the six laws
# Least value of each parameter of rig and contact, and whether it may be that.
LEAST_VALUES: dict[str, tuple[float, bool]] = {
    "k": (0.0, False),
    "Fs": (0.0, False),
    "gamma": (0.0, True),
    "G_slip": (0.0, True),
    "d": (0.0, False),
    "static": (1.0, True),
    "c": (0.0, True),
}
OF_EVERY_LAW = {"k/m": "s^-2", "k": "N/m", "c/m": "s^-1", "c": "N s/m", "v_dr": "m/s", "x0": "m"}
OF_A_RAMP = {"d": "m/s", "static": ""}  # the second of the six alone
NO_LIMIT = (-math.inf, True)
PER_MASS = "/m"
LAST_CYCLE = 100_000  # largest number of a cycle: no record holds as many
BY_FORMULA = {"G_slip/m", "G_slip"}  # parameters of the six that are no unknowns of their kernels


class Given(NamedTuple):
    """Bounds of a parameter, equal where it is fixed, and its first value, if any."""

    low: float = -math.inf
    high: float = math.inf
    start: float | None = None

    @property
    def fixed(self) -> bool:
        return self.low == self.high


@dataclass(frozen=True, eq=False)
class Competitors:
    """The laws that compete; repeated laws, unknown parameters and impossible values raise InputError."""

    laws: tuple[Law, ...] = tuple(SIX.values())
    fix: Mapping[str, float] = field(default_factory=dict)  # by the names of parameters
    bounds: Mapping[str, Bound] = field(default_factory=dict)
    start: Mapping[str, float] = field(default_factory=dict)
    in_newtons: tuple[str, ...] = field(default=(), init=False)  # names given with a unit that needs the mass

    def __post_init__(self) -> None:
        if not self.laws:
            raise InputError("no law to fit", "--laws", "choose 1 to 6, such as 1-6 or 3,5")
        names = [law.name for law in self.laws]
        twice = [name for name in names if names.count(name) > 1]
        if twice:
            raise InputError(f"two laws have the name {twice[0]}", "--law", "give each law a name of its own")
        newtons: set[str] = set()
        for flag, kind in (("--fix", "fix"), ("--bound", "bounds"), ("--start", "start")):
            object.__setattr__(self, kind, self._in_numbers(getattr(self, kind), flag, newtons))
        object.__setattr__(self, "in_newtons", tuple(sorted(newtons)))
        for name, (low, high) in self.bounds.items():
            if low is not None and high is not None and not low < high:
                raise InputError(f"bounds of {name} are {low:g} and {high:g}", "--bound", "give the lower one first")
            if name in self.fix:
                raise InputError(f"{name} is fixed and has bounds", "--bound", "give one of the two")
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
        """Return the competitors that Python code names: numbers, published names, custom laws."""
        found: list[Law] = []
        several = isinstance(laws, Iterable) and not isinstance(laws, str)
        for one in laws if several else [laws]:  # type: ignore[union-attr]
            if not isinstance(one, Integral | str | Law):
                do = "give numbers, names or fitting.Law: laws=(1, 5), laws='1-6,stribeck'"
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
        """Those of the six."""
        return tuple(law for law in self.laws if law.number)

    @property
    def formulas(self) -> tuple[Law, ...]:
        return tuple(law for law in self.laws if not law.number)

    def asks(self, law: Law) -> bool:
        """Return whether a law was named."""
        return any(own.name == law.name for own in self.laws)

    def by_kernel(self, law: Law) -> bool:
        """Return whether a law's own kernel follows it with what is given of its parameters."""
        return law.has_kernel and not BY_FORMULA & self.of_law(law).keys()

    @property
    def searched(self) -> tuple[Law, ...]:
        """The laws of the six that are fitted: all six where a formula competes, since it starts from them."""
        return self.laws if all(map(self.by_kernel, self.laws)) else tuple(SIX.values())

    def of_law(self, law: Law) -> dict[str, Given]:
        """Return the conditions on a law's parameters, named without the law; impossible values raise InputError."""
        given_of: dict[str, Given] = {}
        for kind, given in (("bounds", self.bounds), ("start", self.start), ("fix", self.fix)):
            for name, value in given.items():
                own_name = _named(name, law)
                if own_name is not None:
                    given_of[own_name] = _with(given_of.get(own_name, Given()), kind, value)
        own_names = () if law.number else law.curve.parameters
        for name, one in given_of.items():
            plain = "" if name in own_names else name.removesuffix(PER_MASS)
            _check(name, one, *LEAST_VALUES.get(plain, NO_LIMIT))
        return given_of

    def _in_numbers(self, given: Mapping[str, Any], flag: str, newtons: set[str]) -> dict[str, Any]:
        """Return values as numbers in the unit of the results; adds names whose unit has newtons to ``newtons``."""
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
                what = f"{name} has another unit in each law"
                raise InputError(what, flag, f"name the law: {self.laws[-1].name}.{name}")
            own, number = readings.pop()
            if own in found or (own != name and own in given):
                raise InputError(f"{own} is given twice", flag, "leave one out")
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
        return InputError(f"no law that is fitted has a parameter {name}", flag, nearest(name, list(choices)))


def units_of(law: Law) -> dict[str, str]:
    """Return the unit in the results of each parameter that can be given."""
    own = {name: law.unit(name, newtons=True) for name in law.curve.parameters}
    per_mass = {f"{name}{PER_MASS}": law.unit(name) for name in own if law.dimensions.get(name, (0, 0))[0]}
    ramp = {name: unit for name, unit in OF_A_RAMP.items() if law.ramp and (law.number or name == "d")}
    return {**OF_EVERY_LAW, **ramp, **per_mass, **own}


def _named(name: str, law: Law) -> str | None:
    """Return a parameter's name without the law's; None where the law has no such parameter."""
    prefix, dot, bare = name.partition(".")
    if dot and prefix != law.name:
        return None
    bare = bare if dot else name
    return bare if bare in units_of(law) else None


def _read_value(name: str, value: Any, law: Law, flag: str, *, typed: bool) -> tuple[str, Any]:
    """Return the name, per unit mass if the value's unit is, and the value as a number."""
    own, known = str(_named(name, law)), units_of(law)
    if typed and f"{own}{PER_MASS}" in known:
        with suppress(InputError):
            return f"{name}{PER_MASS}", in_unit(value, known[f"{own}{PER_MASS}"], name, flag)
    return name, in_unit(value, known[own], name, flag)


def _with(given: Given, kind: str, value: float | Bound) -> Given:
    """Return the conditions with one more; a fixed value replaces all."""
    if kind == "bounds":
        low, high = value  # type: ignore[misc]
        return given._replace(
            low=NO_LIMIT[0] if low is None else float(low), high=math.inf if high is None else float(high)
        )
    number = float(value)  # type: ignore[arg-type]
    return Given(number, number, number) if kind == "fix" else given._replace(start=number)


def _check(name: str, given: Given, least: float, itself: bool) -> None:
    """Raise InputError for values below ``least``, or equal to it unless ``itself``."""
    for value in (given.high, given.start):
        if value is not None and (math.isnan(value) or value < least or (value == least and not itself)):
            do = f"it must be {'at least' if itself else 'above'} {least:g}"
            raise InputError(f"{name} is {value:g}", "--fix" if given.fixed else "--bound", do)
    if given.start is not None and not given.low <= given.start <= given.high:
        what = f"{name} is {given.start:g}, not within {given.low:g} and {given.high:g}"
        raise InputError(what, "--start", "give a first value within the bounds")


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
            raise InputError(f"unknown law {unknown[0]}", where, "choose 1 to 6, such as 1-6 or 3,5")
        found += [SIX[number] for number in listed]
    return found


def numbers(text: str, flag: str) -> list[int]:
    """Return the whole numbers of a list such as ``1-3,6``; other text raises InputError."""
    listed: list[int] = []
    for part in filter(None, (piece.strip() for piece in text.split(","))):
        first, dash, last = part.partition("-")
        try:
            low = int(first)
            high = int(last) if dash else low
        except ValueError:
            raise InputError(f"{part!r} is not a number or range", flag, "write for example 1-3,6") from None
        if not 1 <= low <= high <= LAST_CYCLE:
            raise InputError(f"{part!r} is not an increasing range from 1", flag, "write for example 1-3,6")
        listed.extend(range(low, high + 1))
    return listed


def _pairs(typed: Iterable[str], flag: str) -> Iterator[tuple[str, str]]:
    """Yield name and value of each NAME=VALUE."""
    seen: set[str] = set()
    for text in typed:
        name, equals, value = (part.strip() for part in text.partition("="))
        if not equals or not name or not value:
            what = "LO:HI" if flag == "--bound" else "VALUE"
            do = f"write for example gamma={'0:20' if flag == '--bound' else '9.6'}"
            raise InputError(f"{text!r} is not NAME={what}", flag, do)
        if name in seen:
            raise InputError(f"{name} is given twice", flag, "leave one out")
        seen.add(name)
        yield name, value


def _interval(text: str, name: str) -> tuple[str | None, str | None]:
    """Return the bounds of LO:HI; either may be missing, and a unit after HI alone is that of both."""
    low, colon, high = (part.strip() for part in text.partition(":"))
    if not colon or not (low or high):
        raise InputError(f"bounds of {name} are {text!r}", "--bound", "write LO:HI, LO: or :HI")
    if low and units.typed_unit(high) and not units.typed_unit(low):
        low = f"{low} {units.typed_unit(high)}"
    return low or None, high or None
