"""Kernels: the acceleration of the mass in each mode, and one Runge-Kutta step of it.

`fitting.sensitivity.flow` joins the steps.
"""

import math
from typing import NamedTuple

from fitting.model.parameters import Global
from fitting.sensitivity.friction import Contact, friction
from rig_sim.flow.modes import RAMP, STICK
from stickslip.compute.arrays import Array, Integers

CREEP = 4  # a mode beside those of `rig_sim.flow.modes`: a steep ramp, its velocity that of balanced forces

K, LOG_F, V_DR, SHAPE = int(Global.K), int(Global.LOG_F), int(Global.V_DR), int(Global.SHAPE)
D, DATUM, DAMPING, FADE = int(Global.D), int(Global.DATUM), int(Global.DAMPING), int(Global.FADE)
COMPLIANCE, COSINE, SINE, OMEGA = (
    int(Global.COMPLIANCE),
    int(Global.COSINE),
    int(Global.SINE),
    int(Global.OMEGA),
)
STATIC = int(Global.STATIC)
INLINED = ("acceleration",)  # `Window` has 49 numbers: called four times a step, it took half as long again


class Drag(NamedTuple):
    """A drag on the mass: a table, extrapolated linearly; empty for none.

    ``velocity`` (G,) in m/s rises, ``acceleration`` (G,) is in m/s^2.  Within ``turn`` of rest (m/s) it may change
    steeply: no step passes over that.
    """

    velocity: Array
    acceleration: Array
    turn: float


class Extra(NamedTuple):
    """Additional effects: a force and a change of the belt's speed along an earlier path, and a drag.

    ``first`` (windows + 1,) are the first points of each window in ``along``, whose row 0 is time (s), row ``force``
    the force (m/s^2) and row ``belt`` the change of the belt's speed (m/s); row 0 stands for none.  ``drag`` (2, G) and
    ``turn`` are those of a `Drag`.  Unused arrays are empty.
    """

    first: Integers
    along: Array
    force: int
    belt: int
    drag: Array
    turn: float


class Window(NamedTuple):
    """The numbers of one window: its run's unknowns (13,), friction, current level and its epoch, and extras.

    The points of ``along`` from ``low`` to before ``high`` are the window's.  Compiled code passes seven to ten numbers
    for an array: fewer arrays make a step faster.
    """

    u: Array
    contact: Contact
    level: float
    epoch: float
    low: int
    high: int
    along: Array
    force: int
    belt: int
    drag: Array
    turn: float


def at_level(w: Window, level: float) -> Window:
    return Window(w.u, w.contact, level, w.epoch, w.low, w.high, w.along, w.force, w.belt, w.drag, w.turn)


def piece(w: Window, t: float) -> int:
    """Return the latest point of the window, other than its last, not after t; else its first."""
    low, last = w.low, w.high - 1
    while last - low > 1:
        middle = (low + last) // 2
        if t < w.along[0, middle]:
            last = middle
        else:
            low = middle
    return low


def between(w: Window, row: int, t: float) -> float:
    """Return a row of `Extra.along` at time t by linear interpolation; 0 for no row."""
    if row == 0:
        return 0.0
    i = piece(w, t)
    j = min(i + 1, w.high - 1)
    gap = w.along[0, j] - w.along[0, i]
    part = (t - w.along[0, i]) / gap if gap > 0.0 else 0.0
    part = min(max(part, 0.0), 1.0)
    return float(w.along[row, i] + part * (w.along[row, j] - w.along[row, i]))


def slope_between(w: Window, row: int, t: float) -> float:
    """Return the slope of a row of `Extra.along` just after time t, interpolated as by `between`."""
    if row == 0 or not w.along[0, w.low] <= t < w.along[0, w.high - 1]:
        return 0.0
    i = piece(w, t)
    return float((w.along[row, i + 1] - w.along[row, i]) / (w.along[0, i + 1] - w.along[0, i]))


def belt_speed(w: Window, t: float) -> float:
    """Return the speed of the unloaded belt, m/s."""
    u, omega = w.u, w.u[OMEGA]
    steady = u[V_DR] + between(w, w.belt, t)
    if omega == 0.0:
        return float(steady)
    return float(steady + u[COSINE] * math.cos(omega * t) + u[SINE] * math.sin(omega * t))


def belt_acceleration(w: Window, t: float) -> float:
    """Return the acceleration of the unloaded belt just after time t, m/s^2."""
    u, omega = w.u, w.u[OMEGA]
    if omega == 0.0 and w.belt == 0:
        return 0.0
    drift = slope_between(w, w.belt, t)
    return float(drift + omega * (u[SINE] * math.cos(omega * t) - u[COSINE] * math.sin(omega * t)))


