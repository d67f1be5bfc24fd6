"""The connections of a journal: a new one begins where the port was reopened."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

from daq import protocols
from daq.output.spill import Shelf, Spill
from daq.runfile import journal
from daq.wire import decode
from daq.wire import frames as wire

COUNTER_BITS, TICK_NS = 16, 1000  # of the project's firmware, where a journal's identification cannot be true


def connections(taken: journal.Journal, spill: Spill) -> list[Shelf[decode.Stream]]:
    """Return the decoded stream of each connection, in pieces: a new one begins where the port was reopened.

    Raises
    ------
    InputError
        The journal is in a protocol that this version does not know.
    """
    backend = protocols.load(taken.header["protocol"], str(taken.path))
    found = []
    for reads in _reads(taken.records):
        shelf: Shelf[decode.Stream] = Shelf(spill)
        for stream in backend.pieces(reads, taken.header):
            shelf.append(stream)
        found.append(shelf)
    return found


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
    """Return the board's first identification; one that cannot be true with the firmware's own counters and tick.

    A recorder refuses such a board; a journal that holds one is read all the same.
    """
    ident = next((connection.ident for connection in streams if connection.ident is not None), None)
    if ident is not None and ident.implausible:
        return replace(ident, counter_bits=COUNTER_BITS, tick_ns=TICK_NS)
    return ident
