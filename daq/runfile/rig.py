"""Calibration of a rig: measured constants of encoder, mass, spring and belt, each with its standard deviation.

The text form is TOML, the same in a board's CONFIG frame and in a lab's ``rig.toml``::

    [rig]
    name = "thesis rig"
    mass = 0.3               # kg
    mass_sd = 0.0003
    belt_speed = 0.22        # m/s, positive towards +x
    x0 = 0.06                # m: the reading at the spring's rest position; instead of the encoder's datum
    [encoder]
    decoder = "x4"
    metres_per_count = 7.67e-6
    datum = 0.0              # m: position of count zero, from the spring's rest position
    belt_metres_per_count = 7.67e-6  # where the belt has an encoder of its own

A quantity that nobody measured is absent, never zero.  SI throughout; ``*_sd`` is one standard deviation.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

from stickslip import toml
from stickslip.errors import InputError, nearest
from stickslip.toml import check_keys, quote
from stickslip.units import OF_QUANTITY, QUANTITIES, Measured, check_measured, si_unit, with_error

DECODERS = ("x4", "x1", "jk", "jk-latched", "two-counter")
COUNTER_BITS = (8, 16, 24, 32)


@dataclass(frozen=True)
class Rig:
    """What is known of a rig beforehand.

    Notes
    -----
    A rig has a datum or an x0, not both: either says where the spring is at rest, for positions of its own.

    Not modelled: the correlation between these errors, and a cog whose pitch varies within a turn.
    """

    name: str = ""  # what the lab calls it
    decoder: str = "x4"  # one of `DECODERS`: how edges became counts
    metres_per_count: Measured | None = None  # metres of travel per count; negative when counting up means towards -x
    counts_per_revolution: int | None = None  # counts of one turn of the encoder
    counter_bits: int = 16  # width of the board's counters
    mass: Measured | None = None  # kg, N/m, N s/m, m/s (signed)
    stiffness: Measured | None = None
    # position of count zero relative to the spring's rest, m: -x0 of the readings.  It is added to them, so that
    # positions are measured from the spring's rest.
    datum: Measured | None = None
    damping: Measured | None = None
    belt_speed: Measured | None = None
    # metres of belt per count of the belt's own encoder; negative when counting up means towards -x
    belt_metres_per_count: Measured | None = None
    x0: Measured | None = None  # reading at the spring's rest, m.  The positions are the readings themselves.

    def __post_init__(self) -> None:
        if self.datum is not None and self.x0 is not None:
            raise InputError("datum and x0 are both given", "rig", "give only x0; the datum is -x0")

    @property
    def offset(self) -> float:
        """What was added to readings in m to make positions, m: the datum, or 0."""
        return 0.0 if self.datum is None else self.datum.value

    def resting_at(self, x0: Measured) -> "Rig":
        """Return the rig with the reading at the spring's rest, m, in place of a datum or another x0."""
        return replace(self, datum=None, x0=x0)

    def stating(self, values: Mapping[str, Measured | int]) -> "Rig":
        """Return the rig with some quantities replaced, by their attributes; an x0 takes the place of a datum."""
        changes: dict[str, Any] = dict(values)
        if "x0" in values:
            changes["datum"] = None
        return replace(self, **changes)

    @classmethod
    def from_toml(cls, text: str, where: str) -> "Rig":
        """Read a rig from TOML; ``where`` is its file or frame, for the messages."""
        values: dict[str, Any] = {}
        for section, content in toml.parse(text, where).items():
            if section == "board":
                continue  # how to reach the board: `daq.cli.settings`
            if section not in SECTIONS:
                raise InputError(f"unknown section [{section}]", where, nearest(section, list(SECTIONS)))
            values |= _read_section(section, content, where)
        if "datum" in values and "x0" in values:
            raise InputError("encoder.datum and rig.x0 are both given", where, "give only x0; the datum is -x0")
        return cls(**values)

    def to_toml(self) -> str:
        """Write the rig as TOML; `from_toml` reads back an equal rig."""
        lines: list[str] = []
        for section, keys in SECTIONS.items():
            lines.append(f"[{section}]")
            for key in keys:
                value = getattr(self, key)
                if isinstance(value, Measured):
                    lines.append(f"{key} = {float(value.value)!r}")
                    if value.sd:
                        lines.append(f"{key}_sd = {float(value.sd)!r}")
                elif isinstance(value, str):
                    lines.append(f"{key} = {quote(value)}")
                elif value is not None:
                    lines.append(f"{key} = {value}")
        return "\n".join(lines) + "\n"


