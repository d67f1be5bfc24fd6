"""Cycles that fit badly because the mass got a velocity step there, as from the belt's joint.

A cycle with a far larger residual than its run's median is not evidence against a law where one velocity step explains
the excess.  In a slip the step changes the velocity at one time; in a stick, and after the landing, friction stops the
mass again within milliseconds, and a step of the position remains.
"""

import numpy as np

from fitting.adequacy.statistics import cycle_squares
from fitting.estimation.linearised import LinearisedFit
from fitting.model.windows import SPOILT
from fitting.sensitivity.path import Path
from fitting.sensitivity.tangents import tangents
from stickslip.compute.arrays import Array, Integers, Mask

TIMES_TRIED = 40  # steps tried, one a time, in a slip and in a stick; at 20 the best explains 0.8 of some steps
# Share of a cycle's mean square beyond the usual one that a step explains.  Steps of 5 to 20 mm/s explain 0.97 to 1.0
# of it in a slip; a landing after which the mass overtakes the belt unseen 0.77.
LEAST_EXPLAINED = 0.9
# Other cycles of a run that may fit badly by chance: a touch of a hand, an overtaking that was not seen.
MOST_ODD, MOST_ODD_SHARE = 1, 0.1


def left_out(path: Path | None, linear: LinearisedFit, landings: Array, spoilt: Mask, run: Integers) -> Mask:
    """Return which spoilt cycles (cycles,) to leave out: those struck, and others where they are few.

    Velocity steps are searched only where a ``path`` is given; ``run`` is each cycle's run, ``landings`` are in s.
    """
    if not spoilt.any():
        return spoilt
    struck = np.zeros_like(spoilt) if path is None else _struck(path, linear, landings, spoilt, run)
    odd = spoilt & ~struck
    for one in np.unique(run[odd]):
        own = odd & (run == one)
        if own.sum() > max(MOST_ODD, MOST_ODD_SHARE * np.sum(run == one)):
            odd &= ~own
    return np.asarray(struck | odd)


def _struck(path: Path, linear: LinearisedFit, landings: Array, spoilt: Mask, run: Integers) -> Mask:
    """Return the spoilt cycles whose excess residual one velocity step explains nearly in full."""
    columns = np.hstack([tangents(path, _impulses(path, landings, spoilt)), _position_steps(path, landings, spoilt)])
    square = cycle_squares(linear.residual[:, np.newaxis], linear.rows)[:, 0]
    found = np.zeros_like(spoilt)
    for k in np.flatnonzero(spoilt):
        rows = linear.rows[k]
        usual = float(np.median(square[run == run[k]]))
        left = square[k] - _best_gain(linear, int(k), columns[rows]) / (rows.stop - rows.start)
        found[k] = left < SPOILT * usual or left - usual < (1 - LEAST_EXPLAINED) * (square[k] - usual)
    return found


def _best_gain(linear: LinearisedFit, k: int, columns: Array) -> float:
    """Return by how much the best column (n, steps) lowers a cycle's sum of squares with its own unknowns free."""
    rows, q = linear.rows[k], linear.local.shape[1]
    prior = np.diag(np.sqrt(linear.local_precision[k] / max(linear.weights[k], 1e-300)))
    scale = np.sqrt(np.maximum(np.sum(linear.local[rows] ** 2, axis=0) + np.diag(prior) ** 2, 1e-300))
    own = np.linalg.qr(np.vstack([linear.local[rows], prior]) / scale)[0]
    both = np.vstack([np.column_stack([linear.residual[rows], columns]), np.zeros((q, 1 + columns.shape[1]))])
    both -= own @ (own.T @ both)
    square = np.sum(both[:, 1:] ** 2, axis=0)
    seen = square > 1e-9 * np.sum(columns**2, axis=0)
    return float(np.max((both[:, 1:].T @ both[:, 0]) ** 2 / np.where(seen, square, np.inf), initial=0.0))


def _impulses(path: Path, landings: Array, spoilt: Mask) -> Array:
    """Return accelerations (M, TIMES_TRIED) that change the velocity by about 1 m/s in one step of a spoilt slip."""
    found = np.zeros((path.time.size, TIMES_TRIED))
    table = path.windows.table
    for row in np.flatnonzero((table[:, 1] == 0) & spoilt[table[:, 0]]):
        first = path.steps[path.first_step[row] : path.first_step[row + 1], 0]
        length = path.time[first + 2] - path.time[first]
        slips = (path.time[first] < landings[table[row, 0]]) & (length > 0)
        first, length = first[slips], length[slips]
        if first.size:
            chosen = np.round(np.linspace(0, first.size - 1, TIMES_TRIED)).astype(np.int64)
            # a step's middle counts four times as much as its ends, which belong to its neighbours too
            found[first[chosen] + 1, np.arange(TIMES_TRIED)] = 1.5 / length[chosen]
    return found


def _position_steps(path: Path, landings: Array, spoilt: Mask) -> Array:
    """Return steps of the position (N, 2 TIMES_TRIED) in each spoilt cycle's stick and after its landing."""
    windows = path.windows
    found = np.zeros((windows.time.size, 2 * TIMES_TRIED))
    for k, stick, first, count, _, _ in windows.table[spoilt[windows.table[:, 0]]]:
        own = slice(first, first + count)
        begin = windows.time[first] if stick else landings[k]
        times = np.linspace(begin, windows.time[first + count - 1], TIMES_TRIED + 1)[:-1]
        place = slice(0, TIMES_TRIED) if stick else slice(TIMES_TRIED, 2 * TIMES_TRIED)
        found[own, place] = windows.time[own, np.newaxis] >= times
    return found
