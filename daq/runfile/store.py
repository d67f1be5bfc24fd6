"""The run file: load it, write it once, add a stage to it.  Its tree is `daq.runfile.schema`'s.

Raw data are never open for writing again: `write` builds a new file beside the old name and moves it into place,
`extend` copies the file, adds groups to the copy and moves that into place.  A reader therefore sees the old file
or the new one, whole, and a crash leaves at worst a ``.NAME.*.partial`` beside it.

Equal `RunData` give equal bytes under the same file name and library versions: nothing here reads a clock.
"""

import os
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from daq.errors import InputError
from daq.output import atomic, disk
from daq.runfile import schema as layout
from daq.runfile.nexus_read import AGAIN, EVERY, array, dataset, group, same_length, scalar, string, text
from daq.runfile.recording import EVENT_NAMES as EVENT_NAMES
from daq.runfile.recording import EVENTS as EVENTS
from daq.runfile.recording import Raw as Raw
from daq.runfile.recording import Recording as Recording
from daq.runfile.recording import RunData as RunData
from daq.runfile.recording import Truth as Truth
from daq.runfile.recording import positions as positions
from daq.runfile.rig import Measured, Rig

SCHEMA = 1

# A stage rests on those before it: writing one drops the ones after it, which were made from what it replaces.
STAGES = ("data", "smooth", "fit")


def samples(path: str | os.PathLike[str]) -> int:
    """Return how many samples a run holds; InputError as for `load`."""
    where = Path(path)
    with opened(where) as file, _damage(where):
        return int(dataset(group(file, "entry", where), "instrument/encoder/value_log/time", where).size)


def load(path: str | os.PathLike[str], own: slice = EVERY) -> Recording:
    """Read a run.

    Parameters
    ----------
    path : path
        A run file.
    own : slice
        Samples to read; by default all.  Events and clock are those of the whole run, numbered as there.

    Raises
    ------
    InputError
        When the file is missing, cut short, not HDF5, not a run file, of another schema, or holds something else
        where a run has its samples.
    """
    where = Path(path)
    with opened(where) as file, _damage(where):
        entry = group(file, "entry", where)
        log = "instrument/encoder/value_log"
        time = array(entry, f"{log}/time", np.float64, where, own)
        position = array(entry, f"{log}/value", np.float64, where, own)
        unit = text(entry[f"{log}/value"].attrs.get("units", "m"))
        n = time.size
        _check_times(time, where)
        same_length(position.size, n, f"{log}/value", where)
        if not np.isfinite(position).all():
            raise InputError(
                f"position is not finite at sample {int(np.argmin(np.isfinite(position)))}",
                str(where),
                AGAIN,
            )
        count = None
        if f"{log}/raw_value" in entry:
            count = array(entry, f"{log}/raw_value", np.int64, where, own)
            same_length(count.size, n, f"{log}/raw_value", where)
        raw, segment = _raw(entry, n, where, own)
        belt = belt_count = None
        belt_log = "instrument/belt/value_log"
        if belt_log in entry:
            belt = array(entry, f"{belt_log}/value", np.float64, where, own)
            same_length(belt.size, n, f"{belt_log}/value", where)
            if f"{belt_log}/raw_value" in entry:
                belt_count = array(entry, f"{belt_log}/raw_value", np.int64, where, own)
                same_length(belt_count.size, n, f"{belt_log}/raw_value", where)
        events = array(entry, "events/sample", np.uint32, where)
        kinds = array(entry, "events/kind", np.uint8, where)
        same_length(kinds.size, events.size, "events/kind", where)
        notes = tuple(text(item) for item in entry["events/note"][()]) if "events/note" in entry else ()
        calibration = "instrument/encoder/calibration"
        return Recording(
            source=where,
            title=string(entry, "title", where),
            started=string(entry, "start_time", where),
            ended=string(entry, "end_time", where),
            time=time,
            position=position,
            unit=unit,
            count=count,
            segment=segment,
            rate_hz=scalar(entry, f"{calibration}/rate", where),
            rig=_rig(entry, where),
            raw=raw,
            event_sample=events,
            event_kind=tuple(EVENT_NAMES.get(int(kind), f"kind {kind}") for kind in kinds),
            event_note=notes or ("",) * events.size,
            belt_velocity=belt,
            belt_count=belt_count,
            default=text(entry.attrs.get("default", "data")),
            digest=string(entry, "provenance/sha256_raw", where),
            config_toml=string(entry, "configuration/data", where),
            clock_sample=array(entry, "clock_sync/sample", np.uint32, where),
            clock_offset=array(entry, "clock_sync/host_minus_device", np.float64, where),
            clock_ppm=scalar(entry, "clock_sync/drift", where) if "clock_sync/drift" in entry else None,
            clock_ppm_error=scalar(entry, "clock_sync/drift_errors", where)
            if "clock_sync/drift_errors" in entry
            else None,
            clock_offset_error=array(entry, "clock_sync/host_minus_device_errors", np.float64, where)
            if "clock_sync/host_minus_device_errors" in entry
            else np.empty(0),
            operator=string(entry, "operator/name", where) if "operator/name" in entry else "",
            provenance=_provenance(entry),
        )


