"""Friction force F(w) of a law at relative velocity w = x' - v_belt: odd in w, against w (F > 0 where w < 0).

Jump: F = -sign(w) curve(abs(w)); at w = 0 any value in [-static Fs, static Fs], here 0.
Ramp: F = -(static Fs/d) w for abs(w) <= d; outside, the curve shifted to begin at the ramp's edge: curve(abs(w) - d).
"""

from rig_sim.friction.curve import Real, magnitude
from rig_sim.friction.law import Law


def force(
    law: Law,
    w: Real,
    *,
    Fs: float = 1.0,
    G_slip: float = 0.0,
    gamma: float = 0.0,
    d: float = 0.0,
    static: float = 1.0,
    factor: float = 1.0,
) -> Real:
    """Return the friction force on the mass (N, positive along x).

    law: One of `rig_sim.friction.law.LAWS`.
    w: Relative velocity x' - v_belt, m/s.
    Fs, G_slip, gamma, d: N, N s/m, s/m, m/s (half-width of the ramp, d = static Fs/abs(G_stick)); those that the law
        does not name are not used.
    static: Break-away level / Fs; it shows in the ramp alone (its peak is static Fs, then the force drops to the
        curve).
    factor: Scatter: multiplies the whole curve; d is unchanged.
    Raises ValueError: for a ramp law whose d is not positive.

    Notes
    -----
    In stick a jump law's force is whatever balances the rest: `rig_sim.flow.contact_state.force` knows the state.
    """
    velocity: float = w  # type: ignore[assignment]  # arithmetic is the same for arrays
    sign = (velocity > 0) * 1.0 - (velocity < 0) * 1.0
    speed = abs(velocity)
    if law.contact == "jump":
        return -sign * factor * magnitude(law.curve_code, speed, Fs, G_slip, gamma)  # type: ignore[return-value]
    if not d > 0:
        raise ValueError(f"d is {d}; a ramp needs a half-width above 0 m/s")
    inside = (speed <= d) * 1.0
    beyond = (speed - d) * (speed > d)
    outside = sign * magnitude(law.curve_code, beyond, Fs, G_slip, gamma)
    return -factor * (inside * (static * Fs / d) * velocity + (1.0 - inside) * outside)  # type: ignore[return-value]
