"""A run out of any file that holds one: a run file as it is, a table by what its columns say and the caller adds."""

import os
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from stickslip.errors import InputError, in_python, nearest

if TYPE_CHECKING:
    from daq.imports.options import ImportOptions
    from daq.runfile.recording import Recording

# Flags of `daq import` whose field has another name; either is a keyword.
FLAGS = {"belt": "belt_speed", "frame_rate": "frame_rate_hz", "start": "started"}
RUN_SUFFIXES = (".h5", ".hdf5", ".hdf", ".he5", ".nxs", ".part")
TABLE_SUFFIXES = (".mat", ".xlsx", ".tdms")  # suffixes of tables that are no text


def load(path: str | os.PathLike[str], **import_options: Any) -> "Recording":
    """Read a run from a run file, or from a table of times and positions.

    Parameters
    ----------
    path : path
        A run file (.h5), or a table as `daq import` reads it: text (.csv, .txt, .lvm ...), MATLAB (.mat), and with the
        extra ``formats`` .xlsx and .tdms.  A table is read in memory; `Recording.save` makes a run file of it.
    **import_options
        Of a table: the flags of `daq import` with underscores, as in ``x_unit="cm"``, ``time="t"``,
        ``position="x (px)"``, ``frame_rate="400 fps"``, ``skip_bad=True``; and ``mass``, ``stiffness``,
        ``belt_speed``, ``x0`` as for `Recording.from_arrays`.

    Returns
    -------
    Recording

    Raises
    ------
    InputError
        When the file is missing, cut short or contains something else; for a table, when a column, a unit or a number
        cannot be read: the message names line and column, and what to give.

    Warns
    -----
    UserWarning
        What `daq import` warns about, such as a frame rate that contradicts mass and stiffness.

    Examples
    --------
    >>> import daq
    >>> daq.load("data_samples/law5.h5")
    <Recording law5.h5: 'simulated rig, scene rig, 500 Hz'
     6000 samples, 12 s at 500 Hz>
    >>> run = daq.load("data_samples/camera.csv", mass="300 g", x0="0 mm +- 0.5 mm")
    >>> run.rig.x0
    Measured(value=0.0, sd=0.0005)
    """
    from daq.runfile import store

    file = Path(path)
    if _is_run(file):
        if import_options:
            name = next(iter(import_options))
            do = "omit it; pass calibrations and x0 to fitting.rank"
            raise InputError(f"{name}= applies only to tables, but this is a run file", str(file), do)
        return store.load(file)
    import warnings

    from daq.imports import table_to_run  # with the library of the command line, which run files do without

    imported = table_to_run.read(file, _build_options(import_options))
    for text in imported.warnings:
        warnings.warn(f"{file.name}: {in_python(text)}", UserWarning, stacklevel=2)
    return imported.run


def _is_run(path: Path) -> bool:
    """Return whether a file is to be read as a run file: by its suffix, else by its first bytes."""
    if path.suffix.lower() in TABLE_SUFFIXES:
        return False
    if path.suffix.lower() in RUN_SUFFIXES or not path.is_file():
        return True  # whose reader says what is wrong with it
    with path.open("rb") as file:
        head = file.read(17)
    return head.startswith((b"\x89HDF\r\n\x1a\n", b"stickslip journal"))


def _build_options(keywords: dict[str, Any]) -> "ImportOptions":
    from daq.imports.options import ImportOptions
    from stickslip import units

    field_names = {field.name for field in fields(ImportOptions)}
    options: dict[str, Any] = {}
    for keyword, value in keywords.items():
        name = FLAGS.get(keyword, keyword)
        if name not in field_names:
            names = sorted(field_names - set(FLAGS.values())) + list(FLAGS)
            raise InputError(f"{keyword!r} is not an option for tables", "daq.load", nearest(keyword, names))
        if name in units.OF_QUANTITY:
            value = units.read_stated(value, name)
        elif name == "circumference":
            value = units.in_si(value, "length", name)
        elif name == "frame_rate_hz" and isinstance(value, str):
            value = units.quantity(value, "rate", keyword)
        elif name in ("time", "position", "spring_force", "belt_column") and isinstance(value, int):
            value = str(value)
        options[name] = value
    return ImportOptions(**options)
