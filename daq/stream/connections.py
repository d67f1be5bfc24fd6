"""The connections of a journal, and the identifications that their samples were sent under.

A new connection begins where the port was reopened.  A board that restarts, or another one on the same port, may count
with another decoder, other counters or another clock: each segment is read by the identification before it.
Counts of decoders that count one, or four, of the same edges are brought to the finest of them: the calibration belongs
to the first identification, and is divided by as much.  How counts of a decoder without such a ratio compare is
unknown; they are not changed, and there is a warning.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from daq import protocols
from daq.protocols import session
from daq.runfile import journal
from daq.runfile.rig import Rig
from daq.runfile.run_data import SentAs
from daq.wire import counters, decode
from daq.wire import frames as wire
from daq.wire.quadrature import EDGES_PER_COUNT
from stickslip.errors import InputError
from stickslip.units import Measured

# Standard errors by which two calibrations differ if they contradict each other: 0.3 % of sound pairs do.
ERRORS_APART = 3.0
COUNTER_BITS, TICK_NS = 16, 1000  # those of the firmware, for an implausible identification


def decode_connections(recorded: journal.Journal) -> Iterator[Iterator[decode.Stream]]:
    """Yield the decoded stream of each connection, in pieces: a new one begins where the port was reopened.

    Raises InputError if this version does not know the journal's protocol.
    """
    backend = protocols.load(recorded.header["protocol"], str(recorded.path))
    rate_hz = float(recorded.header["rate_hz"])
    records = recorded.records
    cuts = [number for number, kind in enumerate(records.kinds) if kind == journal.REOPENED]
    for first, last in pairwise([0, *cuts, len(records)]):
        pieces = backend.decode_pieces(_ConnectionReads(records, first, last), recorded.header, session.PIECE_BYTES)
        yield (cut_at_leaps(replace_implausible(stream), rate_hz) for stream in pieces)


def cut_at_leaps(stream: decode.Stream, rate_hz: float) -> decode.Stream:
    """Return a stream with frames cut where the board's clock leaps within one, so that each keeps one pace.

    A leap is a sample that does not follow the previous one after a period of the nominal rate ``rate_hz``, Hz.  Leaps
    between frames are found by `daq.wire.counters.FrameOrder`.
    """
    samples = len(stream.dt)
    periods = np.concatenate(
        [np.empty(0)]
        + [
            np.full(int(stream.n[first:end].sum()), 1e9 / (rate_hz * (TICK_NS if ident is None else ident.tick_ns)))
            for first, end, ident in stream.split_by_ident()
        ]
    )
    leaps = np.asarray(~counters.agree_on_gap(1, stream.dt / periods))
    leaps[stream.first] = False
    if not leaps.any():
        return stream
    first = np.flatnonzero(leaps | np.isin(np.arange(samples), stream.first))
    frame = np.searchsorted(stream.first, first, side="right") - 1  # the old frame that holds each new one
    sample_in_frame = first - stream.first[frame]
    elapsed = np.cumsum(stream.dt, dtype=np.int64)
    dt = stream.dt.copy()
    dt[first] = 0
    last = np.diff(frame, append=len(stream.n)) > 0  # whether a new frame ends with the bytes of its old one
    new_frame = np.concatenate((np.flatnonzero(sample_in_frame == 0), [len(first)]))  # where each old frame begins
    return replace(
        stream,
        first=first,
        n=np.diff(first, append=samples),
        seq=stream.seq[frame] + sample_in_frame & 0xFFFF,
        ticks=stream.ticks[frame] + elapsed[first] - elapsed[stream.first[frame]] & 0xFFFFFFFF,
        illegal=stream.illegal[frame],
        stamp_ns=stream.stamp_ns[frame],
        length=np.where(last, stream.length[frame], 0),
        time_error=None if stream.time_error is None else stream.time_error[frame],
        dt=dt,
        idents=new_frame[stream.idents],
        crc_frame=new_frame[stream.crc_frame],
        part_frame=new_frame[stream.part_frame],
        configs=tuple((int(new_frame[at]), text) for at, text in stream.configs),
        notices=tuple((int(new_frame[at]), text) for at, text in stream.notices),
    )


@dataclass(frozen=True)
class _ConnectionReads:
    """The reads of one connection, stamp and bytes, read from the journal at each iteration."""

    records: journal.Records
    first: int
    last: int

    def __iter__(self) -> Iterator[tuple[int, bytes]]:
        kinds = self.records.kinds
        received = (number for number in range(self.first, self.last) if kinds[number] == journal.RECEIVED)
        return ((record.stamp_ns, record.data) for record in self.records.at(received))


def replace_implausible(stream: decode.Stream) -> decode.Stream:
    """Return a stream in which an impossible identification has the firmware's own counters and tick.

    A recorder rejects such a board; a journal that contains one is read nevertheless.
    """
    if not any(ident.implausible for ident in (stream.ident, *stream.identified) if ident is not None):
        return stream
    ident = None if stream.ident is None else _replace_ident(stream.ident)
    return replace(stream, ident=ident, identified=tuple(map(_replace_ident, stream.identified)))


def _replace_ident(ident: wire.Ident) -> wire.Ident:
    return replace(ident, counter_bits=COUNTER_BITS, tick_ns=TICK_NS) if ident.implausible else ident


@dataclass(frozen=True)
class CountUnits:
    """The units of counts and times under each of k identifications."""

    bits: NDArray[np.int64]  # (k,) width of the counters
    tick_ns: NDArray[np.int64]  # (k,) tick of the board's clock
    scale: NDArray[np.int64]  # (k,) counts of the run in one count of the board
    edges: NDArray[np.int64]  # (k,) edges in one count of the board
    # (k,) whether counts can be compared with the levels sent with them; whether illegal transitions are counted
    phase: NDArray[np.bool_]
    illegal: NDArray[np.bool_]


def find_units(idents: Sequence[wire.Ident | None], rig: Rig) -> CountUnits:
    """Return the units under each identification, in a run of this calibration (`unify_calibration`)."""
    decoders = [rig.decoder if ident is None else ident.decoder for ident in idents]
    capabilities_of = [wire.Capability(0) if ident is None else ident.capabilities for ident in idents]
    finest = EDGES_PER_COUNT.get(rig.decoder, 1)
    edges = np.array([EDGES_PER_COUNT.get(decoder, 1) for decoder in decoders], dtype=np.int64)
    return CountUnits(
        bits=np.array([rig.counter_bits if ident is None else ident.counter_bits for ident in idents], dtype=np.int64),
        tick_ns=np.array([TICK_NS if ident is None else ident.tick_ns for ident in idents], dtype=np.int64),
        scale=np.maximum(edges // finest, 1),
        edges=edges,
        phase=np.array([wire.Capability.LEVELS in each for each in capabilities_of]) & (np.array(decoders) == "x4"),
        illegal=np.array([wire.Capability.ILLEGAL in each for each in capabilities_of], dtype=np.bool_),
    )


def unify_calibration(rig: Rig, idents: Sequence[wire.Ident | None]) -> Rig:
    """Return the calibration of a run: that of its first identification, in counts of the finest decoder."""
    reported = [ident for ident in idents if ident is not None]
    if not reported:
        return rig
    finest = min(reported, key=lambda ident: EDGES_PER_COUNT.get(ident.decoder, 1))
    ratio = EDGES_PER_COUNT.get(reported[0].decoder, 1) // EDGES_PER_COUNT.get(finest.decoder, 1)
    rig = replace(rig, counter_bits=reported[0].counter_bits, decoder=reported[0].decoder)
    if ratio == 1:
        return rig
    pitch, turn = rig.metres_per_count, rig.counts_per_revolution
    return replace(
        rig,
        decoder=finest.decoder,
        metres_per_count=None if pitch is None else Measured(pitch.value / ratio, pitch.sd / ratio),
        counts_per_revolution=None if turn is None else turn * ratio,
    )


def find_contradictions(idents: Sequence[wire.Ident | None], configs: Sequence[str], rig: Rig) -> list[str]:
    """Return sentences for identifications and calibrations of one run that contradict each other.

    ``configs`` are the calibrations that the boards sent, in order; ``rig`` is the run's own.
    """
    sentences = []
    reported = [ident for ident in idents if ident is not None]
    if len(reported) > 1:
        changes = "; then ".join(describe_ident(ident) for ident in reported)
        sentences.append(
            f"the board identified itself again with different values: {changes}. Each segment is read with "
            "its own identification"
        )
    decoders = list(dict.fromkeys(ident.decoder for ident in reported))
    unrelated = [decoder for decoder in decoders if decoder not in EDGES_PER_COUNT]
    if len(decoders) > 1 and unrelated:
        sentences.append(
            f"the decoder changed between {' and '.join(decoders)}, and the ratio of their counts is unknown. "
            f"Positions may be scaled wrongly in segments with a decoder other than {decoders[0]}"
        )
    elif len({EDGES_PER_COUNT[decoder] for decoder in decoders if decoder not in unrelated}) > 1:
        sentences.append(
            f"the decoder changed between {' and '.join(decoders)}. All counts are converted to counts of "
            f"{rig.decoder}, and the metres per count of {decoders[0]} are divided accordingly"
        )
    pitches = [pitch for config in dict.fromkeys(configs) if (pitch := _pitch(config)) is not None]
    differing = next((each for each in pitches if _contradict(each, pitches[0])), None)
    if differing is not None:
        sentences.append(
            f"the board sent a second calibration, {differing.value:g} m per count instead of "
            f"{pitches[0].value:g}. Positions are computed with the first one, or with a stated value"
        )
    return sentences


def _contradict(first: Measured, second: Measured) -> bool:
    """Return whether two measurements of one quantity differ by more than their errors explain."""
    return abs(first.value - second.value) > ERRORS_APART * math.hypot(first.sd, second.sd)


def _pitch(config: str) -> Measured | None:
    try:
        return Rig.from_toml(config, "the board's CONFIG").metres_per_count
    except InputError:
        return None


def describe_ident(ident: wire.Ident) -> str:
    version = ".".join(map(str, ident.firmware))
    clock = f"{ident.counter_bits} bits, tick {ident.tick_ns} ns"
    return f"{ident.name or 'a board'}, firmware {version}, decoder {ident.decoder}, {clock}"


def build_sent_as(
    idents: Sequence[wire.Ident | None], rig: Rig, segment: Sequence[int], source: Sequence[int]
) -> SentAs | None:
    """Return the identifications for the run file, each with its first segment; None if there is only one."""
    if len(source) < 2:
        return None
    per_ident = find_units(idents, rig)
    ident_number = np.array(source, dtype=np.int64)
    texts = ["no identification" if ident is None else describe_ident(ident) for ident in idents]
    return SentAs(
        segment=np.array(segment, dtype=np.uint32),
        counter_bits=per_ident.bits[ident_number].astype(np.uint8),
        counts=per_ident.scale[ident_number].astype(np.uint8),
        ident=tuple(texts[each] for each in source),
    )
