"""From a journal to a run file: the one finaliser behind ``daq record`` on stop and ``daq recover`` after a crash.

Everything in the run comes out of the journal and its markers, times and provenance too, so that both ways give the
same file byte for byte, but for who finished it.
"""

from collections.abc import Sequence
from dataclasses import replace
from datetime import datetime, timedelta, timezone
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from daq.errors import DataError, InputError
from daq.finalise import belt_counter, clock_sync, timeline
from daq.finalise.events import events_of
from daq.finalise.integrity import Checked, check
from daq.finalise.quality import Summary
from daq.finalise.timeline import Samples, TruthRows
from daq.output import atomic
from daq.protocols import link_budget
from daq.runfile import journal, store
from daq.runfile.recording import EVENT_NAMES, Raw, Recording, Truth, positions
from daq.runfile.rig import Rig
from daq.wire import counters, decode, frames
from daq.wire.quadrature import EDGES_PER_COUNT


def finalise(part: Path, output: Path, *, finished_by: str, force: bool = False) -> Summary:
    """Build the run file of a journal; then remove the journal and its markers, unless the journal was damaged.

    Parameters
    ----------
    part, output : Path
        The journal, and the run file to write.
    finished_by : str
        The command, for the provenance.

    Raises
    ------
    InputError
        The journal is missing or none of ours, or ``output`` exists.
    DataError
        The journal holds no samples.  It stays where it is, as after every other error.
    """
    atomic.refuse_existing(output, force)
    markers = journal.markers_path(part)
    taken = journal.read(part)
    data, summary = run_data(taken, journal.read_markers(markers), finished_by)
    store.write(output, data, force=force)
    if not taken.damaged:
        part.unlink()
        markers.unlink(missing_ok=True)
    return replace(summary, file=output)


def run_data(
    taken: journal.Journal, markers: Sequence[tuple[int, str]] = (), finished_by: str = ""
) -> tuple[Recording, Summary]:
    """Turn a journal into a run, and say what was found in it.

    Raises
    ------
    InputError
        The journal is in a protocol this version does not know.
    DataError
        It holds no samples.
    """
    header = taken.header
    rate_hz = float(header["rate_hz"])
    said = timeline.connections(taken)
    ident = timeline.first_ident(said)
    tick_ns = ident.tick_ns if ident else 1000
    samples, truth_rows = timeline.assemble(said, rate_hz, tick_ns)
    if header["samples"] is not None:
        samples = samples.take(timeline.run_index(samples, rate_hz) < header["samples"])
    if len(samples) == 0:
        raise DataError("holds no samples", str(taken.path), "see that the board sends, then record again")
    config, rig, warnings = _calibration(taken, said, ident)
    checked = check(samples, ident, rig, rate_hz, starts_at_phase=header["protocol"] == "frames")
    position = positions(checked.count, rig)
    zone = timezone(timedelta(seconds=header["utc_offset_s"]))
    wall_ns = header["wall_ns"] + int(samples.stamp_ns[0]) - header["monotonic_ns"]
    started = datetime.fromtimestamp(wall_ns / 1e9, zone)
    ended = started + timedelta(seconds=float(samples.time[-1]))
    belt_count, belt_velocity = belt_counter.decoded(samples.belt, samples.time, checked.starts, rate_hz, rig)
    if samples.belt is not None and belt_velocity is None:
        warnings.append("no metres per belt count are known, so the belt's counts give no speed")
    clocks = _clocks(samples, said, header.get("baud"))
    events = events_of(samples, checked, said, markers, rate_hz)
    data = Recording(
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
        provenance=header["provenance"] | {"finished_by": finished_by},
    )
    return data, _summary(taken, samples, checked, said, clocks, rig, position, warnings)


def _raw(samples: Samples, checked: Checked, tick_ns: int) -> Raw:
    microseconds = samples.ticks * tick_ns // 1000
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
    """Return the time since the last edge in us; "none" stays what it is on the wire."""
    us = edge.astype(np.int64) * tick_ns // 1000
    return np.where(edge == frames.NO_EDGE, frames.NO_EDGE, us).astype(np.uint16)


