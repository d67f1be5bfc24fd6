"""The tree of a run file: one table (`daq.runfile.tree`) that writes it, reads it and documents it.

`TREE` lists the groups of /entry, in NeXus base classes, and the fields of each with the attribute of `RunData` it
holds.

Types: ``f8`` and the like are numpy's; ``[n]`` is a column over the samples, ``[c]`` over the clock readings, ``[e]``
over the events, ``[m]`` over the samples of the truth, ``[i]`` over the identifications.  A measured quantity is a
number and, beside it, ``NAME_errors``, its standard deviation.
"""

import hashlib
import uuid
from collections.abc import Callable
from datetime import datetime
from operator import attrgetter
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from daq.runfile import nexus, tree
from daq.runfile.run_data import EVENTS, RunData, find_disorder
from daq.runfile.spill import blocks
from daq.runfile.tree import LENGTH, Field, Group
from stickslip.text import storable
from stickslip.version import VERSION

SCHEMA = 1


def _if_counted(of: str) -> Callable[[RunData], Any]:
    """Return a function that reads an attribute of a run with counts, None of an import."""
    return lambda run: None if run.count is None else attrgetter(of)(run)


def _name_sensor(counted: str, imported: str) -> Callable[[RunData], str]:
    return lambda run: imported if run.count is None else counted


def _compute_duration(run: RunData) -> int:
    span = datetime.fromisoformat(run.ended) - datetime.fromisoformat(run.started)
    return round(span.total_seconds())


def _derive_identity(run: RunData) -> str:
    return str(uuid.uuid5(uuid.NAMESPACE_OID, f"{run.started} {storable(run.title)} {run.digest}"))


def _name_sample(run: RunData) -> str:
    return run.sample_name or run.rig.name or "mass"


def _get_segment(run: RunData) -> NDArray[np.uint16] | NDArray[np.uint32] | None:
    return None if run.raw is None else run.segment


def _name_belt(run: RunData) -> str | None:
    signs = (run.rig.belt_speed, run.rig.belt_metres_per_count, run.belt_velocity)
    return "belt" if any(item is not None for item in signs) else None


DATA = {"signal": "value", "axes": "time", "time_indices": np.int64(0)}
RAW = {"signal": "count_up", "axes": "sample", "auxiliary_signals": ["count_down"], "sample_indices": np.int64(0)}
SYNC = {"signal": "host_minus_device", "axes": "sample"}
CALIBRATION = "instrument/encoder/calibration"
ENCODER_LOG = "instrument/encoder/value_log"
BELT_LOG = "instrument/belt/value_log"

