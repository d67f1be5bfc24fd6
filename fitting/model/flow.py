"""Kernels: the motion along the windows of a fit by the classical Runge-Kutta method, and its points for tangents.

The relative speed e = v_belt - x' is positive where the belt is faster; friction then pushes the mass along +x:

    slip   sign(e) level F n(s)             abs(e) = s + d + q n(s)
    ramp   static level F n(0) e/edge       edge = d + q n(0)

n is the curve of a law over F = Fs/m (a spline is its own curve per unit mass, F = 1), d the ramp's half-width, and q =
compliance F/K the speed that a compliant belt loses under the load F, which makes friction a function of the speed of
the unloaded belt (`rig_sim.flow.modes`, droop).  Where a touch of the belt ends a step, n is continued to s < 0.

Each window is integrated from its own start.  Friction is the cycle's level, which fades, times the curve.  A contact
with the belt before ``earliest`` is not a landing: the mass slips again as soon as the load exceeds its level, so the
motion depends continuously on the start of the window.  After the landing the next level applies.  There, and in a
window of stick, the mass sticks whatever the load, since no window contains the next break-away.  So the jump is nested
in its ramp.  If the mass overtakes the belt, it slips forwards under the new level until that stops it.

A slip window that starts within a ramp contains the break-away: there the ramp ends at the break-away level, static
times that of slip, at the half-width d.

The integration works for any curve and any small additional force.  A step ends at every sample and every change of
mode, and is short enough for the fastest rate of the motion.  On a ramp inertia is treated as small (`CREEP`), in steps
as long as those of a stick, once the transient has died out, or if the transient moves the mass by less than
`TRANSIENT_HIDDEN` of the spring's stretch.

Every function runs as written or compiled (`stickslip.compute.compile`).
"""

import math
from typing import NamedTuple

from fitting.model.unknowns import Global, PerCycle
from rig_sim.flow.modes import NEGATIVE, POSITIVE, RAMP, STICK
from rig_sim.friction.curve import MEASURED, magnitude, slope
from rig_sim.friction.spline import piece_of
from stickslip.compute.arrays import Array, Integers

SPLINE = MEASURED  # code of a curve given by knots and pieces
MOST_ITERATIONS = 30  # Newton steps on a compliant belt; it needs 3 to 5


class Contact(NamedTuple):
    """Friction of one run, for `friction`.

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
        z, first = s - c.table[i], c.pieces + 4 * i
        c1, c2, c3 = c.table[first + 1], c.table[first + 2], c.table[first + 3]
        return c.table[first] + z * (c1 + z * (c2 + z * c3)), c1 + z * (2.0 * c2 + z * 3.0 * c3)
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


CREEP = 4  # a mode in addition to `rig_sim.flow.modes`: a steep ramp, with the velocity of balanced forces

K, LOG_F, V_DR, SHAPE = int(Global.K), int(Global.LOG_F), int(Global.V_DR), int(Global.SHAPE)
D, DATUM, DAMPING, FADE = int(Global.D), int(Global.DATUM), int(Global.DAMPING), int(Global.FADE)
COMPLIANCE, COSINE, SINE, OMEGA = (
    int(Global.COMPLIANCE),
    int(Global.COSINE),
    int(Global.SINE),
    int(Global.OMEGA),
)
STATIC = int(Global.STATIC)
# Called in each step with all 49 numbers of a `Window`; without inlining a path takes 1.5 times as long.
INLINED = ("acceleration", "margin", "store_point")


class Drag(NamedTuple):
    """A drag on the mass: a table, extrapolated linearly; empty for none.

    ``velocity`` (G,) increases, m/s; ``acceleration`` (G,) is in m/s^2.  Within ``turn`` of rest (m/s) it may change
    steeply, which no step skips.
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


def interpolate(w: Window, row: int, t: float) -> float:
    """Return a row of `Extra.along` at time t by linear interpolation; 0 for no row."""
    if row == 0:
        return 0.0
    i = piece(w, t)
    j = min(i + 1, w.high - 1)
    gap = w.along[0, j] - w.along[0, i]
    share = (t - w.along[0, i]) / gap if gap > 0.0 else 0.0
    share = min(max(share, 0.0), 1.0)
    return float(w.along[row, i] + share * (w.along[row, j] - w.along[row, i]))


