"""The encoder: position of the mass -> edges of A and B -> the two counters of its decoder.

Convention: n = floor((x + vibration)/delta), delta = circumference/lines_per_rev/4, and n mod 4 = 0, 1, 2, 3 means AB =
00, 10, 11, 01.  The vibration, amplitude sin(2 pi f t), moves the encoder alone: the mass feels nothing of it.

x4 counters start with up = n mod 4, so that (up - down) mod 4 is always the phase of the levels.  The others start at 0
and count lines.  Between two nodes of the motion the position is the cubic through their x and v; it is cut at the
turning points of x + vibration, and every edge of every monotone piece is seen, in order, however many there are.

Not modelled: a cog with play, an encoder line of uneven width, the time an edge takes.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from daq.wire.quadrature import Decoder, levels_of
from rig_sim.motion.trajectory import Nodes
from rig_sim.scenes.sections import Encoder
from stickslip.compute.arrays import Array, Integers
from stickslip.errors import InputError

LARGEST_COUNT = 2**62
MOST_EDGES = 50_000_000  # in one call, for decoders that need them one by one
_PIECES_PER_VIBRATION = 16  # so that x' + vibration' crosses zero at most once in a piece
_HALVINGS = 30  # halvings of a piece: the position at a turning point is right to the square of the time's error


@dataclass(frozen=True)
class Counts:
    """The board's readings at s sampling instants."""

    up: Integers  # (s,) the two counters, not yet wrapped to their width
    down: Integers
    levels: NDArray[np.uint8]  # (s,) A + 2 B


