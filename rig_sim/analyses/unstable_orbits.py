"""Periodic orbits of a map, unstable ones too: found by close returns of a motion, made exact by Newton's method.

A motion that comes back close to an earlier state after p applications has passed an orbit of period p (thesis 6.16).
From such a piece of the motion Newton's method solves for all p points at once, so that an error grows by one
application only, and periods of 20 and more are found.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rig_sim.systems.interface import Controlled, derivatives, difference, slope_at
from stickslip.compute.arrays import Array
from stickslip.compute.stages import Stages, parts, silent

# Closest returns from which Newton's method starts; the least unstable orbit of the thesis's motions is among them.
CANDIDATES = 100
ITERATIONS = 20
LONGEST_STEP = 0.3  # of the scales; a longer step of Newton's method means that there is no orbit here
CLOSED = 1e-10  # of the scales: how well the points of an orbit follow each other
TURNS = 3  # of an orbit, after which directions at right angles grow by its multipliers
LOST = 1e-12  # of the largest multiplier, below which one is rounding in the product of the slopes
SAME = 1e-6  # of the scales: orbits closer than this are one; points of one orbit closer than this are one


@dataclass(frozen=True)
class UnstableOrbit:
    """A periodic orbit of a map, stable or not."""

    points: Array  # (p, d) states in the order of the orbit, from the smallest last coordinate
    multipliers: NDArray[np.complex128]  # (d,) by which small deviations grow from turn to turn, largest first
    slopes: Array  # (p, d, d) derivative of the map by the state at every point, in units of the scales
    # (p, d) derivative by the parameter at every point, in units of the scales and of the parameter's strength
    responses: Array

    @property
    def period(self) -> int:
        return len(self.points)

    @property
    def unstable_directions(self) -> int:
        """Number of multipliers above 1 in size."""
        return int(np.sum(np.abs(self.multipliers) > 1.0))


def find_close_returns(f: Controlled, states: Array, period: int) -> NDArray[np.intp]:
    """Return the starts of pieces of ``period`` states in a motion, (n, d), that nearly close, the closest first.

    Pieces that nearly close after a divisor of the period already, three times as close, are left out.
    """
    number = len(states) - period
    if number < 1:
        return np.zeros(0, dtype=np.intp)

    def distance(lag: int) -> Array:
        return np.linalg.norm(difference(f, states[lag : lag + number], states[:number]), axis=1)  # type: ignore[no-any-return]

    closing = distance(period)
    order = np.argsort(closing, kind="stable")
    for divisor in range(1, period // 2 + 1):
        if period % divisor == 0:
            shorter = distance(divisor) < 3.0 * closing
            order = order[~shorter[order]]
    return order


def find_orbits_in_motion(f: Controlled, states: Array, period: int, progress: Stages = silent) -> list[UnstableOrbit]:
    """Return the orbits of exactly this period near which a motion, (n, d), passed: the least unstable first."""
    orbits: list[UnstableOrbit] = []
    candidates = find_close_returns(f, states, period)[:CANDIDATES]
    for number, _ in parts("searching orbits", len(candidates), progress, 1):
        begin = candidates[number]
        piece = states[begin : begin + period]
        gap = float(np.linalg.norm(difference(f, states[begin + period], piece[0])))
        if any(separation(f, piece[0], other) < gap for other in orbits):  # passed the same orbit
            continue
        orbit = refine_orbit(f, piece)
        if orbit is None or any(separation(f, orbit.points[0], other) < SAME for other in orbits):
            continue
        orbits.append(orbit)
    return sorted(orbits, key=lambda orbit: float(np.abs(orbit.multipliers[0])))


def separation(f: Controlled, state: Array, orbit: UnstableOrbit) -> float:
    """Return the distance of a state from the nearest point of an orbit, in units of the scales."""
    return float(np.min(np.linalg.norm(difference(f, state, orbit.points), axis=1)))


def refine_orbit(f: Controlled, points: Array) -> UnstableOrbit | None:
    """Return the orbit of exactly this period next to ``points``, (p, d); None where there is none."""
    period, d = points.shape
    points = points.copy()
    for _ in range(ITERATIONS):
        pieces = [slope_at(f, point) for point in points]
        gaps = np.array([difference(f, image, points[(i + 1) % period]) for i, (image, _) in enumerate(pieces)])
        system = np.zeros((period, d, period, d))
        for i, (_, slope) in enumerate(pieces):
            system[i, :, i, :] += slope
            system[i, :, (i + 1) % period, :] -= np.eye(d)
        matrix = system.reshape(period * d, period * d)
        if not (np.all(np.isfinite(matrix)) and np.all(np.isfinite(gaps))):
            return None
        try:
            step = np.linalg.solve(matrix, -gaps.ravel()).reshape(period, d)
        except np.linalg.LinAlgError:
            return None
        if not np.max(np.abs(step)) < LONGEST_STEP:
            return None
        points += step * f.scale
        if np.max(np.abs(step)) < 0.01 * CLOSED:
            break
    cyclic = np.isfinite(f.turn)
    points[:, cyclic] %= f.turn[cyclic]
    gaps = np.array([difference(f, f.after(point), points[(i + 1) % period]) for i, point in enumerate(points)])
    if not np.max(np.abs(gaps)) < CLOSED:
        return None
    if any(np.linalg.norm(difference(f, points[i], points[0])) < SAME for i in range(1, period)):
        return None  # an orbit of a shorter period
    points = np.roll(points, -int(np.argmin(points[:, -1])), axis=0)
    pairs = [derivatives(f, point) for point in points]
    slopes = np.array([slope for slope, _ in pairs])
    return UnstableOrbit(points, orbit_multipliers(slopes), slopes, np.array([response for _, response in pairs]))


def orbit_multipliers(slopes: Array) -> NDArray[np.complex128]:
    """Return the eigenvalues of the product of slopes, (p, d, d), the last one to the left: (d,), largest first.

    The product of a long unstable orbit has no correct digit of the small ones: these are the growth of directions kept
    at right angles, whose sign is unknown.
    """
    d = slopes.shape[1]
    turn, directions, growth = np.eye(d), np.eye(d), np.zeros(d)
    with np.errstate(divide="ignore"):
        for _ in range(TURNS):
            growth[:] = 0.0
            for slope in slopes:
                directions, triangle = np.linalg.qr(slope @ directions)
                growth += np.log(np.abs(np.diag(triangle)))
    for slope in slopes:
        turn = slope @ turn
    values = np.linalg.eigvals(turn).astype(np.complex128)
    values = values[np.argsort(-np.abs(values), kind="stable")]
    inaccurate = np.abs(values) < LOST * np.abs(values[0])
    values[inaccurate] = np.exp(np.sort(growth)[::-1])[inaccurate]
    return values