def interpolate_slope(w: Window, row: int, t: float) -> float:
    """Return the slope of a row of `Extra.along` just after time t, interpolated as by `interpolate`."""
    if row == 0 or not w.along[0, w.low] <= t < w.along[0, w.high - 1]:
        return 0.0
    i = piece(w, t)
    return float((w.along[row, i + 1] - w.along[row, i]) / (w.along[0, i + 1] - w.along[0, i]))


def belt_speed(w: Window, t: float) -> float:
    """Return the speed of the unloaded belt, m/s."""
    u, omega = w.u, w.u[OMEGA]
    steady = u[V_DR] + interpolate(w, w.belt, t)
    if omega == 0.0:
        return float(steady)
    return float(steady + u[COSINE] * math.cos(omega * t) + u[SINE] * math.sin(omega * t))


def belt_acceleration(w: Window, t: float) -> float:
    """Return the acceleration of the unloaded belt just after time t, m/s^2."""
    u, omega = w.u, w.u[OMEGA]
    if omega == 0.0 and w.belt == 0:
        return 0.0
    drift = interpolate_slope(w, w.belt, t)
    return float(drift + omega * (u[SINE] * math.cos(omega * t) - u[COSINE] * math.sin(omega * t)))


def fade_factor(fade: float, t: float, epoch: float) -> float:
    """Return the friction level at time t (s) over that at ``epoch``.

    Each cycle's level falls linearly in time; all lines have the same zero, as for the wear of the run: a constant rate
    left a residual of 2 um in a run of 16 s that lost a tenth of its level. ``fade`` is the loss per second over the
    level at 0 s.
    """
    return float((1.0 - fade * t) / (1.0 - fade * epoch))


def level_at(w: Window, t: float) -> float:
    """Return the friction level over F, which fades from the cycle's break-away on."""
    return float(w.level * fade_factor(w.u[FADE], t, w.epoch))


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
    return float(-w.u[K] * (x - w.u[DATUM]) + interpolate(w, w.force, t))


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
    steady = w.u[V_DR] + interpolate(w, w.belt, t)
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


# Longest step times the fastest rate: at 100 Hz positions in slips of the rig scene have errors of 2e-8 m, at twice
# this 1e-7 m, compared with microns of noise.  At 1 kHz one step a sample is shorter, except on steep ramps.
LONGEST_STEP = 0.1
SEARCH_STEP = 0.4  # longest step of a search: errors of positions are 0.5 um, which the last steps correct
# Distance of a ramp's transient over the spring's stretch under F.  At 1e-5 creep would omit a micron of the transient;
# at 1e-9 a steep ramp takes ten times as many steps.
TRANSIENT_HIDDEN = 1e-7
# Longest time constant of a ramp that creeps once its transient has died out, over the longest step of the oscillation.
# At twice that, tangents of a search have errors of 3e-3; at half, ramps of 12 mm/s take 9 steps a sample at 125 Hz.
STEEP_RAMP = 0.1
TRANSIENT_TIMES = 18.0  # time constants of a ramp after which its transient has died out: exp(-18) is 1.5e-8
# Step over the time to rest: at 0.5 the force of a sharp guide is accurate to 1e-3 of its change in one step.
STEP_IN_TURN = 0.5
# Step of a finite difference over the time in which creep changes: the relative error of its rate, plus rounding of
# 1e-12 m/s over d.
CREEP_DIFFERENCE = 1e-4
MOST_EVENTS = 200  # changes of mode in one window; a motion with more stays on an edge
MOST_BISECTIONS = 60  # halvings that find an event: a double has 53 binary digits

# Rows of the table of points.
TIME, POSITION, VELOCITY, BELT, LEVEL, FRICTION, SLOPE, SPEED, RESISTANCE = range(9)
# Columns of the table of steps: first of its three points, window, sample at its end or -1.
FIRST_POINT, WINDOW, SAMPLE = range(3)
X_SLIP, V_SLIP, OWN, NEXT, X_STICK, V_STICK = (int(column) for column in PerCycle)


def margin(w: Window, mode: int, lasts: bool, t: float, x: float, v: float) -> float:
    """Return the distance of a state from the edge of its mode (m/s, in stick m/s^2); negative after its end."""
    if lasts:
        return 1.0
    e, edge = belt_speed(w, t) - v, edge_speed(w.contact)
    if mode == NEGATIVE:
        return e - edge
    if mode == POSITIVE:
        return -e - edge
    if mode == STICK:
        return w.contact.static * level_at(w, t) * w.contact.F * w.contact.at_rest - abs(load(w, t, x))
    return edge - abs(e)


