"""The data sent to the pages of a view: numbered events, and any stretch of the record on request.

An event is one JSON document with these members, each only if there is something new:

::

    t, x, v, a          columns: samples since the last event; s, and the unit of the positions; null where not known,
                        also x between two samples that nothing connects
    counts              totals so far: samples, lost, crc_errors, illegal, phase_errors, segments
    unit, state         "m" or "count"; "stick", "slip", "moving" or "gap"
    trouble             the current fault as text; "" when it is over
    summary             `daq.live.analysis.LiveAnalysis.summarise`
    break_aways         those since the last event: time, position, time of the landing after it
    marker              a person's: {"t", "text"}
    progress            share of a finished run that has been read
    ended               how the recording ended, as text: the last event
    duration            of the recording that has ended, s
"""

import asyncio
import json
import math
import os
import shlex
import time
from abc import ABC, abstractmethod
from bisect import bisect_right
from collections import deque
from collections.abc import AsyncIterator, Mapping
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from daq.finalise import claim
from daq.live.analysis import LiveAnalysis, motion_columns, round_for_json
from daq.live.finished import RunSamples
from daq.live.motion import LONGEST_PARABOLA, LiveFilter, LiveMotion
from daq.live.tail import JournalTail, JournalTotals, NewSamples
from daq.runfile import journal
from stickslip.compute.arrays import Array, joined, rows
from stickslip.errors import InputError

# From one look at the journal to the next: the page draws the data of one in two halves, at 20 frames/s.  A look takes
# 2 to 3 ms of CPU time.
LOOK_EVERY_S = 0.099
SUMMARY_EVERY_S = 1.0
MOST_PER_S = 1000  # points sent per second of recording: every second, third ... sample of faster runs
HISTORY_S = 120.0  # span of a running recording that is sent to a page that connects late
GONE_AFTER_S = 3.0  # a journal that does not grow for so long may have lost its recorder
LOSS_SHOWN_S = 10.0  # for so long a loss of samples is reported
LONGEST_MARKER = 200  # characters
MOST_ROWS = 30_000  # rows of a stretch that is sent sample by sample: six for each pixel of a wide screen
ON_EDGE = 1e-3  # samples: times closer to an edge are at it, apart from rounding
MOST_PLACES = 1024  # positions in the journal from which samples can be read again, 2 kB each
PART_BYTES = 1 << 16  # part of the journal read again at once
PORTION = 1 << 8  # samples of a finished run that are analysed at once
SERVED_EVERY_S = 0.02  # interval of serving pages while a finished run is read
LEARNED_FROM = 1 << 17  # first samples of a finished run, from which the window of its motion is chosen


@dataclass(frozen=True)
class PageEvent:
    """One message to the pages: its number, the time of its last sample (s), and its JSON."""

    number: int
    time: float
    data: str


class NotPossibleError(Exception):
    """A request of a page cannot be fulfilled; the message says why."""


