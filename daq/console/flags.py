"""Flags whose value is a quantity with a unit: the command receives it in SI, checked."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import cyclopts
from cyclopts import Parameter

from daq.errors import InputError
from daq.runfile.rig import checked

Force = Annotated[bool, Parameter(name="--force", negative=(), help="Replace an existing output file.")]
Plot = Annotated[Path | None, Parameter(name="--plot", help="Draw the result into this file (.png, .svg, .pdf).")]


def check_plot(plot: Path | None, force: bool) -> None:
    """Refuse a picture that could not be written before anything is computed: InputError of `daq.output.plot`."""
    if plot is not None:
        from daq.output.plot import check_place

        check_place(plot, force=force)


def measured(name: str, dimension: str, text: str, key: str = "") -> Parameter:
    """Return the flag ``name`` for a `daq.runfile.rig.Measured`: '300 g', '300 g +- 1 g'.

    ``key`` is the rig's quantity whose range the value must lie in; without it any value is accepted.
    """

    def convert(type_: Any, tokens: Sequence[cyclopts.Token]) -> Any:
        from daq.console import units

        found = units.measured(tokens[0].value, dimension, name)
        return checked(key, found.value, found.sd, name) if key else found

    return Parameter(name=name, converter=convert, accepts_keys=False, n_tokens=1, help=text)


def quantity(name: str, dimension: str, text: str, *, signed: bool = False) -> Parameter:
    """Return the flag ``name`` for a number with a unit of that dimension, or a bare SI number: '20 s', '1.5 min'.

    ``signed``: a value that begins with a minus is a value, not a flag.
    """

    def convert(type_: Any, tokens: Sequence[cyclopts.Token]) -> float:
        from daq.console import units

        return units.quantity(tokens[0].value, dimension, name)

    return Parameter(name=name, converter=convert, help=text, allow_leading_hyphen=signed)


def whole_rate(name: str, text: str) -> Parameter:
    """Return the flag ``name`` for a rate in whole Hz: '1000', '1 kHz'."""

    def convert(type_: Any, tokens: Sequence[cyclopts.Token]) -> int:
        from daq.console import units

        found = units.quantity(tokens[0].value, "rate", name)
        if not found.is_integer():
            raise InputError(f"{tokens[0].value!r} is not a whole number of Hz", name, "give one such as 1000")
        return int(found)

    return Parameter(name=name, converter=convert, help=text)


def rate(name: str, text: str) -> Parameter:
    """Return the flag ``name`` for a positive rate in Hz: '400 fps', '1 kHz'."""

    def convert(type_: Any, tokens: Sequence[cyclopts.Token]) -> float:
        from daq.console import units

        found = units.quantity(tokens[0].value, "rate", name)
        if found <= 0:
            raise InputError(f"{tokens[0].value!r} is not positive", name, "give a rate like '400 fps'")
        return found

    return Parameter(name=name, converter=convert, help=text)
