"""The tree of a run file, group by group, in NeXus base classes.

::

    entry                NXentry       title, times, program
      operator           NXuser        when known
      sample             NXsample      the mass
      instrument         NXinstrument
        encoder          NXsensor      value_log (time, position, count), calibration
        belt             NXpositioner  velocity; with a channel its value_log (time, velocity, count) and calibration
      raw                NXdata        the samples as sent; absent in an import
      clock_sync         NXdata        host minus device
      events             NXcollection  sample, kind, note
      configuration      NXnote        TOML, verbatim
      provenance         NXcollection  software, versions, sha256 of the raw data
      truth              NXcollection  only of a simulated rig that was asked to tell
      data               NXdata        hard links to value_log
"""

import hashlib
import uuid
from datetime import datetime

import h5py
import numpy as np
from numpy.typing import NDArray

from daq.runfile.nexus import field, group, link, scale
from daq.runfile.recording import EVENTS, Raw, RunData
from daq.runfile.rig import Measured
from daq.version import VERSION

RAW_COLUMNS = ("count_up", "count_down", "device_time", "levels", "flags", "illegal", "belt_count", "edge_time")
RAW_UNITS = {"device_time": "us", "edge_time": "us"}
KIND = h5py.enum_dtype(EVENTS, basetype="u1")


def digest(data: RunData) -> str:
    """Return the sha256 of the raw columns, or of time and position when there are none."""
    columns: dict[str, NDArray[np.generic]]
    if data.raw is None:
        columns = {"time": data.time, "position": data.position}
    else:
        columns = raw_columns(data.raw, segments(data))
    sha = hashlib.sha256()
    for name, values in columns.items():
        sha.update(f"{name} {values.dtype.str} {values.size}\n".encode())
        sha.update(np.ascontiguousarray(values).tobytes())
    return sha.hexdigest()


def segments(data: RunData) -> NDArray[np.uint16]:
    """Return the segment of each sample; a run that was never interrupted is segment 0 throughout."""
    return np.zeros(data.time.size, np.uint16) if data.segment is None else data.segment


def raw_columns(raw: Raw, segment: NDArray[np.uint16]) -> dict[str, NDArray[np.generic]]:
    """Return the raw columns that this board sent, in the order of the file."""
    columns: dict[str, NDArray[np.generic]] = {"sample": raw.sample, "segment": segment}
    for name in RAW_COLUMNS:
        values = getattr(raw, name)
        if values is not None:
            columns[name] = values
    return columns


def build(file: h5py.File, data: RunData, file_name: str, schema: int) -> None:
    """Write the whole tree of ``data`` into the empty ``file``.

    No clock is read: ``@file_time`` is the end of the run, the entry's identifier is derived from the raw data.
    """
    sha256 = digest(data)
    file.attrs["NX_class"] = "NXroot"
    file.attrs["default"] = "entry"
    file.attrs["creator"] = f"stickslip {VERSION}"
    file.attrs["file_name"] = file_name
    file.attrs["file_time"] = data.ended
    file.attrs["HDF5_Version"] = h5py.version.hdf5_version
    file.attrs["h5py_version"] = h5py.version.version
    file.attrs["NeXus_version"] = "2024.02"
    entry = group(file, "entry", "NXentry", default="data")
    _entry(entry, data, sha256)
    if data.operator:
        field(group(entry, "operator", "NXuser"), "name", data.operator)
    sample = group(entry, "sample", "NXsample")
    field(sample, "name", data.rig.name or "mass")
    _measured(sample, "mass", data.rig.mass, "kg")
    log = _instrument(entry, data)
    if data.raw is not None:
        _raw(entry, data.raw, segments(data))
    sync = group(entry, "clock_sync", "NXdata", signal="host_minus_device", axes="sample")
    field(sync, "sample", data.clock_sample)
    field(sync, "host_minus_device", data.clock_offset, "s")
    if data.clock_ppm is not None:
        field(sync, "drift", np.float64(data.clock_ppm), "ppm")
    if data.clock_ppm_error is not None:
        field(sync, "drift_errors", np.float64(data.clock_ppm_error), "ppm")
    if data.clock_offset_error.size:
        field(sync, "host_minus_device_errors", data.clock_offset_error, "s")
    _events(entry, data)
    note = group(entry, "configuration", "NXnote")
    field(note, "type", "application/toml")
    field(note, "data", data.config_toml)
    provenance = group(entry, "provenance", "NXcollection")
    # Not on the root: nxcheck warns of any attribute there that NeXus does not define, and allows all of them here.
    provenance.attrs["stickslip_schema"] = np.int64(schema)
    for key, value in data.provenance.items():
        field(provenance, key, value if isinstance(value, str) else np.int64(value))
    field(provenance, "sha256_raw", sha256)
    if data.truth is not None:
        truth = group(entry, "truth", "NXcollection")
        if data.truth.scene:
            field(truth, "scene", data.truth.scene)
        for name, units in (("time", "s"), ("x", "m"), ("v", "m/s"), ("F", "N")):
            field(truth, name, np.asarray(getattr(data.truth, name), np.float64), units)
    plot = group(entry, "data", "NXdata", signal="value", axes="time", title=data.title)
    plot.attrs["time_indices"] = np.int64(0)
    link(plot, "time", log["time"])
    link(plot, "value", log["value"])


