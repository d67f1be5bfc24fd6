"""Shaker: a force on the mass made of its own velocity, amplified by ``a`` and shifted in phase by ``phi``.

The thesis writes a phasor, which gives a small oscillation e^{-i Omega t} about the fixed point x_e its frequency omega
and its growth rate delta: `rig_sim.analyses.control.shaker`.  a in N s/m, phi in rad; the force leads the velocity by
phi, and phi = pi is a damper of a.  gamma_lin = dF/dw at w = -v_belt: how friction rises as the mass speeds up, > 0 on
a falling curve, -Fs/d inside a ramp.

A phasor does not define the force for a motion that is no oscillation, and the filter before the phase shifter is not
specified.  Integrated here is a shifter tuned to Omega: the local term with the phasor's effect on this oscillation.
It is a damper and a spring about x_e, exact because one complex equation determines two real numbers:

    m x'' + (c_eff - gamma_lin) x' + k_eff (x - x_e) = 0 has the root x' = -i Omega x:
    c_eff = gamma_lin - 2 m delta   (= c - a cos phi - a sin phi delta/omega),   may be negative
    k_eff = m (omega^2 + delta^2)   (= k + a sin phi (omega^2 + delta^2)/omega), never is

The filter passes no constant force, so x_e = x0 + F(-v_belt)/k stays where it is: the spring's rest moves to
x0_eff = x_e - F(-v_belt)/k_eff.  So the motion is the same equation with other numbers, played by the same kernels;
stick, slip point (k_eff (x - x0_eff) = Fs - c_eff v_belt) and all else follow from it.

Where omega is below `CREEP` abs(delta) nothing oscillates and there is no phase to shift: refused, but for phi a
multiple of pi (to `NO_SHIFT`, as 3.14159 is), which asks for no shift: c_eff = c - a cos phi, k_eff = k, both roots
exact.

Before ``belt.start`` the shaker is off.  Wear and scatter change gamma_lin, and the shifter is tuned again at each
landing.

Not modelled: the filter's bandwidth and its ringing (in stick and at corners a real one would lag and pass less), a
saturating amplifier (so a shaker that drives the mass on, c_eff below 0, may do so without bound), a detuned shifter,
the shaker's own mass.
"""

import math

from rig_sim.analyses.control.shaker import phasor
from rig_sim.analyses.limit_cycles.fixed_point import friction_at_rest
from rig_sim.flow.flow import Flow

CREEP = 0.1  # frequency over abs(delta): a slower oscillation is over, or grown e^63-fold, within one period
NO_SHIFT = 1e-5  # rad


def add_shaker(flow: Flow, a: float, phi: float) -> Flow:
    """Return the flow with a shaker of amplification ``a`` (N s/m) and phase lead ``phi`` (rad).

    Raises ValueError where the belt is at rest under a jump law (friction has no slope there), or the mass would creep.
    """
    if a == 0.0:  # nothing, whatever the belt does
        return flow
    F, gamma_lin = friction_at_rest(flow)
    Omega = phasor(flow.m, flow.k, gamma_lin - flow.c, a, phi)
    if Omega.real < CREEP * abs(Omega.imag):
        if abs(math.sin(phi)) > NO_SHIFT:
            raise ValueError(
                f"the mass would creep instead of oscillating (omega {Omega.real:.3g}, delta "
                f"{Omega.imag:.3g}), so it has no phase that can be shifted"
            )
        return flow._replace(c=flow.c - a * math.cos(phi))
    k = flow.m * (Omega.real**2 + Omega.imag**2)
    return flow._replace(
        c=gamma_lin - 2.0 * flow.m * Omega.imag,
        k=k,
        x0=flow.x0 + F / flow.k - F / k,
    )
