"""Ripple: a belt whose speed swings, v_belt + ripple sin(2 pi ripple_hz (t - belt.start)), played exactly.

In coordinates that swing with the belt, xi = x - b(t) with b' the ripple, the belt runs steadily and

    m xi'' + c xi' + k (xi - x0) = F(xi' - v_belt) - (m b'' + c b' + k b)

so that the ripple is a harmonic drive, which the integrator knows.  b = -(ripple/Omega) cos(Omega (t - start)); the
drive is u cos(Omega t + phase) of the complex size

    u e^{i phase} = (k/Omega - m Omega + i c) ripple e^{-i Omega start}

Not modelled: more than one harmonic, so a drive of the mass beside the ripple.
"""

import cmath
import math

from rig_sim.flow.flow import Flow


class SwingingBelt:
    """The swing of a belt's position about its steady run, and the equivalent drive."""

    def __init__(self, amplitude: float, frequency_hz: float, start: float) -> None:
        self._speed = amplitude  # m/s
        self._omega = 2.0 * math.pi * frequency_hz
        self._start = start  # s, phase 0

    def position(self, t: float) -> float:
        """Return b (m) at time t (s)."""
        return -self._speed / self._omega * math.cos(self._omega * (t - self._start))

    def speed(self, t: float) -> float:
        """Return b' (m/s) at time t (s)."""
        return self._speed * math.sin(self._omega * (t - self._start))

    def drive(self, flow: Flow) -> Flow:
        """Return the flow of xi, driven by the ripple."""
        omega = self._omega
        u = complex(flow.k / omega - flow.m * omega, flow.c) * self._speed * cmath.exp(-1j * omega * self._start)
        return flow._replace(u0=abs(u), omega=omega, phase=cmath.phase(u))