def margin_at_side(w: Window, mode: int, side: float, t: float, x: float, v: float) -> float:
    """Return `margin`, of a ramp from its edge where the belt is faster (``side`` 1.0) or slower (-1.0)."""
    if mode == RAMP or mode == CREEP:
        return edge_speed(w.contact) - side * (belt_speed(w, t) - v)
    return margin(w, mode, False, t, x, v)


def time_of_edge(w: Window, mode: int, t: float, x: float, v: float, h: float) -> float:
    """Return the part of the step h after which the mode ends, by bisection with a faster secant.

    A ramp ends at the edge on the final side of the step, since within rounding it begins on the other edge.
    """
    low, high = 0.0, h
    far_x, far_v = advance(w, mode, t, x, v, h)
    side = 1.0 if belt_speed(w, t + h) >= far_v else -1.0
    at_low = max(margin_at_side(w, mode, side, t, x, v), 0.0)
    at_high = margin_at_side(w, mode, side, t + h, far_x, far_v)
    for number in range(MOST_BISECTIONS):
        if high - low <= 1e-15 * (abs(t) + h) or at_low == 0.0:
            break
        guess = low + (high - low) * at_low / (at_low - at_high) if number % 3 < 2 else 0.5 * (low + high)
        if not low < guess < high:
            guess = 0.5 * (low + high)
        x_guess, v_guess = advance(w, mode, t, x, v, guess)
        value = margin_at_side(w, mode, side, t + guess, x_guess, v_guess)
        if value > 0.0:
            low, at_low = guess, value
        else:
            high, at_high = guess, value
    return low


def next_mode(w: Window, mode: int, t: float, x: float, v: float) -> int:
    """Return the mode that follows at an edge, as in `rig_sim.flow.modes`; a steep ramp creeps."""
    edge, pull = edge_speed(w.contact), load(w, t, x)
    if mode == STICK:
        return NEGATIVE if pull > 0.0 else POSITIVE
    if mode == RAMP or mode == CREEP:
        return NEGATIVE if belt_speed(w, t) > v else POSITIVE
    if edge > 0.0:
        return ramp_mode(w, False, t, x)
    most = level_at(w, t) * w.contact.F * w.contact.at_rest
    if mode == NEGATIVE:
        return POSITIVE if pull < -most else STICK
    return NEGATIVE if pull > most else STICK


def ramp_mode(w: Window, lasts: bool, t: float, x: float) -> int:
    """Return the mode in which a ramp is entered: CREEP if its transient is negligible, else RAMP.

    If the forces balance only outside the ramp, the transient carries the mass through it without creep.
    """
    edge = edge_speed(w.contact)
    _, rise, _ = friction(w.contact, RAMP, 0.0, level_at(w, t))
    stretch = w.contact.F * w.contact.at_rest / w.u[K]
    return CREEP if edge < TRANSIENT_HIDDEN * rise * stretch and balances(w, lasts, t, x) else RAMP


def balances(w: Window, lasts: bool, t: float, x: float) -> bool:
    """Return whether the forces balance within the ramp, which has no edge if ``lasts``."""
    return lasts or abs(belt_speed(w, t) - bound_velocity(w, CREEP, t, x)) < edge_speed(w.contact)


def can_creep(w: Window, lasts: bool, t: float, x: float, since: float, longest: float) -> bool:
    """Return whether a ramp entered at time ``since`` can creep in steps ``longest`` times the fastest rate.

    The error is of second order in K/rise^2, like that of a step.
    """
    _, rise, _ = friction(w.contact, RAMP, 0.0, level_at(w, t))
    steep = math.sqrt(w.u[K]) < STEEP_RAMP * longest * rise
    return steep and (t - since) * rise > TRANSIENT_TIMES and balances(w, lasts, t, x)


def turning_step(w: Window, mode: int, t: float, x: float, v: float) -> float:
    """Return the longest step (s) that resolves a steep change of drag where the mass turns."""
    turn = w.turn
    if turn == 0.0 or mode == STICK or mode == CREEP:
        return math.inf
    return float(STEP_IN_TURN * (abs(v) + turn) / (abs(acceleration(w, mode, t, x, v)) + 1e-300))