def _calibration(
    taken: journal.Journal, said: Sequence[decode.Stream], ident: frames.Ident | None
) -> tuple[str, Rig, list[str]]:
    """Return the configuration's text and the rig it describes; the board's word on its own decoder goes first."""
    given = [record.data.decode(errors="replace") for record in taken.records if record.kind == journal.CONFIGURATION]
    told = next((connection.configs for connection in said if connection.configs), ())
    config = (*given, *(text for _, text in told), "")[0]
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


def _clocks(samples: Samples, said: Sequence[decode.Stream], baud: int | None) -> clock_sync.Clock:
    """Compare the clocks over the longest part; ``index`` of the answer is the run's sample."""
    here = max((where for _, where in timeline.parts_of(samples)), key=lambda where: where.stop - where.start)
    last = here.start + np.flatnonzero(np.diff(samples.frame[here], append=-1) != 0)
    host, sample, sent_s = samples.stamp_ns[last], last, np.zeros(len(last))
    # What had not come in yet: the next frame, where another read brought it.
    following = np.append(np.where(np.diff(host) > 0, samples.time[last][1:], np.nan), np.nan)
    by_bytes = False
    if baud is not None:
        # On a serial line of known speed every byte has its time, so reads that ended inside a frame count as well.
        base = np.cumsum([0, *(len(connection.n) for connection in said)])
        length = np.concatenate([connection.length for connection in said])
        stamps = np.concatenate([connection.part_stamp_ns for connection in said])
        begun = np.concatenate([at + connection.part_frame for at, connection in zip(base, said, strict=False)])
        count = np.concatenate([connection.part_bytes for connection in said])
        of = np.searchsorted(samples.frame[last], begun)
        known = (of < len(last)) & (samples.frame[last][np.minimum(of, len(last) - 1)] == begun)
        host = np.concatenate((host, stamps[known]))
        sample = np.concatenate((last, last[of[known]]))
        byte_s = link_budget.BITS_PER_BYTE / baud
        sent_s = np.concatenate((length[samples.frame[last]], count[known])) * byte_s
        by_bytes = bool(length.any())  # of text lines the recorder does not know how long each was
        if by_bytes:
            # The next byte; behind a frame that is the first of the next one, if no byte of it had come.
            following[:-1][np.isin(samples.frame[last][1:], begun)] = np.nan
            following = np.concatenate((following, samples.time[last[of[known]]] + sent_s[len(last) :])) + byte_s
        else:
            following = np.concatenate((following, np.full(int(known.sum()), np.nan)))
    device = samples.time[sample] + sent_s
    order = np.argsort(device, kind="stable")
    host_s = (host[order] - samples.stamp_ns[0]) / 1e9
    found = clock_sync.compare(host_s, device[order], following[order], by_bytes=by_bytes)
    return replace(found, index=sample[order][found.index])


def _truth(samples: Samples, told: TruthRows, tick_ns: int, scene: str) -> Truth | None:
    """Return the truth of the samples that are there, its time on the run's axis; None when none was told."""
    if len(told.rows) == 0:
        return None
    # One number for part and index: parts are few, and an index stays far below 2^48.
    key = samples.part << 48 | samples.index
    _, at, row = np.intersect1d(key, told.part << 48 | told.index, return_indices=True)
    shift = np.zeros(len(samples))
    for _, here in timeline.parts_of(samples):
        shift[here] = samples.time[here.start] - samples.ticks[here.start] * tick_ns / 1e9
    time, x, v, force = told.rows[row].T
    return Truth(time + shift[at], x, v, force, scene)


