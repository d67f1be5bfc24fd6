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
jk          the thesis's J-K box, first reading: every rise of A counts, and B at that moment says which way.
            A dither about one A rise meets that rise in one direction only, and adds a line each time.
jk-latched  second reading: a J-K flip-flop with J = A, K = not A, clocked by B's rise.  Its table

            ::

                J  K   Q after the clock
                1  0   1        A high at B's rise: moving up
                0  1   0        A low at B's rise: moving down
                (J = K does not occur: K is not J)

            so Q holds the direction seen at B's last rise and gates A's rises to the up or to the down output.  Q
            starts as 1 (up).  Between two rises of B it does not notice a reversal.

The technique is "find the changes first": one vectorised comparison finds the few samples where the levels differ
from the sample before, and only those are decoded.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

DECODERS = ("x4", "x1", "jk", "jk-latched")
EDGES_PER_COUNT = {"x4": 1, "x1": 4, "jk": 4, "jk-latched": 4}  # x4 counts in one count of each decoder
GRAY = np.array([0, 1, 3, 2], dtype=np.uint8)  # levels of n mod 4 = 0, 1, 2, 3
PHASE = np.array([0, 1, 3, 2], dtype=np.uint8)  # n mod 4 of levels 0, 1, 2, 3: GRAY is its own inverse

# Index of the tables below: 4 * levels before + levels after.
_ILLEGAL = np.zeros(16, dtype=np.bool_)
_ILLEGAL[[4 * 0 + 3, 4 * 3 + 0, 4 * 1 + 2, 4 * 2 + 1]] = True
_UP = ((0, 1), (1, 3), (3, 2), (2, 0))
_X4 = np.zeros(16, dtype=np.int8)
for _before, _after in _UP:
    _X4[4 * _before + _after] = 1
    _X4[4 * _after + _before] = -1
_X1 = np.zeros(16, dtype=np.int8)
_X1[4 * 0 + 1] = 1  # A rises, B low
_X1[4 * 1 + 0] = -1  # A falls, B low
_JK = np.zeros(16, dtype=np.int8)
_JK[4 * 0 + 1] = 1  # A rises, B low
_JK[4 * 2 + 3] = -1  # A rises, B high
_STEP = {"x4": _X4, "x1": _X1, "jk": _JK}
_A_RISES = _JK != 0
_LATCH = np.full(16, -1, dtype=np.int8)  # what B's rise makes of Q; -1: leaves it
_LATCH[4 * 1 + 3] = 1
_LATCH[4 * 0 + 2] = 0


@dataclass(frozen=True)
class Steps:
    """The changes found in one chunk of levels, e of them.

    Attributes
    ----------
    index : (e,) int
        Where in the chunk the new levels first stand.
    step : (e,) int8
        +1 counted up, -1 counted down, 0 not counted by this decoder.
    illegal : (e,) bool
        Both channels changed at once.
    """

    index: NDArray[np.intp]
    step: NDArray[np.int8]
    illegal: NDArray[np.bool_]


class Decoder:
    """One decoder at work on a stream of levels that comes in chunks; the state is carried across them.

    Parameters
    ----------
    kind : str
        One of `DECODERS`.
    levels : int, optional
        Levels before the first sample; without it the first sample only sets the state and is never an edge.

    Attributes
    ----------
    up, down, illegal, edges : int
        Totals so far; ``edges`` counts every change of the levels, whatever this decoder makes of it.
    levels : int or None
        Levels of the last sample seen.
    latched_up : bool
        The flip-flop's Q (jk-latched only).

    Raises
    ------
    ValueError
        For an unknown kind, or levels outside 0 to 3.
    """

    def __init__(self, kind: str, levels: int | None = None) -> None:
        if kind not in DECODERS:
            raise ValueError(f"decoder is {kind!r}; need one of {', '.join(DECODERS)}")
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
        chunk = np.asarray(levels, dtype=np.uint8)
        index, code = self._changes(chunk)
        illegal = _ILLEGAL[code]
        step = self._latched(code) if self.kind == "jk-latched" else _STEP[self.kind][code]
        counted = int(np.count_nonzero(step))
        up = (counted + int(step.sum(dtype=np.int64))) // 2
        self.up += up
        self.down += counted - up
        self.illegal += int(np.count_nonzero(illegal))
        self.edges += len(index)
        return Steps(index, step, illegal)

    def _changes(self, chunk: NDArray[np.uint8]) -> tuple[NDArray[np.intp], NDArray[np.uint8]]:
        """Return where the levels change, and 4 * before + after there."""
        if len(chunk) == 0:
            return np.empty(0, dtype=np.intp), np.empty(0, dtype=np.uint8)
        if chunk.max() > 3:
            raise ValueError(f"levels of {chunk.max()} at sample {int(chunk.argmax())}; need A + 2 B, 0 to 3")
        index = np.flatnonzero(chunk[1:] != chunk[:-1]) + 1
        code = np.left_shift(chunk[index - 1], 2) | chunk[index]
        if self.levels is not None and self.levels != chunk[0]:
            index = np.concatenate(([0], index))
            code = np.concatenate((np.array([self.levels << 2 | int(chunk[0])], dtype=np.uint8), code))
        self.levels = int(chunk[-1])
        return index, code

    def _latched(self, code: NDArray[np.uint8]) -> NDArray[np.int8]:
        """Return the steps of jk-latched: A's rises, signed by Q as B's last rise before them left it."""
        latch = _LATCH[code]
        rises = np.flatnonzero(_A_RISES[code])
        clocks = np.flatnonzero(latch >= 0)
        q = np.concatenate(([self.latched_up], latch[clocks] == 1))
        step = np.zeros(len(code), dtype=np.int8)
        step[rises] = np.where(q[np.searchsorted(clocks, rises)], 1, -1)
        self.latched_up = bool(q[-1])
        return step


class PulseDecoder:
    """Step and direction lines, the two-counter case: a rising step counts up where direction is high, else down.

    Such a source has no illegal change: a step and a turn of direction in one sample count with the new direction,
    which a driver must have set up before it steps.

    Attributes
    ----------
    up, down, edges : int
        Totals so far; ``edges`` counts the rises of step.
    """

    def __init__(self) -> None:
        self.up = self.down = self.edges = 0
        self._step_high = True  # a line that is high from the first sample on has not been seen to rise

    @property
    def net(self) -> int:
        """Up minus down, in pulses."""
        return self.up - self.down

    def feed(self, step: ArrayLike, direction: ArrayLike) -> Steps:
        """Decode a chunk of step and direction levels (0 or 1, one per sample) and add to the totals."""
        high = np.asarray(step, dtype=np.bool_)
        forward = np.asarray(direction, dtype=np.bool_)
        if high.shape != forward.shape:
            raise ValueError(f"step has {high.shape} samples and direction {forward.shape}; need the same")
        rises = high.copy()
        if len(high):
            rises[1:] &= ~high[:-1]
            rises[0] &= not self._step_high
            self._step_high = bool(high[-1])
        index = np.flatnonzero(rises)
        signs = np.where(forward[index], 1, -1).astype(np.int8)
        up = int(np.count_nonzero(signs == 1))
        self.up += up
        self.down += len(index) - up
        self.edges += len(index)
        return Steps(index, signs, np.zeros(len(index), dtype=np.bool_))


def levels_of(count: ArrayLike) -> NDArray[np.uint8]:
    """Return the levels A + 2 B at x4 counts n (any integers, any shape)."""
    phase = np.asarray(count, dtype=np.int64) & 3
    return np.asarray(GRAY[phase], dtype=np.uint8)
