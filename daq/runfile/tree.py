"""Groups and fields of a run file as rows of a table, which writes them, reads them and documents them.

A `Field` names the attribute that it holds, of whatever is written (``rig.mass``), and how it is computed where that is
not simply the attribute.  The run itself is such a table (`daq.runfile.schema`), and so is each stage beside it
(`processing.stage`, `fitting.report.stage`).  docs/reference/run-file.md is generated from them
(docs/run_file_table.py).
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from operator import attrgetter
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from daq.runfile import nexus
from daq.runfile.spill import Column
from stickslip.units import Measured
from stickslip.version import VERSION

LENGTH = "m or count"  # in the unit of a field: the run's own unit of position


@dataclass(frozen=True)
class Field:
    """One field of a group."""

    path: str  # within /entry
    # "text", "measured", "link", or a numpy type; with the letter of its axis when it is a column ("f8[n]").  Text
    # columns are "text[e]"; "enum[e]" are `codes` with their names, a whole number with `codes` the codes alone; "u2 or
    # u4" is stored as it is; "text or i8" and "parameters" are as many fields as the mapping has keys.
    kind: str
    # SI unit; "" when dimensionless; a name in it that `write` is given a unit for, such as `LENGTH`, is replaced
    unit: str
    text: str  # what it is, for the documentation, "" where that of another field says so; the target of a link
    # the attribute that it is written from and read into; "" for a field that is only written.  Of a tuple of rows
    # (``phases.start``) it is the column of their attributes.
    of: str = ""
    # the value to write, None to leave the field out; by default the attribute ``of``
    value: Callable[[Any], Any] | None = None
    optional: bool = False  # whether a file without it is read; an empty value of an optional field is not written
    codes: Mapping[str, int] | None = None  # names that are stored as numbers

    @property
    def dtype(self) -> str:
        """The kind without its axis."""
        return self.kind.split("[")[0]

    @property
    def axis(self) -> str:
        """The letter of the column's axis, "" for a single value."""
        return self.kind.partition("[")[2].rstrip("]")

    @property
    def parent(self) -> str:
        """The path of the group that it stands in."""
        return self.path.rpartition("/")[0]

    @property
    def name(self) -> str:
        """Its name in the group."""
        return self.path.rpartition("/")[2]

    def of_source(self, source: Any) -> Any:
        """Return the value to write of ``source``, None where that has none."""
        found = self.value(source) if self.value is not None else self._attribute(source)
        if found is None or not self.optional:
            return found
        empty = not any(found) if self.dtype == "text" else np.size(found) == 0
        return None if empty else found

    def _attribute(self, source: Any) -> Any:
        owner, _, name = self.of.rpartition(".")
        held = attrgetter(owner)(source) if owner else source
        if isinstance(held, tuple):
            return [getattr(row, name) for row in held] or None
        return None if held is None else getattr(held, name)


@dataclass(frozen=True)
class Group:
    """One group."""

    path: str  # within /entry
    nx_class: str  # its NeXus class
    optional: bool = False  # whether it is there only with its fields
    attributes: Mapping[str, Any] = field(default_factory=dict)  # its attributes
    scale: str = ""  # the column that becomes the dimension scale of the others of its length; "" for none


Row = Group | Field
Tree = Sequence[Row]


def table(
    path: str, axis: str, signal: str, title: str, *, auxiliary: tuple[str, ...] = (), optional: bool = False
) -> Group:
    """Return the row of an NXdata group of columns over ``axis``, of which ``signal`` is drawn."""
    attributes: dict[str, Any] = {"signal": signal, "axes": axis, f"{axis}_indices": np.int64(0), "title": title}
    if auxiliary:
        attributes["auxiliary_signals"] = list(auxiliary)
    return Group(path, "NXdata", optional, attributes, scale=axis)


