"""Records larger than memory: read, smoothed and written a chunk at a time, each with some of its neighbours.

A chunk is smoothed like a record of its own, from `MARGIN` samples before it to as many behind; what is kept is the
chunk.  Savitzky-Golay takes one window throughout, chosen from stretches spread over the record; the smoothers learn
their noise levels and find sticks in every chunk anew.  Memory does not grow with the record, but for a line per stick
and slip.  The even grid of an import, which only the whole record tells, takes a pass of its own.
"""

import math
import time as clock
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np

from daq.compute.arrays import Array
from daq.errors import InputError, nearest
from daq.runfile import store
from daq.runfile.recording import Recording
from processing import belt_motion as belts
from processing import stage
from processing.defects import lost_counts, velocity_steps
from processing.methods import registry, window_choice
from processing.record import import_grid, series
from processing.record.import_grid import ImportGrid
from processing.record.kinematics import SmoothingSummary
from processing.record.lost_counts import LostCounts, counts_missing, restore_counts
from processing.record.motion import Phase, VelocityStep
from processing.record.series import Series
from processing.record.setting import DEFAULT_ORDER, Setting, parse_belt_speed, parse_window
from processing.segmentation import plateaus
from processing.smoothing import REPAIRS

CHUNK = 2**16  # samples kept at a time
MARGIN = 2**12  # samples to either side that are smoothed too
LARGE = 2**20  # samples: longer records are smoothed here
LOOKED_AT = 2**14  # samples of each of eight stretches that a window is chosen from


def smooth(
    path: Path,
    method: str = "auto",
    window: int | str = "auto",
    order: int | None = None,
    times: str = "recorded",
    belt_speed: float | str = "auto",
    repair_counts: str = "flag",
    progress: Callable[[float], None] = lambda done: None,
) -> SmoothingSummary:
    """Smooth a run and write the stage into its file; arguments as for `processing.smooth`.

    Raises
    ------
    InputError
        As `processing.smooth`.
    """
    begun = clock.process_time()
    registry.check(method)
    if repair_counts not in REPAIRS:
        raise InputError(f"is {repair_counts!r}", "--repair-counts", nearest(repair_counts, REPAIRS))
    n = store.samples(path)
    first = store.load(path, slice(0, min(n, 2 * window_choice.LONGEST)))
    setting = parse_window(window, order, _spread(path, n, times))
    setting = replace(setting, belt_speed=parse_belt_speed(belt_speed))
    if method == "sg" and setting.window is None:
        chosen = window_choice.choose(_spread(path, n, times), setting.order)
        setting = replace(setting, window=chosen.window, order=chosen.order)
    elif method == "sg" and setting.order is None:
        setting = replace(setting, order=DEFAULT_ORDER)
    worker = _Worker(path, n, method, setting, times, belt_speed, repair_counts)
    belt = belts.has_belt_encoder(first)
    if times == "nominal" and first.raw is None:
        worker.grid = import_grid.learn(path, n, [worker.low(begin) for begin in range(0, n, CHUNK)])
    told: list[SmoothingSummary] = []

    def write(entry: h5py.Group) -> None:
        smoothed = stage.begin(entry)
        table = stage.empty(smoothed, n, first.unit, belt=belt)
        for at in range(0, n, CHUNK):
            worker.chunk(at, min(at + CHUNK, n), table)
            progress(min(at + CHUNK, n))
        told.append(worker.told(clock.process_time() - begun, first.unit))
        stage.finish(smoothed, told[0], first.unit, first.digest)

    store.extend(path, "smooth", write, default="smooth")
    return told[0]


def _spread(path: Path, n: int, times: str) -> Series:
    """Return eight stretches spread over the record, as one series of as many pieces."""
    size = min(LOOKED_AT, n)
    starts = np.unique(np.linspace(0, n - size, 8).astype(int)).tolist()
    parts = [series.from_recording(store.load(path, slice(at, at + size)), times) for at in starts]
    pieces, at, end = [], 0, 0.0
    time, position = [], []
    for part in parts:
        pieces += [slice(own.start + at, own.stop + at) for own in part.pieces]
        time.append(part.time - part.time[0] + end)
        position.append(part.position)
        at += part.time.size
        end = float(time[-1][-1]) + 10 * part.interval
    return Series(
        time=np.concatenate(time),
        position=np.concatenate(position),
        origin=parts[0].origin,
        pitch=parts[0].pitch,
        interval=parts[0].interval,
        pieces=tuple(pieces),
        source=parts[0].source,
    )


