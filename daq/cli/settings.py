"""Settings: flag, else environment, else rig.toml, else user config, else default.

The keys are the flags of `BoardFlags`: --port is STICKSLIP_PORT in the environment, and ``port`` in a section [board].
A rig.toml is `daq.runfile.rig`'s calibration and, beside it, a section [board] with these keys.  The user config is
``$XDG_CONFIG_HOME/stickslip/config.toml`` (``~/.config`` where that is no absolute path): the section [board] alone,
and ``rig``.
"""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from stickslip import toml, user_folders
from stickslip.console.application import Whole
from stickslip.console.flags import whole_rate
from stickslip.errors import InputError, check_known
from stickslip.toml import check_keys, quote

KEYS: dict[str, type] = {"port": str, "protocol": str, "columns": str, "baud": int, "rate": int, "decoder": str}
FIELDS = {"rate": "rate_hz"}  # where a field of the request has another name than the key


@Parameter(name="*")
@dataclass(frozen=True)
class BoardFlags:
    """The flags about the board and its rig, as typed; an argument of a command, one flag for each field."""

    port: Annotated[str | None, Parameter(help="Device or URL of the board; by default the simulated rig.")] = None
    rate: Annotated[
        int | None,
        whole_rate(
            "--rate",
            "Sample rate, such as '1 kHz'; default 1000 Hz, or 512 Hz for qsb. With text lines the sketch sets "
            "the rate.",
        ),
    ] = None
    protocol: Annotated[
        str | None, Parameter(help="Format of the data: 'frames' (stickslip firmware, default), 'qsb' or 'text'.")
    ] = None
    columns: Annotated[
        str | None,
        Parameter(help="Columns of text lines, such as t_us,up,down; not needed for labelled lines such as t=1,pos=2."),
    ] = None
    decoder: Annotated[
        str | None, Parameter(help="Decoder of the board: 'x4', 'x1', 'jk', 'jk-latched' or 'two-counter'.")
    ] = None
    rig: Annotated[
        Path | None, Parameter(help="Calibration and board settings, as written by 'daq calibrate' (rig.toml).")
    ] = None
    baud: Annotated[
        int | None, Whole, Parameter(help="Baud rate of a serial line; default 115200, or 230400 for qsb.")
    ] = None


NO_FLAGS = BoardFlags()


def resolve(flags: BoardFlags) -> dict[str, Any]:
    """Return the settings from any source, by the fields of `daq.protocols.request.RecordRequest`."""
    user = _read_user_settings()
    named = os.environ.get("STICKSLIP_RIG") or user.get("rig")
    rig = flags.rig or (Path(named) if named else None)
    text = None if rig is None else toml.read_text(rig, "--rig")
    board = {} if text is None else read_board_section(text, str(rig))
    settings = {} if text is None else {"calibration": text}
    for key, kind in KEYS.items():
        value = getattr(flags, key)
        if value is None and (typed := os.environ.get(f"STICKSLIP_{key.upper()}")):
            value = _parse_value(typed, kind, f"STICKSLIP_{key.upper()}")
        for section in (board, user):
            value = section.get(key) if value is None else value
        if value not in (None, ""):
            settings[FIELDS.get(key, key)] = value
    return settings


def read_board_section(text: str, where: str) -> dict[str, Any]:
    """Return the section [board] of a TOML text; empty when there is none."""
    return _check_section(toml.parse(text, where).get("board", {}), where)


def format_board(settings: Mapping[str, Any]) -> str:
    """Return a section [board] with the result of `resolve`; empty when that is empty."""
    values = {key: settings[FIELDS.get(key, key)] for key in KEYS if FIELDS.get(key, key) in settings}
    lines = [f"{key} = {quote(value) if isinstance(value, str) else value}" for key, value in values.items()]
    return "\n".join(["[board]", *lines]) + "\n" if lines else ""


def _read_user_settings() -> dict[str, Any]:
    folder = user_folders.find_config()
    if folder is None:
        return {}
    path = folder / "stickslip" / "config.toml"
    try:
        if not path.is_file():
            return {}
    except OSError:  # a home directory without read permission
        return {}
    where = str(path)
    content = toml.parse(toml.read_text(path, where), where)
    for section in content:
        check_known(section, ["board", "rig"], "key", where)
    settings = _check_section(content.get("board", {}), where)
    if "rig" in content:
        if not isinstance(content["rig"], str):
            raise InputError(f"rig is {content['rig']!r}", where, "write the path of a rig.toml in quotes")
        settings["rig"] = content["rig"]
    return settings


def _check_section(section: Any, where: str) -> dict[str, Any]:
    for key, value in check_keys("board", section, list(KEYS), where).items():
        if isinstance(value, bool) or not isinstance(value, KEYS[key]):
            kind = "text in quotes" if KEYS[key] is str else "a whole number"
            raise InputError(f"board.{key} is {value!r}", where, f"write {kind}")
    return dict(section)


def _parse_value(text: str, kind: type, where: str) -> Any:
    if kind is str:
        return text
    if not text.isdecimal():
        raise InputError(f"{text!r} is not a whole number", where, "correct or unset it")
    return int(text)