def truth(path: str | os.PathLike[str]) -> Truth | None:
    """Read the exact motion of a simulated run that was asked to tell it; None for every other run.

    Only comparisons and benchmarks may call this: processing and fitting know no more than a real rig tells.
    """
    where = Path(path)
    with opened(where) as file, _damage(where):
        entry = group(file, "entry", where)
        if "truth" not in entry:
            return None
        columns = {name: array(entry, f"truth/{name}", np.float64, where) for name in ("time", "x", "v", "F")}
        return Truth(**columns, scene=string(entry, "truth/scene", where) if "truth/scene" in entry else "")


def write(path: str | os.PathLike[str], data: RunData, *, force: bool = False) -> None:
    """Write a run into a new file: build it beside ``path``, sync it to disk, move it into place.

    Parameters
    ----------
    path : path
        The run file.
    data : RunData
        The run.
    force : bool
        Replace an existing file.

    Raises
    ------
    InputError
        When ``path`` exists and ``force`` was not given, or its folder does not exist.
    ValueError
        When the arrays of ``data`` do not belong together.
    """
    target = Path(path)
    atomic.refuse_existing(target, force)
    _check(data)
    with atomic.replacing(target, force) as temporary, disk.hdf5(temporary, "w") as file:
        layout.build(file, data, target.name, SCHEMA)


def extend(
    path: str | os.PathLike[str],
    names: str | Sequence[str],
    writer: Callable[[h5py.Group], None],
    *,
    default: str | None = None,
) -> None:
    """Add a stage to a run: copy the file, write into the copy, sync it, move it into place.

    Parameters
    ----------
    path : path
        The run file.
    names : str or sequence of str
        The groups of /entry that ``writer`` writes; groups of these names are removed first, and so is every
        later stage ("fit", "fit_law1" ... when "smooth" is written again).
    writer : callable
        Takes /entry of the copy, open for writing.
    default : str, optional
        The new ``/entry/@default``: the group that viewers open on.

    Raises
    ------
    InputError
        As `load`, for a file that is no run.
    ValueError
        When a name belongs to the recording itself.
    """
    target = Path(path)
    wanted = (names,) if isinstance(names, str) else tuple(names)
    for name in wanted:
        if not name.startswith(STAGES[1:]):
            raise ValueError(f"{name!r} is no stage; extend writes {' or '.join(STAGES[1:])} groups, never the record")
    with opened(target):
        pass
    stage = min(STAGES.index(name.split("_")[0]) for name in wanted)
    with atomic.replacing(target, force=True) as temporary:
        shutil.copyfile(target, temporary)
        with disk.hdf5(temporary, "r+") as file:
            entry = file["entry"]
            for name in list(entry):
                if name in wanted or name.split("_")[0] in STAGES[stage + 1 :]:
                    del entry[name]
            writer(entry)
            if default is not None:
                entry.attrs["default"] = default


@contextmanager
def opened(path: Path) -> Iterator[h5py.File]:
    """Open a run file for reading, or raise an InputError that says what the file is instead."""
    where = str(path)
    if not path.exists():
        raise InputError("no such file", where, "check the path")
    if path.is_dir():
        raise InputError("is a folder", where, "give the run file in it")
    try:
        file = h5py.File(path, "r")
    except PermissionError as error:
        raise InputError("may not be read", where, "check its permissions") from error
    except OSError as error:
        raise _unopened(path, error) from error
    with file:
        schema = _schema(file)
        if schema is None:
            raise InputError(
                "is HDF5 but no run file (it has no @stickslip_schema)",
                where,
                "give a file made by daq record, daq import or daq replay",
            )
        if not isinstance(schema, int | np.integer) or isinstance(schema, np.bool_):
            raise InputError(f"@stickslip_schema is {schema!r}, not a whole number", where, "record or import again")
        if schema > SCHEMA:
            raise InputError(
                f"has schema {int(schema)}; this version reads schema {SCHEMA}", where, "install a newer stickslip"
            )
        if schema < SCHEMA:
            raise InputError(
                f"has schema {int(schema)}; this version reads schema {SCHEMA}",
                where,
                "make it again: daq recover on its journal, or daq import on its CSV",
            )
        yield file


def _schema(file: h5py.File) -> Any:
    # On the root it would be found too, and heeded first: that is where a person looks for it.
    provenance = file.get("entry/provenance")
    inside = provenance.attrs.get("stickslip_schema") if isinstance(provenance, h5py.Group) else None
    return file.attrs.get("stickslip_schema", inside)


def _unopened(path: Path, error: OSError) -> InputError:
    with path.open("rb") as stream:
        head = stream.read(32)
    if head.startswith(b"stickslip journal"):
        return InputError("is a journal, not a finished run", str(path), f"run: daq recover {path.name}")
    if not head.startswith(b"\x89HDF\r\n\x1a\n"):
        what = "is empty" if not head else "is not an HDF5 file"
        return InputError(what, str(path), "give a run file; a CSV is read by daq import, a capture by daq replay")
    detail = "is cut short" if "truncated" in str(error) else f"is damaged HDF5 ({str(error).splitlines()[0]})"
    return InputError(detail, str(path), "copy it again from its source, or daq recover its journal")


