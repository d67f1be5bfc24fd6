"""Kernels: friction per unit mass in each mode of the contact, for the curve of a law or for a spline.

The relative speed e = v_belt - x' is positive where the belt is faster; friction then pushes the mass along +x:

    slip   sign(e) level F n(s)             abs(e) = s + d + q n(s)
    ramp   static level F n(0) e/edge       edge = d + q n(0)

n is the curve over F = Fs/m (a spline is its own curve per unit mass, F = 1), d the ramp's half-width, and q =
compliance F/K the speed that a compliant belt loses under the load F, which makes friction a function of the speed of
the unloaded belt (`rig_sim.flow.modes`, droop).  Where a touch of the belt ends a step, n is continued to s < 0.
"""

from typing import NamedTuple

from rig_sim.flow.modes import NEGATIVE, RAMP
from rig_sim.friction.curve import MEASURED, magnitude, slope
from rig_sim.friction.spline import piece_of
from stickslip.compute.arrays import Array

SPLINE = MEASURED  # code of a curve given by knots and pieces
MOST_ITERATIONS = 30  # Newton steps on a compliant belt; it needs 3 to 5


class Contact(NamedTuple):
    """Friction of one run, as `friction` reads it.

    ``curve`` is a code, F in m/s^2, ``shape`` in s/m, d and q in m/s; ``at_rest`` is n(0).  ``table`` is that of a
    spline of ``pieces`` cubics as in `rig_sim.friction.spline`, without its last two numbers.
    """

    curve: int
    F: float
    shape: float
    d: float
    q: float
    static: float
    at_rest: float
    pieces: int
    table: Array


def normal_curve(c: Contact, s: float) -> tuple[float, float]:
    """Return n(s) and its slope (s/m); a spline has a constant slope beyond its last knot."""
    if c.curve == SPLINE:
        i = piece_of(c.table, c.pieces, s)
        z, at = s - c.table[i], c.pieces + 4 * i
        c1, c2, c3 = c.table[at + 1], c.table[at + 2], c.table[at + 3]
        return c.table[at] + z * (c1 + z * (c2 + z * c3)), c1 + z * (2.0 * c2 + z * 3.0 * c3)
    return magnitude(c.curve, s, 1.0, c.shape, c.shape), slope(c.curve, s, 1.0, c.shape, c.shape)


def edge_speed(c: Contact) -> float:
    """Return the relative speed (m/s) at which a ramp ends and slip begins; 0 for a jump on a stiff belt."""
    return c.d + c.q * c.at_rest


def friction(c: Contact, mode: int, e: float, level: float) -> tuple[float, float, float]:
    """Return friction (m/s^2), its derivative by e (1/s), and the slip speed s (m/s; 0 on the ramp)."""
    if mode == RAMP:
        rise = c.static * level * c.F * c.at_rest / edge_speed(c)
        return rise * e, rise, 0.0
    sign = 1.0 if mode == NEGATIVE else -1.0
    s = sign * e - c.d
    n, rate = normal_curve(c, s)
    if c.q > 0.0:
        r = s
        s -= c.q * n
        for _ in range(MOST_ITERATIONS):
            n, rate = normal_curve(c, s)
            change = (s + c.q * n - r) / (1.0 + c.q * rate)
            s -= change
            if abs(change) <= 1e-15 * (abs(r) + c.q):
                break
        n, rate = normal_curve(c, s)
    return sign * level * c.F * n, level * c.F * rate / (1.0 + c.q * rate), s
