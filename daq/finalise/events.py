"""Events of a run, for the run file: sample, kind and a short note each.

Only the first of consecutive flagged samples is an event; its note gives their number, and the flags of the samples
mark each one.
"""

from collections.abc import Sequence

import numpy as np

from daq.runfile.run_data import EVENTS
from daq.stream.integrity import CheckedCounts
from daq.stream.timeline import Piece
from daq.wire import counters
from daq.wire import frames as wire
from stickslip.compute.arrays import runs

RunEvent = tuple[int, int, str]
FLAGS = {
    "illegal": counters.FLAG_ILLEGAL,
    "phase": counters.FLAG_PHASE,
    "both-moved": counters.FLAG_BOTH,
    "overrun": wire.OVERRUN,
    "retimed": counters.FLAG_TIME,
}


class RunEvents:
    """The events of a run whose pieces come in order.

    markers: Stamp in monotonic ns, text, in order; markers set before or after the run are omitted.
    rate_hz: Nominal rate, Hz.
    """

    def __init__(self, markers: Sequence[tuple[int, str]], rate_hz: float) -> None:
        self._events: list[RunEvent] = []
        self._runs: dict[str, list[tuple[int, int]]] = {name: [] for name in FLAGS}
        self._frames: list[tuple[int, str, str]] = []  # events of frames whose sample has not come yet
        self._markers = list(markers)
        self._period_ns = 1e9 / rate_hz
        self._samples = 0

    def take(self, piece: Piece, checked: CheckedCounts) -> None:
        samples, frames = piece
        segments = zip(
            checked.starts.tolist(), checked.reasons, checked.gap_s.tolist(), checked.leap_s.tolist(), strict=True
        )
        for start, reason, gap_s, leap_s in segments:
            if start:
                kind = EVENTS["invalid" if reason == "invalid" else "reopened"]
                self._events.append((start, kind, _explain_start(reason, gap_s, leap_s)))
        for sample, pause_s in zip(checked.paused.tolist(), checked.paused_s.tolist(), strict=True):
            note = f"the board paused for {1e3 * pause_s:.0f} ms, but its sequence numbers show no lost sample"
            self._events.append((sample, EVENTS["gap"], note))
        for sample in np.flatnonzero(checked.lost).tolist():
            self._events.append((self._samples + sample, EVENTS["gap"], f"{checked.lost[sample]} samples lost"))
        for name, flag in FLAGS.items():
            stretches = self._runs[name]
            for first, end in runs(checked.flags & flag > 0):
                begin = self._samples + first
                if stretches and stretches[-1][1] == begin:
                    begin = stretches.pop()[0]
                stretches.append((begin, self._samples + end))
        self._frames += [(frames.first + int(frame), "crc", "") for frame in frames.crc_frame]
        self._frames += [(frames.first + frame, "notice", text) for frame, text in frames.notices]
        if not len(samples):
            return
        self._frames.sort()
        last = int(samples.frame[-1])
        due = [event for event in self._frames if event[0] <= last]
        self._frames = self._frames[len(due) :]
        first_samples = np.searchsorted(samples.frame, np.array([frame for frame, _, _ in due], dtype=np.int64))
        for sample, (_, name, note) in zip(first_samples.tolist(), due, strict=True):
            self._events.append((self._samples + sample, EVENTS[name], note))
        if not self._samples:
            first_ns = int(samples.stamp_ns[0])
            self._markers = [marker for marker in self._markers if marker[0] >= first_ns - self._period_ns]
        while self._markers and self._markers[0][0] <= samples.stamp_ns[-1]:
            stamp, text = self._markers.pop(0)
            sample = int(np.searchsorted(samples.stamp_ns, stamp))
            self._events.append((self._samples + sample, EVENTS["marker"], text))
        self._samples += len(samples)

    def sort(self) -> list[RunEvent]:
        events = list(self._events)
        for name, stretches in self._runs.items():
            events += [(first, EVENTS[name], f"{end - first} samples") for first, end in stretches]
        events += [(self._samples - 1, EVENTS[name], note) for _, name, note in self._frames]
        return sorted(events)


def _explain_start(reason: str, gap_s: float, leap_s: float) -> str:
    """Return as text why a segment begins."""
    gap_ms = 1e3 * gap_s
    return {
        "invalid": f"there was no sample for {gap_ms:.0f} ms, so the counters may have rolled over",
        "reopened": f"the port was lost for {gap_ms:.0f} ms: the position may restart",
        "restarted": f"the board restarted, {gap_ms:.0f} ms lost: the position restarts",
        "jumped": f"sequence number and clock of the board jump, {gap_ms:.0f} ms after the previous sample "
        "(a reset?): the position may restart",
        "clock": f"the board's clock jumped by {1e3 * leap_s:+.0f} ms while its sequence numbers continued: the "
        "time follows the sequence numbers",
    }[reason]