class QuadratureEncoder:
    """The encoder and its decoder at work; the state is carried from one stretch of motion to the next."""

    def __init__(self, section: Encoder, x: float, t: float = 0.0, decoder: str | None = None) -> None:
        self.decoder = decoder or section.decoder  # ``decoder`` overrides the scene's
        self.section = section
        self.delta = section.metres_per_count
        self._amplitude = section.vibration
        self._omega = 2 * math.pi * section.vibration_hz if section.vibration else 0.0
        # The x4 count of the position now, never wrapped; x (m) and t (s) are those at power-up
        self.n = math.floor((x + self._amplitude * math.sin(self._omega * t)) / self.delta)
        # A line counts where A rises with B low, from n = 4 j to 4 j + 1, and is four counts long.
        zero = self.n - self.n % 4 + 0.5 if self.decoder == "x4" else (self.n - 1) // 4 * 4 + 3
        self.origin = zero * self.delta  # position (m) of the middle of the count where up - down is 0
        self._up = self.n % 4 if self.decoder == "x4" else 0
        self._down = 0
        self._lines = None if self.decoder == "x4" else Decoder(self.decoder, levels=int(levels_of(self.n)))

    def read(self, nodes: Nodes, samples: Integers) -> Counts:
        """Return the counters at the nodes numbered ``samples`` (increasing) of the motion since the last call.

        Its first node is the last one's end.  Raises InputError where the position is beyond what counts can hold, or
        has more edges than can be followed one by one.
        """
        y, origin = self._insert_turning_points(nodes)
        if not np.abs(y).max() < LARGEST_COUNT * self.delta:
            raise InputError(
                f"the mass is at {float(y[-1]):g} m, which no encoder can measure", "encoder", "correct the scene"
            )
        n = np.floor(y / self.delta).astype(np.int64)
        jumps = np.diff(n, prepend=self.n)
        self.n = int(n[-1])
        indices = np.searchsorted(origin, samples)
        if self._lines is None:
            up = self._up + np.cumsum(np.maximum(jumps, 0))
            down = self._down + np.cumsum(np.maximum(-jumps, 0))
            self._up, self._down = int(up[-1]), int(down[-1])
            return Counts(up[indices], down[indices], levels_of(n[indices]))
        last = np.cumsum(np.abs(jumps))  # edges up to and with each piece
        up, down = self._count_lines(n, jumps, last)
        return Counts(up[last[indices]], down[last[indices]], levels_of(n[indices]))

    def _count_lines(self, n: Integers, jumps: Integers, last: Integers) -> tuple[Integers, Integers]:
        """Return both counters after 0, 1, 2 ... edges of this stretch."""
        if self._lines is None:
            raise TypeError("x4 needs no edge by edge decoding")
        edges = np.abs(jumps)
        if edges.sum() > MOST_EDGES:
            raise InputError(
                f"{int(edges.sum())} edges in one part of the motion are too many",
                "encoder",
                "lower encoder.vibration, vibration_hz or lines_per_rev, or use the decoder x4",
            )
        within = np.arange(int(last[-1])) - np.repeat(last - edges, edges)  # 0, 1 ... inside each piece
        visited = np.repeat(n - jumps, edges) + np.repeat(np.sign(jumps), edges) * (within + 1)
        before = self._lines.up, self._lines.down
        steps = self._lines.feed(levels_of(visited))
        up = before[0] + np.concatenate(([0], np.cumsum(steps.step > 0)))
        down = before[1] + np.concatenate(([0], np.cumsum(steps.step < 0)))
        return up, down

    def _insert_turning_points(self, nodes: Nodes) -> tuple[Array, Array]:
        """Return encoder positions with the turning points between the nodes inserted, and a number for each point.

        Node i has the number i, a point between i and i + 1 a number in between.
        """
        t, x, v = nodes.t, nodes.x, nodes.v
        origin = np.arange(len(t), dtype=np.float64)
        if self._omega:
            t, x, v, origin = self._refine(nodes, origin)
        rate = v + self._amplitude * self._omega * np.cos(self._omega * t)
        turns = np.flatnonzero(((rate[:-1] > 0) != (rate[1:] > 0)) & (t[1:] > t[:-1]))
        y = x + self._amplitude * np.sin(self._omega * t)
        if len(turns):
            y_turn = self._find_turning_points(t, x, v, turns)
            y = np.insert(y, turns + 1, y_turn)
            origin = np.insert(origin, turns + 1, (origin[turns] + origin[turns + 1]) / 2)
        return y, origin

    def _refine(self, nodes: Nodes, origin: Array) -> tuple[Array, Array, Array, Array]:
        """Cut the pieces at every sixteenth of a vibration period, so that each holds at most one turning point."""
        step = 2 * math.pi / self._omega / _PIECES_PER_VIBRATION
        first, last = math.floor(nodes.t[0] / step) + 1, math.ceil(nodes.t[-1] / step)
        cuts = np.arange(first, last, dtype=np.float64) * step
        piece = np.searchsorted(nodes.t, cuts, side="right") - 1
        inside = (cuts > nodes.t[piece]) & (piece < len(nodes.t) - 1)
        cuts, piece = cuts[inside], piece[inside]
        cubic, s = fit_cubic(nodes.t, nodes.x, nodes.v, piece), cuts - nodes.t[piece]
        x, v = cubic_position(cubic, s), cubic_speed(cubic, s)
        numbers = piece + np.clip(s / (nodes.t[piece + 1] - nodes.t[piece]), 1e-9, 1 - 1e-9)
        return (
            np.insert(nodes.t, piece + 1, cuts),
            np.insert(nodes.x, piece + 1, x),
            np.insert(nodes.v, piece + 1, v),
            np.insert(origin, piece + 1, numbers),
        )

    def _find_turning_points(self, t: Array, x: Array, v: Array, pieces: Integers) -> Array:
        """Return the encoder position at the turning point of each of these pieces, by bisection."""
        cubic = fit_cubic(t, x, v, pieces)
        start = t[pieces]
        low, high = np.zeros(len(pieces)), t[pieces + 1] - start
        shaking = self._amplitude * self._omega
        rising = v[pieces] + shaking * np.cos(self._omega * start) > 0
        for _ in range(_HALVINGS):
            middle = (low + high) / 2
            same = (cubic_speed(cubic, middle) + shaking * np.cos(self._omega * (start + middle)) > 0) == rising
            low = np.where(same, middle, low)
            high = np.where(same, high, middle)
        return cubic_position(cubic, low) + self._amplitude * np.sin(self._omega * (start + low))


def fit_cubic(t: Array, x: Array, v: Array, piece: Integers) -> Array:
    """Return the coefficients (4, p) in the time since each piece's start, from x and v at both ends (Hermite)."""
    h = t[piece + 1] - t[piece]
    slope = (x[piece + 1] - x[piece]) / h
    c2 = (3 * slope - 2 * v[piece] - v[piece + 1]) / h
    c3 = (v[piece] + v[piece + 1] - 2 * slope) / h**2
    return np.stack((x[piece], v[piece], c2, c3))


def cubic_position(cubic: Array, s: Array) -> Array:
    x, v, c2, c3 = cubic
    position: Array = x + s * (v + s * (c2 + s * c3))
    return position


def cubic_speed(cubic: Array, s: Array) -> Array:
    _, v, c2, c3 = cubic
    speed: Array = v + s * (2 * c2 + 3 * s * c3)
    return speed
