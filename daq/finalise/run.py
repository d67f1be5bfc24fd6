"""From a journal to a run file: used by ``daq record`` on stop and by ``daq recover`` after a crash.

Everything in the run comes from the journal and its markers, times and provenance too.  So both commands write the same
file byte for byte, except for the name of the command.
"""

import logging
from collections.abc import Callable, Sequence
from dataclasses import replace
from datetime import datetime, timedelta, timezone
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.errors import DataError, InputError
from daq.finalise import belt_counter, clock_sync, quality, timeline
from daq.finalise.events import events_of
from daq.finalise.integrity import CheckedCounts, check
from daq.finalise.quality import RecordingQuality
from daq.finalise.timeline import Samples, TruthRows
from daq.output import atomic
from daq.runfile import journal, journal_header, store
from daq.runfile.recording import EVENT_NAMES, Raw, Recording, Truth, positions
from daq.runfile.rig import Rig
from daq.wire import decode, frames

logger = logging.getLogger(__name__)


def finalise(
    part: Path, output: Path, *, finished_by: str, force: bool = False, remove: Callable[[], None] | None = None
) -> RecordingQuality:
    """Build the run file of a journal; then remove the journal and its markers, unless the journal was damaged.

    Parameters
    ----------
    part, output : Path
        The journal, and the run file to write.
    finished_by : str
        The command, for the provenance.
    remove : callable, optional
        Removes the journal: from the recorder, which holds its lock.  Without it the lock is taken here.

    Raises
    ------
    InputError
        The journal is missing, not a journal, or still being written; or ``output`` exists.
    DataError
        The journal holds no samples.  It is kept, as after every other error.
    """
    if remove is None:
        with journal.claimed(part) as removing:
            return finalise(part, output, finished_by=finished_by, force=force, remove=removing)
    exists = output.is_file() and not force
    if not exists:
        atomic.refuse_existing(output, force)
    markers = journal.markers_path(part)
    recorded = journal.read(part)
    run, found = run_data(recorded, journal.read_markers(markers), finished_by)
    logger.info("%s: %d records, %d samples", part, len(recorded.records), found.samples)
    # A command that was killed after it had put the file in place left the journal: what is missing is its removal.
    if not (exists and not recorded.damaged and store.holds(output, run)):
        store.write(output, run, force=force)
    if not recorded.damaged:
        markers.unlink(missing_ok=True)
        remove()
    return replace(found, file=output)


def run_data(
    recorded: journal.Journal, markers: Sequence[tuple[int, str]] = (), finished_by: str = ""
) -> tuple[Recording, RecordingQuality]:
    """Return the run in a journal, and its quality.

    Raises
    ------
    InputError
        The journal is in a protocol this version does not know.
    DataError
        It holds no samples.
    """
    header = journal_header.complete(recorded.header, recorded.path)
    rate_hz = float(header["rate_hz"])
    streams = timeline.connections(recorded)
    if not any(len(stream.n) for stream in streams):
        raise _no_samples(recorded)
    ident = timeline.first_ident(streams)
    tick_ns = ident.tick_ns if ident else 1000
    samples, truth_rows = timeline.assemble(streams, rate_hz, tick_ns)
    if header["samples"] is not None:
        samples = samples.take(timeline.run_index(samples, rate_hz) < header["samples"])
    if len(samples) == 0:
        raise _no_samples(recorded)
    config, rig, warnings = calibration(recorded.records, streams, ident)
    checked = check(samples, ident, rig, rate_hz, starts_at_phase=header["protocol"] == "frames")
    position = positions(checked.count, rig)
    started, ended = _instants(recorded.path, header, int(samples.stamp_ns[0]), float(samples.time[-1]))
    belt_count, belt_velocity = belt_counter.decoded(samples.belt, samples.time, checked.starts, rate_hz, rig)
    if samples.belt is not None and belt_velocity is None:
        warnings.append("no metres per belt count are known, so the belt's counts give no speed")
    clocks = clock_sync.from_samples(samples, streams, header["baud"])
    events = events_of(samples, checked, streams, markers, rate_hz)
    run = Recording(
        title=header["title"],
        started=started.isoformat(),
        ended=ended.isoformat(),
        rate_hz=rate_hz,
        rig=rig,
        time=samples.time,
        position=position,
        count=checked.count,
        raw=_raw(samples, checked, tick_ns),
        segment=checked.segment,
        config_toml=config,
        clock_sample=clocks.index.astype(np.uint32),
        clock_offset=clocks.offset,
        clock_ppm=clocks.ppm,
        clock_ppm_error=clocks.ppm_error,
        clock_offset_error=clocks.offset_error,
        event_sample=np.array([event[0] for event in events], dtype=np.uint32),
        event_kind=tuple(EVENT_NAMES[event[1]] for event in events),
        event_note=tuple(event[2] for event in events),
        belt_velocity=belt_velocity,
        belt_count=belt_count,
        truth=_truth(samples, truth_rows, tick_ns, header["port"]),
        operator=header["operator"],
        sample_name=header["sample_name"],
        note=header["note"],
        tags=header["tags"],
        provenance=header["provenance"] | {"finished_by": finished_by},
    )
    found = quality.from_run(recorded, samples, checked, streams, run)
    warnings = [*header["warnings"], *warnings, *quality.warnings(found, recorded, samples, checked, streams, rig)]
    return run, replace(found, warnings=tuple(warnings))


