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
DO = "keep it: its samples are complete, but the settings of the recording are unknown"


def _is_text(value: Any) -> bool:
    return isinstance(value, str)


def _make_whole_check(least: int, most: int) -> Callable[[Any], bool]:
    return lambda value: isinstance(value, int) and not isinstance(value, bool) and least <= value <= most


def _is_rate(value: Any) -> bool:
    number = isinstance(value, int | float) and not isinstance(value, bool)
    return number and SLOWEST_HZ <= value <= FASTEST_HZ


def _is_texts(value: Any) -> bool:
    return isinstance(value, list) and all(map(_is_text, value))


def _is_mapping_of(value: Any, kind: Callable[[Any], bool]) -> bool:
    return isinstance(value, dict) and all(_is_name(name) and kind(item) for name, item in value.items())


def _is_name(name: str) -> bool:
    """Return whether a name can be that of a field of the run file."""
    return storable(name) == name and name not in ("", ".", "..", DIGEST) and "/" not in name


def _allow_none(kind: Callable[[Any], bool]) -> Callable[[Any], bool]:
    return lambda value: value is None or kind(value)


_NS = _make_whole_check(0, LAST_NS)
_I8 = _make_whole_check(-(1 << 63), (1 << 63) - 1)


def _is_provenance(value: Any) -> bool:
    return _is_mapping_of(value, lambda item: _is_text(item) or _I8(item))


_FIELDS: dict[str, tuple[str, Callable[[Any], bool]]] = {
    "protocol": ("a text", _is_text),
    "columns": ("a text or nothing", _allow_none(_is_text)),
    "decoder": ("a text or nothing", _allow_none(_is_text)),
    "port": ("a text", _is_text),
    "baud": ("a rate in bits per second or nothing", _allow_none(_make_whole_check(1, 1 << 31))),
    "rate_hz": (f"a rate of {SLOWEST_HZ:g} to {FASTEST_HZ:g} Hz", _is_rate),
    "samples": (f"1 to {MOST_SAMPLES} or nothing", _allow_none(_make_whole_check(1, MOST_SAMPLES))),
    "title": ("a text", _is_text),
    "operator": ("a text", _is_text),
    "sample_name": ("a text", _is_text),
    "note": ("a text", _is_text),
    "tags": ("texts with names", lambda value: _is_mapping_of(value, _is_text)),
    "wall_ns": ("nanoseconds since 1970, before 2100", _NS),
    "monotonic_ns": ("nanoseconds", _NS),
    "utc_offset_s": ("seconds, less than a day", _make_whole_check(-86399, 86399)),
    "warnings": ("texts", _is_texts),
    "provenance": (
        "texts or whole numbers with names",
        _is_provenance,
    ),
}
# Fields that a journal may lack, with what stands for them: those of version 0.1.0 have no notes.
_DEFAULTS: dict[str, Any] = {
    **dict.fromkeys(("columns", "decoder", "baud")),
    **dict.fromkeys(("sample_name", "note"), ""),
    "tags": {},
}


def parse(text: bytes, path: Path) -> dict[str, Any]:
    """Parse a header from JSON; its texts are `stickslip.text.storable`."""
    try:
        header = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError("its header is not JSON", str(path), DO) from error
    if not isinstance(header, dict):
        raise InputError("its header contains no fields", str(path), DO)
    for name, (what, may_be) in _FIELDS.items():
        if name in header and not may_be(header[name]):
            shown_value = repr(header[name])
            shown_value = shown_value if len(shown_value) <= 40 else shown_value[:37] + "..."
            raise InputError(f"{name} in its header is {shown_value} instead of {what}", str(path), DO)
    return {name: _storable(value) for name, value in header.items()}


def _storable(value: Any) -> Any:
    if isinstance(value, str):
        return storable(value)
    if isinstance(value, list):
        return [_storable(item) for item in value]
    return {name: _storable(item) for name, item in value.items()} if isinstance(value, dict) else value


def complete(header: dict[str, Any], path: Path) -> dict[str, Any]:
    """Return a header with every field that a run file needs."""
    header = _DEFAULTS | header
    for name in _FIELDS:
        if name not in header:
            raise InputError(f"its header has no {name}", str(path), DO)
    return header
