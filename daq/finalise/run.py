"""From a journal to a run file: used by ``daq record`` on stop and by ``daq recover`` after a crash.

Everything in the run comes from the journal and its markers, times and provenance too.  So both commands write the same
file byte for byte, except for the name of the command.
"""

import logging
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timedelta, timezone
from pathlib import Path
from typing import Any

import numpy as np

from daq.finalise import blocks, claim, connections, quality
from daq.finalise.clock_points import PartClock
from daq.finalise.columns import RunColumns
from daq.finalise.events import RunEvents
from daq.finalise.integrity import CountCheck
from daq.finalise.quality import DataTotals, RecordingQuality
from daq.finalise.timeline import Samples, Timeline, parts_of
from daq.protocols import blocks as block_records
from daq.runfile import journal, journal_header, store
from daq.runfile.recording import EVENT_NAMES, Recording, positions
from daq.runfile.rig import Rig
from daq.runfile.spill import Column, Spill
from daq.wire import decode, frames
from daq.wire.roll_over import survey_roll_over
from stickslip import toml
from stickslip.errors import DataError, InputError
from stickslip.output import atomic
from stickslip.text import storable

logger = logging.getLogger(__name__)
WITHOUT_PITCH = "no metres per count are known, so positions are counts"


def finalise(
    part: Path, output: Path, *, finished_by: str, force: bool = False, remove: Callable[[], None] | None = None
) -> RecordingQuality:
    """Build the run file of a journal; then remove the journal and its markers, unless the journal was damaged.

    part, output: The journal, and the run file to write.
    finished_by: The command, for the provenance.
    remove: Removes the journal: from the recorder, which holds its lock.  Without it the lock is taken here.
    Raises InputError: the journal is missing, not a journal, or still being written; ``output`` exists, or cannot be
        read back.
    Raises DataError: the journal holds no samples.  It is kept, as after every other error.
    """
    if remove is None:
        with claim.claimed(part) as removing:
            return finalise(part, output, finished_by=finished_by, force=force, remove=removing)
    exists = output.is_file() and not force
    if not exists:
        atomic.refuse_existing(output, force)
    markers = journal.markers_path(part)
    recorded = journal.read(part)
    run, found = run_data(recorded, journal.read_markers(markers), finished_by, output)
    logger.info("%s: %d records, %d samples", part, len(recorded.records), found.samples)
    # A command that was killed after it had put the file in place left the journal: what is missing is its removal.
    if not (exists and not recorded.damaged and store.holds(output, run)):
        store.write(output, run, force=force)
        store.read_back(output)
    if not recorded.damaged:
        try:
            markers.unlink(missing_ok=True)
            journal.stop_path(part).unlink(missing_ok=True)
            remove()
        except OSError as error:
            left = f"{error.filename or part} could not be removed ({error.strerror})"
            kept = f"the run file is complete, but {left}: delete it"
            found = replace(found, warnings=(*found.warnings, kept))
    return replace(found, file=output)