def remaining(fade: float, t: float, epoch: float) -> float:
    """Return the friction level at time t (s) over that at ``epoch``.

    Each cycle's level falls along a line of time; all lines have the same zero, as the run's wear has: a constant loss
    left 2 um of a 16 s run that lost a tenth of its level. ``fade`` is the loss per second over the level at 0 s.
    """
    return float((1.0 - fade * t) / (1.0 - fade * epoch))


def level_at(w: Window, t: float) -> float:
    """Return the friction level over F, which fades from the cycle's break-away on."""
    return float(w.level * remaining(w.u[FADE], t, w.epoch))


def drag(w: Window, v: float) -> tuple[float, float]:
    """Return the drag without damping (m/s^2), and its derivative (1/s)."""
    if w.drag.shape[1] < 2:
        return 0.0, 0.0
    low, high = 0, w.drag.shape[1] - 1
    while high - low > 1:
        middle = (low + high) // 2
        if v < w.drag[0, middle]:
            high = middle
        else:
            low = middle
    slope = (w.drag[1, high] - w.drag[1, low]) / (w.drag[0, high] - w.drag[0, low])
    return float(w.drag[1, low] + slope * (v - w.drag[0, low])), float(slope)


def resistance(w: Window, v: float) -> float:
    """Return the deceleration by damping and drag, m/s^2."""
    return float(w.u[DAMPING] * v - drag(w, v)[0])


def free_force(w: Window, t: float, x: float) -> float:
    """Return the acceleration of the mass at rest without friction, m/s^2."""
    return float(-w.u[K] * (x - w.u[DATUM]) + between(w, w.force, t))


def acceleration(w: Window, mode: int, t: float, x: float, v: float) -> float:
    """Return x'' (m/s^2) of slip or ramp."""
    force, _, _ = friction(w.contact, mode, belt_speed(w, t) - v, level_at(w, t))
    return float(free_force(w, t, x) - resistance(w, v) + force)


def bound_velocity(w: Window, mode: int, t: float, x: float) -> float:
    """Return x' (m/s) of a mode bound to the belt: the belt's in stick; in creep that of balanced forces.

    In creep the inertia counts to first order, by the acceleration of that velocity; for a ripple to second order.
    """
    if mode == STICK:
        return belt_speed(w, t)
    _, rise, _ = friction(w.contact, RAMP, 0.0, level_at(w, t))
    belt = belt_speed(w, t)
    dragged, bend = drag(w, belt)  # the mass is nearly as fast as the belt
    rate = rise + w.u[DAMPING] - bend
    slower = (w.u[DAMPING] * belt - dragged - free_force(w, t, x)) / rate  # than the belt; small on a steep ramp
    late = (rise * belt_acceleration(w, t) - w.u[K] * (belt - slower)) / rate**2
    steady = w.u[V_DR] + between(w, w.belt, t)
    return float(belt - (slower + late + w.u[OMEGA] ** 2 * (belt - steady) / rate**2))


def advance(w: Window, mode: int, t: float, x: float, v: float, h: float) -> tuple[float, float]:
    """Return (x, v) after a step of length h."""
    half = 0.5 * h
    if mode == STICK or mode == CREEP:
        k1 = bound_velocity(w, mode, t, x)
        k2 = bound_velocity(w, mode, t + half, x + half * k1)
        k3 = bound_velocity(w, mode, t + half, x + half * k2)
        k4 = bound_velocity(w, mode, t + h, x + h * k3)
        x += h / 6.0 * (k1 + 2.0 * (k2 + k3) + k4)
        return x, bound_velocity(w, mode, t + h, x)
    a1 = acceleration(w, mode, t, x, v)
    v2 = v + half * a1
    a2 = acceleration(w, mode, t + half, x + half * v, v2)
    v3 = v + half * a2
    a3 = acceleration(w, mode, t + half, x + half * v2, v3)
    v4 = v + h * a3
    a4 = acceleration(w, mode, t + h, x + h * v3, v4)
    return x + h / 6.0 * (v + 2.0 * (v2 + v3) + v4), v + h / 6.0 * (a1 + 2.0 * (a2 + a3) + a4)


def load(w: Window, t: float, x: float) -> float:
    """Return the friction force needed to move with the belt, including inertia, m/s^2."""
    belt = belt_speed(w, t)
    return float(belt_acceleration(w, t) + resistance(w, belt) - free_force(w, t, x))
