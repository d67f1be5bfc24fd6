"""Quadrature decoders: sampled or edge-by-edge A, B levels -> up and down counts.

Convention: ``levels`` = A + 2 B.  The x4 count is n = floor(x / delta), and n mod 4 = 0, 1, 2, 3 means AB = 00, 10,
11, 01, so that levels run 0, 1, 3, 2 as the mass moves up (`GRAY`).

Truth tables.  Entry: what one change of the levels AB does; ``.`` nothing, ``!`` illegal: both channels changed at
once, so the order of the two edges, and with it the direction, is not known.  Illegal changes are counted, never
guessed, and move no counter.  One x4 count is one edge; x1, jk and jk-latched count lines, four edges each.

::

    from -> to  motion      x4      x1      jk      jk-latched
    00 -> 10    up          up      up      up      up if Q else down      A rises
    10 -> 11    up          up      .       .       Q := A = 1             B rises
    11 -> 01    up          up      .       .       .
    01 -> 00    up          up      .       .       .
    10 -> 00    down        down    down    .       .
    11 -> 10    down        down    .       .       .
    01 -> 11    down        down    .       down    up if Q else down      A rises
    00 -> 01    down        down    .       .       Q := A = 0             B rises
    00 -> 11, 11 -> 00, 10 -> 01, 01 -> 10          !  for every decoder

x4          every edge, state-checked.
x1          same edge: A rising with B low is up, A falling with B low is down: one physical edge, both ways.
jk          the thesis's J-K box, first reading: every rise of A counts, and B at that moment gives the direction.
            A dither about one A rise meets that rise in one direction only, and adds a line each time.
jk-latched  second reading: a J-K flip-flop with J = A, K = not A, clocked by B's rise.  Its table

            ::

                J  K   Q after the clock
                1  0   1        A high at B's rise: moving up
                0  1   0        A low at B's rise: moving down
                (J = K does not occur: K is not J)

            so Q holds the direction seen at B's last rise and gates A's rises to the up or to the down output.  Q
            starts as 1 (up).  Between two rises of B it does not notice a reversal.

The technique: every rule is first applied to all samples at once, in bytes, where one instruction serves 16 to 64 of
them; only then are the few samples with a change selected.  A table looked up per edge costs 15 times
as much, and a loop over the edges a thousand times.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

PIECE = 1 << 15  # samples decoded at a time, so that intermediate arrays stay in the processor's cache
DECODERS = ("x4", "x1", "jk", "jk-latched")
EDGES_PER_COUNT = {"x4": 1, "x1": 4, "jk": 4, "jk-latched": 4}  # x4 counts in one count of each decoder
GRAY = np.array([0, 1, 3, 2], dtype=np.uint8)  # levels of n mod 4 = 0, 1, 2, 3
PHASE = np.array([0, 1, 3, 2], dtype=np.uint8)  # n mod 4 of levels 0, 1, 2, 3: GRAY is its own inverse

# Changes, as 4 * levels before + levels after, that count up and down.
_UP = {"x1": 4 * 0 + 1, "jk": 4 * 0 + 1}  # A rises, B low
_DOWN = {"x1": 4 * 1 + 0, "jk": 4 * 2 + 3}  # A falls, B low; A rises, B high
_A_RISES = (4 * 0 + 1, 4 * 2 + 3)
_Q_UP, _Q_DOWN = 4 * 1 + 3, 4 * 0 + 2  # B rises with A high, with A low: the flip-flop's inputs


@dataclass(frozen=True)
class Steps:
    """The e changes in a chunk of levels."""

    index: NDArray[np.intp]  # (e,) first sample in the chunk with the new levels
    step: NDArray[np.int8]  # (e,) +1 counted up, -1 counted down, 0 not counted by this decoder
    illegal: NDArray[np.bool_]  # (e,) both channels changed at once


class Decoder:
    """One decoder of a stream of levels that comes in chunks; the state is carried across them.

    kind: One of `DECODERS`.
    levels: Levels of the last sample, initially those before the first one; None: the first sample only sets the state
        and is never an edge.
    up, down, illegal, edges: Totals so far; ``edges`` counts every change of the levels, whether or not this decoder
        counts it.
    latched_up: The flip-flop's Q (jk-latched only).
    Raises ValueError for an unknown kind, or levels outside 0 to 3.
    """

    def __init__(self, kind: str, levels: int | None = None) -> None:
        if kind not in DECODERS:
            raise ValueError(f"the decoder must be one of {', '.join(DECODERS)}, not {kind!r}")
        self.kind = kind
        self.levels = levels
        self.latched_up = True
        self.up = self.down = self.illegal = self.edges = 0

    @property
    def net(self) -> int:
        """Up minus down, in counts of this decoder."""
        return self.up - self.down

    def feed(self, levels: ArrayLike) -> Steps:
        """Decode a chunk of levels, one per sample or one per edge, and add to the totals."""
        chunk = _check_levels(levels)
        index, step, illegal = [], [], []
        for first in range(0, len(chunk), PIECE):
            code = self._encode_changes(chunk[first : first + PIECE])
            changed = np.flatnonzero(_has_changed(code))
            signs, both = self._decode(code[changed])
            index.append(changed + first)
            step.append(signs)
            illegal.append(both)
        if not index:
            return Steps(np.empty(0, dtype=np.intp), np.empty(0, dtype=np.int8), np.empty(0, dtype=np.bool_))
        return Steps(np.concatenate(index), np.concatenate(step), np.concatenate(illegal))

    def count(self, levels: ArrayLike) -> None:
        """Decode a chunk and add to the totals without locating the edges, up to twice as fast as `feed`."""
        chunk = _check_levels(levels)
        for first in range(0, len(chunk), PIECE):
            code = self._encode_changes(chunk[first : first + PIECE])
            self._decode(code[np.flatnonzero(_has_changed(code))] if self.kind == "jk-latched" else code)

    def _encode_changes(self, chunk: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return 4 * levels before + levels at each sample, and keep the last one for the next chunk."""
        code = np.empty(len(chunk), dtype=np.uint8)
        code[0] = chunk[0] if self.levels is None else self.levels
        code[1:] = chunk[:-1]
        code <<= 2
        code |= chunk
        self.levels = int(chunk[-1])
        return code

    def _decode(self, code: NDArray[np.uint8]) -> tuple[NDArray[np.int8], NDArray[np.bool_]]:
        """Return the step of each change, +1, -1 or 0, and whether it is illegal; add to the totals.

        Codes of samples without a change may be among them; they have no effect.
        """
        moved = _diff_phase(code)
        illegal = moved == 2
        if self.kind == "x4":
            up, down = moved == 1, moved == 3
        elif self.kind == "jk-latched":
            up, down = self._gate_rises(code)
        else:
            up, down = code == _UP[self.kind], code == _DOWN[self.kind]
        self.up += int(np.count_nonzero(up))
        self.down += int(np.count_nonzero(down))
        self.illegal += int(np.count_nonzero(illegal))
        self.edges += int(np.count_nonzero(moved))
        return up.view(np.int8) - down.view(np.int8), illegal

    def _gate_rises(self, code: NDArray[np.uint8]) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Return where jk-latched counts up and down: at rises of A, by Q, which B's last rise before them set."""
        rises = (code == _A_RISES[0]) | (code == _A_RISES[1])
        clocks = (code == _Q_UP).view(np.int8) - (code == _Q_DOWN).view(np.int8)  # what Q becomes, as +1 or -1
        q = _fill_zeros(clocks, 1 if self.latched_up else -1, rises)
        if len(q):
            self.latched_up = bool(q[-1] > 0)
        return rises & (q > 0), rises & (q < 0)