class _Worker:
    """Smooths chunk after chunk, and remembers what goes on from one to the next."""

    def __init__(
        self, path: Path, n: int, method: str, setting: Setting, times: str, belt_speed: float | str, repair: str
    ) -> None:
        self.path, self.n, self.method, self.setting = path, n, method, setting
        self.times, self.belt_speed, self.repair = times, belt_speed, repair
        self.phases: list[Phase] = []
        self.losses: list[LostCounts] = []
        self.kicks: list[VelocityStep] = []
        self.used: dict[str, int] = {}
        self.windows: list[tuple[int, int]] = []
        self.speeds: list[float] = []
        self.stuck = 0
        self.span = (math.nan, math.nan)
        self.grid: ImportGrid | None = None
        self.belt_counted = False
        self._behind = 0.0  # counts lost so far in this segment
        self._anchors: dict[int, tuple[float, int]] = {}

    @property
    def _margin(self) -> int:
        return max(MARGIN, 2 * (self.setting.window or 0))

    def low(self, begin: int) -> int:
        """Return the first sample that is smoothed with the chunk from ``begin`` on."""
        return max(begin - self._margin, 0)

    def chunk(self, begin: int, end: int, table: h5py.Group) -> None:
        """Smooth samples begin..end-1 and write them."""
        low, high = self.low(begin), min(end + self._margin, self.n)
        recording = store.load(self.path, slice(low, high))
        grid = None if self.grid is None else self.grid.times(low, recording.time)
        data = series.from_recording(recording, self.times, self._anchored(recording), grid)
        found = lost_counts.losses(data) if self.repair != "off" else ()
        behind = counts_missing(recording.segment, found)
        data = restore_counts(data, behind)
        motion = registry.estimate(self.method, data, self.setting)
        belt = belts.smooth_belt(recording, data, motion)
        seen = plateaus.segment(data, motion, recording.rig.belt_speed, self.belt_speed, belt)
        own = slice(begin - low, end - low)
        position = motion.position[own]
        mine = [loss for loss in found if own.start <= loss.first < own.stop]
        if self.repair == "fix":
            position = position - data.pitch * self._lost_before(recording, own, found)
        else:
            position = position + data.pitch * behind[own]
        for name, values in (
            ("time", data.time[own]),
            ("position", position),
            ("velocity", motion.velocity[own]),
            ("acceleration", motion.acceleration[own]),
            ("position_errors", motion.position_errors[own]),
            ("velocity_errors", motion.velocity_errors[own]),
            ("acceleration_errors", motion.acceleration_errors[own]),
        ):
            table[name][begin:end] = values
        if belt is not None:
            self.belt_counted = True
            table["belt_velocity"][begin:end] = belt.velocity[own]
            table["belt_velocity_errors"][begin:end] = belt.velocity_errors[own]
        self.losses += [LostCounts(loss.first + low, loss.last + low, loss.counts) for loss in mine]
        steps = [step for step in velocity_steps.kicks(data) if own.start <= step.sample < own.stop]
        self.kicks += [VelocityStep(step.sample + low, step.step) for step in steps]
        self._join(seen.phases, data, low, begin, end)
        self.used[motion.method] = self.used.get(motion.method, 0) + end - begin
        self.windows.append((motion.window, motion.order))
        if math.isfinite(seen.belt_speed):
            self.speeds.append(seen.belt_speed)
        self.stuck += int(seen.stick[own].sum())
        self.span = (self.span[0] if begin else float(data.time[own][0]), float(data.time[own][-1]))

    def _anchored(self, recording: Recording) -> tuple[float, int] | None:
        """Return where the even grid of the chunk's first segment starts: at the segment's first sample."""
        if self.times != "nominal" or recording.raw is None:
            return None
        for segment in np.unique(recording.segment).tolist():
            first = int(np.argmax(recording.segment == segment))
            self._anchors.setdefault(segment, (float(recording.time[first]), int(recording.raw.sample[first])))
        return self._anchors[int(recording.segment[0])]

    def _lost_before(self, recording: Recording, own: slice, found: tuple[LostCounts, ...]) -> Array:
        """Return the counts that were lost before what was read now, for every sample of the chunk."""
        segment = recording.segment[own]
        earlier = sum(loss.counts for loss in found if loss.first < own.start)
        before = np.where(segment == segment[0], self._behind - earlier, 0.0)
        last = [loss.counts for loss in found if own.start <= loss.first < own.stop]
        if segment[-1] != segment[0]:
            self._behind = 0.0
            last = [
                loss.counts
                for loss in found
                if own.start <= loss.first < own.stop and recording.segment[loss.first] == segment[-1]
            ]
        self._behind += sum(last)
        return np.asarray(before)

    def _join(self, found: tuple[Phase, ...], data: Series, low: int, begin: int, end: int) -> None:
        """Take the chunk's share of its phases; one that goes on from the chunk before is made one with it."""
        for phase in found:
            first, last = max(phase.first + low, begin), min(phase.last + low, end - 1)
            if last < first:
                continue
            cut_before, cut_behind = first > phase.first + low, last < phase.last + low
            own = Phase(
                phase.kind,
                float(data.time[first - low]) if cut_before else phase.start,
                float(data.time[last - low]) if cut_behind else phase.end,
                first,
                last,
                math.inf if cut_before else phase.start_sd,
                math.inf if cut_behind else phase.end_sd,
            )
            before = self.phases[-1] if self.phases else None
            if before is not None and cut_before and before.kind == own.kind and before.last + 1 == own.first:
                self.phases[-1] = replace(own, start=before.start, first=before.first, start_sd=before.start_sd)
            else:
                self.phases.append(own)

    def told(self, cpu_s: float, unit: str) -> SmoothingSummary:
        """Return what is said of it all: the method and window of most samples, the middle belt speed."""
        window, order = max(set(self.windows), key=self.windows.count)
        return SmoothingSummary(
            method=max(self.used, key=lambda name: self.used[name]),
            window=window,
            order=order,
            times=self.times,
            belt_speed=float(np.median(self.speeds)) if self.speeds else math.nan,
            phases=tuple(self.phases),
            losses=tuple(self.losses),
            kicks=tuple(self.kicks),
            repaired=self.repair == "fix" and bool(self.losses),
            cpu_s=cpu_s,
            samples=self.n,
            span=self.span[1] - self.span[0],
            unit=unit,
            plateau_fraction=self.stuck / self.n,
            belt_counted=self.belt_counted,
        )
