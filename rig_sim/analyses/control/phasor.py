"""The oscillation of a mass under a shaker: frequency and growth rate from amplification and phase, and back.

The thesis (6.10 to 6.15, after Heckl) feeds the velocity back as a phasor.  With S = gamma_lin - c, the slope of the
friction less the damping, and E = a e^{-i phi}, a small oscillation e^{-i Omega t} about the fixed point has

    m Omega^2 - i (S + E) Omega - k = 0,   Omega = sqrt(k/m - (S + E)^2/4m^2) + i (S + E)/2m = omega + i delta

so omega > 0 is its frequency (rad/s) and delta its growth rate (1/s; > 0: it grows).  The force leads the velocity by
phi (rad); phi = pi is a damper of a (N s/m).  The other way round, S + E = i (k/Omega - m Omega), that is E = R + i I
with

    R = c - gamma_lin + delta (m + k/abs(Omega)^2),   I = omega (k/abs(Omega)^2 - m)
"""

import cmath
import math


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
        raise ValueError(f"omega must be a frequency above 0, not {omega}")
    size = omega * omega + delta * delta
    R = -S + delta * (m + k / size)
    I = omega * (k / size - m)  # noqa: E741
    return math.hypot(R, I), math.atan2(-I, R) % (2.0 * math.pi)