def _entry(entry: h5py.Group, data: RunData, sha256: str) -> None:
    field(entry, "title", data.title)
    field(entry, "start_time", data.started)
    field(entry, "end_time", data.ended)
    span = datetime.fromisoformat(data.ended) - datetime.fromisoformat(data.started)
    field(entry, "duration", np.int64(round(span.total_seconds())), "s")
    identity = uuid.uuid5(uuid.NAMESPACE_OID, f"{data.started} {data.title} {sha256}")
    field(entry, "entry_identifier_uuid", str(identity))
    field(entry, "program_name", "daq", version=VERSION, configuration="configuration/data")


def _instrument(entry: h5py.Group, data: RunData) -> h5py.Group:
    instrument = group(entry, "instrument", "NXinstrument")
    encoder = group(instrument, "encoder", "NXsensor")
    counts = data.count is not None
    field(encoder, "name", "encoder" if counts else "position track")
    field(encoder, "model", data.rig.decoder if counts else "imported")
    field(encoder, "type", "incremental encoder" if counts else "position against time")
    unit = "m" if data.rig.metres_per_count is not None or not counts else "count"
    log = group(encoder, "value_log", "NXlog")
    field(log, "time", np.asarray(data.time, np.float64), "s", start=data.started)
    field(log, "value", np.asarray(data.position, np.float64), unit, long_name=f"position ({unit})")
    if data.count is not None:
        field(log, "raw_value", np.asarray(data.count, np.int64), "count")
    scale(log, "time")
    calibration = group(encoder, "calibration", "NXcollection")
    if data.rig.name:
        field(calibration, "rig", data.rig.name)
    field(calibration, "rate", np.float64(data.rate_hz), "Hz")
    for name, units in (
        ("metres_per_count", "m"),
        ("datum", "m"),
        ("stiffness", "N/m"),
        ("damping", "N*s/m"),
    ):
        _measured(calibration, name, getattr(data.rig, name), units)
    if data.rig.counts_per_revolution is not None:
        field(calibration, "counts_per_revolution", np.int64(data.rig.counts_per_revolution), "")
    if counts:
        field(calibration, "counter_bits", np.int64(data.rig.counter_bits), "")
        field(calibration, "decoder", data.rig.decoder)
    known = (data.rig.belt_speed, data.rig.belt_metres_per_count, data.belt_velocity)
    if any(item is not None for item in known):
        belt = group(instrument, "belt", "NXpositioner")
        field(belt, "name", "belt")
        _measured(belt, "velocity", data.rig.belt_speed, "m/s")
        if data.belt_velocity is not None:
            belt_log = group(belt, "value_log", "NXlog")
            link(belt_log, "time", log["time"])
            field(belt_log, "value", np.asarray(data.belt_velocity, np.float64), "m/s")
            if data.belt_count is not None:
                field(belt_log, "raw_value", np.asarray(data.belt_count, np.int64), "count")
        if data.rig.belt_metres_per_count is not None:
            own = group(belt, "calibration", "NXcollection")
            _measured(own, "metres_per_count", data.rig.belt_metres_per_count, "m")
    return log


def _raw(entry: h5py.Group, raw: Raw, segment: NDArray[np.uint16]) -> None:
    made = group(entry, "raw", "NXdata", signal="count_up", axes="sample")
    made.attrs["auxiliary_signals"] = ["count_down"]
    made.attrs["sample_indices"] = np.int64(0)
    for name, values in raw_columns(raw, segment).items():
        field(made, name, values, RAW_UNITS.get(name))


def _events(entry: h5py.Group, data: RunData) -> None:
    events = group(entry, "events", "NXcollection")
    field(events, "sample", data.event_sample)
    events.create_dataset("kind", data=np.asarray(data.event_kind, np.uint8), dtype=KIND, track_times=False)
    if any(data.event_note):
        field(events, "note", list(data.event_note))


def _measured(parent: h5py.Group, name: str, measured: Measured | None, units: str) -> None:
    # One number and its error, both in f8: a scalar's error in f4 would save nothing and not read back exactly.
    if measured is not None:
        field(parent, name, np.float64(measured.value), units)
        if measured.sd:
            field(parent, f"{name}_errors", np.float64(measured.sd), units)