class Publisher(ABC):
    """The events of a view, and how to wait for the next one.

    path: The journal, or the run file.
    rate_hz: Nominal rate of the samples.
    ended: How the view has ended, "" until then.
    failure: The error that ended it.
    """

    def __init__(self, path: Path, rate_hz: float) -> None:
        self.path, self.rate_hz = path, rate_hz
        self.ended = ""
        self.failure: Exception | None = None
        self.analysis = LiveAnalysis(rate_hz)
        self._events: deque[PageEvent] = deque()
        self._number = 0
        self._came = asyncio.Event()
        self._now = 0.0
        self._n_sent = 0  # break-aways

    @abstractmethod
    async def follow(self) -> None:
        """Publish events until the view has ended; an error ends it, and is stored in `failure`."""

    @abstractmethod
    def describe_run(self) -> dict[str, Any]:
        """Return the data that a page receives first."""

    @abstractmethod
    def _load_stretch(self, begin: float, end: float) -> LiveMotion | None:
        """Return the motion from time ``begin`` to ``end``, s, or somewhat more; None if there is none."""

    def mark(self, text: str) -> None:
        """Store a marker at the current time; NotPossibleError if there is no recording."""
        raise NotPossibleError("there is no recording; use daq note --mark")

    def stop(self) -> None:
        """Ask the recorder to end the recording and keep its data; NotPossibleError if there is no recording."""
        raise NotPossibleError("there is no recording to stop")

    def stretch(self, begin: float, end: float) -> str:
        """Return the JSON of a stretch of the record: columns t, x, v, a, and whether they are all samples, ``exact``.

        A sample on an edge is included.  A stretch of more than `MOST_ROWS` samples is thinned to its extremes.
        """
        motion = self._load_stretch(begin, end) if (end - begin) * self.rate_hz <= MOST_ROWS else None
        rows = motion_columns(motion) if motion is not None else self.analysis.overview.collect_rows()
        inside = (rows[0] >= begin - ON_EDGE / self.rate_hz) & (rows[0] <= end + ON_EDGE / self.rate_hz)
        return json.dumps({"exact": motion is not None})[:-1] + _join_members(_format_columns(rows[:, inside])) + "}"

    async def events(self, after: int) -> AsyncIterator[PageEvent]:
        """Yield the events after a number, those of the past first, until the view has ended."""
        while True:
            arrived = self._came
            for event in [event for event in self._events if event.number > after]:
                after = event.number
                yield event
            if self.ended:
                return
            await arrived.wait()

    def _new_members(self) -> dict[str, Any]:
        """Return the members ``summary`` and ``break_aways``."""
        n_new, self._n_sent = self.analysis.slips - self._n_sent, self.analysis.slips
        return self._summarise(max(0, len(self.analysis.break_aways) - n_new))

    def _all_members(self) -> dict[str, Any]:
        """Return the same members for a page that connects: all break-aways; the run file, and the next command."""
        run = self.path.with_name(self.path.name.removesuffix(".part")).absolute()
        return {
            "file": run.name,
            "path": str(run),
            "next": f"fit-friction {shlex.quote(str(run))}",
            **self._summarise(0),
        }

    def _summarise(self, first: int) -> dict[str, Any]:
        """Return the summary, and the break-aways from the ``first`` one on."""
        rounded = [
            [round(time, 6), round_for_json(x), round(landing, 6)]
            for time, x, landing in islice(self.analysis.break_aways, first, None)
        ]
        return {"summary": self.analysis.summarise(), "break_aways": rounded}

    def _send(self, data: dict[str, Any], texts: Mapping[str, str] = MappingProxyType({})) -> None:
        """Store an event for the pages; ``texts`` are members that are already JSON, by name."""
        self._number += 1
        self._events.append(PageEvent(self._number, self._now, json.dumps(data)[:-1] + _join_members(texts) + "}"))
        while self._events[0].time < self._now - HISTORY_S:
            self._events.popleft()
        self._came.set()
        self._came = asyncio.Event()

    def _end(self, words: str, **members: float) -> None:
        self.ended = words
        self._send({"ended": words, **members})


