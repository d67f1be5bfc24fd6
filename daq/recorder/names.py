"""Names that the program completes: ``run-{n:03}.h5`` gets the next free number, ``run-{date}.h5`` the time."""

import re
import string
from datetime import datetime
from pathlib import Path

from stickslip.errors import InputError

FORMATS = {"n": r"(0?\d+)?d?", "date": ""}  # format of each field, as a regular expression
DO = "use {n}, {n:03} or {date}, as in 'run-{n:03}.h5'; write a literal brace twice"


def complete_name(path: Path) -> Path:
    """Fill in the fields of a file name: {n} is the next free number in the folder, {date} the local time."""
    if "{" not in path.name and "}" not in path.name:
        if "{" in str(path.parent):
            raise InputError(
                "the name of the folder contains a field", str(path), "use fields only in the name of the file"
            )
        return path
    try:
        parts = list(string.Formatter().parse(path.name))
    except ValueError as error:
        raise InputError(f"the pattern cannot be read: {error}", str(path), DO) from error
    for _, field, form, conversion in parts:
        if field is not None and (field not in FORMATS or conversion or not re.fullmatch(FORMATS[field], form or "")):
            raise InputError("contains an unknown field", str(path), DO)
    date = f"{datetime.now():%Y%m%d-%H%M%S}"
    return path.with_name(path.name.format(n=_find_next_number(path.parent, parts), date=date))


def _find_next_number(folder: Path, parts: list[tuple[str, str | None, str | None, str | None]]) -> int:
    """Return one more than the largest number that a run file or a journal of this pattern has."""
    kinds = {"n": r"(\d+)", "date": r"\d{8}-\d{6}", None: ""}
    pattern = re.compile("".join(re.escape(text) + kinds[field] for text, field, _, _ in parts) + r"(?:\.part)?")
    matches = [pattern.fullmatch(item.name) for item in folder.iterdir()] if folder.is_dir() else []
    return 1 + max((int(match[1]) for match in matches if match and match.re.groups), default=0)