def _instants(path: Path, header: dict[str, Any], first_ns: int, span_s: float) -> tuple[datetime, datetime]:
    """Return when the first and the last sample were taken, by the host's clock at the start and the stamps."""
    wall_ns = header["wall_ns"] + first_ns - header["monotonic_ns"]
    try:
        started = datetime.fromtimestamp(wall_ns / 1e9, timezone(timedelta(seconds=header["utc_offset_s"])))
        return started, started + timedelta(seconds=span_s)
    except (OverflowError, OSError, ValueError) as error:
        what = f"its first sample was stamped {(first_ns - header['monotonic_ns']) / 1e9:.3g} s after the start"
        raise InputError(f"{what}, and the last one {span_s:.3g} s later", str(path), journal_header.DO) from error


def _no_samples(recorded: journal.Journal) -> DataError:
    size = sum(len(record.data) for record in recorded.records if record.kind == journal.RECEIVED)
    what = f"holds no samples: none can be read in the {size} bytes that were received" if size else "holds no samples"
    return DataError(
        what, str(recorded.path), "check that the board sends, and --baud and --protocol; delete it and record again"
    )


def _raw(samples: Samples, checked: CheckedCounts, tick_ns: int) -> Raw:
    sent = samples.ticks if samples.time_error is None else samples.ticks + samples.time_error
    microseconds = sent * tick_ns // 1000
    return Raw(
        sample=samples.index.astype(np.uint32),
        count_up=samples.up,
        count_down=samples.down,
        device_time=(microseconds & 0xFFFFFFFF).astype(np.uint32),
        levels=samples.status & np.uint8(frames.LEVELS),
        flags=checked.flags,
        illegal=samples.illegal,
        belt_count=samples.belt,
        edge_time=None if samples.edge is None else _edge_us(samples.edge, tick_ns),
    )


def _edge_us(edge: NDArray[np.uint16], tick_ns: int) -> NDArray[np.uint16]:
    """Return the time since the last edge in us; "none" keeps its value on the wire."""
    us = edge.astype(np.int64) * tick_ns // 1000
    return np.where(edge == frames.NO_EDGE, frames.NO_EDGE, us).astype(np.uint16)


def calibration(
    records: Sequence[journal.Record], streams: Sequence[decode.Stream], ident: frames.Ident | None
) -> tuple[str, Rig, list[str]]:
    """Return the configuration's text, the rig it describes, and warnings; the decoder is what the board reports."""
    given = [record.data.decode(errors="replace") for record in records if record.kind == journal.CONFIGURATION]
    sent = next((stream.configs for stream in streams if stream.configs), ())
    config = (*given, *(text for _, text in sent), "")[0]
    warnings = []
    rig = Rig()
    try:
        rig = Rig.from_toml(config, "the board's CONFIG")
    except InputError as error:
        warnings.append(f"the calibration could not be read ({error})")
    if ident is not None:
        rig = replace(rig, decoder=ident.decoder, counter_bits=ident.counter_bits)
    if rig.metres_per_count is None:
        warnings.append("no metres per count are known, so positions are counts")
    return config, rig, warnings


def _truth(samples: Samples, sent: TruthRows, tick_ns: int, scene: str) -> Truth | None:
    """Return the exact motion at the received samples, its time on the run's axis; None if none was sent."""
    if len(sent.rows) == 0:
        return None
    # One number for part and index: parts are few, and an index stays far below 2^48.
    key = samples.part << 48 | samples.index
    _, at, row = np.intersect1d(key, sent.part << 48 | sent.index, return_indices=True)
    shift = np.zeros(len(samples))
    for _, here in timeline.parts_of(samples):
        shift[here] = samples.time[here.start] - samples.ticks[here.start] * tick_ns / 1e9
    time, x, v, force = sent.rows[row].T
    return Truth(time + shift[at], x, v, force, scene)
