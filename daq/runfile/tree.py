"""Groups and fields of a run file as rows of a table, which writes them, reads them and documents them.

A `Field` names the attribute that it holds, of whatever is written (``rig.mass``), and how it is computed where that is
not simply the attribute.  The run itself is such a table (`daq.runfile.schema`), and so is each stage beside it
(`processing.stage`, `fitting.report.stage`).  docs/run_file_table.py writes the tables of
docs/reference/run-file.md from them.
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
        return self.path.rpartition("/")[0]

    @property
    def name(self) -> str:
        return self.path.rpartition("/")[2]

    def of_source(self, source: Any) -> Any:
        """Return the value to write of ``source``, None where that has none."""
        value = self.value(source) if self.value is not None else self._attribute(source)
        if value is None or not self.optional:
            return value
        empty = not any(value) if self.dtype == "text" else np.size(value) == 0
        return None if empty else value

    def _attribute(self, source: Any) -> Any:
        owner, _, name = self.of.rpartition(".")
        holder = attrgetter(owner)(source) if owner else source
        if isinstance(holder, tuple):
            return [getattr(row, name) for row in holder] or None
        return None if holder is None else getattr(holder, name)


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
    """Return the rows of a stage's NXprocess; ``default`` is the group in it that a viewer draws."""
    return (
        Group(path, "NXprocess", attributes={"default": default}),
        Field(f"{path}/program", "text", "", f"`{program}`", value=lambda source: program),
        Field(f"{path}/version", "text", "", "of stickslip", value=lambda source: VERSION),
        Field(f"{path}/date", "text", "", "when it was made, ISO 8601", value=lambda source: _now()),
        Field(f"{path}/sequence_index", "i8", "", f"{step}, the step of the evaluation", value=lambda source: step),
    )


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")


def list_fields(tree: Tree) -> list[Field]:
    return [row for row in tree if isinstance(row, Field)]


def select_groups(tree: Tree, *paths: str) -> list[Row]:
    return [row for row in tree if f"{row.path}/".startswith(tuple(f"{path}/" for path in paths))]


def check(tree: Tree, source: Any) -> list[tuple[Field, Any]]:
    """Return the fields that ``source`` has a value for; ValueError where columns of an axis differ in length."""
    filled = [(row, value) for row in list_fields(tree) if (value := row.of_source(source)) is not None]
    first: dict[str, tuple[str, int]] = {}
    for row, value in filled:
        if row.axis and row.dtype != "link":
            name, length = first.setdefault(row.axis, (row.of or row.path, len(value)))
            if np.shape(value) != (length,):
                raise ValueError(f"{row.of or row.path} has shape {np.shape(value)}; {name} has {length} values")
    return filled


def write(entry: h5py.Group, tree: Tree, source: Any, units: Mapping[str, str] | None = None) -> None:
    """Write the fields that ``source`` has a value for; ``units`` replaces names such as `LENGTH`."""
    filled = check(tree, source)
    inside = {row.parent for row, _ in filled}
    groups = [row for row in tree if isinstance(row, Group)]
    for group in groups:
        if group.path not in entry and (group.path in inside or not group.optional):
            _make_group(entry, group)
    for row, value in filled:
        _write_field(entry, row, value, _resolve_unit(row, units))
    for group in groups:
        if group.scale and group.path in inside:
            nexus.attach_scale(entry[group.path], group.scale)


def empty(entry: h5py.Group, tree: Tree, n: int, units: Mapping[str, str]) -> None:
    """Make groups, and columns of ``n`` numbers yet to be written; ``units`` as for `write`."""
    for row in tree:
        if isinstance(row, Group):
            _make_group(entry, row)
        else:
            nexus.column(entry, row.path, n, row.dtype, _resolve_unit(row, units))
    for row in tree:
        if isinstance(row, Group) and row.scale:
            nexus.attach_scale(entry[row.path], row.scale)


def _make_group(entry: h5py.Group, row: Group) -> None:
    nexus.group(entry, row.path, row.nx_class, **row.attributes)


def _resolve_unit(row: Field, units: Mapping[str, str] | None) -> str:
    unit = row.unit
    for name, replacement in (units or {}).items():
        unit = unit.replace(name, replacement)
    return unit


def _write_field(entry: h5py.Group, row: Field, value: Any, unit: str) -> None:
    match row.dtype:
        case "link":
            nexus.add_link(entry, row.path, entry[row.text])
        case "text":
            nexus.field(entry, row.path, value if isinstance(value, str) else list(value))
        case "text or i8":
            for name, item in value.items():
                nexus.field(entry, f"{row.parent}/{name}", item if isinstance(item, str) else np.int64(item))
        case "enum":
            kind = h5py.enum_dtype(row.codes, basetype="u1")
            entry.create_dataset(row.path, data=_encode(row, value), dtype=kind, track_times=False)
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
                value = _encode(row, value)
            stored = value if dtype == "u2 or u4" or isinstance(value, Column) else np.asarray(value, dtype)
            bare = row.axis and not unit and stored.dtype.kind != "f"
            nexus.field(entry, row.path, stored, None if bare else unit)


def _encode(row: Field, names: Iterable[str]) -> NDArray[np.uint8]:
    codes = row.codes or {}
    return np.array([codes[name] for name in names], np.uint8)


def read(entry: h5py.Group, tree: Tree, where: Path, selected: slice = nexus.EVERY) -> dict[str, Any]:
    """Read fields into a mapping from attribute (``rig.mass``) to value, without absent optional ones."""
    values: dict[str, Any] = {}
    lengths: dict[str, int] = {}
    optional = {row.path for row in tree if isinstance(row, Group) and row.optional}
    for row in list_fields(tree):
        absent_group = row.parent in optional and row.parent not in entry
        if not row.of or absent_group or (row.optional and row.path not in entry):
            continue
        value = _read_field(entry, row, where, selected)
        if row.axis:
            nexus.check_length(len(value), lengths.setdefault(row.axis, len(value)), row.path, where)
        values[row.of] = value
    return values


def select_part(values: Mapping[str, Any], name: str) -> dict[str, Any]:
    """Return the values of one part: ``rig.mass`` as ``mass``."""
    inside = {key.removeprefix(f"{name}."): value for key, value in values.items() if key.startswith(f"{name}.")}
    return {key: value for key, value in inside.items() if "." not in key}


def rows(values_read: Mapping[str, Any], name: str) -> list[dict[str, Any]]:
    """Return the rows of a table that was read, each by attribute; none of an absent one."""
    columns = {
        key: value.tolist() if isinstance(value, np.ndarray) else value
        for key, value in select_part(values_read, name).items()
    }
    return [dict(zip(columns, values, strict=True)) for values in zip(*columns.values(), strict=True)]


def _read_field(entry: h5py.Group, row: Field, where: Path, selected: slice) -> Any:
    selected = selected if row.axis == "n" else nexus.EVERY
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
            return nexus.read_array(entry, row.path, np.uint32 if wide else np.uint16, where, selected)
    if not row.axis:
        number = nexus.read_number(entry, row.path, where)
        return number if row.dtype == "f8" else int(number)
    if row.codes is not None:
        names = {code: name for name, code in row.codes.items()}
        codes = nexus.read_array(entry, row.path, np.uint8, where)
        return tuple(names.get(int(code), f"kind {code}") for code in codes)
    return nexus.read_array(entry, row.path, "f8" if row.dtype == "f4" else row.dtype, where, selected)
