"""Quantities as people type them: ``1 kg``, ``300 g +- 1 g``, ``12 cm``, ``400 fps``; a bare number is SI.

Units are case-sensitive, as SI is (mN is not MN); the letter u stands for either form of the Greek mu.  A decimal
comma is refused, since ``1,000 g`` has two readings.
"""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from numbers import Real
from typing import Any

from stickslip.errors import InputError, nearest


@dataclass(frozen=True)
class Measured:
    """A measured quantity and its standard deviation (0 when it is exact or was not stated)."""

    value: float
    sd: float = 0.0


# A quantity of a rig as Python code states it: a number in SI, value and standard deviation, or text with a unit.
Stated = float | Sequence[float] | str | Measured

# Dimension -> its SI unit, then every unit known for it with its size in SI.
UNITS: dict[str, dict[str, float]] = {
    "length": {"m": 1.0, "km": 1e3, "dm": 0.1, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "nm": 1e-9}
    | {"in": 0.0254, "inch": 0.0254, "ft": 0.3048},
    "time": {"s": 1.0, "sec": 1.0, "seconds": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9} | {"min": 60.0, "h": 3600.0},
    "mass": {"kg": 1.0, "g": 1e-3, "mg": 1e-6, "t": 1e3, "lb": 0.45359237, "oz": 0.028349523125},
    "rate": {"Hz": 1.0, "kHz": 1e3, "MHz": 1e6, "fps": 1.0, "1/s": 1.0, "/s": 1.0},
    "speed": {"m/s": 1.0, "cm/s": 1e-2, "mm/s": 1e-3, "um/s": 1e-6}
    | {"m/min": 1 / 60, "mm/min": 1e-3 / 60, "km/h": 1 / 3.6, "in/s": 0.0254},
    "stiffness": {"N/m": 1.0, "N/cm": 100.0, "N/mm": 1e3, "kN/m": 1e3, "mN/m": 1e-3, "mN/mm": 1.0, "kg/s^2": 1.0}
    | {"lbf/in": 175.12683524647636},
    "damping": {"N s/m": 1.0, "N*s/m": 1.0, "Ns/m": 1.0, "kg/s": 1.0, "mN s/m": 1e-3, "N s/mm": 1e3},
    "angle": {"rad": 1.0, "mrad": 1e-3, "deg": math.pi / 180, "°": math.pi / 180},
    "angular frequency": {"rad/s": 1.0, "Hz": 2 * math.pi, "1/s": 1.0, "rpm": math.pi / 30},
    "force": {"N": 1.0, "kN": 1e3, "mN": 1e-3, "uN": 1e-6, "gf": 9.80665e-3, "kgf": 9.80665, "lbf": 4.4482216152605},
}
EXAMPLES = {"length": "12 cm", "time": "20 ms", "mass": "300 g", "rate": "400 fps"} | {
    "speed": "22 cm/s",
    "stiffness": "10.5 N/m",
    "damping": "0.02 N s/m",
    "force": "0.5 N",
    "angle": "90 deg",
    "angular frequency": "5.9 rad/s",
}

# The dimension of each quantity of a rig.
OF_QUANTITY = {"mass": "mass", "stiffness": "stiffness", "damping": "damping", "belt_speed": "speed"} | dict.fromkeys(
    ("metres_per_count", "belt_metres_per_count", "datum", "x0"), "length"
)

# The rule that each value must obey; None where every finite number will do.
QUANTITIES: dict[str, str | None] = {
    "mass": "positive",
    "stiffness": "positive",
    "damping": "not negative",
    "belt_speed": None,
    "metres_per_count": "not zero",
    "datum": None,
    "belt_metres_per_count": "not zero",
    "x0": None,
}
_RULES = {"positive": lambda x: x > 0, "not negative": lambda x: x >= 0, "not zero": lambda x: x != 0}
# What composed units are made of, as powers of kg, m and s.
COMPOSED = {"mass": (1, 0, 0), "length": (0, 1, 0), "time": (0, 0, 1), "force": (1, 1, -2), "rate": (0, 0, -1)}