@contextmanager
def _damage(path: Path) -> Iterator[None]:
    # A failed checksum, a lost chunk or a broken link surfaces as any of these from deep inside the HDF5 library.
    try:
        yield
    except (OSError, RuntimeError, KeyError, ValueError) as error:
        what = f"is damaged: {str(error).splitlines()[0]}"
        raise InputError(what, str(path), "copy it again from its source, or daq recover its journal") from error


def _check(data: RunData) -> None:
    n = data.time.size
    if n == 0:
        raise ValueError("a run needs at least one sample")
    columns: dict[str, Any] = {
        "position": data.position,
        "count": data.count,
        "segment": data.segment,
        "belt_velocity": data.belt_velocity,
        "belt_count": data.belt_count,
    }
    if data.raw is not None:
        columns |= {f"raw.{name}": value for name, value in vars(data.raw).items()}
        columns["count"] = data.count if data.count is not None else np.empty(0)
    for name, values in columns.items():
        if values is not None and values.shape != (n,):
            raise ValueError(f"{name} has shape {values.shape}; time has {n} samples")
    if not (np.isfinite(data.time).all() and np.isfinite(data.position).all()):
        raise ValueError("times and positions must be finite")
    if (np.diff(data.time) <= 0).any():
        raise ValueError(f"time does not increase at sample {int(np.argmax(np.diff(data.time) <= 0)) + 1}")
    if data.event_sample.shape != data.event_kind.shape:
        raise ValueError("event_sample and event_kind differ in length")
    if data.event_note and len(data.event_note) != data.event_sample.size:
        raise ValueError("event_note and event_sample differ in length")
    if data.clock_sample.shape != data.clock_offset.shape:
        raise ValueError("clock_sample and clock_offset differ in length")
    if not set(map(int, data.event_kind)) <= set(EVENT_NAMES):
        raise ValueError(f"event kinds {sorted(set(map(int, data.event_kind)) - set(EVENT_NAMES))} are unknown")
    if data.belt_count is not None and data.belt_velocity is None:
        raise ValueError("belt_count without belt_velocity")
    for name in ("started", "ended"):
        if datetime.fromisoformat(getattr(data, name)).tzinfo is None:
            raise ValueError(f"{name} is {getattr(data, name)!r}; it needs its zone")


def _raw(entry: h5py.Group, n: int, where: Path, own: slice) -> tuple[Raw | None, Any]:
    if "raw" not in entry:
        return None, np.zeros(n, np.uint16)
    types = {"sample": np.uint32, "device_time": np.uint32, "levels": np.uint8}
    columns: dict[str, Any] = {}
    for name in ("sample", "segment", *layout.RAW_COLUMNS):
        if name in ("belt_count", "edge_time") and f"raw/{name}" not in entry:
            columns[name] = None
            continue
        item = entry.get(f"raw/{name}")
        wide = name in ("count_up", "count_down") and isinstance(item, h5py.Dataset) and item.dtype.itemsize > 2
        columns[name] = array(entry, f"raw/{name}", np.uint32 if wide else types.get(name, np.uint16), where, own)
        same_length(columns[name].size, n, f"raw/{name}", where)
    segment = columns.pop("segment")
    return Raw(**columns), segment


def _rig(entry: h5py.Group, where: Path) -> Rig:
    base = "instrument/encoder/calibration"
    found: dict[str, Any] = {}
    for name, path in {
        "mass": "sample/mass",
        "belt_speed": "instrument/belt/velocity",
        "belt_metres_per_count": "instrument/belt/calibration/metres_per_count",
        **{name: f"{base}/{name}" for name in ("metres_per_count", "datum", "stiffness", "damping")},
    }.items():
        if path in entry:
            sd = scalar(entry, f"{path}_errors", where) if f"{path}_errors" in entry else 0.0
            found[name] = Measured(scalar(entry, path, where), sd)
    for name in ("counts_per_revolution", "counter_bits"):
        if f"{base}/{name}" in entry:
            found[name] = int(scalar(entry, f"{base}/{name}", where))
    if f"{base}/decoder" in entry:
        found["decoder"] = string(entry, f"{base}/decoder", where)
    if f"{base}/rig" in entry:
        found["name"] = string(entry, f"{base}/rig", where)
    return Rig(**found)


def _provenance(entry: h5py.Group) -> dict[str, str | int]:
    found: dict[str, str | int] = {}
    for name, item in entry["provenance"].items():
        if name != "sha256_raw":
            value = item[()]
            if isinstance(value, bytes | str):
                found[name] = text(value)
            elif isinstance(value, np.integer):
                found[name] = int(value)
    return found


def _check_times(time: NDArray[np.float64], where: Path) -> None:
    if time.size == 0:
        raise InputError("holds no samples", str(where), AGAIN)
    wrong = ~np.isfinite(time)
    wrong[1:] |= ~(np.diff(time) > 0)
    if wrong.any():
        raise InputError(
            f"time does not increase at sample {int(np.argmax(wrong))}",
            str(where),
            AGAIN,
        )