def process(path: str, program: str, step: int, default: str) -> Tree:
    """Return the rows of the group of a stage, an NXprocess: which program made it, of which version, when.

    ``step`` is its place among the steps of the evaluation, ``default`` the group in it that a viewer draws.
    """
    return (
        Group(path, "NXprocess", attributes={"default": default}),
        Field(f"{path}/program", "text", "", f"`{program}`", value=lambda source: program),
        Field(f"{path}/version", "text", "", "of stickslip", value=lambda source: VERSION),
        Field(f"{path}/date", "text", "", "when it was made, ISO 8601", value=lambda source: _now()),
        Field(f"{path}/sequence_index", "i8", "", f"{step}, the step of the evaluation", value=lambda source: step),
    )


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")


def fields(tree: Tree) -> list[Field]:
    """Return the fields of a table."""
    return [row for row in tree if isinstance(row, Field)]


def below(tree: Tree, *paths: str) -> list[Row]:
    """Return the rows of the groups at these paths."""
    return [row for row in tree if f"{row.path}/".startswith(tuple(f"{path}/" for path in paths))]


def check(tree: Tree, source: Any) -> list[tuple[Field, Any]]:
    """Return the fields that ``source`` has a value for, each with it.

    Raises ValueError: where the columns of one axis differ in length.
    """
    filled = [(row, value) for row in fields(tree) if (value := row.of_source(source)) is not None]
    first: dict[str, tuple[str, int]] = {}
    for row, value in filled:
        if row.axis and row.dtype != "link":
            name, length = first.setdefault(row.axis, (row.of or row.path, len(value)))
            if np.shape(value) != (length,):
                raise ValueError(f"{row.of or row.path} has shape {np.shape(value)}; {name} has {length} values")
    return filled


def write(entry: h5py.Group, tree: Tree, source: Any, units: Mapping[str, str] | None = None) -> None:
    """Write those of the fields that ``source`` has a value for, and the groups they stand in.

    entry: /entry, open for writing.
    tree: The rows; one group may be there already.
    source: Has the attributes that the fields name.
    units: The unit for a name in the units of fields, as for `LENGTH`.
    Raises ValueError: as `check`.
    """
    filled = check(tree, source)
    inside = {row.parent for row, _ in filled}
    groups = [row for row in tree if isinstance(row, Group)]
    for group in groups:
        if group.path not in entry and (group.path in inside or not group.optional):
            _make(entry, group)
    for row, value in filled:
        _write_field(entry, row, value, _unit(row, units))
    for group in groups:
        if group.scale and group.path in inside:
            nexus.scale(entry[group.path], group.scale)


def empty(entry: h5py.Group, tree: Tree, n: int, units: Mapping[str, str]) -> None:
    """Make groups, and columns of ``n`` numbers yet to be written; ``units`` as for `write`."""
    for row in tree:
        if isinstance(row, Group):
            _make(entry, row)
        else:
            nexus.column(entry, row.path, n, row.dtype, _unit(row, units))
    for row in tree:
        if isinstance(row, Group) and row.scale:
            nexus.scale(entry[row.path], row.scale)


def _make(entry: h5py.Group, row: Group) -> None:
    nexus.group(entry, row.path, row.nx_class, **row.attributes)


def _unit(row: Field, units: Mapping[str, str] | None) -> str:
    unit = row.unit
    for name, own in (units or {}).items():
        unit = unit.replace(name, own)
    return unit