def fastest_rate(w: Window, mode: int, t: float, v: float) -> float:
    if mode == STICK:
        return float(w.u[OMEGA])
    if mode == CREEP:
        return float(w.u[OMEGA] + math.sqrt(w.u[K]))
    _, slope, _ = friction(w.contact, mode, belt_speed(w, t) - v, level_at(w, t))
    return float(w.u[OMEGA] + math.sqrt(w.u[K]) + w.u[DAMPING] + abs(slope))


def store_point(w: Window, mode: int, t: float, x: float, v: float, points: Array, i: int) -> None:
    """Store one stage point in column i of ``points`` (9, M)."""
    belt, level = belt_speed(w, t), level_at(w, t)
    force, slope, s = 0.0, 0.0, 0.0
    if mode == STICK:
        force = load(w, t, x)
    else:
        force, slope, s = friction(w.contact, RAMP if mode == CREEP else mode, belt - v, level)
    points[TIME, i], points[POSITION, i], points[VELOCITY, i] = t, x, v
    points[BELT, i], points[LEVEL, i] = belt, level
    points[FRICTION, i], points[SLOPE, i], points[SPEED, i] = force, slope, s
    points[RESISTANCE, i] = w.u[DAMPING] - drag(w, v)[1]


def store_middle(w: Window, mode: int, t: float, h: float, points: Array, i: int) -> None:
    """Store the midpoint of the step from point i to i + 2, by Hermite's cubic between them."""
    x0, x1 = points[POSITION, i], points[POSITION, i + 2]
    v0, v1 = points[VELOCITY, i], points[VELOCITY, i + 2]
    middle = t + 0.5 * h
    x = 0.5 * (x0 + x1) + 0.125 * h * (v0 - v1)
    if mode == STICK or mode == CREEP:
        v = bound_velocity(w, mode, middle, x)
    else:
        a0 = free_force(w, t, x0) - resistance(w, v0) + points[FRICTION, i]
        a1 = free_force(w, t + h, x1) - resistance(w, v1) + points[FRICTION, i + 2]
        v = 0.5 * (v0 + v1) + 0.125 * h * (a0 - a1)
    store_point(w, mode, middle, x, v, points, i + 1)


def first_mode(w: Window, stick: bool, t: float, x: float, v: float) -> tuple[int, float]:
    """Return the first mode of a window, and the velocity: the belt's where the mass is bound to it."""
    belt, edge = belt_speed(w, t), edge_speed(w.contact)
    if stick and edge == 0.0:
        mode = STICK
        v = belt
    elif stick:
        mode = ramp_mode(w, True, t, x)
        v = min(max(v, belt - 10 * edge), belt + 10 * edge)
    elif edge > 0.0 and abs(belt - v) <= edge:
        mode = ramp_mode(w, False, t, x)
    else:
        mode = NEGATIVE if belt - v >= 0.0 else POSITIVE
    if mode == CREEP:
        v = bound_velocity(w, mode, t, x)
    return mode, v


def mode_at_edge(
    w: Window,
    before: int,
    lasts: bool,
    landed: bool,
    overtakes: bool,
    earliest: float,
    next_level: float,
    t: float,
    x: float,
    v: float,
) -> tuple[int, bool, bool, float]:
    """Return the mode after one that has ended, whether it lasts to the window's end, whether landed, and the level.

    The first contact with the belt from ``earliest`` on is the landing: the next level applies, and the mass sticks to
    the window's end, or overtakes the belt and sticks when it returns.
    """
    jump = edge_speed(w.contact) == 0.0
    if landed and before == POSITIVE:
        return STICK if jump else ramp_mode(w, True, t, x), True, True, w.level
    if landed or before != NEGATIVE or t < earliest:
        return next_mode(w, before, t, x, v), lasts, landed, w.level
    if jump:
        return POSITIVE if overtakes else STICK, not overtakes, True, next_level
    after = at_level(w, next_level)
    return ramp_mode(after, not overtakes, t, x), not overtakes, True, next_level


