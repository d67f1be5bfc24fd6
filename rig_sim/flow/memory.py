"""The equation of motion with a friction law with memory (`rig_sim.friction.memory`), its rates and its Jacobian.

    m x'' + c x' + k (x - x0) = F + u0 cos(omega t + phase)

A state is (x, y, z).  Of bristles y = w = x' - v_belt.  Of rate and state y = F/(L a): the slip speed

    e = v0 (exp(y - q) - exp(-y - q)),   q = (F0 + b z)/a

keeps its relative accuracy in a stick, where it falls to 1e-20 v0 and less, and passes through 0 smoothly where the
slip reverses.  There y follows the load at a rate of L a/(m e); no event has to be located.

Of two formulas (`rig_sim.friction.pair`) F = L f(s, z) tanh y with e = 2 v0 sinh y and s = 2 v0 cosh y, where v0 is a
speed so low that slip is then a stick; where f is not above 0, there is no motion.
"""

import math
from typing import TYPE_CHECKING, NamedTuple

from rig_sim.flow.flow import Flow
from rig_sim.friction.memory import AGEING, BRISTLE, PAIR
from rig_sim.friction.pair import at, evaluate

if TYPE_CHECKING:
    from stickslip.compute.arrays import Array

Vector = tuple[float, float, float]

RELATIVE_TOLERANCE = 1e-8  # of a step, over the stretch of the spring in slip
LANDING = 0.05  # share of the belt's speed: slip slower than that is a landing
BREAK_AWAY = 4.0  # over the slip speed of a landing: a stick ends at faster slip, so that ringing does not end it
# Of the exponents of e/v0: slower slip, 1e-100 v0, moves nothing; faster slip, 1e21 v0, is a trial step gone astray.
SLOWEST, FASTEST = -230.0, 50.0


class MemoryFlow(NamedTuple):
    """The parameters of the motion between events; those that a law does not have are 0."""

    m: float  # kg
    k: float  # N/m
    x0: float  # m
    c: float  # N s/m
    v_belt: float  # m/s, either sign or 0
    factor: float  # L
    u0: float  # N
    omega: float  # rad/s
    phase: float  # rad
    droop: float  # m/s; 0: a compliant belt is not modelled
    law: int  # BRISTLE, AGEING, SLIP or PAIR
    edge: float  # slip speed of a landing, m/s, above 0
    tolerance: float  # error of the position that a step may make, m
    formulas: "Array | None"  # of `rig_sim.friction.pair`
    s0: float = 0.0  # N/m
    s1: float = 0.0  # N s/m
    s2: float = 0.0  # N s/m
    Fc: float = 0.0  # N
    Fs: float = 0.0  # N
    v_s: float = 1.0  # m/s
    F0: float = 0.0  # N
    a: float = 0.0  # N
    b: float = 0.0  # N
    D: float = 0.0  # m
    v0: float = 0.0  # m/s


def make_memory_flow(flow: Flow, law: int, speed: float, parameters: dict[str, float]) -> MemoryFlow:
    """Return the flow of a law with memory: all but friction from ``flow``; ``speed`` is the running belt's, not 0."""
    values = {"Fs": parameters.get("Fc", 0.0), **parameters}
    reach = max(values["Fs"], values.get("F0", 0.0)) / flow.k + abs(speed) * math.sqrt(flow.m / flow.k)
    shared = {name: getattr(flow, name) for name in MemoryFlow._fields[:10]}
    edge, tolerance = LANDING * abs(speed), RELATIVE_TOLERANCE * reach
    return MemoryFlow(**shared, law=law, edge=edge, tolerance=tolerance, formulas=None, **values)


def drive(flow: MemoryFlow, t: float) -> float:
    """Return the driving force (N)."""
    return flow.u0 * math.cos(flow.omega * t + flow.phase) if flow.u0 != 0.0 else 0.0


def slip(flow: MemoryFlow, y: float, z: float) -> Vector:
    """Return the slip speed e (m/s), and its derivatives by y and by z."""
    if flow.law == BRISTLE:
        return -y, -1.0, 0.0
    if flow.law == PAIR:
        size = min(max(y, -FASTEST), FASTEST)
        return 2.0 * flow.v0 * math.sinh(size), 2.0 * flow.v0 * math.cosh(size), 0.0
    ratio = flow.b / flow.a
    q = flow.F0 / flow.a + ratio * z
    forwards = flow.v0 * math.exp(min(max(y - q, SLOWEST), FASTEST))
    backwards = flow.v0 * math.exp(min(max(-y - q, SLOWEST), FASTEST))
    e = forwards - backwards
    return e, forwards + backwards, -ratio * e


def second_variable(flow: MemoryFlow, w: float, z: float) -> float:
    """Return y of a relative velocity (m/s) and a memory."""
    if flow.law == BRISTLE or w == 0.0:
        return w
    if flow.law == PAIR:
        return -math.asinh(0.5 * w / flow.v0)
    load = math.log(abs(w) / flow.v0) + (flow.F0 + flow.b * z) / flow.a
    size = load if load > 30.0 else math.asinh(0.5 * math.exp(load))
    return -size if w > 0.0 else size


