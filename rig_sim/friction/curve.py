"""The slip curves of the laws: the magnitude of friction against slip speed s >= 0; `spline` has the measured one.

Formulas below take floats or numpy arrays alike; numpy itself is not imported.
"""

import math
from typing import TypeVar

Real = TypeVar("Real")  # float, or numpy array of floats

CONSTANT = 0
LINEAR = 1
HYPERBOLIC = 2
MEASURED = 3  # given by points: see `rig_sim.friction.spline`

CURVES = {"constant": CONSTANT, "linear": LINEAR, "hyperbolic": HYPERBOLIC, "measured": MEASURED}


def magnitude(curve: int, s: Real, Fs: float, G_slip: float = 0.0, gamma: float = 0.0) -> Real:
    """Return the friction force (N, >= 0 in its physical range) at slip speed ``s`` (m/s, >= 0).

    Fs is the level at s = 0 (N), G_slip the slope of the linear curve (N s/m, > 0 for falling friction), gamma the rate
    of the hyperbolic one (s/m).  The linear curve changes sign beyond s = Fs/G_slip (`reversal_speed`); the formula is
    returned unchanged.

    Not modelled: rise at high speed (viscous), memory, dependence on normal force or temperature.
    """
    speed: float = s  # type: ignore[assignment]  # arithmetic is the same for arrays
    if curve == CONSTANT:
        force = Fs + 0.0 * speed
    elif curve == LINEAR:
        force = Fs - G_slip * speed
    elif curve == HYPERBOLIC:
        force = Fs / (1.0 + gamma * speed)
    else:
        raise ValueError("the curve must be 0 (constant), 1 (linear) or 2 (hyperbolic)")
    return force  # type: ignore[return-value]


def slope(curve: int, s: Real, Fs: float, G_slip: float = 0.0, gamma: float = 0.0) -> Real:
    """Return the derivative of `magnitude` by the slip speed, N s/m; parameters as there."""
    speed: float = s  # type: ignore[assignment]  # arithmetic is the same for arrays
    if curve == LINEAR:
        rate = -G_slip + 0.0 * speed
    elif curve == HYPERBOLIC:
        rate = -Fs * gamma / (1.0 + gamma * speed) ** 2
    else:
        rate = 0.0 * speed
    return rate  # type: ignore[return-value]


def shape_slope(curve: int, s: Real, Fs: float, gamma: float = 0.0) -> Real:
    """Return the derivative of `magnitude` by the curve's shape: G_slip/Fs of the linear one, else gamma; N m/s."""
    speed: float = s  # type: ignore[assignment]  # arithmetic is the same for arrays
    if curve == LINEAR:
        rate = -Fs * speed
    elif curve == HYPERBOLIC:
        rate = -Fs * speed / (1.0 + gamma * speed) / (1.0 + gamma * speed)  # a square would overflow
    else:
        rate = 0.0 * speed
    return rate  # type: ignore[return-value]


def reversal_speed(curve: int, Fs: float, G_slip: float) -> float:
    """Return the slip speed (m/s) beyond which the curve is unphysical; infinite unless it falls linearly."""
    return Fs / G_slip if curve == LINEAR and G_slip > 0.0 else math.inf
