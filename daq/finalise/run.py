"""From a journal to a run file: used by ``daq record`` on stop and by ``daq recover`` after a crash.

Everything in the run comes from the journal and its markers, times and provenance too.  So both commands write the same
file byte for byte, except for the name of the command.
"""

import logging
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timedelta, timezone
from pathlib import Path
from typing import Any

import numpy as np

from daq.finalise import blocks, claim, quality
from daq.finalise.columns import RunColumns
from daq.finalise.events import RunEvents
from daq.finalise.quality import DataTotals, RecordingQuality
from daq.protocols import blocks as block_records
from daq.runfile import journal, journal_header, store
from daq.runfile.recording import Recording
from daq.runfile.rig import Rig
from daq.runfile.run_data import EVENT_NAMES, positions
from daq.runfile.spill import Column, Shelf, Spill
from daq.stream import connections
from daq.stream.clock import PartClock
from daq.stream.integrity import CountCheck, CountSurvey
from daq.stream.timeline import Frames, Piece, Samples, Timeline, drop_columns
from daq.wire import frames
from daq.wire.roll_over import survey_roll_over
from stickslip import toml
from stickslip.errors import DataError, InputError
from stickslip.output import atomic
from stickslip.text import storable

logger = logging.getLogger(__name__)
WITHOUT_PITCH = "the metres per count are not known, so positions are in counts"


def finalise(
    part: Path, output: Path, *, finished_by: str, force: bool = False, remove: Callable[[], None] | None = None
) -> RecordingQuality:
    """Build the run file of a journal; then remove the journal and its markers, unless the journal was damaged.

    part, output: The journal, and the run file to write.
    finished_by: The command, for the provenance.
    remove: Removes the journal: from the recorder, which holds its lock.  Without it the lock is taken here.
    Raises InputError if the journal is missing, not a journal, or still being written, or if ``output`` exists or
    cannot be read back; DataError if the journal contains no samples.  The journal is kept after every error.
    """
    if remove is None:
        with claim.claim_journal(part) as remover:
            return finalise(part, output, finished_by=finished_by, force=force, remove=remover)
    exists = output.is_file() and not force
    if not exists:
        atomic.refuse_existing(output, force)
    markers = journal.markers_path(part)
    recorded = journal.read(part)
    run, findings = run_data(recorded, journal.read_markers(markers), finished_by, output)
    logger.info("%s: %d records, %d samples", part, len(recorded.records), findings.samples)
    # If a command was killed after it had put the file in place, only the removal of the journal is missing.
    if not (exists and not recorded.damaged and store.is_same_run(output, run)):
        store.write(output, run, force=force)
        store.read_back(output)
    if not recorded.damaged:
        try:
            markers.unlink(missing_ok=True)
            journal.stop_path(part).unlink(missing_ok=True)
            remove()
        except OSError as error:
            unremoved = f"{error.filename or part} could not be removed ({error.strerror})"
            note = f"the run file is complete, but {unremoved}: delete it"
            findings = replace(findings, warnings=(*findings.warnings, note))
    return replace(findings, file=output)


def run_data(
    recorded: journal.Journal,
    markers: Sequence[tuple[int, str]] = (),
    finished_by: str = "",
    output: Path | None = None,
) -> tuple[Recording, RecordingQuality]:
    """Return the run in a journal, and its quality.

    The samples are processed piece by piece, in memory that does not grow with their number; if there are many, the
    columns of the run are in a file (`daq.runfile.spill.Column`) next to ``output``.

    Raises InputError if this version does not know the journal's protocol, DataError if it contains no samples.
    """
    recorded = replace(recorded, header=journal_header.complete(recorded.header, recorded.path))
    header = recorded.header
    spill = Spill(output)
    parts = (_gather_blocks if header["protocol"] == block_records.NAME else _gather_board)(recorded, markers, spill)
    totals, rig, clocks = parts.totals, parts.rig, parts.clock.compare()
    started, ended = _find_instants(recorded.path, header, totals.first_ns, totals.last_s)
    sorted_events = parts.events.sort()
    run = Recording(
        title=header["title"],
        started=started.isoformat(),
        ended=ended.isoformat(),
        rate_hz=float(header["rate_hz"]),
        rig=rig,
        config_toml=parts.config,
        clock_sample=clocks.index.astype(np.uint32),
        clock_offset=clocks.offset,
        clock_ppm=clocks.ppm,
        clock_ppm_error=clocks.ppm_error,
        clock_offset_error=clocks.offset_error,
        event_sample=np.array([event[0] for event in sorted_events], dtype=np.uint32),
        event_kind=tuple(EVENT_NAMES[event[1]] for event in sorted_events),
        event_note=tuple(event[2] for event in sorted_events),
        operator=header["operator"],
        sample_name=header["sample_name"],
        note=header["note"],
        tags=header["tags"],
        provenance=header["provenance"] | {"finished_by": finished_by},
        **parts.columns,
    )
    findings = quality.assess_run(recorded, totals, run)
    warnings = quality.find_warnings(findings, recorded, totals, rig)
    return run, replace(findings, warnings=(*header["warnings"], *parts.warnings, *warnings))


@dataclass(frozen=True)
class _RunParts:
    """The contents of a journal's records."""

    rig: Rig  # the calibration, and its text
    config: str
    columns: dict[str, Any]  # the attributes of the run that are columns over its samples, or follow from them
    totals: DataTotals  # counts, events, and the clocks
    events: RunEvents
    clock: PartClock
    warnings: list[str]  # about the calibration


