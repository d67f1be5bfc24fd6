"""Where in the amplification-phase plane a shaker makes the small oscillation decay, without and with a filter band.

In a filter's band the frequency omega lies from its low to its high end (rad/s); outside the shaker receives nothing.
Without a band the oscillation decays exactly where S + a cos(phi) < 0.  Every other boundary is a curve of constant
frequency, and crosses a given amplification or phase at the roots of a polynomial in the growth rate: none is missed.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rig_sim.analyses.control.phasor import phasor, shaker_for
from stickslip.compute.arrays import Array

Band = tuple[float, float]  # lowest and highest frequency that the filter passes, rad/s
TURN = 2.0 * math.pi
CURVE = 4001  # points of a curve, those above a_max included
REAL = 1e-6  # imaginary part of a root, relative to the root, below which it counts as real; a false one is harmless


@dataclass(frozen=True)
class ShakerCurve:
    """Points of constant growth rate or frequency: phi (rad), a (N s/m), shape (n,) each; NaN where a is too large."""

    phi: Array
    a: Array

    def with_gaps(self) -> tuple[Array, Array]:
        """Return phi and a with a gap where the phase passes 0, so that no line is drawn back."""
        jumps = np.flatnonzero(np.abs(np.diff(self.phi)) > math.pi) + 1
        return np.insert(self.phi, jumps, np.nan), np.insert(self.a, jumps, np.nan)


@dataclass(frozen=True)
class ShakerPlane:
    """The amplification-phase plane of one mass: m (kg), k (N/m), S = gamma_lin - c (N s/m), a filter's band."""

    m: float
    k: float
    S: float
    band: Band | None = None

    def is_stable(self, a: float, phi: float) -> bool:
        """Return whether the small oscillation decays and, with a band, has a frequency within it."""
        Omega = phasor(self.m, self.k, self.S, a, phi)
        return Omega.imag < 0.0 and self.passes(Omega.real)

    def passes(self, omega: float) -> bool:
        """Return whether the filter passes a frequency (rad/s); without a band it passes all."""
        return self.band is None or self.band[0] <= omega <= self.band[1]

    def stable_phases(self, a: float) -> list[tuple[float, float]]:
        """Return the intervals of phi (rad, within 0 to 2 pi) in which a shaker of amplification a is stable."""
        edges = [0.0, math.pi, TURN]  # at pi omega may jump to 0
        if a > 0.0 and abs(self.S) <= a:
            half = math.acos(self.S / a)
            edges += [math.pi - half, math.pi + half]
        for omega in self.band or ():
            size, R, I = self._feedback(omega)  # noqa: E741
            # abs(E)^2 = a^2, cleared of fractions
            square = np.polysub(np.polyadd(np.polymul(R, R), np.polymul(I, I)), a * a * np.polymul(size, size))
            edges += [shaker_for(self.m, self.k, self.S, omega, delta)[1] for delta in real_roots(square)]
        return find_intervals(edges, lambda phi: self.is_stable(a, phi))

    def stable_amplifications(self, phi: float) -> list[tuple[float, float]]:
        """Return the intervals of a (N s/m) in which a shaker of phase phi is stable; the last may end at infinity."""
        edges = [0.0]
        if math.cos(phi) != 0.0 and -self.S / math.cos(phi) > 0.0:
            edges.append(-self.S / math.cos(phi))
        for omega in self.band or ():
            _, R, I = self._feedback(omega)  # noqa: E741
            for delta in real_roots(np.polyadd(math.cos(phi) * I, math.sin(phi) * R)):  # E e^{i phi} is real
                a, phase = shaker_for(self.m, self.k, self.S, omega, delta)
                if math.cos(phase - phi) > 0.0:  # not the opposite phase
                    edges.append(a)
        edges = [*edges, 2.0 * max(edges) + 2.0 * math.sqrt(self.m * self.k)]
        intervals = find_intervals(edges, lambda level: self.is_stable(level, phi))
        return [(low, math.inf if high == max(edges) else high) for low, high in intervals]

    def growth_curve(self, delta: float, a_max: float) -> ShakerCurve:
        """Return the curve of constant growth rate delta (1/s) up to the amplification a_max (N s/m)."""
        omegas = self._scale() * np.logspace(-4.0, 4.0, CURVE)
        return self._curve([(float(omega), delta) for omega in omegas], a_max)

    def frequency_curve(self, omega: float, a_max: float) -> ShakerCurve:
        """Return the curve of constant frequency omega (rad/s) up to the amplification a_max (N s/m)."""
        deltas = self._scale() * np.sinh(np.linspace(-9.0, 9.0, CURVE))
        return self._curve([(omega, float(delta)) for delta in deltas], a_max)

    def _scale(self) -> float:
        return math.sqrt(self.k / self.m)

    def _feedback(self, omega: float) -> tuple[Array, Array, Array]:
        """Return abs(Omega)^2 and, times this, R and I of E = R + i I, as polynomials in the growth rate."""
        size = np.array([1.0, 0.0, omega * omega])
        R = np.array([self.m, -self.S, self.k + self.m * omega * omega, -self.S * omega * omega])
        return size, R, omega * np.polysub(np.array([self.k]), self.m * size)

    def _curve(self, oscillations: list[tuple[float, float]], a_max: float) -> ShakerCurve:
        a, phi = np.array([shaker_for(self.m, self.k, self.S, omega, delta) for omega, delta in oscillations]).T
        return ShakerCurve(np.where(a <= a_max, phi, np.nan), np.where(a <= a_max, a, np.nan))


def real_roots(polynomial: NDArray[np.floating[Any]]) -> list[float]:
    """Return the real roots of a polynomial, highest power first; a complex pair close to the axis may count as one."""
    return [float(root.real) for root in np.roots(polynomial) if abs(root.imag) <= REAL * abs(root)]


def find_intervals(edges: list[float], holds: Callable[[float], bool]) -> list[tuple[float, float]]:
    """Return the intervals between edges in whose middle ``holds`` is true, neighbours joined."""
    points = sorted(set(edges))
    merged: list[tuple[float, float]] = []
    for low, high in pairwise(points):
        if holds(0.5 * (low + high)):
            if merged and merged[-1][1] == low:
                merged[-1] = (merged[-1][0], high)
            else:
                merged.append((low, high))
    return merged