def run_data(
    recorded: journal.Journal,
    markers: Sequence[tuple[int, str]] = (),
    finished_by: str = "",
    output: Path | None = None,
) -> tuple[Recording, RecordingQuality]:
    """Return the run in a journal, and its quality.

    The samples are worked on piece by piece, in memory that does not grow with their number; where they are many, the
    columns of the run are in a file (`daq.runfile.spill.Column`) beside ``output``.

    Raises InputError: the journal is in a protocol this version does not know.
    Raises DataError: it holds no samples.
    """
    recorded = replace(recorded, header=journal_header.complete(recorded.header, recorded.path))
    header = recorded.header
    spill = Spill(output)
    gathered = (_of_blocks if header["protocol"] == block_records.NAME else _of_board)(recorded, markers, spill)
    totals, rig, clocks = gathered.totals, gathered.rig, gathered.clock.compared()
    started, ended = _instants(recorded.path, header, gathered.first_ns, totals.last_s)
    found_events = gathered.events.sorted()
    run = Recording(
        title=header["title"],
        started=started.isoformat(),
        ended=ended.isoformat(),
        rate_hz=float(header["rate_hz"]),
        rig=rig,
        config_toml=gathered.config,
        clock_sample=clocks.index.astype(np.uint32),
        clock_offset=clocks.offset,
        clock_ppm=clocks.ppm,
        clock_ppm_error=clocks.ppm_error,
        clock_offset_error=clocks.offset_error,
        event_sample=np.array([event[0] for event in found_events], dtype=np.uint32),
        event_kind=tuple(EVENT_NAMES[event[1]] for event in found_events),
        event_note=tuple(event[2] for event in found_events),
        operator=header["operator"],
        sample_name=header["sample_name"],
        note=header["note"],
        tags=header["tags"],
        provenance=header["provenance"] | {"finished_by": finished_by},
        **gathered.columns,
    )
    streams = gathered.streams
    found = quality.from_run(recorded, totals, gathered.peak_count_rate, streams, run)
    said = quality.warnings(found, recorded, totals, gathered.repeated, streams, rig)
    return run, replace(found, warnings=(*header["warnings"], *gathered.warnings, *said))


@dataclass(frozen=True)
class _Gathered:
    """What the records of a journal hold."""

    rig: Rig  # the calibration, and its text
    config: str
    columns: dict[str, Any]  # the attributes of the run that are columns over its samples, or follow from them
    totals: DataTotals  # what was counted, what happened, and how the clocks went
    events: RunEvents
    clock: PartClock
    streams: list[decode.Stream]  # what was sent, without its arrays
    warnings: list[str]  # what is wrong with the calibration
    first_ns: int  # Host's stamp of the first sample
    peak_count_rate: float  # see `CountCheck`, `Timeline`
    repeated: int = 0


def _of_blocks(recorded: journal.Journal, markers: Sequence[tuple[int, str]], spill: Spill) -> _Gathered:
    """Gather the samples of blocks that a program handed over."""
    header = recorded.header
    config, rig, _ = calibration(recorded.records.of_kind(journal.CONFIGURATION), (), None)
    rig = replace(rig, counter_bits=blocks.COUNTER_BITS)
    counted = header["columns"] == block_records.COUNTS
    columns = {name: Column(spill) for name in ("time", "position", "segment", *(["count"] if counted else []))}
    totals, events = DataTotals(), RunEvents(markers, float(header["rate_hz"]))
    clock = PartClock(0, None, by_bytes=False, spill=spill)
    damaged: list[decode.Stream] = []
    first_ns, peak = 0, 0.0
    for piece, checked, values in blocks.pieces(recorded):
        position = positions(checked.count, rig) if counted else values.astype(np.float64)
        if len(values) and not totals.samples:
            first_ns = int(piece.samples.stamp_ns[0])
        own = {"time": piece.samples.time, "position": position, "segment": checked.segment, "count": checked.count}
        for name, column in columns.items():
            column.append(own[name])
        totals.take(piece, checked, position)
        events.take(piece, checked)
        clock.take(piece)
        peak = max(peak, checked.peak_count_rate)
        damaged += [piece.stream] if piece.stream.crc_errors else []
    if not totals.samples:
        raise _no_samples(recorded)
    warnings = [WITHOUT_PITCH] if counted and rig.metres_per_count is None else []
    whole = {name: column.whole() for name, column in columns.items()}
    return _Gathered(rig, config, whole, totals, events, clock, damaged, warnings, first_ns, peak)