class LiveRun(Publisher):
    """A recording while it runs; ``path`` is its journal."""

    def __init__(self, path: Path) -> None:
        self.tail = JournalTail(path)
        super().__init__(path, float(self.tail.header["rate_hz"]))
        self._stride = max(1, math.ceil(self.rate_hz / MOST_PER_S))
        self._skip, self._before = 0, np.empty((5, 0))
        self._last_new = time.monotonic()
        self._summed = -math.inf
        self._trouble = ""
        self._losses: deque[tuple[float, int]] = deque([(0.0, 0)])
        self._places: list[tuple[float, JournalTail]] = [(-math.inf, self.tail.fork())]
        self._markers: deque[tuple[int, str]] = deque()  # stamp in monotonic ns, text; their samples are yet to come
        self._spacing_s = 1.0

    async def follow(self) -> None:
        due = time.monotonic()
        while not self.ended:
            try:
                self.look()
            except Exception as error:
                self.failure = error
                self._end(f"The view failed ({error}); the recording continues")
            now = time.monotonic()
            due = max(due + LOOK_EVERY_S, now)  # a look that is late does not make the next ones follow at once
            await asyncio.sleep(due - now)

    def look(self) -> None:
        """Read the new data in the journal and publish them as an event."""
        try:
            pieces = self.tail.poll()
        except FileNotFoundError:
            self._end(self._explain_missing())
            return
        except InputError as error:
            self._end(f"the journal {error.what}")
            return
        self.analysis.rig, self.analysis.unit = self.tail.rig, self.tail.unit
        motions = [self.analysis.feed(part) for part in pieces]
        if pieces:
            self._last_new, self._now = time.monotonic(), float(pieces[-1].time[-1])
            self._remember()
            self._send_markers(pieces)
        summary: dict[str, Any] = {}
        if self._last_new - self._summed >= SUMMARY_EVERY_S or self.tail.ended:
            self._summed = self._last_new
            summary = self._new_members()
        trouble = self._find_trouble()
        if motions or summary or trouble != self._trouble:
            self._trouble = trouble
            self._publish(np.concatenate(motions, axis=1) if motions else None, summary)
        if self.tail.ended:
            words = {journal.COMPLETE: "complete", journal.STOPPED: "stopped by the user"}
            ending = words.get(self.tail.ended, f"ended: {self.tail.ended}")
            self._end(f"Recording {ending}", duration=self._now)
        elif time.monotonic() - self._last_new > GONE_AFTER_S and not claim.is_locked(self.tail.path):
            self._end(
                f"The recording process has ended unexpectedly. Save the data with daq recover {self.tail.path.name}"
            )

    def mark(self, text: str) -> None:
        """Store a marker next to the journal; pages receive it with the sample that the finaliser assigns to it."""
        if self.ended:
            raise NotPossibleError("the recording has ended; use daq note --mark")
        label = " ".join(text.split())[:LONGEST_MARKER] or "marker"
        stamp_ns = time.monotonic_ns()
        handle = os.open(journal.markers_path(self.tail.path), os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o666)
        try:
            os.write(handle, f"{stamp_ns} {label}\n".encode())
        finally:
            os.close(handle)
        self._markers.append((stamp_ns, label))

    def _send_markers(self, pieces: list[NewSamples]) -> None:
        """Send the markers set before the last of these samples, each at the first sample received after it."""
        for piece in pieces:
            while piece.stamp_ns is not None and self._markers and self._markers[0][0] <= piece.stamp_ns[-1]:
                stamp_ns, label = self._markers.popleft()
                marked = float(piece.time[np.searchsorted(piece.stamp_ns, stamp_ns)])
                self._send({"marker": {"t": marked, "text": label}})

    def stop(self) -> None:
        """Create the file next to the journal that asks its recorder to stop."""
        if self.ended:
            raise NotPossibleError("the recording has ended")
        journal.stop_path(self.tail.path).touch()

    def describe_run(self) -> dict[str, Any]:
        header = self.tail.header
        samples = header["samples"]
        return {
            "title": header["title"],
            "rate": self.rate_hz,
            "duration": None if samples is None else samples / self.rate_hz,
            "every": self._stride,
            "finished": False,
            "trouble": self._trouble,
            **self._all_members(),
        }

    def _load_stretch(self, begin: float, end: float) -> LiveMotion | None:
        window = self.analysis.filter.window
        margin = window / self.rate_hz
        places = self._places
        index = bisect_right([place for place, _ in places], begin - margin) - 1
        tail = places[index][1].fork()
        motion_filter = LiveFilter(self.rate_hz, window)
        motions: list[LiveMotion] = []
        while True:
            bytes_before = tail.bytes_read
            try:
                pieces = tail.poll(PART_BYTES)
            except (OSError, InputError):
                return None
            motions += [motion_filter.feed(part) for part in pieces]
            if tail.bytes_read == bytes_before or (pieces and pieces[-1].time[-1] > end + margin):
                return joined(motions) if motions else None

    def _remember(self) -> None:
        """Store the current position in the journal, from which its samples can be read again."""
        if self._now - self._places[-1][0] < self._spacing_s:
            return
        self._places.append((self._now, self.tail.fork()))
        if len(self._places) > MOST_PLACES:
            self._places = self._places[::2]
            self._spacing_s *= 2

    def _find_trouble(self) -> str:
        """Return the current fault as text; "" without one."""
        lost = self.tail.counts.lost
        if lost > self._losses[-1][1]:
            self._losses.append((self._now, lost))
        while len(self._losses) > 1 and self._losses[1][0] < self._now - LOSS_SHOWN_S:
            self._losses.popleft()
        if self.tail.port_lost:
            return f"the port was lost ({self.tail.port_lost}), and the recorder is waiting for it"
        silent_s = time.monotonic() - self._last_new
        if silent_s > GONE_AFTER_S:
            return f"no sample for {silent_s:.0f} s"
        if lost > self._losses[0][1] and self._losses[-1][0] > self._now - LOSS_SHOWN_S:
            return f"the board loses samples: {lost - self._losses[0][1]} in the last {LOSS_SHOWN_S:g} s"
        return ""

    def _explain_missing(self) -> str:
        """Return what happened to a recording whose journal is gone."""
        run = self.path.with_suffix("")
        try:
            is_finished = run.stat().st_mtime_ns >= self.tail.header["wall_ns"]
        except OSError:
            is_finished = False
        if is_finished:
            return "Recording ended"
        return f"{self.path.name} has been moved or removed; the terminal of daq record shows where it continues"

    def _publish(self, motion: Array | None, summary: dict[str, Any]) -> None:
        texts: dict[str, str] = {}
        if motion is not None:
            shown = motion[:, self._skip :: self._stride]
            self._skip = (self._skip - motion.shape[1]) % self._stride
            shown = shown[:, shown[0] > self._now - HISTORY_S]  # of a viewer that catches up
            texts = _format_columns(np.concatenate((self._before, shown), axis=1), self._before.shape[1])
            self._before = shown[:, -1:] if shown.size else self._before
        data = {"counts": vars(self.tail.counts), "unit": self.tail.unit, "state": self.analysis.state}
        self._send({**data, "trouble": self._trouble, **summary}, texts)


