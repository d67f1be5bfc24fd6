"""The connections of a journal, and the identifications that their samples were sent under.

A new connection begins where the port was reopened.  A board that restarts, or another one behind the same port, may
count with another decoder, other counters or another clock: each segment is read as the identification before it says.
Counts of decoders that count one, or four, of the same edges are brought to the finest of them: the calibration belongs
to the first identification, and is divided by as much.  How counts of a decoder without such a ratio compare is not
known; they stay as they are, and a warning says so.
"""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from daq import protocols
from daq.runfile import journal
from daq.runfile.recording import SentAs
from daq.runfile.rig import Rig
from daq.runfile.spill import Shelf, Spill
from daq.wire import counters, decode
from daq.wire import frames as wire
from daq.wire.quadrature import EDGES_PER_COUNT
from stickslip.errors import InputError
from stickslip.units import Measured

# Two calibrations contradict each other that differ by more standard errors.  With half, 13 % of sound pairs do; double
# passes a change that is certain.
ERRORS_APART = 3.0
COUNTER_BITS, TICK_NS = 16, 1000  # those of the firmware, for an implausible identification


def connections(taken: journal.Journal, spill: Spill) -> list[Shelf[decode.Stream]]:
    """Return the decoded stream of each connection, in pieces: a new one begins where the port was reopened.

    Raises InputError: the journal is in a protocol that this version does not know.
    """
    backend = protocols.load(taken.header["protocol"], str(taken.path))
    shelves = []
    for reads in _reads(taken.records):
        shelf: Shelf[decode.Stream] = Shelf(spill)
        for stream in backend.pieces(reads, taken.header):
            shelf.append(cut_at_leaps(believed(stream), float(taken.header["rate_hz"])))
        shelves.append(shelf)
    return shelves


def cut_at_leaps(stream: decode.Stream, rate_hz: float) -> decode.Stream:
    """Return a stream whose frames are cut where the board's clock leaps within one: each keeps one pace.

    A leap is a sample that does not follow the one before after a period of the nominal rate ``rate_hz``, Hz.  Leaps
    between frames are judged by `daq.wire.counters.FrameOrder`.
    """
    samples = len(stream.dt)
    period = np.concatenate(
        [np.empty(0)]
        + [
            np.full(int(stream.n[first:end].sum()), 1e9 / (rate_hz * (1000 if ident is None else ident.tick_ns)))
            for first, end, ident in stream.sent_as()
        ]
    )
    leaps = np.asarray(~counters.fits(1, stream.dt / period))
    leaps[stream.first] = False
    if not leaps.any():
        return stream
    first = np.flatnonzero(leaps | np.isin(np.arange(samples), stream.first))
    frame = np.searchsorted(stream.first, first, side="right") - 1  # the old frame that holds each new one
    within = first - stream.first[frame]
    elapsed = np.cumsum(stream.dt, dtype=np.int64)
    dt = stream.dt.copy()
    dt[first] = 0
    last = np.diff(frame, append=len(stream.n)) > 0  # whether a new frame ends with the bytes of its old one
    place = np.concatenate((np.flatnonzero(within == 0), [len(first)]))  # where each old frame begins
    return replace(
        stream,
        first=first,
        n=np.diff(first, append=samples),
        seq=stream.seq[frame] + within & 0xFFFF,
        ticks=stream.ticks[frame] + elapsed[first] - elapsed[stream.first[frame]] & 0xFFFFFFFF,
        illegal=stream.illegal[frame],
        stamp_ns=stream.stamp_ns[frame],
        length=np.where(last, stream.length[frame], 0),
        time_error=None if stream.time_error is None else stream.time_error[frame],
        dt=dt,
        idents=place[stream.idents],
        crc_frame=place[stream.crc_frame],
        truth_frame=place[stream.truth_frame],
        part_frame=place[stream.part_frame],
        configs=tuple((int(place[at]), text) for at, text in stream.configs),
        notices=tuple((int(place[at]), text) for at, text in stream.notices),
    )


@dataclass(frozen=True)
class _Reads:
    """The reads of one connection: stamp and bytes, out of the journal whenever they are asked for."""

    records: journal.Records
    first: int
    last: int

    def __iter__(self) -> Iterator[tuple[int, bytes]]:
        kinds = self.records.kinds
        received = (number for number in range(self.first, self.last) if kinds[number] == journal.RECEIVED)
        return ((record.stamp_ns, record.data) for record in self.records.at(received))


def _reads(records: journal.Records) -> list[_Reads]:
    cuts = [number for number, kind in enumerate(records.kinds) if kind == journal.REOPENED]
    return [_Reads(records, first, last) for first, last in pairwise([0, *cuts, len(records)])]


def first_ident(streams: Iterable[decode.Stream]) -> wire.Ident | None:
    """Return the board's first identification, as `believed`."""
    return next((ident for stream in streams if (ident := believed(stream).ident) is not None), None)


def believed(stream: decode.Stream) -> decode.Stream:
    """Return a stream in which an identification that cannot be true has the firmware's own counters and tick.

    A recorder refuses such a board; a journal that holds one is read all the same.
    """
    if not any(ident.implausible for ident in (stream.ident, *stream.identified) if ident is not None):
        return stream
    ident = None if stream.ident is None else _believed(stream.ident)
    return replace(stream, ident=ident, identified=tuple(map(_believed, stream.identified)))


def _believed(ident: wire.Ident) -> wire.Ident:
    return replace(ident, counter_bits=COUNTER_BITS, tick_ns=TICK_NS) if ident.implausible else ident


