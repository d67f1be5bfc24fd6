"""A run file built again from what was recorded: a journal, a run file, or a logic analyser's capture.

A journal goes through the recorder's own finaliser and stays where it is.  A run file is decoded again from its raw
counters, without the stages made from it; with another calibration its positions change, its raw data do not.  A
capture becomes the run that a board sampling at ``rate_hz`` would have sent: 16-bit counters, levels, device time.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from daq.imports import capture as decode
from daq.imports import sigrok
from daq.runfile import belt_counter, provenance, store
from daq.runfile.recording import Recording
from daq.runfile.regular import open_regular
from daq.runfile.rig import Rig
from daq.runfile.run_data import EVENTS, LONGEST_S, Raw, SentAs, count_lost, positions
from daq.wire import counters
from daq.wire.quadrature import PHASE, Steps
from stickslip.compute.arrays import runs
from stickslip.errors import InputError
from stickslip.toml import quote

HOST_FLAGS = {"illegal": counters.FLAG_ILLEGAL, "phase": counters.FLAG_PHASE, "both-moved": counters.FLAG_BOTH}


def recognise_kind(source: Path) -> str:
    """Return "journal", "run" or "capture" by a file's first bytes."""
    where = str(source)
    with open_regular(source, "use a journal, a run file or a .sr capture") as stream:
        head = stream.read(32)
    kinds = {b"stickslip journal": "journal", b"\x89HDF\r\n\x1a\n": "run", b"PK": "capture"}
    for magic, kind in kinds.items():
        if head.startswith(magic):
            return kind
    by_name = {".part": "journal", ".sr": "capture", ".h5": "run"}
    if source.suffix in by_name:
        return by_name[source.suffix]
    raise InputError("is neither a journal, a run file nor a .sr capture", where, "use 'daq import' for a CSV file")


def decode_run(source: Path) -> Recording:
    """Decode a run file again from its raw counters; an import, which has none, is returned as it is."""
    recording = store.load(source)
    count = recording.count
    if recording.raw is not None and count is not None:
        count = _recount(recording.raw, recording.segment, recording.rig.counter_bits, recording.sent_as)
    run = replace(
        recording,
        position=recording.position if count is None else positions(count, recording.rig),
        count=count,
        truth=store.truth(source),
        provenance={key: recording.provenance[key] for key in ("port", "firmware") if key in recording.provenance}
        | provenance.collect_provenance()
        | {"replay_of": source.name, "replay_of_sha256": recording.digest},
    )
    return _recount_belt(run)


def recalibrate(run: Recording, rig: Rig) -> Recording:
    """Return the run with another calibration; decoder and counter width stay those it was recorded with."""
    rig = replace(rig, decoder=run.rig.decoder, counter_bits=run.rig.counter_bits)
    position = positions(run.count, rig) if run.count is not None else run.position + (rig.offset - run.rig.offset)
    return _recount_belt(replace(run, rig=rig, position=position, config_toml=rig.to_toml()))


def _recount_belt(run: Recording) -> Recording:
    """Return the run with its belt decoded again from the raw counter; without one the run is unchanged."""
    if run.raw is None or run.raw.belt_count is None:
        return run
    if (pitch := run.rig.belt_metres_per_count) is None:
        return replace(run, belt_count=None, belt_velocity=None)
    starts = np.flatnonzero(np.diff(run.segment.astype(np.int64), prepend=-1))
    count = belt_counter.unwrap_count(run.raw.belt_count, run.rig.counter_bits, starts)
    velocity = belt_counter.yield_velocities(count, run.time, starts, run.rate_hz, pitch.value)
    return replace(run, belt_count=count, belt_velocity=np.concatenate([*velocity]))


def count_faults(run: Recording) -> dict[str, int]:
    """Return ``lost, crc_errors, illegal, phase_errors`` from the raw samples and events of a run."""
    counts = {"lost": 0, "illegal": 0, "phase_errors": 0}
    if run.raw is not None:
        within = np.diff(run.segment) == 0
        counts["lost"] = count_lost(run.raw.sample, run.segment)
        counts["illegal"] = int(counters.diff_unsigned(run.raw.illegal, 16)[within].sum())
        counts["phase_errors"] = int(np.count_nonzero(run.raw.flags & counters.FLAG_PHASE))
    return counts | {"crc_errors": run.event_kind.count("crc")}


def _recount(raw: Raw, segment: NDArray[np.unsignedinteger], bits: int, sent_as: SentAs | None) -> NDArray[np.int64]:
    begins = np.diff(segment.astype(np.int64), prepend=-1) != 0
    widths, scale = np.full(segment.size, bits), np.ones(segment.size, np.int64)
    if sent_as is not None:
        ident = np.searchsorted(sent_as.segment, segment, side="right") - 1
        widths, scale = (column[ident].astype(np.int64) for column in (sent_as.counter_bits, sent_as.counts))
    return counters.net_count(raw.count_up, raw.count_down, begins, widths, scale)


@dataclass
class _Sampler:
    """The board that a capture is played to: its counters and levels at every ``stride``-th capture sample."""

    stride: float
    next_sample: int = 0

    def take(self, levels: NDArray[np.uint8], steps: Steps, before: decode.Totals, offset: int) -> NDArray[np.int64]:
        """Return rows of (capture index, up, down, illegal, levels) for the board samples that lie in this chunk."""
        last = offset + levels.size
        count = max(0, int(np.ceil(last / self.stride)) - self.next_sample)
        index = np.floor((self.next_sample + np.arange(count + 1)) * self.stride).astype(np.int64)
        index = index[index < last]
        self.next_sample += index.size
        chunk_index = index - offset
        step_count = np.searchsorted(steps.index, chunk_index, side="right")

        def count_so_far(mask: NDArray[np.bool_]) -> NDArray[np.int64]:
            total = np.zeros(mask.size + 1, np.int64)
            np.cumsum(mask, out=total[1:])
            return np.asarray(total[step_count], np.int64)

        rows = np.empty((index.size, 5), np.int64)
        rows[:, 0] = index
        rows[:, 1] = before.up + count_so_far(steps.step > 0)
        rows[:, 2] = before.down + count_so_far(steps.step < 0)
        rows[:, 3] = before.illegal + count_so_far(steps.illegal)
        rows[:, 4] = levels[chunk_index]
        return rows


