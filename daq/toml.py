"""TOML from people, boards and strangers: every fault of the text is one error that names its place."""

import tomllib
from typing import Any

from daq.errors import InputError


def parsed(text: str, where: str) -> dict[str, Any]:
    """Return the content of a TOML text.

    Raises
    ------
    InputError
        The text is not TOML (with the line), is nested too deeply, or holds a number of thousands of digits.
    """
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"invalid TOML: {error}", where, "correct that line") from error
    except RecursionError as error:
        raise InputError("is nested too deeply", where, "write sections of keys and values") from error
    except ValueError as error:
        raise InputError("holds a number of too many digits", where, "correct it") from error