@dataclass(frozen=True)
class CountUnits:
    """What counts are under each of k identifications."""

    bits: NDArray[np.int64]  # (k,) width of the counters
    scale: NDArray[np.int64]  # (k,) counts of the run in one count of the board
    edges: NDArray[np.int64]  # (k,) edges in one count of the board
    # (k,) whether counts can be held against the levels sent with them; whether illegal transitions are counted
    phase: NDArray[np.bool_]
    illegal: NDArray[np.bool_]


def units(idents: Sequence[wire.Ident | None], rig: Rig) -> CountUnits:
    """Return what counts are under each identification, in a run of this calibration (`common`)."""
    decoders = [rig.decoder if ident is None else ident.decoder for ident in idents]
    has = [wire.Capability(0) if ident is None else ident.capabilities for ident in idents]
    finest = EDGES_PER_COUNT.get(rig.decoder, 1)
    edges = np.array([EDGES_PER_COUNT.get(decoder, 1) for decoder in decoders], dtype=np.int64)
    return CountUnits(
        bits=np.array([rig.counter_bits if ident is None else ident.counter_bits for ident in idents], dtype=np.int64),
        scale=np.maximum(edges // finest, 1),
        edges=edges,
        phase=np.array(
            [
                each == "x4" and wire.Capability.LEVELS in capabilities
                for each, capabilities in zip(decoders, has, strict=True)
            ],
            dtype=np.bool_,
        ),
        illegal=np.array([wire.Capability.ILLEGAL in each for each in has], dtype=np.bool_),
    )


def common(rig: Rig, idents: Sequence[wire.Ident | None]) -> Rig:
    """Return the calibration of a run: that of its first identification, in counts of the finest decoder."""
    known = [ident for ident in idents if ident is not None]
    if not known:
        return rig
    finest = min(known, key=lambda ident: EDGES_PER_COUNT.get(ident.decoder, 1))
    ratio = EDGES_PER_COUNT.get(known[0].decoder, 1) // EDGES_PER_COUNT.get(finest.decoder, 1)
    rig = replace(rig, counter_bits=known[0].counter_bits, decoder=known[0].decoder)
    if ratio == 1:
        return rig
    pitch, turn = rig.metres_per_count, rig.counts_per_revolution
    return replace(
        rig,
        decoder=finest.decoder,
        metres_per_count=None if pitch is None else Measured(pitch.value / ratio, pitch.sd / ratio),
        counts_per_revolution=None if turn is None else turn * ratio,
    )


def contradictions(idents: Sequence[wire.Ident | None], configs: Sequence[str], rig: Rig) -> list[str]:
    """Return sentences for identifications and calibrations of one run that contradict each other.

    ``configs`` are the calibrations that the boards sent, in order; ``rig`` is the run's own.
    """
    sentences = []
    known = [ident for ident in idents if ident is not None]
    if len(known) > 1:
        changes = "; then ".join(words(ident) for ident in known)
        sentences.append(
            f"the board identified itself anew, as another: {changes}; each segment is read as it was sent"
        )
    decoders = list(dict.fromkeys(ident.decoder for ident in known))
    unrelated = [decoder for decoder in decoders if decoder not in EDGES_PER_COUNT]
    if len(decoders) > 1 and unrelated:
        sentences.append(
            f"the decoder changed between {' and '.join(decoders)}, and how their counts compare is not known: "
            f"positions of segments other than {decoders[0]} may have another scale"
        )
    elif len({EDGES_PER_COUNT[decoder] for decoder in decoders if decoder not in unrelated}) > 1:
        sentences.append(
            f"the decoder changed between {' and '.join(decoders)}: all counts are in those of {rig.decoder}, and the "
            f"metres per count are those of {decoders[0]}, divided accordingly"
        )
    pitches = [pitch for config in dict.fromkeys(configs) if (pitch := _pitch(config)) is not None]
    other = next((each for each in pitches if _contradict(each, pitches[0])), None)
    if other is not None:
        sentences.append(
            f"the board sent another calibration, {other.value:g} m per count where it was {pitches[0].value:g}: "
            "positions are made with the first of them, or with the one given"
        )
    return sentences


def _contradict(one: Measured, other: Measured) -> bool:
    """Return whether two measurements of one quantity differ by more than their errors explain."""
    return abs(one.value - other.value) > ERRORS_APART * math.hypot(one.sd, other.sd)


def _pitch(config: str) -> Measured | None:
    try:
        return Rig.from_toml(config, "the board's CONFIG").metres_per_count
    except InputError:
        return None


def words(ident: wire.Ident) -> str:
    """Return an identification in words."""
    version = ".".join(map(str, ident.firmware))
    clock = f"{ident.counter_bits} bits, tick {ident.tick_ns} ns"
    return f"{ident.name or 'a board'}, firmware {version}, decoder {ident.decoder}, {clock}"


def stored(
    idents: Sequence[wire.Ident | None], rig: Rig, segment: Sequence[int], source: Sequence[int]
) -> SentAs | None:
    """Return for the run file from which segment on which identification holds; None where there is only one."""
    if len(source) < 2:
        return None
    per_ident = units(idents, rig)
    which = np.array(source, dtype=np.int64)
    text = ["no identification" if ident is None else words(ident) for ident in idents]
    return SentAs(
        segment=np.array(segment, dtype=np.uint32),
        counter_bits=per_ident.bits[which].astype(np.uint8),
        counts=per_ident.scale[which].astype(np.uint8),
        ident=tuple(text[each] for each in source),
    )