class FinishedRun(Publisher):
    """A run file in the same view."""

    def __init__(self, path: Path) -> None:
        self.samples = RunSamples(path)
        super().__init__(path, self.samples.header.rate_hz)
        self._progress = 0.0

    async def follow(self) -> None:
        """Read the run, then wait for ever."""
        try:
            first = LiveAnalysis(self.rate_hz)
            await self._read(first, LEARNED_FROM)
            self.analysis = LiveAnalysis(self.rate_hz, first.filter.window)
            self.samples.counts = JournalTotals(crc_errors=self.samples.counts.crc_errors)
            await self._read(self.analysis)
        except Exception as error:
            self.failure = error
            self._end(f"The run cannot be read ({error})")
            return
        self._progress = 1.0
        self._send_progress()
        await asyncio.Event().wait()

    async def _read(self, analysis: LiveAnalysis, most: int | None = None) -> None:
        """Analyse the samples, or so many of the first ones, and send the progress at intervals."""
        analysis.rig, analysis.unit = self.samples.header.rig, self.samples.header.unit
        updated = served = time.monotonic()
        for piece in self.samples.read_pieces():
            # In portions, as in a recording: estimates from one are used for the next one.
            for first in range(0, piece.time.size, PORTION):
                analysis.feed(rows(piece, slice(first, first + PORTION)))
                if time.monotonic() - served > SERVED_EVERY_S:
                    await asyncio.sleep(0)
                    served = time.monotonic()
            if most is not None and self.samples.counts.samples >= most:
                return
            if time.monotonic() - updated > SUMMARY_EVERY_S:
                updated = time.monotonic()
                self._progress = self.samples.counts.samples / self.samples.times.size if most is None else 0.0
                self._send_progress()

    def _send_progress(self) -> None:
        counts = vars(self.samples.counts)
        self._send({"counts": counts, "unit": self.analysis.unit, "progress": self._progress, **self._new_members()})

    def describe_run(self) -> dict[str, Any]:
        run, times = self.samples.header, self.samples.times
        return {
            "title": run.title,
            "rate": self.rate_hz,
            "duration": round_for_json(float(times[-1] - times[0])),
            "every": 1,
            "finished": True,
            "first": float(times[0]),
            "last": float(times[-1]),
            "started": run.started,
            "unit": run.unit,
            "counted": run.raw is not None,
            "markers": [{"t": time, "text": label} for time, label in run.list_markers(times)],
            **self._all_members(),
        }

    def _load_stretch(self, begin: float, end: float) -> LiveMotion | None:
        try:
            samples = self.samples.load_between(begin, end, LONGEST_PARABOLA, MOST_ROWS)
        except (OSError, InputError):  # the file has been moved meanwhile
            return None
        return LiveFilter(self.rate_hz, self.analysis.filter.window).feed(samples)


def _format_columns(rows: Array, n_sent: int = 0) -> dict[str, str]:
    """Return rows t, x, v, a, piece as JSON lists by name, with a row without a position between two pieces.

    The first ``n_sent`` rows have been sent before.
    """
    breaks = np.flatnonzero(np.diff(rows[4]) != 0) + 1
    if breaks.size:
        between = np.full((5, breaks.size), math.nan)
        between[0] = (rows[0, breaks - 1] + rows[0, breaks]) / 2
        rows = np.insert(rows, breaks, between, axis=1)
    forms = {"t": "%.6f", "x": "%.7g", "v": "%.5g", "a": "%.5g"}
    return {
        name: _format_column(values[n_sent:], form) for (name, form), values in zip(forms.items(), rows, strict=False)
    }


def _format_column(values: Array, form: str) -> str:
    return "[" + ",".join([form % value if math.isfinite(value) else "null" for value in values.tolist()]) + "]"


def _join_members(texts: Mapping[str, str]) -> str:
    """Return the rest of a JSON object, from the comma on: names and texts that are already JSON."""
    return "".join(f', "{name}": {text}' for name, text in texts.items())
