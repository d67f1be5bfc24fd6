"""Scan of a departure's scale (a frequency, a wavelength), on a thinned record.

Every gain here is that of one linear step (`fitting.departures.scores`).
"""

import numpy as np

from daq.base.compute.arrays import Array
from fitting.departures.base import Base
from fitting.departures.scores import LEAST_KEPT, RIDGE
from fitting.forces.departure import Departure

CHUNK = 16  # scales at a time: the curvatures between all columns are made, and only those of one scale are used
CLOSER = (-0.5, -0.25, 0.0, 0.25, 0.5)  # of the step between neighbours: where the best of a scan is looked at again


def best_scale(base: Base, departure: Departure) -> tuple[float, int]:
    """Return the scale that explains most, and how many were tried; NaN without one, or where there is none to try."""
    if departure.scales is None:
        return np.nan, 1
    scales = departure.scales(base.trajectory)
    if scales.size == 0:
        return np.nan, 0
    gain = gains(base, departure, scales)
    top = int(np.argmax(gain))
    if scales.size == 1:
        return float(scales[0]), 1
    gaps = np.abs(np.diff(np.log(scales)))
    gap = float(np.min(gaps[max(top - 1, 0) : top + 1]))
    nearer = scales[top] * np.exp(np.array(CLOSER) * gap)
    return float(nearer[np.argmax(gains(base, departure, nearer))]), scales.size


def gains(base: Base, departure: Departure, scales: Array) -> Array:
    """Return by how much the cost would fall with the departure at each of the scales (n,)."""
    return np.concatenate(
        [_gains(base, departure, scales[first : first + CHUNK]) for first in range(0, scales.size, CHUNK)]
    )


def _gains(base: Base, departure: Departure, scales: Array) -> Array:
    columns = base.respond([departure.forcing(base.trajectory, float(scale)) for scale in scales])
    found = base.linear.scores(columns)
    shape = (scales.size, departure.columns)
    every = np.arange(columns.shape[1]).reshape(shape)
    information = found.total_information[every[:, :, np.newaxis], every[:, np.newaxis]]
    size, raw, total = np.einsum("skk->sk", information), found.raw.reshape(shape), found.total.reshape(shape)
    # beside an unstable motion the response to a force grows beyond all numbers
    usable = np.isfinite(raw) & np.isfinite(size) & np.isfinite(total)
    kept = np.all(usable & (size > LEAST_KEPT * np.where(usable, raw, 0.0)), axis=1)
    unit = 1 / np.sqrt(size[kept])
    total = total[kept] * unit
    information = information[kept] * unit[:, :, np.newaxis] * unit[:, np.newaxis]
    information += RIDGE * np.eye(departure.columns)
    gain = np.zeros(scales.size)
    gain[kept] = 0.5 * np.sum(total * np.linalg.solve(information, total[:, :, np.newaxis])[:, :, 0], axis=1)
    return gain
