"""Two equal masses on one belt, each on its spring to the wall, coupled by a spring between them.

    m x1'' + c x1' + k (x1 - x0) + a k (x1 - x2) =   F(x1' - v_belt)
    m x2'' + c x2' + k (x2 - x0) + a k (x2 - x1) = b F(x2' - v_belt)

F is the friction of one of the laws with a jump contact.  A mass sticks while the load on its contact,

    L1 = k (x1 - x0) + a k (x1 - x2) + c v_belt,   L2 likewise,

lies within its break-away level: static Fs for the first mass, b static Fs for the second.  In the plane (x1, x2) these
four lines are the failure locus.  While both stick, d = x2 - x1 stays as it is.
"""

import math
from typing import NamedTuple

from rig_sim.flow.flow import LARGEST, Flow, validate
from rig_sim.friction.curve import MEASURED


class TwoMassFlow(NamedTuple):
    """The equations above: ``mass``, one of the two alone; ``a``, coupling spring / k; ``b``, the levels' ratio."""

    mass: Flow
    a: float = 1.2
    b: float = 1.3


def validate_two_masses(flow: TwoMassFlow) -> None:
    """Raise ValueError for two masses that are not physical, or not modelled (ramp contact, drive, compliant belt)."""
    validate(flow.mass)
    for name, number in (("a", flow.a), ("b", flow.b)):
        if not 0.0 <= number <= LARGEST:
            raise ValueError(f"{name} must be a number from 0 to {LARGEST:g}, not {number}")
    if flow.mass.curve == MEASURED:
        raise ValueError("two masses with a measured curve are not modelled; use law 1, 3 or 5")
    if flow.mass.ramp:
        raise ValueError("two masses with a ramp contact are not modelled; use law 1, 3 or 5")
    if flow.mass.u0 != 0.0:
        raise ValueError("two masses with a drive are not modelled")
    if flow.mass.droop != 0.0:
        raise ValueError("two masses on a belt that droops are not modelled")


def largest_stretch(flow: TwoMassFlow) -> float:
    """Return the largest abs(x2 - x1), m, with which both masses can stick."""
    mass = flow.mass
    return mass.static * mass.factor * mass.Fs * (1.0 + flow.b) / (mass.k * (1.0 + 2.0 * flow.a))


def slip_start(flow: TwoMassFlow, d: float) -> tuple[float, float]:
    """Return (x1, x2), m, where a global stick with the stretch d = x2 - x1 (m) ends: on the failure locus.

    Raises ValueError where no global stick has this stretch, or on a belt at rest, where it would not end.
    """
    mass = flow.mass
    if not abs(d) <= largest_stretch(flow):
        raise ValueError(f"d is {d:g}, but both masses can stick only with abs(d) up to {largest_stretch(flow):.6g}")
    if mass.v_belt == 0.0:
        raise ValueError("on a belt at rest no stick ends; set a belt speed")
    sign = math.copysign(1.0, mass.v_belt)
    level = mass.static * mass.factor * mass.Fs - mass.c * abs(mass.v_belt)
    second = flow.b * mass.static * mass.factor * mass.Fs - mass.c * abs(mass.v_belt)
    stretch = sign * d
    y1 = min(level / mass.k + flow.a * stretch, second / mass.k - (1.0 + flow.a) * stretch)
    return mass.x0 + sign * y1, mass.x0 + sign * y1 + d
