"""The oscillation of a mass under a shaker: frequency and growth rate from amplification and phase, and back.

The thesis (6.10 to 6.15, after Heckl) feeds the velocity back as a phasor.  With S = gamma_lin - c, the slope of the
friction less the damping, and E = a e^{-i phi}, a small oscillation e^{-i Omega t} about the fixed point has

    m Omega^2 - i (S + E) Omega - k = 0,   Omega = sqrt(k/m - (S + E)^2/4m^2) + i (S + E)/2m = omega + i delta

so omega > 0 is its frequency (rad/s) and delta its growth rate (1/s; > 0: it grows).  The force leads the velocity by
phi (rad); phi = pi is a damper of a (N s/m).  The other way round, S + E = i (k/Omega - m Omega), that is E = R + i I
with

    R = c - gamma_lin + delta (m + k/abs(Omega)^2),   I = omega (k/abs(Omega)^2 - m)

Where in the amplification-phase plane a shaker makes the small oscillation decay, without and with a filter band.

In a filter's band the frequency omega lies from its low to its high end (rad/s); outside the shaker receives nothing.
Without a band the oscillation decays exactly where S + a cos(phi) < 0.  Every other boundary is a curve of constant
frequency, and crosses a given amplification or phase at the roots of a polynomial in the growth rate: none is missed.
"""

import cmath
import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stickslip.compute.arrays import Array


def phasor(m: float, k: float, S: float, a: float, phi: float) -> complex:
    """Return Omega = omega + i delta (1/s) of the small oscillation e^{-i Omega t} under the shaker.

    m in kg, k in N/m, S = gamma_lin - c in N s/m (slope of the friction less the damping), amplification a in N s/m,
    phase lead phi in rad.
    """
    return phasor_roots(m, k, S, a, phi)[0]


def phasor_roots(m: float, k: float, S: float, a: float, phi: float) -> tuple[complex, complex]:
    """Return both roots of m Omega^2 - i (S + E) Omega - k, that of `phasor` first.

    The second one, at a negative frequency, belongs to a motion only where phi is a multiple of pi: the phase of a
    real oscillation is shifted by phi at a positive frequency.
    """
    P = (S + a * cmath.exp(-1j * phi)) / (2.0 * m)
    rate = math.sqrt(k / m)
    root = cmath.sqrt((rate - P) * (rate + P))
    if root.real < 0.0:
        root = -root
    first, second = 1j * P + root, 1j * P - root
    # their product is -k/m: the smaller one, a difference of nearly equal numbers, from the larger one
    if abs(first) < abs(second):
        return -k / m / second, second
    return first, -k / m / first


def shaker_for(m: float, k: float, S: float, omega: float, delta: float) -> tuple[float, float]:
    """Return (a, phi) that give a small oscillation the frequency omega (rad/s) and the growth rate delta (1/s).

    The inverse of `phasor`; phi lies from 0 to 2 pi.
    """
    if not omega > 0.0:
        raise ValueError(f"omega is {omega}; need a frequency above 0")
    size = omega * omega + delta * delta
    R = -S + delta * (m + k / size)
    I = omega * (k / size - m)  # noqa: E741
    return math.hypot(R, I), math.atan2(-I, R) % (2.0 * math.pi)


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
