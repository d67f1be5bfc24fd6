"""Motion at samples that were left out, from the smoothed motion on either side.

Between two smoothed samples the motion is one of white jerk (`processing.kalman.white_jerk`): what is carried forward
from the one before and back from the one behind is weighted by its covariance.  Beyond the first and the last sample
there is one side only.  The variances grow into the hole with the jerk, and are nowhere below those at its edges.

Not modelled: the covariances between x, v and a at the edges, and corners inside the hole.
"""

from dataclasses import replace

import numpy as np

from daq.base.compute.arrays import Array, Mask
from processing.record.motion import Motion

UNKNOWN = 1e6  # standard deviations, in units of the smallest known one, of a derivative that is not known


def across_faults(time: Array, kept: Mask, motion: Motion, jerk: float) -> Motion:
    """Return the motion of all n samples.

    Parameters
    ----------
    time : array of shape (n,)
        s.
    kept : array of bool, shape (n,)
        True for the samples that ``motion`` has, at least one.
    motion : Motion
        Of the k samples kept.
    jerk : float
        Density of the white jerk, m^2/s^5.
    """
    own, gone = np.flatnonzero(kept), np.flatnonzero(~kept)
    behind = np.searchsorted(own, gone)
    left, right = np.maximum(behind - 1, 0), np.minimum(behind, own.size - 1)
    values = np.array([motion.position, motion.velocity, motion.acceleration])
    errors = np.array([motion.position_errors, motion.velocity_errors, motion.acceleration_errors])
    finite = np.isfinite(errors)
    errors = np.where(finite, errors, UNKNOWN * np.max(errors, axis=1, where=finite, initial=1e-9)[:, None])
    precision, weighted = np.zeros((gone.size, 3, 3)), np.zeros((gone.size, 3))
    for edge, there in ((left, behind > 0), (right, behind < own.size)):
        step = np.eye(3) + np.zeros((gone.size, 3, 3))
        h = time[gone] - time[own[edge]]
        step[:, 0, 1] = step[:, 1, 2] = h
        step[:, 0, 2] = h**2 / 2
        size = np.abs(h)
        noise = np.empty((gone.size, 3, 3))
        for i in range(3):
            for j in range(3):
                power = 5 - i - j
                factor = 1.0 / ((1, 1, 2)[2 - i] * (1, 1, 2)[2 - j] * power)
                noise[:, i, j] = jerk * factor * size**power * np.sign(h) ** (i + j)
        spread = (step * (errors[:, edge].T ** 2)[:, None, :]) @ step.transpose(0, 2, 1) + noise
        inverse = _inverse(spread) * there[:, None, None]
        precision += inverse
        weighted += np.einsum("kij,kjl,lk->ki", inverse, step, values[:, edge] - _origin(values, left))
    covariance = _inverse(precision)
    filled = np.einsum("kij,kj->ki", covariance, weighted).T + _origin(values, left)
    edges = np.maximum(errors[:, left], errors[:, right])
    spread = np.maximum(np.sqrt(np.maximum(np.einsum("kii->ik", covariance), 0.0)), edges)
    rows, sds = np.empty((3, kept.size)), np.empty((3, kept.size))
    rows[:, own], sds[:, own] = values, np.where(finite, errors, np.inf)
    rows[:, gone], sds[:, gone] = filled, spread
    return replace(
        motion,
        position=rows[0],
        velocity=rows[1],
        acceleration=rows[2],
        position_errors=sds[0],
        velocity_errors=sds[1],
        acceleration_errors=sds[2],
    )


def _origin(values: Array, left: Array) -> Array:
    """Return the position left of each hole, (3, k), from which positions are counted: no digit is lost."""
    found = np.zeros((3, left.size))
    found[0] = values[0, left]
    return found


def _inverse(matrices: Array) -> Array:
    """Return the inverses of symmetric matrices (k, 3, 3), scaled to a diagonal of ones."""
    scale = 1 / np.sqrt(np.einsum("kii->ki", matrices))
    both = scale[:, :, None] * scale[:, None, :]
    return np.asarray(np.linalg.inv(matrices * both) * both)