def smooth_speed(flow: MemoryFlow, e: float) -> float:
    return math.sqrt(e * e + 4.0 * flow.v0 * flow.v0)


def friction_of_pair(flow: MemoryFlow, state: Vector, e: float) -> Vector:
    """Return the friction (N) of two formulas, and its derivatives by y and by z."""
    _, y, z = state
    s = smooth_speed(flow, e)
    place = evaluate(flow.formulas, False, s, z, 3)
    f, by_s, by_z = at(flow.formulas, place), at(flow.formulas, place + 1), at(flow.formulas, place + 2)
    sign = math.tanh(y)
    if not f > 0.0:
        f = math.nan
    by_y = by_s * e * sign + f * (1.0 - sign) * (1.0 + sign)
    return flow.factor * f * sign, flow.factor * by_y, flow.factor * by_z * sign


def memory_rate(flow: MemoryFlow, e: float, z: float) -> Vector:
    """Return z', and its derivatives by e and by z."""
    s = abs(e)
    sign = 1.0 if e > 0.0 else -1.0
    if flow.law == BRISTLE:
        u = e / flow.v_s
        fall = flow.factor * (flow.Fs - flow.Fc) * math.exp(-u * u)
        g = flow.factor * flow.Fc + fall
        by_e = 1.0 - flow.s0 * z * (sign + 2.0 * s * u / flow.v_s * fall / g) / g
        return e - flow.s0 * s * z / g, by_e, -flow.s0 * s / g
    if flow.law == PAIR:
        speed = smooth_speed(flow, e)
        place = evaluate(flow.formulas, True, speed, z, 3)
        return at(flow.formulas, place), at(flow.formulas, place + 1) * e / speed, at(flow.formulas, place + 2)
    if flow.law == AGEING:
        growth = flow.v0 * math.exp(min(-z, FASTEST)) / flow.D
        return growth - s / flow.D, -sign / flow.D, -growth
    if s == 0.0:
        return 0.0, 0.0, 0.0
    lag = math.log(s / flow.v0) + z
    return -s * lag / flow.D, -sign * (lag + 1.0) / flow.D, -s / flow.D


def net_acceleration(flow: MemoryFlow, t: float, state: Vector, e: float, dz: float) -> float:
    """Return x'' (m/s^2) where e and z' are known."""
    x, y, z = state
    if flow.law == BRISTLE:
        F = flow.s0 * z + flow.s1 * dz + flow.s2 * e
    elif flow.law == PAIR:
        F = friction_of_pair(flow, state, e)[0]
    else:
        F = flow.factor * flow.a * y
    return (F - flow.k * (x - flow.x0) - flow.c * (flow.v_belt - e) + drive(flow, t)) / flow.m


def motion_of(flow: MemoryFlow, t: float, state: Vector) -> Vector:
    """Return position (m), velocity (m/s) and acceleration (m/s^2) of a state."""
    e, _, _ = slip(flow, state[1], state[2])
    dz, _, _ = memory_rate(flow, e, state[2])
    return state[0], flow.v_belt - e, net_acceleration(flow, t, state, e, dz)


def rates(flow: MemoryFlow, t: float, state: Vector) -> Vector:
    """Return x', y' and z': e' = -x'' makes y' = -(x'' + e_z z')/e_y."""
    _, y, z = state
    e, e_y, e_z = slip(flow, y, z)
    dz, _, _ = memory_rate(flow, e, z)
    return flow.v_belt - e, -(net_acceleration(flow, t, state, e, dz) + e_z * dz) / e_y, dz


def jacobian(flow: MemoryFlow, t: float, state: Vector) -> tuple[Vector, Vector, Vector]:
    """Return the derivatives of x', y' and z' by x, y and z."""
    _, y, z = state
    e, e_y, e_z = slip(flow, y, z)
    dz, z_e, z_z = memory_rate(flow, e, z)
    z_y, z_z = z_e * e_y, z_z + z_e * e_z
    if flow.law == BRISTLE:
        F_y, F_z = flow.s1 * z_y + flow.s2 * e_y, flow.s0 + flow.s1 * z_z
        ratio = bend = 0.0
    elif flow.law == PAIR:
        _, F_y, F_z = friction_of_pair(flow, state, e)
        ratio, bend = 0.0, e / e_y
    else:
        F_y, F_z = flow.factor * flow.a, 0.0
        ratio, bend = flow.b / flow.a, e / e_y  # bend: e_yy/e_y
    slope = -(net_acceleration(flow, t, state, e, dz) + e_z * dz) / e_y  # y'
    a_y, a_z = (F_y + flow.c * e_y) / flow.m, (F_z + flow.c * e_z) / flow.m
    y_y = -a_y / e_y + ratio * dz - e_z * z_y / e_y - slope * bend
    y_z = -(a_z - ratio * e_z * dz + e_z * z_z) / e_y + ratio * slope
    return (0.0, -e_y, -e_z), (flow.k / flow.m / e_y, y_y, y_z), (0.0, z_y, z_z)
