"""Lost counts: samples at which ten or more counts went missing at once.  Marked and counted, never repaired here.

The increment of every sample is set against the median of the eleven around it; a count lost when the mass bounces
or the coupling slips stands out of it, and stays lost from there on.
"""

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from processing.series import Series

Array = NDArray[np.float64]

LEAST = 10.0  # counts
ROUNDING = 1.5  # counts that whole numbers and the median may take off a loss
POINTS = 11
AROUND = 41  # samples that tell how far increments scatter by themselves
SCATTER = 12.0  # times their median deviation, 8 standard deviations


def lost_counts(series: Series) -> tuple[int, ...]:
    """Return the samples at which the position jumped by ten or more counts against its neighbours.

    Parameters
    ----------
    series : Series
        The record; one without counts has none to lose.

    Notes
    -----
    The speed is compared, not the bare increment, and a loss must stand out of the scatter around it, so that jitter
    of the sample times, recorded or not, is not taken for one.  Losses spread over several samples, and smaller ones,
    are not seen.
    """
    if not series.pitch:
        return ()
    found: list[int] = []
    for piece in series.pieces:
        time, count = series.time[piece], series.position[piece] / series.pitch
        if time.size <= AROUND:
            continue
        step = np.diff(time)
        speed = np.diff(count) / step
        padded = np.pad(speed, POINTS // 2, mode="reflect")
        usual = np.median(sliding_window_view(padded, POINTS), axis=1)
        excess = np.abs(speed - usual) * step
        for i in np.flatnonzero(excess >= LEAST - ROUNDING).tolist():
            low = min(max(i - AROUND // 2, 0), excess.size - AROUND)
            if excess[i] >= SCATTER * np.median(excess[low : low + AROUND]):
                found.append(piece.start + i + 1)
    return tuple(found)
