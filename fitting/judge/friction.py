"""The law against the measurement as the eye compares them: friction by relative velocity, and the phase plane.

A measured point is the force balance F = m a + c v + k (x - b) at a smoothed sample, divided by its cycle's level so
that all cycles are on one curve.  Units are newtons where mass or stiffness is known, else newtons per kilogram.

Laws whose errors differ tenfold have nearly the same distance from the measured orbit, so it is reported but is not
part of the evidence.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitting.model.unknowns import PerCycle
from fitting.record.motion import MeasuredMotion
from fitting.search.fit import Fit
from stickslip.compute.arrays import Array


def mass(motion: MeasuredMotion, fit: Fit) -> float:
    """Return the mass that converts accelerations to newtons, kg; 1 where neither mass nor stiffness is known."""
    if motion.mass is not None:
        return motion.mass.value
    return motion.stiffness.value / fit.values.K if motion.stiffness is not None else 1.0


def unit(motion: MeasuredMotion) -> str:
    return "N" if motion.mass is not None or motion.stiffness is not None else "N/kg"


def speeds(motion: MeasuredMotion) -> Array:
    """Return relative velocities (m/s, in the record's sign) over the range of the motion, including 0."""
    w = motion.velocity - motion.belt_speed
    low, high = float(w.min()), max(float(w.max()), 0.1 * motion.belt_speed)
    half = np.linspace(0, 1, 201) ** 2  # densest around 0, where the laws differ
    return np.sort(motion.sign * np.r_[low * half[1:], high * half])


def speeds_of_all(motions: Sequence[MeasuredMotion]) -> Array:
    widest: dict[float, Array] = {}
    for motion in motions:
        spanned = speeds(motion)
        if motion.sign not in widest or np.ptp(spanned) > np.ptp(widest[motion.sign]):
            widest[motion.sign] = spanned
    return np.unique(np.concatenate(list(widest.values())))


def friction_at(fit: Fit, motion: MeasuredMotion, w: Array) -> Array:
    """In `unit`, at relative velocities w (n,), m/s in the record's sign."""
    return fit.force(w, mass(motion, fit))


def points(fit: Fit, motion: MeasuredMotion) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Return relative velocity (m/s), friction (in `unit`) and whether it is a stick, of slip and stick samples.

    Samples within half a smoothing window of a landing are omitted, since smoothing rounds the corner there.
    """
    p = fit.values
    w_parts, f_parts, stick_parts = [], [], []
    for k, cycle in enumerate(fit.cycles):
        level = math.exp(float(fit.local[k, PerCycle.LEVEL]))
        end_of_slip = int(np.searchsorted(motion.time, cycle.landing - motion.half_window))
        for first, end, stick in ((*cycle.stick, True), (cycle.slip[0], end_of_slip, False)):
            x, v, a = (values[first:end] for values in (motion.position, motion.velocity, motion.acceleration))
            friction = (a + p.damping * v + p.K * (x - p.datum)) / level
            w_parts.append(v - p.v_dr + p.compliance / p.K * friction)  # the belt slows under the friction it carries
            f_parts.append(mass(motion, fit) * friction)
            stick_parts.append(np.full(x.size, stick))
    return motion.sign * np.concatenate(w_parts), motion.sign * np.concatenate(f_parts), np.concatenate(stick_parts)


MOST_POINTS = 4000  # points of each curve


@dataclass(frozen=True, eq=False)
class MeasuredOrbit:
    size: Array  # (2,) between smallest and largest position (m) and velocity (m/s)
    tree: Any  # `scipy.spatial.cKDTree` of positions and velocities over their sizes

    @classmethod
    def of(cls, motion: MeasuredMotion) -> "MeasuredOrbit":
        from scipy.spatial import cKDTree

        points = np.c_[motion.position, motion.velocity]
        size = np.ptp(points, axis=0)
        return cls(size, cKDTree(points / size))

    def distance(self, fit: Fit) -> float:
        """Return the rms distance in the phase plane, over the orbit's size: differences in time do not count."""
        points = orbit(fit) / self.size
        distances, _ = self.tree.query(points[:: max(1, len(points) // MOST_POINTS)])
        return float(np.sqrt(np.mean(distances**2)))


def orbit(fit: Fit) -> Array:
    """Return position and velocity of a law in all windows, shape (samples, 2)."""
    x = fit.windows.position + fit.residual
    parts = []
    for _, _, first, count, *_ in fit.windows.table:
        if count >= 3:
            rows = slice(first, first + count)
            parts.append(np.stack([x[rows], np.gradient(x[rows], fit.windows.time[rows])], axis=1))
    return np.concatenate(parts)