ENTRY = Group("", "NXentry", attributes={"default": "data"})
TREE: tree.Tree = (
    Field("title", "text", "", "title of the run", "title"),
    Field("start_time", "text", "", "first sample, ISO 8601 with zone", "started"),
    Field("end_time", "text", "", "last sample, ISO 8601 with zone", "ended"),
    Field("duration", "i8", "s", "end minus start, rounded", value=_compute_duration),
    Field("entry_identifier_uuid", "text", "", "derived from start, title and raw data", value=_derive_identity),
    Field("program_name", "text", "", "`daq`; @version, @configuration", value=lambda run: "daq"),
    Group("operator", "NXuser", optional=True),
    Field("operator/name", "text", "", "who recorded", "operator", optional=True),
    Group("sample", "NXsample"),
    Field("sample/name", "text", "", "of the sample, else of the rig, else `mass`", value=_name_sample),
    Field("sample/description", "text", "", "what was measured, as stated", "sample_name", optional=True),
    Field("sample/mass", "measured", "kg", "moving mass", "rig.mass", optional=True),
    Group("notes", "NXnote", optional=True),
    Field("notes/type", "text", "", "`text/plain`", value=lambda run: "text/plain" if run.note else None),
    Field("notes/data", "text", "", "remarks", "note", optional=True),
    Group("tags", "NXcollection", optional=True),
    Field("tags/*", "text or i8", "", "named values that a person gave the run", "tags", lambda run: run.tags or None),
    Group("instrument", "NXinstrument"),
    Group("instrument/encoder", "NXsensor"),
    Field("instrument/encoder/name", "text", "", "of the sensor", value=_name_sensor("encoder", "position track")),
    Field(
        "instrument/encoder/model",
        "text",
        "",
        "decoder, or `imported`",
        value=lambda run: "imported" if run.count is None else run.rig.decoder,
    ),
    Field(
        "instrument/encoder/type",
        "text",
        "",
        "of sensor",
        value=_name_sensor("incremental encoder", "position against time"),
    ),
    Group(ENCODER_LOG, "NXlog", scale="time"),
    Field(f"{ENCODER_LOG}/time", "f8[n]", "s", "since the first sample by the device's clock; @start", "time"),
    Field(f"{ENCODER_LOG}/value", "f8[n]", LENGTH, "position; with a datum, from the spring's rest", "position"),
    Field(f"{ENCODER_LOG}/raw_value", "i8[n]", "count", "unwrapped count", "count", optional=True),
    Group(CALIBRATION, "NXcollection"),
    Field(f"{CALIBRATION}/rig", "text", "", "name of the rig", "rig.name", optional=True),
    Field(f"{CALIBRATION}/rate", "f8", "Hz", "nominal sample rate", "rate_hz"),
    Field(f"{CALIBRATION}/metres_per_count", "measured", "m", "pitch", "rig.metres_per_count", optional=True),
    Field(f"{CALIBRATION}/datum", "measured", "m", "position of count zero", "rig.datum", optional=True),
    Field(f"{CALIBRATION}/x0", "measured", "m", "reading at the spring's rest", "rig.x0", optional=True),
    Field(f"{CALIBRATION}/stiffness", "measured", "N/m", "of the spring", "rig.stiffness", optional=True),
    Field(f"{CALIBRATION}/damping", "measured", "N*s/m", "viscous damping", "rig.damping", optional=True),
    Field(f"{CALIBRATION}/counts_per_revolution", "i8", "", "one turn", "rig.counts_per_revolution", optional=True),
    Field(f"{CALIBRATION}/counter_bits", "i8", "", "width", "rig.counter_bits", _if_counted("rig.counter_bits"), True),
    Field(f"{CALIBRATION}/decoder", "text", "", "how edges count", "rig.decoder", _if_counted("rig.decoder"), True),
    Group("instrument/belt", "NXpositioner", optional=True),
    Field("instrument/belt/name", "text", "", "`belt`", value=_name_belt),
    Field("instrument/belt/velocity", "measured", "m/s", "positive towards +x", "rig.belt_speed", optional=True),
    Group(BELT_LOG, "NXlog", optional=True),
    Field(f"{BELT_LOG}/time", "link", "s", f"{ENCODER_LOG}/time", value=lambda run: run.belt_velocity),
    Field(f"{BELT_LOG}/value", "f8[n]", "m/s", "belt velocity: differences of its counts over 20 ms", "belt_velocity"),
    Field(f"{BELT_LOG}/raw_value", "i8[n]", "count", "unwrapped count of the belt", "belt_count", optional=True),
    Group("instrument/belt/calibration", "NXcollection", optional=True),
    Field("instrument/belt/calibration/metres_per_count", "measured", "m", "pitch", "rig.belt_metres_per_count"),
    Group("raw", "NXdata", optional=True, attributes=RAW),
    Field("raw/sample", "u4[n]", "", "sequence number: skips lost samples, restarts in each segment", "raw.sample"),
    Field("raw/segment", "u2 or u4[n]", "", "a new one after every unplug and restart", "segment", _get_segment),
    Field("raw/count_up", "u2 or u4[n]", "", "counter of steps up, rolling over at its width", "raw.count_up"),
    Field("raw/count_down", "u2 or u4[n]", "", "counter of steps down", "raw.count_down"),
    Field("raw/device_time", "u4[n]", "us", "device time, rolling over at 2^32", "raw.device_time"),
    Field("raw/levels", "u1[n]", "", "channel levels, A = 1, B = 2", "raw.levels"),
    Field("raw/flags", "u2[n]", "", "status bits of the sample, and the checks of `daq.wire.counters`", "raw.flags"),
    Field("raw/illegal", "u2[n]", "", "illegal transitions so far, rolling over", "raw.illegal"),
    Field("raw/belt_count", "u2[n]", "", "the belt encoder's counter", "raw.belt_count", optional=True),
    Field("raw/edge_time", "u2[n]", "us", "from the last edge to the sample", "raw.edge_time", optional=True),
    Group("sent_as", "NXcollection", optional=True),
    Field("sent_as/segment", "u4[i]", "", "first segment under each identification", "sent_as.segment"),
    Field("sent_as/counter_bits", "u1[i]", "", "width of its counters", "sent_as.counter_bits"),
    Field("sent_as/counts", "u1[i]", "", "counts of the run in one of its counts", "sent_as.counts"),
    Field("sent_as/ident", "text[i]", "", "the board's identification, in words", "sent_as.ident"),
    Group("clock_sync", "NXdata", attributes=SYNC),
    Field("clock_sync/sample", "u4[c]", "", "index of the sample", "clock_sample"),
    Field("clock_sync/host_minus_device", "f8[c]", "s", "host clock minus device clock", "clock_offset"),
    Field("clock_sync/drift", "f8", "ppm", "of the device's clock, positive when fast", "clock_ppm", optional=True),
    Field("clock_sync/drift_errors", "f8", "ppm", "standard deviation", "clock_ppm_error", optional=True),
    Field("clock_sync/host_minus_device_errors", "f8[c]", "s", "same", "clock_offset_error", optional=True),
    Group("events", "NXcollection"),
    Field("events/sample", "u4[e]", "", "index of the sample", "event_sample"),
    Field("events/kind", "enum[e]", "", f"u1: {', '.join(EVENTS)}", "event_kind", codes=EVENTS),
    Field("events/note", "text[e]", "", "words about it", "event_note", optional=True),
    Group("configuration", "NXnote"),
    Field("configuration/type", "text", "", "`application/toml`", value=lambda run: "application/toml"),
    Field("configuration/data", "text", "", "the configuration of the run, verbatim", "config_toml"),
    # Not on the root: nxcheck warns of any attribute there that NeXus does not define, and allows all of them here.
    Group("provenance", "NXcollection", attributes={"stickslip_schema": np.int64(SCHEMA)}),
    Field("provenance/*", "text or i8", "", "software, versions, host, command line", "provenance"),
    Field("provenance/sha256_raw", "text", "", "of the raw columns; of time and position in an import", "digest"),
    Group("truth", "NXcollection", optional=True),
    Field("truth/scene", "text", "", "URL of the simulated rig", "truth.scene", optional=True),
    Field("truth/time", "f8[m]", "s", "sample times", "truth.time"),
    Field("truth/x", "f8[m]", "m", "exact position", "truth.x"),
    Field("truth/v", "f8[m]", "m/s", "exact velocity", "truth.v"),
    Field("truth/F", "f8[m]", "N", "exact friction force", "truth.F"),
    Group("data", "NXdata", attributes=DATA),
    Field("data/time", "link", "s", f"{ENCODER_LOG}/time", value=lambda run: run.time),
    Field("data/value", "link", LENGTH, f"{ENCODER_LOG}/value", value=lambda run: run.position),
)
NOTES = ("title", "operator/", "sample/name", "sample/description", "notes/", "tags/", "events/")  # of `rewrite_notes`
FIELDS = tree.list_fields(TREE)


