"""Cycles that fit badly because the mass got a velocity step there, as from the belt's joint.

A cycle with a far larger residual than its run's median is not evidence against a law where one velocity step explains
the excess.  In a slip the step changes the velocity at one time; in a stick, and after the landing, friction stops the
mass again within milliseconds, and a step of the position remains.
"""

from collections.abc import Callable

import numpy as np

from fitting.adequacy.statistics import cycle_squares
from fitting.estimation.linearised import LinearisedFit
from fitting.least_squares.problem import Block
from fitting.model.windows import SPOILT
from fitting.sensitivity.columns import local_tangents
from fitting.sensitivity.path import Path
from fitting.sensitivity.tangents import tangents
from stickslip.compute.arrays import Array, Integers, Mask

TIMES_TRIED = 40  # steps tried, one a time, in a slip and in a stick; at 20 the best explains 0.8 of some steps
# Share of a cycle's mean square beyond the usual one that a step explains.  Steps of 5 to 20 mm/s explain 0.97 to 1.0
# of it in a slip; a landing after which the mass overtakes the belt unseen 0.77.
LEAST_EXPLAINED = 0.9
# Other cycles of a run that may fit badly by chance: a touch of a hand, an overtaking that was not seen.
MOST_ODD, MOST_ODD_SHARE = 1, 0.1


def left_out(
    path_in: Callable[[Block], Path | None], linear: LinearisedFit, landings: Array, spoilt: Mask, run: Integers
) -> Mask:
    """Return which spoilt cycles (cycles,) to leave out: those struck, and others where they are few.

    ``path_in`` returns the path of a cycle, ``run`` is each cycle's run, ``landings`` are in s.
    """
    if not spoilt.any():
        return spoilt
    struck = _struck(path_in, linear, landings, spoilt, run)
    odd = spoilt & ~struck
    for one in np.unique(run[odd]):
        own = odd & (run == one)
        if own.sum() > max(MOST_ODD, MOST_ODD_SHARE * np.sum(run == one)):
            odd &= ~own
    return np.asarray(struck | odd)


def _struck(
    path_in: Callable[[Block], Path | None], linear: LinearisedFit, landings: Array, spoilt: Mask, run: Integers
) -> Mask:
    """Return the spoilt cycles whose excess residual one velocity step explains nearly in full."""
    square = cycle_squares(linear.residual[:, np.newaxis], linear.rows)[:, 0]
    found = np.zeros_like(spoilt)
    for k in np.flatnonzero(spoilt).tolist():
        rows = linear.rows[k]
        path = path_in(Block(slice(k, k + 1), rows))
        if path is None:
            continue
        at = k if len(path.windows.rows) == spoilt.size else 0
        usual = float(np.median(square[run == run[k]]))
        left = square[k] - _best_gain(linear, k, path, at, float(landings[k])) / (rows.stop - rows.start)
        found[k] = left < SPOILT * usual or left - usual < (1 - LEAST_EXPLAINED) * (square[k] - usual)
    return found


def _best_gain(linear: LinearisedFit, k: int, path: Path, at: int, landing: float) -> float:
    """Return by how much the best step lowers a cycle's sum of squares with its own unknowns free."""
    rows = path.windows.rows[at]
    columns = np.hstack([tangents(path, _impulses(path, landing, at)), _position_steps(path, landing, at)])[rows]
    local, residual, q = (
        local_tangents(path)[rows],
        linear.residual[linear.rows[k]],
        linear.priors.local_gradient.shape[1],
    )
    prior = np.diag(np.sqrt(linear.priors.local_precision[k] / max(linear.weights[k], 1e-300)))
    scale = np.sqrt(np.maximum(np.sum(local**2, axis=0) + np.diag(prior) ** 2, 1e-300))
    own = np.linalg.qr(np.vstack([local, prior]) / scale)[0]
    both = np.vstack([np.column_stack([residual, columns]), np.zeros((q, 1 + columns.shape[1]))])
    both -= own @ (own.T @ both)
    square = np.sum(both[:, 1:] ** 2, axis=0)
    seen = square > 1e-9 * np.sum(columns**2, axis=0)
    return float(np.max((both[:, 1:].T @ both[:, 0]) ** 2 / np.where(seen, square, np.inf), initial=0.0))


def _impulses(path: Path, landing: float, cycle: int) -> Array:
    """Return accelerations (M, TIMES_TRIED) that change the velocity by about 1 m/s in one step of a cycle's slip."""
    found = np.zeros((path.time.size, TIMES_TRIED))
    table = path.windows.table
    for row in np.flatnonzero((table[:, 1] == 0) & (table[:, 0] == cycle)):
        first = path.steps[path.first_step[row] : path.first_step[row + 1], 0]
        length = path.time[first + 2] - path.time[first]
        slips = (path.time[first] < landing) & (length > 0)
        first, length = first[slips], length[slips]
        if first.size:
            chosen = np.round(np.linspace(0, first.size - 1, TIMES_TRIED)).astype(np.int64)
            # a step's middle counts four times as much as its ends, which belong to its neighbours too
            found[first[chosen] + 1, np.arange(TIMES_TRIED)] = 1.5 / length[chosen]
    return found


def _position_steps(path: Path, landing: float, cycle: int) -> Array:
    """Return steps of the position (N, 2 TIMES_TRIED) in a cycle's stick and after its landing."""
    windows = path.windows
    found = np.zeros((windows.time.size, 2 * TIMES_TRIED))
    for _, stick, first, count, _, _ in windows.table[windows.table[:, 0] == cycle]:
        own = slice(first, first + count)
        begin = windows.time[first] if stick else landing
        times = np.linspace(begin, windows.time[first + count - 1], TIMES_TRIED + 1)[:-1]
        place = slice(0, TIMES_TRIED) if stick else slice(TIMES_TRIED, 2 * TIMES_TRIED)
        found[own, place] = windows.time[own, np.newaxis] >= times
    return found
