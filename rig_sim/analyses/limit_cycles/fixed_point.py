"""The fixed point of one mass on a running belt: where friction and spring balance, and the eigenvalues there.

At rest over ground the relative velocity is -v_belt, so x = x0 + F(-v_belt)/k, and a small motion about it obeys

    m x'' + (c - gamma_lin) x' + k x = 0,     gamma_lin = dF/dw at w = -v_belt

gamma_lin > 0 where friction falls with the slip speed.  The fixed point is stable while c > gamma_lin; where the two
are equal and the mass oscillates is the Hopf point.
"""

import math
from dataclasses import dataclass

from rig_sim.flow import modes
from rig_sim.flow.contact_state import force, transition
from rig_sim.flow.flow import Flow, validate
from rig_sim.flow.frame import frame, friction_slope, mirror_mode
from rig_sim.flow.two_mass import TwoMassFlow, validate_two_masses


@dataclass(frozen=True)
class FixedPoint:
    """A fixed point and its stability.

    Attributes
    ----------
    outcome : str
        'fixed point'; 'belt at rest' (jump laws: the mass rests anywhere friction holds it); 'driven' (none: the drive
        moves the mass); 'force reversal' (linear curve: the belt is faster than the curve reaches), or
        'end of the curve' (of a formula: the same).
    advice : str
        What to do where there is none.
    x : float or None
        Position, m.
    eigenvalues : tuple of complex
        Both roots of m s^2 + (c - gamma_lin) s + k = 0, 1/s: by real part, then by imaginary part.
    stable : bool or None
        Whether both real parts are below 0; False on the boundary.
    """

    outcome: str
    advice: str = ""
    x: float | None = None
    eigenvalues: tuple[complex, ...] = ()
    stable: bool | None = None


@dataclass(frozen=True)
class TwoMassFixedPoint:
    """As `FixedPoint`, of two masses: both positions (m), all four eigenvalues (1/s)."""

    outcome: str
    advice: str = ""
    x: tuple[float, float] | None = None
    eigenvalues: tuple[complex, ...] = ()
    stable: bool | None = None


def fixed_point(flow: Flow) -> FixedPoint:
    """Return the fixed point of a flow: one mass, no drive."""
    validate(flow)
    if flow.u0 != 0.0:
        return FixedPoint("driven", "a driven mass does not come to rest; remove the drive")
    if flow.v_belt == 0.0 and frame(flow).B > 0.0 and frame(flow).d == 0.0:
        return FixedPoint("belt at rest", "on a belt at rest, friction holds the mass at any position; set belt.speed")
    if frame(flow).v > frame(flow).s_max:
        return FixedPoint(*modes.OUTCOMES[transition(frame(flow), modes.NEGATIVE, -1, 0.0, 0.0)])
    F, slope = friction_at_rest(flow)
    roots = quadratic_roots(flow.m, flow.c - slope, flow.k)
    return FixedPoint("fixed point", "", flow.x0 + F / flow.k, roots, flow.c > slope)


def two_mass_fixed_point(flow: TwoMassFlow) -> TwoMassFixedPoint:
    """Return the fixed point of two masses, where both stand while the belt slides below them."""
    import numpy as np

    validate_two_masses(flow)
    mass, a, b = flow.mass, flow.a, flow.b
    alone = fixed_point(mass)
    if alone.outcome != "fixed point":
        return TwoMassFixedPoint(alone.outcome, alone.advice)
    F, slope = friction_at_rest(mass)
    y1, y2 = (F / mass.k * top / (1.0 + 2.0 * a) for top in (1.0 + a + a * b, b + a + a * b))
    stiffness = mass.k / mass.m * np.array([[1.0 + a, -a], [-a, 1.0 + a]])
    damping = np.diag([mass.c - slope, mass.c - b * slope]) / mass.m
    matrix = np.block([[np.zeros((2, 2)), np.eye(2)], [-stiffness, -damping]])
    roots = sorted((complex(root) for root in np.linalg.eigvals(matrix)), key=lambda root: (root.real, root.imag))
    return TwoMassFixedPoint(
        "fixed point", "", (mass.x0 + y1, mass.x0 + y2), tuple(roots), max(root.real for root in roots) < 0.0
    )


def friction_at_rest(flow: Flow) -> tuple[float, float]:
    """Return friction (N) on a mass that stands on the running belt, and its slope gamma_lin = dF/dw (N s/m).

    Raises ValueError on a belt at rest under a jump law, where friction has no slope.
    """
    fr = frame(flow)
    if fr.B == 0.0:
        return 0.0, 0.0
    if fr.v == 0.0 and fr.d == 0.0:
        raise ValueError("friction has no slope on a belt at rest; set belt.speed")
    mode = modes.RAMP if fr.v <= fr.d else modes.NEGATIVE
    return force(flow, mirror_mode(fr, mode), 0.0, -flow.v_belt, 0.0), friction_slope(fr, mode, -fr.v)


def quadratic_roots(a: float, b: float, c: float) -> tuple[complex, complex]:
    """Return the roots of a s^2 + b s + c (a > 0), by real part, then imaginary part, without cancellation."""
    half = 0.5 * b / a
    rate = math.sqrt(c / a)
    within = (half - rate) * (half + rate)  # half^2 - c/a
    if within < 0.0:
        return -half - 1j * math.sqrt(-within), -half + 1j * math.sqrt(-within)
    far = -(half + math.copysign(math.sqrt(within), half))
    near = c / a / far
    return complex(min(far, near)), complex(max(far, near))