def sample_capture(
    capture: sigrok.Capture,
    wiring: decode.Wiring,
    rate_hz: float,
    rig: Rig,
    progress: Callable[[float], None] = lambda done: None,
) -> tuple[Recording, decode.Totals]:
    """Sample a capture as a board of ``rate_hz`` would; without metres per count its positions are counts."""
    where = str(capture.path)
    if capture.rate_hz is None:
        raise InputError("does not contain its sample rate", where, "add --capture-rate, for example '1 MHz'")
    if not capture.samples / LONGEST_S <= capture.rate_hz <= sigrok.FASTEST_HZ:
        what = f"{capture.samples} samples at {capture.rate_hz:g} Hz cannot be right"
        raise InputError(what, where, "check the rate")
    if not sigrok.SLOWEST_HZ <= rate_hz <= capture.rate_hz:
        what = f"--rate is {rate_hz:g} Hz, but the capture was sampled at {capture.rate_hz:g} Hz"
        raise InputError(what, where, f"use a rate from {sigrok.SLOWEST_HZ:g} to {capture.rate_hz:g} Hz")
    sampler = _Sampler(capture.rate_hz / rate_hz)
    before = decode.Totals(0, 0, 0, 0, 0)
    offset = 0
    rows = []
    for levels, steps, after in decode.decode_chunks(capture, wiring):
        rows.append(sampler.take(levels, steps, before, offset))
        before = after
        offset += levels.size
        progress(offset)
    if not offset:
        raise InputError("has no logic samples", where, "capture again")
    rig = replace(rig, decoder=wiring.decoder, counter_bits=16)
    return _build_run(capture, wiring, rate_hz, rig, np.concatenate(rows)), before


def _build_run(
    capture: sigrok.Capture, wiring: decode.Wiring, rate_hz: float, rig: Rig, rows: NDArray[np.int64]
) -> Recording:
    """Return the run of the rows of `_Sampler.take`, (n, 5)."""
    index, up, down, illegal, levels = rows.T
    if wiring.decoder == "x4":
        up = up + int(PHASE[levels[0]])  # as on the board, the counter starts at the phase of the levels
    time = index / float(capture.rate_hz or rate_hz)
    count = up - down
    names = [capture.probes[bit] for bit in wiring.bits]
    raw = Raw(
        sample=np.arange(index.size, dtype=np.uint32),
        count_up=(up & 0xFFFF).astype(np.uint16),
        count_down=(down & 0xFFFF).astype(np.uint16),
        device_time=(np.round(time * 1e6).astype(np.int64) & 0xFFFFFFFF).astype(np.uint32),
        levels=levels.astype(np.uint8),
        flags=np.zeros(index.size, np.uint16),
        illegal=(illegal & 0xFFFF).astype(np.uint16),
    )
    raw = replace(raw, flags=_compute_flags(wiring.decoder, raw))
    event_sample, event_kind = _list_events(raw.flags)
    started = datetime(*capture.stamp, tzinfo=UTC)
    roles = ("step", "direction") if wiring.decoder == decode.TWO_COUNTER else ("a", "b")
    settings = f"[replay]\nsource = {quote(capture.path.name)}\nrate_hz = {float(rate_hz)!r}\n"
    settings += "".join(f"{role} = {quote(name)}\n" for role, name in zip(roles, names, strict=True))
    return Recording(
        title=f"{capture.path.name}, probes {names[0]} and {names[1]}",
        started=started.isoformat(),
        ended=(started + timedelta(seconds=float(time[-1]))).isoformat(),
        rate_hz=float(rate_hz),
        rig=rig,
        time=time,
        position=positions(count, rig),
        count=count,
        raw=raw,
        segment=np.zeros(index.size, np.uint16),
        config_toml=rig.to_toml() + settings,
        event_sample=event_sample,
        event_kind=event_kind,
        provenance=provenance.collect_provenance()
        | {"replay_of": capture.path.name, "start_time_from": "time stamp of the zip, zone unknown"},
    )


def _compute_flags(decoder: str, raw: Raw) -> NDArray[np.uint16]:
    flags = np.zeros_like(raw.flags)
    flags[1:][np.diff(raw.illegal) > 0] |= counters.FLAG_ILLEGAL
    if decoder == "x4":
        flags[counters.phase_error(raw.count_up, raw.count_down, raw.levels) != 0] |= counters.FLAG_PHASE
    if decoder in ("jk", "jk-latched"):
        # Only behind a J-K box does it mean lost truth: the other decoders do it at every reversal.
        flags[counters.check_both_moved(raw.count_up, raw.count_down)] |= counters.FLAG_BOTH
    return flags


def _list_events(flags: NDArray[np.uint16]) -> tuple[NDArray[np.uint32], tuple[str, ...]]:
    """Return one event where each check begins to fail."""
    events = []
    for kind, flag in HOST_FLAGS.items():
        events += [(first, EVENTS[kind], kind) for first, _ in runs(flags & flag > 0)]
    events.sort()
    return np.array([i for i, _, _ in events], np.uint32), tuple(kind for _, _, kind in events)
