"""The columns of a run, collected piece by piece: the motion of each sample, its data as sent, and the exact motion."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.runfile import belt_counter
from daq.runfile.belt_counter import BeltCount
from daq.runfile.rig import Rig
from daq.runfile.run_data import Raw, Truth
from daq.runfile.spill import Column, Spill
from daq.stream.connections import find_units
from daq.stream.integrity import CheckedCounts
from daq.stream.timeline import Samples, split_parts
from daq.wire import frames


class RunColumns:
    """The columns of a run whose pieces come in order.

    rig: Its calibration.
    idents: The identifications that it was sent under.
    spill: Storage of the columns.
    """

    def __init__(self, rig: Rig, idents: Sequence[frames.Ident | None], spill: Spill) -> None:
        self._rig, self._spill = rig, spill
        self._units = find_units(idents, rig)
        self._columns: dict[str, Column] = {}
        self._starts: list[int] = []
        self._samples = 0
        self._belt = BeltCount()
        self._part, self._shift_s = -1, 0.0

    def has(self, name: str) -> bool:
        return name in self._columns

    def __getitem__(self, name: str) -> NDArray[Any]:
        return self._columns[name].whole()

    def take(self, samples: Samples, checked: CheckedCounts, position: NDArray[np.float64]) -> None:
        if not len(samples):
            return
        sent = samples.ticks if samples.time_error is None else samples.ticks + samples.time_error
        tick_ns, bits = self._units.tick_ns[samples.source], self._units.bits[samples.source]
        microseconds = sent * tick_ns // 1000
        self._append("time", samples.time)
        self._append("position", position)
        self._append("count", checked.count)
        self._append("segment", checked.segment)
        self._append("sample", samples.index.astype(np.uint32))
        self._append("count_up", samples.up)
        self._append("count_down", samples.down)
        self._append("device_time", (microseconds & 0xFFFFFFFF).astype(np.uint32))
        self._append("levels", samples.status & np.uint8(frames.LEVELS))
        self._append("flags", checked.flags)
        self._append("illegal", samples.illegal)
        self._append("belt_count", samples.belt)
        self._append("edge_time", None if samples.edge is None else _edge_us(samples.edge, tick_ns))
        if samples.belt is not None and self._rig.belt_metres_per_count is not None:
            begins = np.zeros(len(samples), dtype=np.bool_)
            begins[checked.starts - self._samples] = True
            self._append("belt", self._belt.take(samples.belt, begins, bits))
        self._starts += checked.starts.tolist()
        if samples.truth is not None:
            self._take_truth(samples, samples.truth)
        self._samples += len(samples)

    def build_raw(self) -> Raw:
        names = ("sample", "count_up", "count_down", "device_time", "levels", "flags", "illegal")
        optional = [name for name in ("belt_count", "edge_time") if self.has(name)]
        return Raw(**{name: self[name] for name in (*names, *optional)})

    def compute_belt(self, rate_hz: float) -> tuple[NDArray[np.int64], NDArray[np.float64]] | tuple[None, None]:
        """Return the belt's count and speed; None if the board sends none, or its metres per count are unknown."""
        pitch = self._rig.belt_metres_per_count
        if pitch is None or not self.has("belt"):
            return None, None
        count, speed = self["belt"], Column(self._spill)
        starts = np.array(self._starts, dtype=np.int64)
        for piece in belt_counter.yield_velocities(count, self["time"], starts, rate_hz, pitch.value):
            speed.append(piece)
        return count, speed.whole()

    def build_truth(self, scene: str) -> Truth | None:
        """Return the exact motion at the received samples, its time on the run's axis; None if none was sent."""
        if not self.has("truth_time"):
            return None
        time, x, v, force = (self[f"truth_{name}"] for name in ("time", "x", "v", "F"))
        return Truth(time, x, v, force, scene)

    def _append(self, name: str, values: NDArray[np.generic] | None) -> None:
        if values is not None:
            self._columns.setdefault(name, Column(self._spill)).append(values)

    def _take_truth(self, samples: Samples, truth: NDArray[np.float64]) -> None:
        shift = np.zeros(len(samples))
        for part, span in split_parts(samples):
            if part != self._part:
                device_s = samples.ticks[span.start] * int(self._units.tick_ns[samples.source[span.start]]) / 1e9
                self._part, self._shift_s = part, float(samples.time[span.start] - device_s)
            shift[span] = self._shift_s
        sent = ~np.isnan(truth[:, 0])
        if sent.any():
            time, x, v, force = truth[sent].T
            self._append("truth_time", time + shift[sent])
            self._append("truth_x", x)
            self._append("truth_v", v)
            self._append("truth_F", force)


def _edge_us(edge: NDArray[np.uint16], tick_ns: NDArray[np.int64]) -> NDArray[np.uint16]:
    """Return the time since the last edge in us; `NO_EDGE` keeps its value on the wire."""
    us = edge.astype(np.int64) * tick_ns // 1000
    return np.where(edge == frames.NO_EDGE, frames.NO_EDGE, us).astype(np.uint16)