def _write_field(entry: h5py.Group, row: Field, value: Any, unit: str) -> None:
    match row.dtype:
        case "link":
            nexus.link(entry, row.path, entry[row.text])
        case "text":
            nexus.field(entry, row.path, value if isinstance(value, str) else list(value))
        case "text or i8":
            for name, item in value.items():
                nexus.field(entry, f"{row.parent}/{name}", item if isinstance(item, str) else np.int64(item))
        case "enum":
            kind = h5py.enum_dtype(row.codes, basetype="u1")
            entry.create_dataset(row.path, data=_coded(row, value), dtype=kind, track_times=False)
        case "parameters":
            for name, item in value.items():
                nexus.field(entry, f"{row.parent}/{name}", np.float64(item.value), item.unit)
                error = np.float64(item.stderr if item.trusted else np.nan)
                nexus.field(entry, f"{row.parent}/{name}_errors", error, item.unit)
        case "measured":
            # Number and error both in f8: a scalar's error in f4 would save nothing and not read back exactly.
            nexus.field(entry, row.path, np.float64(value.value), unit)
            if value.sd:
                nexus.field(entry, f"{row.path}_errors", np.float64(value.sd), unit)
        case dtype:
            if row.codes is not None:
                value = _coded(row, value)
            stored = value if dtype == "u2 or u4" or isinstance(value, Column) else np.asarray(value, dtype)
            bare = row.axis and not unit and stored.dtype.kind != "f"
            nexus.field(entry, row.path, stored, None if bare else unit)


def _coded(row: Field, names: Iterable[str]) -> NDArray[np.uint8]:
    codes = row.codes or {}
    return np.array([codes[name] for name in names], np.uint8)


def read(entry: h5py.Group, tree: Tree, where: Path, own: slice = nexus.EVERY) -> dict[str, Any]:
    """Read fields into a mapping from attribute (``rig.mass``) to value.

    ``own`` are the samples to read of columns over the samples.  An absent optional field is absent in the mapping.

    Raises InputError: for a field that is missing, of another type, or not as long as the others of its axis.
    """
    found: dict[str, Any] = {}
    lengths: dict[str, int] = {}
    optional = {row.path for row in tree if isinstance(row, Group) and row.optional}
    for row in fields(tree):
        absent_group = row.parent in optional and row.parent not in entry
        if not row.of or absent_group or (row.optional and row.path not in entry):
            continue
        value = _read_field(entry, row, where, own)
        if row.axis:
            nexus.check_length(len(value), lengths.setdefault(row.axis, len(value)), row.path, where)
        found[row.of] = value
    return found


def part(found: Mapping[str, Any], name: str) -> dict[str, Any]:
    """Return what was read of one part: ``rig.mass`` as ``mass``."""
    inside = {key.removeprefix(f"{name}."): value for key, value in found.items() if key.startswith(f"{name}.")}
    return {key: value for key, value in inside.items() if "." not in key}


def rows(found: Mapping[str, Any], name: str) -> list[dict[str, Any]]:
    """Return the rows of a table that was read, each by attribute; none of an absent one."""
    columns = {
        key: value.tolist() if isinstance(value, np.ndarray) else value for key, value in part(found, name).items()
    }
    return [dict(zip(columns, values, strict=True)) for values in zip(*columns.values(), strict=True)]


def _read_field(entry: h5py.Group, row: Field, where: Path, own: slice) -> Any:
    own = own if row.axis == "n" else nexus.EVERY
    match row.dtype:
        case "text":
            return (nexus.read_texts if row.axis else nexus.read_text)(entry, row.path, where)
        case "text or i8":
            group = nexus.read_group(entry, row.parent, where)
            return {name: nexus.read_text_or_whole(group, name, where) for name in group if name != "sha256_raw"}
        case "measured":
            errors = f"{row.path}_errors"
            sd = nexus.read_number(entry, errors, where) if errors in entry else 0.0
            return Measured(nexus.read_number(entry, row.path, where), sd)
        case "u2 or u4":
            wide = nexus.read_dataset(entry, row.path, where).dtype.itemsize > 2
            return nexus.read_array(entry, row.path, np.uint32 if wide else np.uint16, where, own)
    if not row.axis:
        number = nexus.read_number(entry, row.path, where)
        return number if row.dtype == "f8" else int(number)
    if row.codes is not None:
        names = {code: name for name, code in row.codes.items()}
        codes = nexus.read_array(entry, row.path, np.uint8, where)
        return tuple(names.get(int(code), f"kind {code}") for code in codes)
    return nexus.read_array(entry, row.path, "f8" if row.dtype == "f4" else row.dtype, where, own)