def _gather_blocks(recorded: journal.Journal, markers: Sequence[tuple[int, str]], spill: Spill) -> _RunParts:
    """Gather the samples of blocks supplied by a program."""
    header = recorded.header
    config, rig, _ = read_calibration(recorded.records.of_kind(journal.CONFIGURATION), (), None)
    rig = replace(rig, counter_bits=blocks.COUNTER_BITS)
    counted = header["columns"] == block_records.COUNTS
    columns = {name: Column(spill) for name in ("time", "position", "segment", *(["count"] if counted else []))}
    totals, events = DataTotals(), RunEvents(markers, float(header["rate_hz"]))
    clock = PartClock(0, None, by_bytes=False, spill=spill)
    stream = blocks.BlockStream(header)
    for record in recorded.records.of_kind(journal.RECEIVED):
        piece, checked, values = stream.take(record.stamp_ns, record.data)
        position = positions(checked.count, rig) if counted else values.astype(np.float64)
        values_of = {"time": piece.samples.time, "position": position, **vars(checked)}
        for name, column in columns.items():
            column.append(values_of[name])
        totals.take(piece, checked, position)
        events.take(piece, checked)
        clock.take(piece)
    if not totals.samples:
        raise _no_samples(recorded)
    warnings = [WITHOUT_PITCH] if counted and rig.metres_per_count is None else []
    all_columns = {name: column.whole() for name, column in columns.items()}
    return _RunParts(rig, config, all_columns, totals, events, clock, warnings)


def _gather_board(recorded: journal.Journal, markers: Sequence[tuple[int, str]], spill: Spill) -> _RunParts:
    """Gather the samples of a board's bytes."""
    header = recorded.header
    rate_hz = float(header["rate_hz"])
    configurations = list(recorded.records.of_kind(journal.CONFIGURATION))
    starts_at_phase = header["protocol"] == "frames"
    timeline = Timeline(connections.decode_connections(recorded), rate_hz, connections.TICK_NS, header["samples"])
    _, rig, _ = read_calibration(configurations, (), None)
    survey = CountSurvey(timeline.idents, rig.counter_bits, rate_hz, starts_at_phase=starts_at_phase)
    all_samples: Shelf[Samples] = Shelf(spill)
    all_frames: Shelf[Frames] = Shelf(spill)
    for samples, sent in timeline:
        survey.take(samples)
        all_samples.append(samples)
        all_frames.append(sent)
    if not timeline.lengths:
        raise _no_samples(recorded)
    config, rig, warnings = read_calibration(configurations, timeline.configs, timeline.ident)
    rig = connections.unify_calibration(rig, timeline.idents)
    warnings += connections.find_contradictions(timeline.idents, timeline.configs, rig)
    count_check = CountCheck(survey, rig)
    longest = max(timeline.lengths, key=timeline.lengths.__getitem__)
    clock = PartClock(longest, header["baud"], timeline.times_bytes, spill)
    totals, events = DataTotals(repeated=timeline.repeated), RunEvents(markers, rate_hz)
    columns = RunColumns(rig, timeline.idents, spill)
    for samples, sent in zip(all_samples, all_frames, strict=True):
        piece = Piece(drop_columns(samples, timeline.missing), sent)
        checked = count_check.take(piece.samples)
        position = positions(checked.count, rig)
        columns.take(piece.samples, checked, position)
        totals.take(piece, checked, position)
        events.take(piece, checked)
        clock.take(piece)
    belt_count, belt_velocity = columns.compute_belt(rate_hz)
    if columns.has("belt_count") and belt_velocity is None:
        warnings.append("the metres per belt count are not known, so the belt counts give no speed")
    if (roll_over := survey_roll_over(columns["count"], columns["segment"])) is not None:
        warnings.append(
            f"the count jumps {roll_over}, as it does if a counter rolls over or restarts. The jumps were not "
            "removed. Declare the width of a 16-bit counter, as in --columns t_us,count:16, and record again"
        )
    all_columns = {
        "time": columns["time"],
        "position": columns["position"],
        "count": columns["count"],
        "raw": columns.build_raw(),
        "segment": columns["segment"],
        "belt_velocity": belt_velocity,
        "belt_count": belt_count,
        "truth": columns.build_truth(header["port"]),
        "sent_as": connections.build_sent_as(timeline.idents, rig, totals.segment, totals.source),
    }
    return _RunParts(rig, config, all_columns, totals, events, clock, warnings)


def _find_instants(path: Path, header: dict[str, Any], first_ns: int, span_s: float) -> tuple[datetime, datetime]:
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
    what = f"has no samples: none could be read from the {size} bytes received" if size else "has no samples"
    return DataError(
        what, str(recorded.path), "check the board, --baud and --protocol; then delete this file and record again"
    )


def read_calibration(
    configurations: Iterable[journal.Record], sent: Sequence[str], ident: frames.Ident | None
) -> tuple[str, Rig, list[str]]:
    """Return the configuration's text, the rig it describes, and warnings; the decoder is the one the board reports.

    The first of the stored ``configurations`` goes before those that boards have ``sent``.
    """
    stored = [storable(record.data.decode(errors="replace")) for record in configurations]
    config = (*stored, *sent, "")[0]
    warnings = []
    rig = Rig()
    try:
        rig = Rig.from_toml(config, "the board's CONFIG")
    except InputError as error:
        warnings.append(f"the calibration could not be read ({error})")
    if ident is not None:
        stated_decoder = (
            None if warnings else toml.parse(config, "the board's CONFIG").get("encoder", {}).get("decoder")
        )
        if stated_decoder not in (None, ident.decoder):
            warnings.append(
                f"the calibration is for the decoder {stated_decoder}, but the board counts as "
                f"{ident.decoder}, so the metres per count may be wrong"
            )
        rig = replace(rig, decoder=ident.decoder, counter_bits=ident.counter_bits)
    if rig.metres_per_count is None:
        warnings.append(WITHOUT_PITCH)
    return config, rig, warnings
