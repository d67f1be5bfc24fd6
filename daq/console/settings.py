"""Where a setting comes from: flag > environment > rig.toml > user config > default.

===============  =====================  ==================  ===========================================================
flag             environment            [board] key         what
===============  =====================  ==================  ===========================================================
--port           STICKSLIP_PORT         port                a device or URL
--protocol       STICKSLIP_PROTOCOL     protocol            frames, qsb or text
--columns        STICKSLIP_COLUMNS      columns             columns of text lines
--baud           STICKSLIP_BAUD         baud                bits per second of a serial line
--rate           STICKSLIP_RATE         rate                samples per second
--decoder        STICKSLIP_DECODER      decoder             what the board is to decode with
--rig            STICKSLIP_RIG          (not there)         the rig.toml itself
===============  =====================  ==================  ===========================================================

A rig.toml is `daq.runfile.rig`'s calibration and, beside it, a section [board] with these keys.  The user config is
``$XDG_CONFIG_HOME/stickslip/config.toml`` (``~/.config`` without): the section [board] alone, and ``rig``.
"""

import os
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from daq.errors import InputError, nearest

KEYS: dict[str, type] = {"port": str, "protocol": str, "columns": str, "baud": int, "rate": int, "decoder": str}
FIELDS = {"rate": "rate_hz"}  # where a field of the request has another name than the key


def resolve(rig: Path | None = None, **flags: Any) -> dict[str, Any]:
    """Return the settings of a command that any place has, by the fields of `daq.protocols.request.RecordRequest`.

    ``calibration`` is the text of the rig.toml.

    Parameters
    ----------
    rig : Path, optional
        The flag --rig.
    **flags
        Values of the other flags by key; None for one that was not given.

    Raises
    ------
    InputError
        A file that is missing or no TOML, an unknown key (with its nearest neighbour), a value of the wrong kind.
    """
    user = _user()
    rig_name: Path | None = rig
    if rig_name is None and (named := os.environ.get("STICKSLIP_RIG") or user.pop("rig", None)):
        rig_name = Path(named)
    user.pop("rig", None)
    text = None if rig_name is None else _read(rig_name, "--rig")
    board = {} if text is None else board_section(text, str(rig_name))
    found = {} if text is None else {"calibration": text}
    for key, kind in KEYS.items():
        value = flags.get(key)
        if value is None and (typed := os.environ.get(f"STICKSLIP_{key.upper()}")):
            value = _typed(typed, kind, f"STICKSLIP_{key.upper()}")
        for section in (board, user):
            value = section.get(key) if value is None else value
        if value not in (None, ""):
            found[FIELDS.get(key, key)] = value
    return found


def board_section(text: str, where: str) -> dict[str, Any]:
    """Return the section [board] of a TOML text; empty when there is none."""
    try:
        section = tomllib.loads(text).get("board", {})
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"broken TOML: {error}", where, "mend that line") from error
    return _checked(section, where)


def board_toml(known: Mapping[str, Any]) -> str:
    """Return a section [board] with what `resolve` found; nothing where it found nothing."""
    from daq.runfile.rig import quoted

    values = {key: known[FIELDS.get(key, key)] for key in KEYS if FIELDS.get(key, key) in known}
    lines = [f"{key} = {quoted(value) if isinstance(value, str) else value}" for key, value in values.items()]
    return "\n".join(["[board]", *lines]) + "\n" if lines else ""


def user_config() -> Path:
    """Return where the user's own configuration is looked for."""
    home = os.environ.get("XDG_CONFIG_HOME")
    return (Path(home) if home else Path.home() / ".config") / "stickslip" / "config.toml"


def _user() -> dict[str, Any]:
    path = user_config()
    try:
        if not path.is_file():
            return {}
    except OSError:  # a home that may not be looked into
        return {}
    where = str(path)
    try:
        content = tomllib.loads(_read(path, where))
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"broken TOML: {error}", where, "mend that line") from error
    for section in content:
        if section not in ("board", "rig"):
            raise InputError(f"unknown key {section!r}", where, nearest(section, ["board", "rig"]))
    found = _checked(content.get("board", {}), where)
    if "rig" in content:
        if not isinstance(content["rig"], str):
            raise InputError(f"rig is {content['rig']!r}", where, "write the path of a rig.toml in quotes")
        found["rig"] = content["rig"]
    return found


def _read(path: Path, where: str) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except FileNotFoundError as error:
        raise InputError("no such file", str(path), f"check {where}") from error
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"cannot be read as text ({error})", str(path), "give a TOML file") from error


def _checked(section: Any, where: str) -> dict[str, Any]:
    if not isinstance(section, dict):
        raise InputError("board is a value, not a section", where, "write [board] above its keys")
    for key, value in section.items():
        if key not in KEYS:
            raise InputError(f"unknown key board.{key}", where, nearest(key, list(KEYS)))
        if isinstance(value, bool) or not isinstance(value, KEYS[key]):
            kind = "text in quotes" if KEYS[key] is str else "a whole number"
            raise InputError(f"board.{key} is {value!r}", where, f"write {kind}")
    return dict(section)


def _typed(text: str, kind: type, where: str) -> Any:
    if kind is str:
        return text
    if not text.isdecimal():
        raise InputError(f"{text!r} is no whole number", where, "mend it, or unset it")
    return int(text)
