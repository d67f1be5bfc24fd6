"""A long record in a bounded number of its own samples: the extremes of position and velocity in equal stretches."""

import numpy as np

from stickslip.compute.arrays import Array

ROWS = 1 << 14  # kept at most: eight per pixel of a wide screen, 0.5 MB
PICKED = 4  # rows kept of a stretch: the extremes of position and velocity


class Overview:
    """Rows of a record; if they are too many, half of them are kept, and of later ones as many in proportion.

    columns: Numbers in a row: time, position, velocity, and more.
    """

    def __init__(self, columns: int) -> None:
        self._rows = np.empty((columns, 0))
        self._waiting: list[Array] = []  # rows of a stretch that is not complete yet
        self._stretch = 1

    def add(self, rows: Array) -> None:
        self._waiting.append(rows)
        if self._stretch == 1:
            kept, self._waiting = np.concatenate(self._waiting, axis=1), []
        else:
            if sum(part.shape[1] for part in self._waiting) < self._stretch:
                return
            joined = np.concatenate(self._waiting, axis=1)
            n_whole = joined.shape[1] // self._stretch * self._stretch
            self._waiting = [joined[:, n_whole:]]
            kept = joined[:, find_extremes(joined[:, :n_whole], n_whole // self._stretch)]
        self._rows = np.concatenate((self._rows, kept), axis=1)
        while self._rows.shape[1] > ROWS:
            self._rows = self._rows[:, find_extremes(self._rows, self._rows.shape[1] // (2 * PICKED))]
            self._stretch = 2 * PICKED if self._stretch == 1 else 2 * self._stretch

    def collect_rows(self) -> Array:
        """Return the rows kept, and those that wait, (columns, n)."""
        kept, waiting = self._rows, list(self._waiting)  # they may change meanwhile, in another thread
        return np.concatenate([kept, *waiting], axis=1)


def find_extremes(rows: Array, stretches: int) -> np.typing.NDArray[np.intp]:
    """Return which of rows (columns, n) have the extremes of columns 1 and 2 within each of equal stretches, in order.

    ``stretches`` of them have n // stretches rows; the remaining rows at the end are all kept.
    """
    n = rows.shape[1]
    if stretches < 1 or n <= PICKED * stretches:
        return np.arange(n)
    length = n // stretches
    picked = [np.arange(stretches * length, n)]
    starts = np.arange(stretches) * length
    for column in rows[1:3]:
        grid = column[: stretches * length].reshape(stretches, length)
        picked.append(starts + np.where(np.isnan(grid), np.inf, grid).argmin(axis=1))
        picked.append(starts + np.where(np.isnan(grid), -np.inf, grid).argmax(axis=1))
    return np.unique(np.concatenate(picked))
