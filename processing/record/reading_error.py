"""The standard error of one reading, estimated from the record itself."""

import math

import numpy as np

from processing.polynomial.even_grid import even_grid
from processing.record.series import Series


def reading_error(series: Series) -> float:
    """Return the standard error of one reading, m.

    From the median of the absolute third differences: motion nearly cancels in them, while independent reading errors
    have 20 times their variance (1 + 9 + 9 + 1); the median ignores corners.  At least pitch/sqrt(12) of an encoder.
    """
    third = [
        np.diff(even_grid(series.time[piece], series.position[piece]), 3)
        for piece in series.pieces
        if piece.stop - piece.start > 3
    ]
    median = float(np.median(np.abs(np.concatenate(third)))) if third else 0.0
    return max(series.pitch / math.sqrt(12), median / 0.6745 / math.sqrt(20))
