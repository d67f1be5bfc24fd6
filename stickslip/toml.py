"""TOML from people, boards and strangers: every fault of the text is one error that names its place."""

import tomllib
from pathlib import Path
from typing import Any

from stickslip.errors import InputError, nearest


def read_text(path: Path, where: str) -> str:
    """Return the text of a file; ``where`` is what named it."""
    try:
        return path.read_text(encoding="utf-8")
    except FileNotFoundError as error:
        raise InputError("no such file", str(path), f"check {where}") from error
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"cannot be read as text ({error})", str(path), "use a TOML file") from error


def parse(text: str, where: str) -> dict[str, Any]:
    """Parse a TOML text of limited depth and whole numbers of 64 bits."""
    try:
        content = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"invalid TOML: {error}", where, "correct that line") from error
    except RecursionError as error:
        raise InputError("is nested too deeply", where, "write sections of keys and values") from error
    except ValueError as error:
        raise InputError("contains a number with too many digits", where, "correct it") from error
    if has_wide_number(content):
        raise InputError("contains a number with too many digits", where, "correct it")
    return content


def has_wide_number(content: Any) -> bool:
    """Return whether a whole number anywhere in a parsed text has more than 64 bits, with its sign."""
    values_left = [content]
    while values_left:
        value = values_left.pop()
        if isinstance(value, int) and not -(2**63) <= value < 2**63:
            return True
        if isinstance(value, dict | list):
            values_left += value.values() if isinstance(value, dict) else value
    return False


def check_keys(section: str, content: Any, allowed: list[str], where: str) -> dict[str, Any]:
    """Return the content of a TOML section; InputError for another type or an unknown key (the nearest is named)."""
    if not isinstance(content, dict):
        raise InputError(f"{section} is a value, not a section", where, f"write [{section}] above its keys")
    for key in content:
        if key not in allowed:
            raise InputError(f"unknown key {section}.{key}", where, nearest(key, allowed))
    return content


def quote(text: str) -> str:
    """Return a text as TOML's basic string: quotes, backslashes and control characters (DEL too) escaped."""
    out = "".join(f"\\u{ord(c):04x}" if ord(c) < 32 or ord(c) == 127 else f"\\{c}" if c in '"\\' else c for c in text)
    return f'"{out}"'
