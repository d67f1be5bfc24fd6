"""Events of a run, for the run file: sample, kind and a short note each.

Of consecutive flagged samples only the first is an event; its note gives their number, and the flags of the samples
mark each one.
"""

from collections.abc import Sequence

import numpy as np

from daq.finalise.integrity import CheckedCounts
from daq.finalise.timeline import Piece
from daq.runfile.recording import EVENTS
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
        self._found: list[RunEvent] = []
        self._runs: dict[str, list[tuple[int, int]]] = {name: [] for name in FLAGS}
        self._frames: list[tuple[int, str, str]] = []  # events of frames whose sample has not come
        self._markers = list(markers)
        self._period_ns = 1e9 / rate_hz
        self._samples = 0

    def take(self, piece: Piece, checked: CheckedCounts) -> None:
        """Take the next samples."""
        samples, stream = piece.samples, piece.stream
        begun = zip(
            checked.starts.tolist(), checked.reasons, checked.gap_s.tolist(), checked.leap_s.tolist(), strict=True
        )
        for start, why, gap_s, leap_s in begun:
            if start:
                kind = EVENTS["invalid" if why == "invalid" else "reopened"]
                self._found.append((start, kind, _begun(why, gap_s, leap_s)))
        for at, pause_s in zip(checked.paused.tolist(), checked.paused_s.tolist(), strict=True):
            note = f"the board paused for {1e3 * pause_s:.0f} ms; its sequence numbers show no lost sample"
            self._found.append((at, EVENTS["gap"], note))
        for at in np.flatnonzero(checked.lost).tolist():
            self._found.append((self._samples + at, EVENTS["gap"], f"{checked.lost[at]} samples lost"))
        for name, flag in FLAGS.items():
            found = self._runs[name]
            for first, end in runs(checked.flags & flag > 0):
                begin = self._samples + first
                if found and found[-1][1] == begin:
                    begin = found.pop()[0]
                found.append((begin, self._samples + end))
        self._frames += [(piece.frames + int(frame), "crc", "") for frame in stream.crc_frame]
        self._frames += [(piece.frames + frame, "notice", text) for frame, text in stream.notices]
        if not len(samples):
            return
        self._frames.sort()
        last = int(samples.frame[-1])
        known = [event for event in self._frames if event[0] <= last]
        self._frames = self._frames[len(known) :]
        places = np.searchsorted(samples.frame, np.array([frame for frame, _, _ in known], dtype=np.int64))
        for place, (_, name, note) in zip(places.tolist(), known, strict=True):
            self._found.append((self._samples + place, EVENTS[name], note))
        if not self._samples:
            first_ns = int(samples.stamp_ns[0])
            self._markers = [marker for marker in self._markers if marker[0] >= first_ns - self._period_ns]
        while self._markers and self._markers[0][0] <= samples.stamp_ns[-1]:
            stamp, text = self._markers.pop(0)
            place = int(np.searchsorted(samples.stamp_ns, stamp))
            self._found.append((self._samples + place, EVENTS["marker"], text))
        self._samples += len(samples)

    def sorted(self) -> list[RunEvent]:
        """Return all events in order of their samples."""
        events = list(self._found)
        for name, stretches in self._runs.items():
            events += [(first, EVENTS[name], f"{end - first} samples") for first, end in stretches]
        events += [(self._samples - 1, EVENTS[name], note) for _, name, note in self._frames]
        return sorted(events)


def _begun(why: str, gap_s: float, leap_s: float) -> str:
    """Return why a segment begins, in words."""
    gap_ms = 1e3 * gap_s
    return {
        "invalid": f"{gap_ms:.0f} ms without a sample: the counters may have rolled over",
        "reopened": f"the port was lost for {gap_ms:.0f} ms: the position may restart",
        "restarted": f"the board restarted, {gap_ms:.0f} ms lost: the position restarts",
        "jumped": f"sequence number and clock of the board do not follow, {gap_ms:.0f} ms after the sample before "
        "(a reset?): the position may restart",
        "clock": f"the board's clock leapt by {1e3 * leap_s:+.0f} ms while its sequence went on: the time here is that "
        "of the sequence",
    }[why]
