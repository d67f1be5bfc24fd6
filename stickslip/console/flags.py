"""Flags whose value is a quantity with a unit: the command receives it in SI, checked."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any

import cyclopts
from cyclopts import Group, Parameter

from stickslip.errors import InputError
from stickslip.units import check_measured

# Groups of the help, in this order.
LAWS, RIG, PART, OUTPUT, RUNS, NOTES = (
    Group(title, sort_key=place)
    for place, title in enumerate(("Laws", "What you know", "Which part", "Output", "Many runs", "Notes"))
)
OF_PART = Parameter(group=PART)
Force = Annotated[bool, Parameter(name="--force", negative=(), help="Replace an existing output file.", group=OUTPUT)]
Plot = Annotated[
    Path | None, Parameter(name=["--plot", "-o", "--output"], help="Draw the result: .png, .svg or .pdf.", group=OUTPUT)
]


def check_plot(plot: Path | None, force: bool) -> None:
    """Refuse a picture that could not be written before anything is computed: InputError of `stickslip.output.plot`."""
    if plot is not None:
        from stickslip.output.plot import check_place

        check_place(plot, force=force)


def measured(
    name: str, dimension: str, text: str, key: str = "", word: str = "", old_name: str | None = None
) -> Parameter:
    """Return a flag for a `Measured` in the range of the rig's quantity ``key``, or for the word ``word`` itself."""

    def convert(typed: str) -> Any:
        from stickslip import units

        if word and typed == word:
            return word
        value = units.measured(typed, dimension, name)
        return check_measured(key, value.value, value.sd, name) if key else value

    return Parameter.combine(_make_flag(name, convert, text), Parameter(group=RIG, alias=old_name))


def quantity(name: str, dimension: str, text: str) -> Parameter:
    """Return the flag ``name`` for a number with a unit of that dimension, or a bare SI number: '20 s', '1.5 min'."""

    def convert(typed: str) -> float:
        from stickslip import units

        return units.quantity(typed, dimension, name)

    return _make_flag(name, convert, text)


def whole_rate(name: str, text: str) -> Parameter:
    """Return the flag ``name`` for a rate in whole Hz: '1000', '1 kHz'."""

    def convert(typed: str) -> int:
        from stickslip import units

        rate_hz = units.quantity(typed, "rate", name)
        if not rate_hz.is_integer():
            raise InputError(f"{typed!r} is not a whole number of Hz", name, "use a whole number, such as 1000")
        return int(rate_hz)

    return _make_flag(name, convert, text)


def rate(name: str, text: str) -> Parameter:
    """Return the flag ``name`` for a positive rate in Hz: '400 fps', '1 kHz'."""

    def convert(typed: str) -> float:
        from stickslip import units

        rate_hz = units.quantity(typed, "rate", name)
        if rate_hz <= 0:
            raise InputError(f"{typed!r} is not positive", name, "use a rate such as '400 fps'")
        return rate_hz

    return _make_flag(name, convert, text)


def word(name: str, text: str) -> Parameter:
    """Return the flag ``name`` whose value is the word that was typed."""
    return _make_flag(name, str, text)


def _make_flag(name: str, convert: Callable[[str], Any], text: str) -> Parameter:
    """Return a flag of one word converted by ``convert``; unlike in cyclopts the word may begin with a minus."""

    def read(type_: Any, tokens: Sequence[cyclopts.Token]) -> Any:
        typed = tokens[0].value
        if typed.startswith("--"):
            raise InputError(f"has no value, because {typed!r} is also a flag", name, f"write a value after {name}")
        return convert(typed)

    return Parameter(
        name=name,
        converter=read,
        accepts_keys=False,
        n_tokens=1,
        allow_leading_hyphen=True,
        help=text,
        metavar="VALUE",
    )