_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_QUANTITY = re.compile(rf"({_NUMBER})\s*(.*)", re.DOTALL)
_FACTOR = re.compile(r"([A-Za-z]+)\^?([+-]?\d+)?|1")
_PLUS_MINUS = re.compile(r"±|\+-|\+/-")


def quantity(text: str, dimension: str, where: str) -> float:
    """Return a typed quantity in SI; a bare number is SI, and an error (+-) is an InputError."""
    if _PLUS_MINUS.search(text):
        raise InputError(f"{text!r} has an error, which is not accepted here", where, "give only the value")
    value, unit = _split_unit(text, dimension, where)
    return value * _get_size(unit, text, dimension, where)


def measured(text: str, dimension: str, where: str) -> Measured:
    """Return a typed quantity with its error in SI: ``300 g +- 1 g``, ``0.300 +- 0.001 kg``, ``300 g``."""
    parts = _PLUS_MINUS.split(text.strip())
    if len(parts) > 2:
        raise InputError(f"{text!r} has more than one +-", where, f"write, for example, {EXAMPLES[dimension]!r}")
    if len(parts) == 1:
        return Measured(quantity(text, dimension, where))
    (value, value_unit), (sd, sd_unit) = (_split_unit(part, dimension, where) for part in parts)
    if value_unit and not sd_unit:
        raise InputError(f"{text!r} has an error without a unit", where, f"did you mean '{text.strip()} {value_unit}'?")
    size = _get_size(sd_unit, text, dimension, where)
    if sd < 0:
        raise InputError(f"{text!r} has a negative standard deviation", where, "write it as a positive number")
    return Measured(value * (_get_size(value_unit, text, dimension, where) if value_unit else size), sd * size)


def check_measured(key: str, value: float, sd: float, where: str) -> Measured:
    """Return the measured quantity ``key``; InputError when its value or error is impossible."""
    rule = QUANTITIES[key]
    if not math.isfinite(value) or (rule is not None and not _RULES[rule](value)):
        raise InputError(f"{key} is {value:g}", where, f"it must be {rule or 'a finite number'}")
    if not (math.isfinite(sd) and sd >= 0):
        raise InputError(f"{key}_sd is {sd:g}", where, "the standard deviation must be a finite number, not below 0")
    return Measured(value, sd)


STATED_SD = 0.01  # of a value that was stated without an error: people read a speed, a mass or a spring to about 1 %


def with_error(stated: Measured) -> Measured:
    """Return a stated value with an error: `STATED_SD` of it where none was given."""
    return stated if stated.sd > 0 else Measured(stated.value, STATED_SD * abs(stated.value))


def read_stated(value: Stated | None, key: str) -> Measured | None:
    """Return the rig's quantity ``key`` from Python: a number in SI, (value, sd), or text with a unit."""
    if value is None:
        return None
    measurement = in_si(value, OF_QUANTITY[key], key)
    return check_measured(key, measurement.value, measurement.sd, key)


def read_all_stated(**values: Stated | None) -> dict[str, Measured]:
    """Return those of a rig's quantities that are not None, each by `read_stated`."""
    return {key: measurement for key, value in values.items() if (measurement := read_stated(value, key)) is not None}


def in_si(value: Stated, dimension: str, key: str) -> Measured:
    """Return a quantity of any dimension from Python, as `read_stated` does; ``key`` is its name."""
    if isinstance(value, Measured):
        return value
    if isinstance(value, str):
        return measured(value, dimension, key)
    parts: tuple[Any, ...] = tuple(value) if isinstance(value, Sequence) and len(value) == 2 else (value,)
    if not all(isinstance(part, Real) and not isinstance(part, bool) for part in parts):
        do = f"pass a number in {si_unit(dimension)}, (value, sd), or text such as {EXAMPLES[dimension]!r}"
        raise InputError(f"{key} is {value!r:.60}", key, do)
    return Measured(*map(float, parts))


def exact_in_si(value: Stated | None, dimension: str, key: str) -> float | None:
    """Return a number in SI from Python, None where there is none; a standard deviation is an InputError."""
    if value is None:
        return None
    measurement = in_si(value, dimension, key)
    if measurement.sd or (isinstance(value, str) and _PLUS_MINUS.search(value)):
        raise InputError(f"{value!r} has an error, which is not accepted here", key, "give only the value")
    return measurement.value


