"""Flags of the notes on a run: title, operator, sample, note and tags."""

import re
from dataclasses import dataclass
from typing import Annotated, Any

from cyclopts import Parameter

from stickslip.console.flags import NOTES
from stickslip.errors import InputError

TAG = re.compile(r"[A-Za-z][A-Za-z0-9_]*")  # a name that every HDF5 and NeXus reader accepts
LONGEST = 10_000  # characters, at most four bytes each: the title is an HDF5 attribute too, which holds 64 kB


@Parameter(name="*", group=NOTES)
@dataclass(frozen=True)
class NoteFlags:
    """The notes as typed; None where not given."""

    title: Annotated[str | None, Parameter(help="Title of the run.")] = None
    operator: Annotated[str | None, Parameter(help="Who recorded.")] = None
    sample: Annotated[str | None, Parameter(help="Description of the contact or the specimen.")] = None
    note: Annotated[str | None, Parameter(help="Free-text remarks.")] = None
    tag: Annotated[
        list[str] | None,
        Parameter(negative=(), consume_multiple=False, help="Named value, NAME=VALUE; repeatable."),
    ] = None

    def collect(self) -> dict[str, Any]:
        """Return the notes that were given, by the attributes of `daq.runfile.recording.Recording`."""
        typed = {"title": self.title, "operator": self.operator, "sample_name": self.sample, "note": self.note}
        values: dict[str, Any] = {name: value for name, value in typed.items() if value is not None}
        for name, value in values.items():
            check_text(value, f"--{name.removesuffix('_name')}")
        if self.tag is not None:
            values["tags"] = parse_tags(self.tag)
        return values


NO_NOTES = NoteFlags()


def parse_tags(typed: list[str]) -> dict[str, str]:
    values: dict[str, str] = {}
    for text in typed:
        name, equals, value = text.partition("=")
        name, value = name.strip(), value.strip()
        if not equals or not TAG.fullmatch(name):
            do = "write NAME=VALUE with a name of letters, digits and underscores, such as humidity=45"
            raise InputError(f"{text!r} is not a tag", "--tag", do)
        if name in values:
            raise InputError(f"{name} is given twice", "--tag", "omit one")
        check_text(value, "--tag")
        values[name] = value
    return values


def check_text(text: str, flag: str) -> None:
    if not all(character.isprintable() or character in "\n\t" for character in text):
        raise InputError("the text has characters that cannot be printed", flag, "omit them")
    if len(text) > LONGEST:
        raise InputError(f"the text has {len(text)} characters", flag, f"use at most {LONGEST}")