def _of_board(recorded: journal.Journal, markers: Sequence[tuple[int, str]], spill: Spill) -> _Gathered:
    """Gather the samples of a board's bytes."""
    header = recorded.header
    rate_hz = float(header["rate_hz"])
    shelves = connections.connections(recorded, spill)
    streams = [stream for shelf in shelves for stream in shelf.labels]
    ident = connections.first_ident(streams)
    line = Timeline(shelves, rate_hz, connections.TICK_NS, header["samples"], spill)
    config, rig, warnings = calibration(recorded.records.of_kind(journal.CONFIGURATION), streams, ident)
    rig = connections.common(rig, line.idents)
    sent = [text for stream in streams for _, text in stream.configs]
    warnings += connections.contradictions(line.idents, sent, rig)
    checking = CountCheck(line.idents, rig, rate_hz, starts_at_phase=header["protocol"] == "frames")
    pieces = _CountedPieces(line)
    checking.survey(pieces)
    if not pieces.lengths:
        raise _no_samples(recorded)
    clock = PartClock(max(pieces.lengths, key=pieces.lengths.__getitem__), header["baud"], line.times_bytes, spill)
    totals, events, columns = DataTotals(), RunEvents(markers, rate_hz), RunColumns(rig, line.idents, line.truth, spill)
    for piece in line:
        checked = checking.take(piece.samples)
        position = positions(checked.count, rig)
        columns.take(piece.samples, checked, position)
        totals.take(piece, checked, position)
        events.take(piece, checked)
        clock.take(piece)
    belt_count, belt_velocity = columns.belt(rate_hz)
    if columns.has("belt_count") and belt_velocity is None:
        warnings.append("no metres per belt count are known, so the belt's counts give no speed")
    if (roll_over := survey_roll_over(columns["count"], columns["segment"])) is not None:
        warnings.append(
            f"the count jumps {roll_over}, as a counter does that rolls over or restarts, and the motion holds these "
            "jumps; for a counter of 16 bits declare its width, as in --columns t_us,count:16, and record again"
        )
    whole = {
        "time": columns["time"],
        "position": columns["position"],
        "count": columns["count"],
        "raw": columns.raw(),
        "segment": columns["segment"],
        "belt_velocity": belt_velocity,
        "belt_count": belt_count,
        "truth": columns.truth(header["port"]),
        "sent_as": connections.stored(line.idents, rig, totals.segment, totals.source),
    }
    return _Gathered(
        rig,
        config,
        whole,
        totals,
        events,
        clock,
        streams,
        warnings,
        columns.first_ns,
        checking.peak_count_rate,
        line.repeated,
    )


class _CountedPieces:
    """The samples of a timeline's pieces, whenever they are iterated over.

    lengths: How many samples each part of the run has; after the last piece.
    """

    def __init__(self, line: Timeline) -> None:
        self.lengths: dict[int, int] = {}
        self._line = line

    def __iter__(self) -> Iterator[Samples]:
        self.lengths = {}
        for piece in self._line:
            for part, here in parts_of(piece.samples):
                self.lengths[part] = self.lengths.get(part, 0) + here.stop - here.start
            yield piece.samples


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
    size = sum(len(record.data) for record in recorded.records.of_kind(journal.RECEIVED))
    what = f"holds no samples: none can be read in the {size} bytes that were received" if size else "holds no samples"
    return DataError(
        what, str(recorded.path), "check that the board sends, and --baud and --protocol; delete it and record again"
    )


def calibration(
    configurations: Iterable[journal.Record], streams: Sequence[decode.Stream], ident: frames.Ident | None
) -> tuple[str, Rig, list[str]]:
    """Return the configuration's text, the rig it describes, and warnings; the decoder is what the board reports."""
    given = [storable(record.data.decode(errors="replace")) for record in configurations]
    sent = next((stream.configs for stream in streams if stream.configs), ())
    config = (*given, *(text for _, text in sent), "")[0]
    warnings = []
    rig = Rig()
    try:
        rig = Rig.from_toml(config, "the board's CONFIG")
    except InputError as error:
        warnings.append(f"the calibration could not be read ({error})")
    if ident is not None:
        stated = None if warnings else toml.parsed(config, "the board's CONFIG").get("encoder", {}).get("decoder")
        if stated not in (None, ident.decoder):
            warnings.append(
                f"the calibration is for the decoder {stated}, and the board counts as {ident.decoder}: its metres per "
                "count may not hold"
            )
        rig = replace(rig, decoder=ident.decoder, counter_bits=ident.counter_bits)
    if rig.metres_per_count is None:
        warnings.append(WITHOUT_PITCH)
    return config, rig, warnings
