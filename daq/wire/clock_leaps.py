"""A board's clock that leaps within a frame: the frame is cut there, so that each one's samples keep one pace.

Whether a clock has leapt is judged between frames, by `daq.wire.counters.FrameOrder`.
"""

from dataclasses import replace

import numpy as np

from daq.wire import counters
from daq.wire.decode import Stream


def cut(stream: Stream, rate_hz: float) -> Stream:
    """Return a stream whose frames are cut before samples that do not follow the one before after a period.

    ``rate_hz`` is the nominal rate, Hz.
    """
    samples = len(stream.dt)
    period = np.concatenate(
        [np.empty(0)]
        + [
            np.full(int(stream.n[first:end].sum()), 1e9 / (rate_hz * (1000 if ident is None else ident.tick_ns)))
            for first, end, ident in stream.sent_as()
        ]
    )
    leaps = np.asarray(~counters.fits(1, stream.dt / period))
    leaps[stream.first] = False
    if not leaps.any():
        return stream
    first = np.flatnonzero(leaps | np.isin(np.arange(samples), stream.first))
    frame = np.searchsorted(stream.first, first, side="right") - 1  # that each of the new ones is a part of
    within = first - stream.first[frame]
    elapsed = np.cumsum(stream.dt, dtype=np.int64)
    dt = stream.dt.copy()
    dt[first] = 0
    last = np.diff(frame, append=len(stream.n)) > 0  # of its frame: the one that ends with its bytes
    place = np.concatenate((np.flatnonzero(within == 0), [len(first)]))  # of the old frames among the new ones
    return replace(
        stream,
        first=first,
        n=np.diff(first, append=samples),
        seq=stream.seq[frame] + within & 0xFFFF,
        ticks=stream.ticks[frame] + elapsed[first] - elapsed[stream.first[frame]] & 0xFFFFFFFF,
        illegal=stream.illegal[frame],
        stamp_ns=stream.stamp_ns[frame],
        length=np.where(last, stream.length[frame], 0),
        time_error=None if stream.time_error is None else stream.time_error[frame],
        dt=dt,
        idents=place[stream.idents],
        crc_frame=place[stream.crc_frame],
        truth_frame=place[stream.truth_frame],
        part_frame=place[stream.part_frame],
        configs=tuple((int(place[at]), text) for at, text in stream.configs),
        notices=tuple((int(place[at]), text) for at, text in stream.notices),
    )
