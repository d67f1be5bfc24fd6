"""Flags whose value is a quantity with a unit: the command receives it in SI, checked."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any

import cyclopts
from cyclopts import Parameter

from stickslip.errors import InputError
from stickslip.units import checked

Force = Annotated[bool, Parameter(name="--force", negative=(), help="Replace an existing output file.")]
Plot = Annotated[Path | None, Parameter(name="--plot", help="Draw the result into this file (.png, .svg, .pdf).")]


def check_plot(plot: Path | None, force: bool) -> None:
    """Refuse a picture that could not be written before anything is computed: InputError of `stickslip.output.plot`."""
    if plot is not None:
        from stickslip.output.plot import check_place

        check_place(plot, force=force)


def measured(name: str, dimension: str, text: str, key: str = "", word: str = "") -> Parameter:
    """Return the flag ``name`` for a `stickslip.units.Measured`: '300 g', '300 g +- 1 g', '-60 mm +- 0.1 mm'.

    ``key`` is the rig's quantity whose range the value must lie in; without it any value is accepted.  ``word`` is one
    that may stand in place of a value, and is then the flag's.
    """

    def convert(typed: str) -> Any:
        from stickslip import units

        if word and typed == word:
            return word
        found = units.measured(typed, dimension, name)
        return checked(key, found.value, found.sd, name) if key else found

    return _valued(name, convert, text)


def quantity(name: str, dimension: str, text: str) -> Parameter:
    """Return the flag ``name`` for a number with a unit of that dimension, or a bare SI number: '20 s', '1.5 min'."""

    def convert(typed: str) -> float:
        from stickslip import units

        return units.quantity(typed, dimension, name)

    return _valued(name, convert, text)


def whole_rate(name: str, text: str) -> Parameter:
    """Return the flag ``name`` for a rate in whole Hz: '1000', '1 kHz'."""

    def convert(typed: str) -> int:
        from stickslip import units

        found = units.quantity(typed, "rate", name)
        if not found.is_integer():
            raise InputError(f"{typed!r} is not a whole number of Hz", name, "give one such as 1000")
        return int(found)

    return _valued(name, convert, text)


def rate(name: str, text: str) -> Parameter:
    """Return the flag ``name`` for a positive rate in Hz: '400 fps', '1 kHz'."""

    def convert(typed: str) -> float:
        from stickslip import units

        found = units.quantity(typed, "rate", name)
        if found <= 0:
            raise InputError(f"{typed!r} is not positive", name, "give a rate like '400 fps'")
        return found

    return _valued(name, convert, text)


def word(name: str, text: str) -> Parameter:
    """Return the flag ``name`` whose value is the word that was typed."""
    return _valued(name, str, text)


def _valued(name: str, convert: Callable[[str], Any], text: str) -> Parameter:
    """Return a flag whose value is one word of the command line, converted by ``convert``.

    cyclopts takes a word with a minus before it for a flag unless the whole of it is a number: '-60 mm' was one.  Here
    it is the value, and only what begins with two is a flag whose own value is missing.
    """

    def read(type_: Any, tokens: Sequence[cyclopts.Token]) -> Any:
        typed = tokens[0].value
        if typed.startswith("--"):
            raise InputError(f"has no value: {typed} stands in its place", name, f"write a value after {name}")
        return convert(typed)

    return Parameter(name=name, converter=read, accepts_keys=False, n_tokens=1, allow_leading_hyphen=True, help=text)
