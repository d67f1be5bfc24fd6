"""Flow: the numbers of the equation of motion between two events, and which of them are physical."""

import math
from typing import NamedTuple

from rig_sim.friction.curve import HYPERBOLIC, LINEAR, MEASURED
from rig_sim.friction.spline import NO_TABLE, Table, steepest_fall_between


class Flow(NamedTuple):
    """All parameters of the motion between events; the defaults are the dimensionless base case, law 5.

    Pass floats as floats and ints as ints: compiled kernels are specialised on the types.  With a ramp, static > 1
    makes the ramp's peak static Fs, dropping to the curve at its edge.  Kernels trust their flow; `validate` checks
    one.
    """

    m: float = 1.0  # mass, kg, > 0
    k: float = 1.0  # spring, N/m, > 0
    x0: float = 0.0  # rest position of the spring, m
    c: float = 0.0  # viscous damping, N s/m
    v_belt: float = 0.5  # belt velocity, m/s, either sign or 0
    curve: int = HYPERBOLIC  # code of `rig_sim.friction.curve`
    ramp: int = 0  # 1 for a ramp contact, 0 for a jump
    Fs: float = 1.0  # level at rest, N, >= 0; of a measured curve its friction at rest
    static: float = 1.0  # break-away level / Fs, >= 1
    factor: float = 1.0  # scatter: multiplies the whole curve, d unchanged
    G_slip: float = 0.05  # slope of the linear curve, N s/m
    gamma: float = 3.0  # rate of the hyperbolic curve, s/m
    d: float = 0.2  # half-width of the ramp, m/s
    u0: float = 0.0  # drive u0 cos(omega t + phase), N
    omega: float = 0.0  # rad/s
    phase: float = 0.0  # rad
    droop: float = 0.0  # speed drop of the belt at the load Fs, m/s, >= 0: its compliance is droop/Fs, m/s per N
    pieces: int = 0  # of a measured curve, with its table, as of `rig_sim.friction.spline.spline_table`
    table: Table = NO_TABLE  # an array for compiled kernels: `rig_sim.integrate.compiled.for_kernels`


SMALLEST, LARGEST = 1e-100, 1e100  # sizes of any number but 0: products of three stay finite
POSITIVE_FIELDS = ("m", "k")
NON_NEGATIVE_FIELDS = ("Fs", "factor", "gamma", "d", "droop")


def validate(flow: Flow) -> None:
    """Raise ValueError, naming the field, for a flow that is not physical.

    A number is not finite or above `LARGEST`; m or k is not above 0, or below `SMALLEST`; Fs, factor, gamma, d or droop
    is below 0; static is below 1; droop comes with static above 1, without friction, or with friction that falls faster
    than the belt yields.
    """
    for name, number in flow._asdict().items():
        if name == "table":
            continue  # checked where it was made
        if not math.isfinite(number):
            raise ValueError(f"{name} must be a finite number, not {number}")
        if abs(number) > LARGEST or (name in POSITIVE_FIELDS and 0.0 < number < SMALLEST):
            raise ValueError(f"{name} is {number}, which is outside {SMALLEST:g} to {LARGEST:g}; choose other units")
        if name in POSITIVE_FIELDS and not number > 0.0:
            raise ValueError(f"{name} must be above 0, not {number}")
        if name in NON_NEGATIVE_FIELDS and number < 0.0:
            raise ValueError(f"{name} must be 0 or more, not {number}")
    if flow.static < 1.0:
        raise ValueError(
            f"static must be 1 or more, not {flow.static}, because friction at rest is not below friction in slip"
        )
    if flow.droop > 0.0:
        if flow.curve == MEASURED:
            raise ValueError("droop with a measured curve is not modelled")
        if flow.static != 1.0:
            raise ValueError(f"droop with static {flow.static} is not modelled; set static to 1")
        if flow.Fs == 0.0:
            raise ValueError("droop is the decrease of speed at the load Fs, so Fs must be above 0, not 0")
        fall = steepest_fall(flow)
        if flow.droop * fall >= 1.0:
            raise ValueError(
                f"droop is {flow.droop:g} m/s, so friction falls faster than the belt slows and the force is "
                f"not unique; use less than {1.0 / fall:g}"
            )


def steepest_fall(flow: Flow) -> float:
    """Return the steepest fall of friction with speed, divided by Fs (s/m)."""
    if flow.curve == HYPERBOLIC:
        return flow.gamma
    if flow.curve == MEASURED:
        return max(0.0, steepest_fall_between(flow.table, flow.pieces, 0.0, flow.table[flow.pieces - 1]))
    return flow.G_slip / flow.Fs if flow.curve == LINEAR and flow.Fs > 0.0 else 0.0
