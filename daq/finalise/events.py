"""Events of a run, for the run file: sample, kind and a short note each.

Of consecutive flagged samples only the first is an event; its note gives their number, and the flags of the samples
mark each one.
"""

from collections.abc import Sequence

import numpy as np

from daq.compute.arrays import runs
from daq.finalise.integrity import CheckedCounts
from daq.finalise.timeline import Samples
from daq.runfile.recording import EVENTS
from daq.wire import counters, decode
from daq.wire import frames as wire

RunEvent = tuple[int, int, str]


def events_of(
    samples: Samples,
    checked: CheckedCounts,
    streams: Sequence[decode.Stream],
    markers: Sequence[tuple[int, str]],
    rate_hz: float,
) -> list[RunEvent]:
    """Return the events in order of their samples.

    Parameters
    ----------
    streams : sequence of Stream
        The connections, with their notices and damaged frames.
    markers : sequence of (int, str)
        Stamp in monotonic ns, text; markers set before or after the run are omitted.
    rate_hz : float
        Nominal rate, Hz.
    """
    found: list[RunEvent] = []
    for start, why in zip(checked.starts[1:].tolist(), checked.reasons[1:], strict=True):
        gap_ms = 1e3 * (samples.time[start] - samples.time[start - 1])
        note = {
            "invalid": f"{gap_ms:.0f} ms without a sample: the counters may have rolled over",
            "reopened": f"the port was lost for {gap_ms:.0f} ms: the position may restart",
            "restarted": f"the board restarted, {gap_ms:.0f} ms lost: the position restarts",
            "jumped": f"sequence number and clock of the board do not follow, {gap_ms:.0f} ms after the sample before "
            "(a reset?): the position may restart",
        }[why]
        found.append((start, EVENTS["invalid" if why == "invalid" else "reopened"], note))
    for at in np.flatnonzero(checked.lost).tolist():
        found.append((at, EVENTS["gap"], f"{checked.lost[at]} samples lost"))
    for name, flag in (
        ("illegal", counters.FLAG_ILLEGAL),
        ("phase", counters.FLAG_PHASE),
        ("both-moved", counters.FLAG_BOTH),
        ("overrun", wire.OVERRUN),
        ("retimed", counters.FLAG_TIME),
    ):
        for first, end in runs(checked.flags & flag > 0):
            found.append((first, EVENTS[name], f"{end - first} samples"))
    frames = 0
    for connection in streams:
        noted = [(int(frame), "crc", "") for frame in connection.crc_frame]
        noted += [(frame, "notice", text) for frame, text in connection.notices]
        for frame, name, note in noted:
            at = int(np.searchsorted(samples.frame, frames + frame))
            found.append((min(at, len(samples) - 1), EVENTS[name], note))
        frames += len(connection.n)
    for stamp, text in markers:
        at = int(np.searchsorted(samples.stamp_ns, stamp))
        if stamp >= samples.stamp_ns[0] - 1e9 / rate_hz and at < len(samples):
            found.append((at, EVENTS["marker"], text))
    return sorted(found)