def _check_levels(levels: ArrayLike) -> NDArray[np.uint8]:
    chunk = np.asarray(levels, dtype=np.uint8)
    if len(chunk) and chunk.max() > 3:
        raise ValueError(f"levels must be A + 2 B, 0 to 3, not {chunk.max()} (at sample {int(chunk.argmax())})")
    return chunk


def _has_changed(code: NDArray[np.uint8]) -> NDArray[np.bool_]:
    return np.asarray(code >> 2 != code & 3)


def _diff_phase(code: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return how far the Gray phase moves, modulo 4: 1 up, 3 down, 2 illegal.  Levels l have phase l ^ (l >> 1)."""
    phase = code >> 1
    phase &= 0b0101  # each of the two levels shifted by one, nothing from one into the other
    phase ^= code
    moved = phase - (phase >> 2)
    moved &= 3
    return moved


def _fill_zeros(values: NDArray[np.int8], initial: int, wanted: NDArray[np.bool_]) -> NDArray[np.int8]:
    """Return the last value that is not zero up to each place that is ``wanted``, and up to the last place.

    ``initial`` precedes the first value.  Elsewhere the result may be 0.
    """
    filled = values.copy()
    if len(filled) == 0:
        return filled
    filled[0] = filled[0] or initial
    for shift in (1, 2, 4, 8, 16):  # looks back 31 places: in steady motion B has risen 3 edges before A
        filled[shift:] += filled[:-shift] * (filled[shift:] == 0)
    unfilled = np.flatnonzero(wanted & (filled == 0))
    if len(unfilled) or filled[-1] == 0:
        unfilled = np.append(unfilled, len(filled) - 1)
        nonzero = np.flatnonzero(values)
        index = np.searchsorted(nonzero, unfilled, side="right") - 1
        filled[unfilled] = np.where(index >= 0, values[nonzero[index]] if len(nonzero) else initial, initial)
    return filled


class PulseDecoder:
    """Step and direction lines, the two-counter case: a rising step counts up where direction is high, else down.

    Such a source has no illegal change: a step and a turn of direction in one sample count with the new direction,
    which a driver must have set up before it steps.

    up, down, edges: Totals so far; ``edges`` counts the rises of step.
    """

    illegal = 0

    def __init__(self) -> None:
        self.up = self.down = self.edges = 0
        self._step_high = True  # a line that is high from the first sample on has not been seen to rise

    @property
    def net(self) -> int:
        """Up minus down, in pulses."""
        return self.up - self.down

    def feed(self, levels: ArrayLike) -> Steps:
        """Decode a chunk of levels, step + 2 direction, one per sample, and add to the totals."""
        chunk = _check_levels(levels)
        high = (chunk & 1).astype(np.bool_)
        rises = high.copy()
        if len(high):
            rises[1:] &= ~high[:-1]
            rises[0] &= not self._step_high
            self._step_high = bool(high[-1])
        index = np.flatnonzero(rises)
        signs = np.where(chunk[index] > 1, 1, -1).astype(np.int8)
        up = int(np.count_nonzero(signs == 1))
        self.up += up
        self.down += len(index) - up
        self.edges += len(index)
        return Steps(index, signs, np.zeros(len(index), dtype=np.bool_))

    count = feed


def levels_of(count: ArrayLike) -> NDArray[np.uint8]:
    """Return the levels A + 2 B at x4 counts n (any integers, any shape)."""
    phase = np.asarray(count, dtype=np.int64) & 3
    return np.asarray(GRAY[phase], dtype=np.uint8)
