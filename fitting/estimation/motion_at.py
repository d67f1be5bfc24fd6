"""The fitted motion at any times: for a curve over the data."""

from dataclasses import replace

import numpy as np

from fitting.driver.fit import Fit
from fitting.model.windows import ShootingWindows
from fitting.sensitivity.path import follow
from stickslip.compute.arrays import Array


def motion_at(fit: Fit, time: Array) -> tuple[Array, Array]:
    """Return position, m, and velocity, m/s, of one run's fit at times of its record, s, in the fit's frame.

    From a cycle's stick window to its slip window the stick is continued; outside the fitted cycles it is NaN.
    """
    windows, asked = fit.windows, np.asarray(time, np.float64)
    flat, count = asked.ravel(), windows.table[:, 3]
    begin, end = _spans(windows)
    order = np.argsort(begin)
    owner = order[np.maximum(np.searchsorted(begin[order], flat, side="right") - 1, 0)]
    inside = (begin[owner] <= flat) & (flat <= end[owner])
    # among the window's own samples: the steps between those are as short as the flow needs
    times = np.concatenate([windows.time, flat[inside]])
    owners = np.concatenate([np.repeat(np.arange(count.size), count), owner[inside]])
    order = np.lexsort((times, owners))
    table = windows.table.copy()
    table[:, 3] = np.bincount(owners, minlength=count.size)
    table[:, 2] = np.cumsum(table[:, 3]) - table[:, 3]
    nothing = np.zeros(times.size)
    with_asked = replace(
        windows, table=table, time=times[order], position=nothing, source=nothing.astype(np.int64), rows=(), parts=()
    )
    curve = fit.curve_on_path
    path = None if curve is None else follow(with_asked, curve, fit.u, fit.local)
    if path is None:
        raise RuntimeError("the motion of a fit can be followed")
    back = np.empty(times.size, np.int64)
    back[order] = path.reached
    found = np.full((2, flat.size), np.nan)
    found[:, inside] = np.array([path.position, path.velocity])[:, back[windows.time.size :]]
    return found[0].reshape(asked.shape), found[1].reshape(asked.shape)


def _spans(windows: ShootingWindows) -> tuple[Array, Array]:
    """Return start and end of each window, s: a stick's to the slip, others to a sample after their last."""
    table = windows.table
    begin, last = windows.time[table[:, 2]], windows.time[table[:, 2] + table[:, 3] - 1]
    end = last + float(np.median(np.diff(windows.time)))
    breaks = np.flatnonzero((table[1:, 0] == table[:-1, 0]) & (table[:-1, 1] == 1) & (table[1:, 1] == 0))
    end[breaks] = begin[breaks + 1]
    return begin, end