class Replaced(NamedTuple):
    """A stored value that another one replaces: text, both values in SI, and their distance in standard deviations."""

    text: str
    value: float
    expected: float
    sigmas: float


def find_replaced(stored: Rig, used: Rig) -> list[Replaced]:
    """Return the stored quantities that others replace which lie outside both errors (`with_error`)."""
    replacements = []
    for name in QUANTITIES:
        if name == "datum":
            continue  # is -x0
        before, now = (_get_x0(rig) if name == "x0" else getattr(rig, name) for rig in (stored, used))
        if before is None or now is None:
            continue
        difference, errors = abs(now.value - before.value), (with_error(before).sd, with_error(now).sd)
        if difference > sum(errors):
            unit = si_unit(OF_QUANTITY[name])
            text = (
                f"{name}: {now.value:g} {unit} overrides the stored value, {before.value:g} {unit}, and the "
                "two differ by more than their errors"
            )
            sigmas = difference / math.hypot(*errors) if any(errors) else math.nan
            replacements.append(Replaced(text, now.value, before.value, sigmas))
    return replacements


def _get_x0(rig: Rig) -> Measured | None:
    return Measured(-rig.datum.value, rig.datum.sd) if rig.datum is not None else rig.x0


SECTIONS: dict[str, tuple[str, ...]] = {
    "rig": ("name", "mass", "stiffness", "damping", "belt_speed", "x0"),
    "encoder": (
        "decoder",
        "metres_per_count",
        "counts_per_revolution",
        "counter_bits",
        "datum",
        "belt_metres_per_count",
    ),
}


def _read_section(section: str, content: Any, where: str) -> dict[str, Any]:
    allowed = [*SECTIONS[section], *(f"{key}_sd" for key in SECTIONS[section] if key in QUANTITIES)]
    if isinstance(content, dict):
        for other, keys in SECTIONS.items():
            for key in content:
                if key not in allowed and key.removesuffix("_sd") in keys:
                    raise InputError(f"unknown key {section}.{key}", where, f"write it in the section [{other}]")
    check_keys(section, content, allowed, where)
    values: dict[str, Any] = {}
    for key in SECTIONS[section]:
        if key in QUANTITIES:
            if f"{key}_sd" in content and key not in content:
                raise InputError(f"{section}.{key}_sd requires {section}.{key}", where, f"add or remove {key}")
            if key in content:
                values[key] = check_measured(
                    key,
                    _read_number(content[key], f"{section}.{key}", where),
                    _read_number(content.get(f"{key}_sd", 0.0), f"{section}.{key}_sd", where),
                    where,
                )
        elif key in content:
            values[key] = _check_setting(key, content[key], section, where)
    return values


def _read_number(value: Any, key: str, where: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(f"{key} is {value!r}", where, "write a bare number in SI units")
    return float(value)


def _check_setting(key: str, value: Any, section: str, where: str) -> Any:
    if key == "name":
        if not isinstance(value, str):
            raise InputError(f"{section}.{key} is {value!r}", where, "write text in quotes")
    elif key == "decoder":
        if value not in DECODERS:
            raise InputError(f"{section}.{key} is {value!r}", where, nearest(str(value), DECODERS))
    elif isinstance(value, bool) or not isinstance(value, int) or value <= 0:
        raise InputError(f"{section}.{key} is {value!r}", where, "write a positive whole number")
    elif key == "counter_bits" and value not in COUNTER_BITS:
        raise InputError(f"{section}.{key} is {value}", where, f"known: {', '.join(map(str, COUNTER_BITS))}")
    return value