def _summary(
    taken: journal.Journal,
    samples: Samples,
    checked: Checked,
    said: Sequence[decode.Stream],
    clocks: clock_sync.Clock,
    rig: Rig,
    position: NDArray[np.float64],
    warnings: list[str],
) -> Summary:
    rate_hz = float(taken.header["rate_hz"])
    dropped = sum(int.from_bytes(r.data, "little") for r in taken.records if r.kind == journal.DROPPED)
    span = float(samples.time[-1])
    place = timeline.run_index(samples, rate_hz)
    periods = int(place[-1] - place[0])
    summary = Summary(
        samples=len(samples),
        lost=int(checked.lost.sum()),
        crc_errors=sum(connection.crc_errors for connection in said),
        illegal=checked.illegal,
        phase_errors=int(np.count_nonzero(checked.flags & counters.FLAG_PHASE)),
        both_moved=int(np.count_nonzero(checked.flags & counters.FLAG_BOTH)),
        dropped_bytes=dropped,
        segments=len(checked.starts),
        rate_hz=rate_hz,
        measured_rate_hz=periods / span if span > 0 else rate_hz,
        clock_ppm=clocks.ppm,
        clock_ppm_error=clocks.ppm_error,
        duration_s=span + 1 / rate_hz,
        peak_edge_rate_hz=checked.peak_count_rate * EDGES_PER_COUNT.get(rig.decoder, 1),
        travel=(float(position.min()), float(position.max())),
        unit="m" if rig.metres_per_count is not None else "count",
        warnings=(),
        port_lost=sum(record.kind == journal.LOST for record in taken.records),
    )
    findings = _findings(summary, samples, checked, rig, said)
    warnings = [*taken.header["warnings"], *warnings, *_absences(taken.records), *findings]
    if taken.lost_tail:
        warnings.append(f"the last {taken.lost_tail} bytes of the journal were cut short: its last record")
    if taken.damaged:
        warnings.append(f"{taken.damaged} bytes of the journal are in damaged records; it is kept: {taken.path.name}")
    return replace(summary, warnings=tuple(warnings))


def _absences(records: Sequence[journal.Record]) -> list[str]:
    """Return one sentence for each time the port was lost, with how long it was away, or when it was lost for good."""
    first = heard = None
    lost = ""
    told = []
    for record in records:
        if record.kind == journal.RECEIVED:
            if first is None:
                first = record.stamp_ns
            heard = record.stamp_ns
        elif record.kind == journal.LOST:
            lost = record.data.decode(errors="replace")
        elif heard is None or first is None:
            continue
        elif record.kind == journal.REOPENED:
            told.append(
                f"the port was lost ({lost}) and came back: {(record.stamp_ns - heard) / 1e6:.0f} ms are missing"
            )
            lost = ""
        elif record.kind == journal.END and b"port lost" in record.data:
            told.append(f"the port was lost ({lost}) {(heard - first) / 1e9:.3g} s after the start and never came back")
    return told


def _findings(found: Summary, samples: Samples, checked: Checked, rig: Rig, said: Sequence[decode.Stream]) -> list[str]:
    """Return one sentence for each thing that is wrong with the data, with its number."""
    edges = EDGES_PER_COUNT.get(rig.decoder, 1)
    overruns = int(np.count_nonzero(samples.status & frames.OVERRUN))
    unknown = sum(connection.unknown for connection in said)
    lines = [
        (found.lost, f"{found.lost} samples were lost in {np.count_nonzero(checked.lost)} places"),
        (found.crc_errors, f"{found.crc_errors} damaged frames were thrown away"),
        (unknown, f"{unknown} frames were of an unknown kind or length"),
        (
            found.illegal,
            f"{found.illegal} illegal transitions: the encoder outran its decoder, the count may be off by "
            f"{2 * found.illegal}",
        ),
        (found.phase_errors, f"{found.phase_errors} samples disagree with the levels sent beside them"),
        (overruns, f"the board missed its own pace at {overruns} samples"),
        (samples.repeated, f"{samples.repeated} samples came twice or late and were left out"),
        (found.dropped_bytes, f"{found.dropped_bytes} bytes were dropped: this machine could not keep up"),
        (
            found.segments - 1,
            f"{found.segments} segments: {'; '.join(sorted(set(checked.why[1:])))}; positions are not joined "
            "across them",
        ),
    ]
    lines += [(1, f"the board stopped: {text}") for connection in said for _, text in connection.notices]
    half = 2 ** (rig.counter_bits - 1)
    moved = round(checked.peak_count_rate / found.rate_hz)
    lines.append(
        (
            moved > half,
            f"the counters moved by {moved} of {2 * half} within one sample: they may have rolled over unseen, and "
            "positions mean nothing then; record at a higher --rate",
        )
    )
    if rig.decoder in ("jk", "jk-latched"):
        lines.append((1, f"a {rig.decoder} counter adds a line ({edges} edges) at each dither: expect drift"))
        lines.append((found.both_moved, f"both counters moved within one sample, {found.both_moved} times"))
    return [text for number, text in lines if number]
