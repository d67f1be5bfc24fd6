"""The header of a journal: what its fields are, and what they may hold.

A checksum guards it, so a value that cannot be true was written so: by another program, or to do harm.  Text is no such
value, whatever is in it: a board names itself, and a path is bytes.  What a run file cannot hold of it is escaped.
"""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from stickslip.errors import InputError
from stickslip.text import storable

# Rates that a board, a sketch or a QSB may have, Hz, with room on both sides.
SLOWEST_HZ, FASTEST_HZ = 1e-3, 1e7
MOST_SAMPLES = 2_000_000_000  # the run file's sample numbers (uint32) hold twice as many
LAST_NS = 4_102_444_800_000_000_000  # the year 2100
DIGEST = "sha256_raw"  # a field of the provenance that is made with the run file
DO = "keep it: its samples are there, but how they were recorded is not known"


def _text(value: Any) -> bool:
    return isinstance(value, str)


def _whole(least: int, most: int) -> Callable[[Any], bool]:
    return lambda value: isinstance(value, int) and not isinstance(value, bool) and least <= value <= most


def _rate(value: Any) -> bool:
    number = isinstance(value, int | float) and not isinstance(value, bool)
    return number and SLOWEST_HZ <= value <= FASTEST_HZ


def _texts(value: Any) -> bool:
    return isinstance(value, list) and all(map(_text, value))


def _named(value: Any, kind: Callable[[Any], bool]) -> bool:
    return isinstance(value, dict) and all(_is_name(name) and kind(item) for name, item in value.items())


def _is_name(name: str) -> bool:
    """Return whether a name can be that of a field of the run file."""
    return storable(name) == name and name not in ("", ".", "..", DIGEST) and "/" not in name


def _or_none(kind: Callable[[Any], bool]) -> Callable[[Any], bool]:
    return lambda value: value is None or kind(value)


_NS = _whole(0, LAST_NS)
_I8 = _whole(-(1 << 63), (1 << 63) - 1)
_FIELDS: dict[str, tuple[str, Callable[[Any], bool]]] = {
    "protocol": ("a text", _text),
    "columns": ("a text or nothing", _or_none(_text)),
    "decoder": ("a text or nothing", _or_none(_text)),
    "port": ("a text", _text),
    "baud": ("a rate in bits per second or nothing", _or_none(_whole(1, 1 << 31))),
    "rate_hz": (f"a rate of {SLOWEST_HZ:g} to {FASTEST_HZ:g} Hz", _rate),
    "samples": (f"1 to {MOST_SAMPLES} or nothing", _or_none(_whole(1, MOST_SAMPLES))),
    "title": ("a text", _text),
    "operator": ("a text", _text),
    "sample_name": ("a text", _text),
    "note": ("a text", _text),
    "tags": ("texts with names", lambda value: _named(value, _text)),
    "wall_ns": ("nanoseconds since 1970, before 2100", _NS),
    "monotonic_ns": ("nanoseconds", _NS),
    "utc_offset_s": ("seconds, less than a day", _whole(-86399, 86399)),
    "warnings": ("texts", _texts),
    "provenance": ("texts or whole numbers with names", lambda value: _named(value, lambda x: _text(x) or _I8(x))),
}
# Fields that a journal may lack, with what stands for them: those of version 0.1.0 have no notes.
_DEFAULTS: dict[str, Any] = {
    **dict.fromkeys(("columns", "decoder", "baud")),
    **dict.fromkeys(("sample_name", "note"), ""),
    "tags": {},
}


def parse(text: bytes, path: Path) -> dict[str, Any]:
    """Return a header; its texts are `stickslip.text.storable`.

    text: JSON.
    path: The journal, for the message.
    Raises InputError: it is no JSON object, or one of its fields cannot be true.
    """
    try:
        header = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError("its header is no JSON", str(path), DO) from error
    if not isinstance(header, dict):
        raise InputError("its header holds no fields", str(path), DO)
    for name, (what, may_be) in _FIELDS.items():
        if name in header and not may_be(header[name]):
            found = repr(header[name])
            found = found if len(found) <= 40 else found[:37] + "..."
            raise InputError(f"its header gives {name} as {found}, not {what}", str(path), DO)
    return {name: _storable(value) for name, value in header.items()}


def _storable(value: Any) -> Any:
    """Return a field with its texts as a run file can hold them (`stickslip.text.storable`)."""
    if isinstance(value, str):
        return storable(value)
    if isinstance(value, list):
        return [_storable(item) for item in value]
    return {name: _storable(item) for name, item in value.items()} if isinstance(value, dict) else value


def complete(header: dict[str, Any], path: Path) -> dict[str, Any]:
    """Return a header with every field that a run file needs; InputError where one is missing."""
    header = _DEFAULTS | header
    for name in _FIELDS:
        if name not in header:
            raise InputError(f"its header has no {name}", str(path), DO)
    return header