def contact_of(curve: int, u: Array, ramp: int, pieces: int, spline: Array) -> Contact:
    """Return the contact of a run with unknowns ``u`` (13,)."""
    F = math.exp(u[LOG_F])
    d = u[D] if ramp == 1 else 0.0
    q = u[COMPLIANCE] * F / u[K]
    c = Contact(curve, F, u[SHAPE], d, q, 1.0, 1.0, pieces, spline)
    static = u[STATIC] if ramp == 1 and q == 0.0 else 1.0
    return Contact(curve, F, u[SHAPE], d, q, static, normal_curve(c, 0.0)[0], pieces, spline)


def step_to_edge(
    w: Window, mode: int, lasts: bool, t: float, x: float, v: float, h: float
) -> tuple[float, float, float, bool]:
    """Return (x, v) after a step of length h, cut where the mode ends; its length, and whether the mode ends."""
    x1, v1 = advance(w, mode, t, x, v, h)
    ends = margin(w, mode, lasts, t + h, x1, v1) < 0.0 and math.isfinite(x1 + v1)
    if ends:
        h = time_of_edge(w, mode, t, x, v, h)
        x1, v1 = advance(w, mode, t, x, v, h)
    return x1, v1, h, ends


def window_at(
    row: int,
    curve: int,
    u: Array,
    local: Array,
    table: Integers,
    epoch: Array,
    pieces: int,
    spline: Array,
    ramp: int,
    extra: Extra,
) -> tuple[Window, float, float, float]:
    """Return the numbers of a window, its first position and velocity, and the next level; `follow_windows`."""
    u_of_run, start = u[table[row, 5]], local[table[row, 0]]
    c = contact_of(curve, u_of_run, ramp, pieces, spline)
    low, high = 0, 0
    if extra.along.size > 0:
        low, high = extra.first[row], extra.first[row + 1]
    acts = extra.along, extra.force, extra.belt, extra.drag, extra.turn
    w = Window(u_of_run, c, math.exp(start[OWN]), epoch[row], low, high, *acts)
    x, v = (start[X_STICK], start[V_STICK]) if table[row, 1] == 1 else (start[X_SLIP], start[V_SLIP])
    return w, x, v, math.exp(start[NEXT])


def follow_window(
    w: Window,
    stick: bool,
    x: float,
    v: float,
    earliest: float,
    overtakes: bool,
    next_level: float,
    longest: float,
    times: Array,
    first_sample: int,
    row: int,
    points: Array,
    kinds: Integers,
    steps: Integers,
    jumps: Array,
    reached: Integers,
    m: int,
    s: int,
) -> tuple[int, int]:
    """Follow one window from its start; return the numbers of points and of steps stored.

    ``points`` (9, M), ``kinds`` (2, M) (mode, and 1 after the landing), ``steps`` (S, 3), ``jumps`` (S, 3) (`crossing`)
    and ``reached`` (N,), the point of each sample, are filled from ``m`` and ``s`` on. Returns (-1, 0) where they are
    too small, and (0, -1) where the motion cannot be followed.
    """
    t = times[0]
    lasts, landed = stick, stick
    mode, v = first_mode(w, stick, t, x, v)
    i, events, entered, since = 0, 0, True, t
    while True:
        if m + 4 > points.shape[1] or s >= steps.shape[0]:  # a change of mode, and the middle and end of a step
            return -1, 0
        if mode == RAMP and not entered and can_creep(w, lasts, t, x, since, longest):
            mode = CREEP
            v = bound_velocity(w, mode, t, x)
            m += 1
            entered = True
        if entered:
            store_point(w, mode, t, x, v, points, m)
            kinds[0, m], kinds[1, m] = mode, int(landed)
            entered = False
            if i == 0:
                reached[first_sample] = m
                i = 1
                if times.size == 1:
                    return m + 1, s
        gap = times[i] - t
        h = gap / max(1.0, math.ceil(gap * fastest_rate(w, mode, t, v) / longest))
        h = min(h, turning_step(w, mode, t, x, v))
        x1, v1, h, ends = step_to_edge(w, mode, lasts, t, x, v, h)
        if not math.isfinite(x1 + v1):
            return 0, -1
        done = not ends and h >= gap
        begun = t
        t = times[i] if done else t + h
        store_point(w, mode, t, x1, v1, points, m + 2)
        store_middle(w, mode, begun, t - begun, points, m)
        for j in range(m + 1, m + 3):
            kinds[0, j], kinds[1, j] = mode, int(landed)
        steps[s, FIRST_POINT], steps[s, WINDOW], steps[s, SAMPLE] = m, row, -1
        jumps[s, 0] = jumps[s, 1] = jumps[s, 2] = 0.0
        if done:
            steps[s, SAMPLE] = first_sample + i
            reached[first_sample + i] = m + 2
            i += 1
        m, s = m + 2, s + 1
        x, v = x1, v1
        if i == times.size:
            return m + 1, s
        if ends:
            events += 1
            if events > MOST_EVENTS:
                return 0, -1
            before = mode
            rates_before = rates_at(w, before, t, x, v)
            mode, lasts, landed, level = mode_at_edge(
                w, before, lasts, landed, overtakes, earliest, next_level, t, x, v
            )
            w = at_level(w, level)
            if mode == STICK or mode == CREEP:
                v = bound_velocity(w, mode, t, x)
            # Position, velocity, force and tangents are continuous at the end of a ramp that has the level of slip.
            if before != STICK and not (w.contact.static == 1.0 and (before == RAMP or before == CREEP)):
                crossing(w, before, rates_before, mode, t, x, v, jumps[s - 1])
            m += 1
            entered, since = True, t


