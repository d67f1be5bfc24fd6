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
    """Return the friction force on the mass (N, positive along x) at relative velocity w = x' - v_belt (m/s).

    d is the half-width of the ramp (m/s), static Fs/abs(G_stick); parameters that the law does not name are not used.
    static, the break-away level over Fs, enters only the ramp: its peak is static Fs, then the force drops to the
    curve. The scatter ``factor`` multiplies the whole curve; d is unchanged.

    In stick a jump law's force balances all others: see `rig_sim.flow.contact_state.force`.
    """
    velocity: float = w  # type: ignore[assignment]  # arithmetic is the same for arrays
    sign = (velocity > 0) * 1.0 - (velocity < 0) * 1.0
    speed = abs(velocity)
    if law.contact == "jump":
        return -sign * factor * magnitude(law.curve_code, speed, Fs, G_slip, gamma)  # type: ignore[return-value]
    if not d > 0:
        raise ValueError(f"d must be above 0 m/s, not {d}, because it is the half-width of a ramp")
    inside = (speed <= d) * 1.0
    beyond = (speed - d) * (speed > d)
    outside = sign * magnitude(law.curve_code, beyond, Fs, G_slip, gamma)
    return -factor * (inside * (static * Fs / d) * velocity + (1.0 - inside) * outside)  # type: ignore[return-value]