def compute_digest(run: RunData) -> str:
    """Return the sha256 of the raw columns, or of time and position when there are none."""
    columns: dict[str, Any] = {"time": run.time, "position": run.position}
    if run.raw is not None:
        columns = {row.path.removeprefix("raw/"): row.of_source(run) for row in FIELDS if row.path.startswith("raw/")}
    sha = hashlib.sha256()
    for name, values in columns.items():
        if values is not None:
            sha.update(f"{name} {values.dtype.str} {values.size}\n".encode())
            for block in blocks(values):
                sha.update(np.ascontiguousarray(block).data)
    return sha.hexdigest()


def write(file: h5py.File, run: RunData, file_name: str) -> None:
    """Write the tree of ``run`` into the empty ``file``, without reading a clock."""
    file.attrs["NX_class"] = "NXroot"
    file.attrs["default"] = "entry"
    file.attrs["creator"] = f"stickslip {VERSION}"
    file.attrs["file_name"] = storable(file_name)
    file.attrs["file_time"] = run.ended
    file.attrs["HDF5_Version"] = h5py.version.hdf5_version
    file.attrs["h5py_version"] = h5py.version.version
    file.attrs["NeXus_version"] = "2024.02"
    entry = nexus.group(file, "entry", ENTRY.nx_class, **ENTRY.attributes)
    tree.write(entry, TREE, run, {LENGTH: run.unit})
    entry["program_name"].attrs.update({"version": VERSION, "configuration": "configuration/data"})
    entry[f"{ENCODER_LOG}/time"].attrs["start"] = run.started
    entry[f"{ENCODER_LOG}/value"].attrs["long_name"] = f"position ({run.unit})"
    entry["data"].attrs["title"] = storable(run.title)


def rewrite_notes(file: h5py.File, run: RunData) -> None:
    """Write the notes and events of ``run`` over those in the file of the run; nothing else is changed."""
    entry = file["entry"]
    rows = [row for row in TREE if f"{row.path}/".startswith(NOTES)]
    optional = {row.path for row in rows if isinstance(row, Group) and row.optional}
    for name in {row.path.partition("/")[0] if row.parent in optional else row.path for row in tree.list_fields(rows)}:
        if name in entry:
            del entry[name]
    tree.write(entry, rows, run, {LENGTH: run.unit})
    entry["data"].attrs["title"] = storable(run.title)


def check(run: RunData) -> None:
    """Raise ValueError when the parts of ``run`` do not belong together."""
    if run.time.size == 0:
        raise ValueError("a run needs at least one sample")
    if run.raw is not None and run.count is None:
        raise ValueError("count is None; a run with raw samples needs its count")
    tree.check([row for row in FIELDS if row.axis], run)
    if not all(np.isfinite(block).all() for values in (run.time, run.position) for block in blocks(values)):
        raise ValueError("times and positions must be finite")
    if (sample := find_disorder(run.time)) is not None:
        raise ValueError(f"time does not increase at sample {sample}")
    if unknown := sorted(set(run.event_kind) - set(EVENTS)):
        raise ValueError(f"event kinds {unknown} are unknown")
    if run.belt_count is not None and run.belt_velocity is None:
        raise ValueError("belt_count without belt_velocity")
    for name in ("started", "ended"):
        if datetime.fromisoformat(getattr(run, name)).tzinfo is None:
            raise ValueError(f"{name} is {getattr(run, name)!r}; it needs a time zone")
