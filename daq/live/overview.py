"""A long record in a bounded number of its own samples: the extremes of position and velocity in equal stretches."""

import numpy as np

from stickslip.compute.arrays import Array

ROWS = 1 << 14  # kept at most: eight for each pixel of a wide screen, 0.5 MB
PICKED = 4  # rows kept of a stretch: where position and velocity are least and largest


class Overview:
    """Rows of a record; when they are too many, half of them are kept, and of later ones as many in proportion.

    columns: Numbers in a row: time, position, velocity, and more.
    """

    def __init__(self, columns: int) -> None:
        self._rows = np.empty((columns, 0))
        self._waiting: list[Array] = []  # rows of a stretch that is not whole yet
        self._stretch = 1

    def take(self, rows: Array) -> None:
        """Add rows, (columns, n)."""
        self._waiting.append(rows)
        if self._stretch == 1:
            kept, self._waiting = np.concatenate(self._waiting, axis=1), []
        else:
            if sum(part.shape[1] for part in self._waiting) < self._stretch:
                return
            joined = np.concatenate(self._waiting, axis=1)
            whole = joined.shape[1] // self._stretch * self._stretch
            self._waiting = [joined[:, whole:]]
            kept = joined[:, extremes(joined[:, :whole], whole // self._stretch)]
        self._rows = np.concatenate((self._rows, kept), axis=1)
        while self._rows.shape[1] > ROWS:
            self._rows = self._rows[:, extremes(self._rows, self._rows.shape[1] // (2 * PICKED))]
            self._stretch = 2 * PICKED if self._stretch == 1 else 2 * self._stretch

    def rows(self) -> Array:
        """Return the rows kept, and those that wait, (columns, n)."""
        kept, waiting = self._rows, list(self._waiting)  # they may change meanwhile, in another thread
        return np.concatenate([kept, *waiting], axis=1)


def extremes(rows: Array, stretches: int) -> np.typing.NDArray[np.intp]:
    """Return which of rows (columns, n) have the extremes of columns 1 and 2 within each of equal stretches, in order.

    ``stretches`` of them have n // stretches rows; the rows left over at the end are all kept.
    """
    n = rows.shape[1]
    if stretches < 1 or n <= PICKED * stretches:
        return np.arange(n)
    length = n // stretches
    picked = [np.arange(stretches * length, n)]
    begins = np.arange(stretches) * length
    for column in rows[1:3]:
        grid = column[: stretches * length].reshape(stretches, length)
        picked.append(begins + np.where(np.isnan(grid), np.inf, grid).argmin(axis=1))
        picked.append(begins + np.where(np.isnan(grid), -np.inf, grid).argmax(axis=1))
    return np.unique(np.concatenate(picked))