def in_unit(text: str, unit: str, name: str, where: str) -> float:
    """Return a typed value of a parameter in its unit, such as ``m s^-2``; a bare number is in that already."""
    parts = _QUANTITY.fullmatch(text.strip())
    if not parts or parts[2].startswith(",") or not math.isfinite(float(parts[1])):
        hint = " with a decimal point" if "," in text else ""
        raise InputError(
            f"{name} is {text!r}, not a number", where, f"use a number{hint}{f' in {unit}' if unit else ''}"
        )
    if parts[2].strip() in ("", unit):
        return float(parts[1])
    (size, dimension), (own_size, own_dimension) = _composed(parts[2]), _composed(unit)
    if dimension is None or dimension != own_dimension:
        do = f"use a number in {unit}, or one with a unit of this kind" if unit else "use a number without a unit"
        raise InputError(f"{name} is {text!r}, but {parts[2].strip()!r} is not a unit of this quantity", where, do)
    return float(parts[1]) * size / own_size


def typed_unit(text: str) -> str:
    """Return what stands behind the number of a typed value."""
    parts = _QUANTITY.fullmatch(text.strip())
    return "" if parts is None else parts[2].strip()


def _composed(unit: str) -> tuple[float, tuple[int, int, int] | None]:
    """Return the size in SI of a product of powers of units, and its powers of kg, m and s; None if one is unknown."""
    size, powers = 1.0, [0, 0, 0]
    for k, part in enumerate(_spell_latin(unit).replace("²", "^2").replace("·", " ").replace("*", " ").split("/")):
        for n, factor in enumerate(part.split()):
            match = _FACTOR.fullmatch(factor)
            power = int(match[2] or 1) if match else 0
            power *= -1 if k and not n else 1
            name = match[1] if match else ""
            base = next((key for key in COMPOSED if name in UNITS[key]), None)
            if match is None or (name and base is None):
                return 1.0, None
            if base is not None:
                size *= UNITS[base][name] ** power
                powers = [own + power * more for own, more in zip(powers, COMPOSED[base], strict=True)]
    return size, (powers[0], powers[1], powers[2])


def unit_size(text: str, dimension: str, where: str) -> float:
    """Return the size in SI of a unit, or of a multiple of one: ``cm`` 0.01, ``0.25 mm`` 2.5e-4 (a pixel)."""
    if text.strip()[:1].isdigit() or text.strip()[:1] in (".", "-", "+"):
        size = quantity(text, dimension, where)
    else:
        size = _get_size(text.strip(), text, dimension, where)
    if size == 0:
        raise InputError(f"{text!r} is zero", where, f"give a unit, for example {si_unit(dimension)!r}")
    return size


def is_unit(unit: str, dimension: str) -> bool:
    return _spell_latin(unit) in UNITS[dimension]


def si_unit(dimension: str) -> str:
    return next(iter(UNITS[dimension]))


def _split_unit(text: str, dimension: str, where: str) -> tuple[float, str]:
    parts = _QUANTITY.fullmatch(text.strip())
    if not parts or parts[2].startswith(","):
        hint = "with a decimal point, " if "," in text else ""
        raise InputError(f"{text!r} is not a valid {dimension}", where, f"write it {hint}like {EXAMPLES[dimension]!r}")
    value = float(parts[1])
    if not math.isfinite(value):
        raise InputError(f"{text!r} is too large", where, f"write, for example, {EXAMPLES[dimension]!r}")
    return value, parts[2].strip()


def _get_size(unit: str, text: str, dimension: str, where: str) -> float:
    if not unit:
        return 1.0
    table = UNITS[dimension]
    unit = _spell_latin(unit)
    if unit not in table:
        what = f"{unit!r} is not a unit of {dimension}" + (f" (in {text!r})" if text.strip() != unit else "")
        raise InputError(what, where, nearest(unit, list(table)))
    return table[unit]


def _spell_latin(unit: str) -> str:
    return unit.replace("\N{MICRO SIGN}", "u").replace("\N{GREEK SMALL LETTER MU}", "u")