def rates_at(w: Window, mode: int, t: float, x: float, v: float) -> tuple[float, float]:
    """Return x' (m/s) and belt' - x'' (m/s^2) of a state in its mode."""
    if mode == STICK:
        return v, 0.0
    if mode == CREEP:
        # Of the difference of both velocities: on a steep ramp the difference of both accelerations is rounding.
        h = CREEP_DIFFERENCE / fastest_rate(w, mode, t, v)
        later = belt_speed(w, t + h) - bound_velocity(w, mode, t + h, x + h * v)
        return v, (later - (belt_speed(w, t) - bound_velocity(w, mode, t, x))) / h
    return v, belt_acceleration(w, t) - acceleration(w, mode, t, x, v)


def crossing(
    w: Window, before: int, old: tuple[float, float], mode: int, t: float, x: float, v: float, out: Array
) -> None:
    """Store in ``out`` (3,) the effect of a change of mode at a relative speed of +-edge on a tangent.

    The change comes later by dt = (d belt - d x' -+ d edge) / (x'' - belt'), and with it the change of x' and x'': d x
    += out[0] (d belt - d x' - out[2] d edge), d x' += out[1] (the same).
    """
    new = rates_at(w, mode, t, x, v)
    approach = -old[1]
    if approach == 0.0:
        return
    out[0], out[1] = (old[0] - new[0]) / approach, (new[1] - old[1]) / approach
    out[2] = -1.0 if before == POSITIVE or (before != NEGATIVE and belt_speed(w, t) < v) else 1.0


def follow_windows(
    curve: int,
    u: Array,
    local: Array,
    table: Integers,
    epoch: Array,
    earliest: Array,
    time: Array,
    pieces: int,
    spline: Array,
    ramp: int,
    extra: Extra,
    longest: float,
    points: Array,
    kinds: Integers,
    steps: Integers,
    jumps: Array,
    reached: Integers,
    first_point: Integers,
    first_step: Integers,
) -> int:
    """Follow all windows; return 0, -1 where the arrays are too small, or 1 + the window that cannot be followed.

    ``longest`` is the longest step times the fastest rate. ``u`` (runs, 13), ``local`` (cycles, 6), ``table`` (windows,
    6) and the times are those of `ShootingWindows`; ``first_point`` and ``first_step`` (windows + 1,) receive the
    windows' first indices.
    """
    m, s = 0, 0
    for row in range(table.shape[0]):
        first, n = table[row, 2], table[row, 3]
        w, x, v, next_level = window_at(row, curve, u, local, table, epoch, pieces, spline, ramp, extra)
        first_point[row], first_step[row] = m, s
        m, s = follow_window(
            w,
            table[row, 1] == 1,
            x,
            v,
            earliest[row],
            table[row, 4] == 1,
            next_level,
            longest,
            time[first : first + n],
            first,
            row,
            points,
            kinds,
            steps,
            jumps,
            reached,
            m,
            s,
        )
        if m < 0:
            return -1
        if s < 0:
            return 1 + row
    first_point[table.shape[0]], first_step[table.shape[0]] = m, s
    return 0
