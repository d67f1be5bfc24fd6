"""Kernels: the motion along the windows of a fit by the classical Runge-Kutta method, stored where tangents need it.

A window is followed from its own start; friction is the cycle's level times the curve, less what the level has faded
by.  A touch of the belt before ``earliest`` is no landing: the mass slips on as soon as the load exceeds its level, so
the motion depends continuously on where the window starts.  From the landing on the next level holds, and there and in
a window of stick the contact holds whatever the load: the next break-away lies in no window.  So a ramp contains its
jump.  Where the mass was seen to overtake the belt it slips on forwards under the new level, until that stops it.

A slip window that starts within a ramp contains the break-away: there the ramp ends at the break-away level, static
times that of slip, at the half-width d.

The motion is stepped, for any curve and any small force besides.  A step ends at every sample and every change of mode.
It is short enough for the fastest rate of the motion.  A ramp is followed with next to no inertia (`CREEP`), in steps
as long as those of a stick, once its transient has died out, or where that moves the mass by less than
`TRANSIENT_HIDDEN` of the spring's stretch.

Every function runs as written or compiled (`stickslip.compute.compile`).
"""

import math

from fitting.model.parameters import PerCycle
from fitting.sensitivity.friction import Contact, edge_speed, friction, normal_curve
from fitting.sensitivity.rates import (
    COMPLIANCE,
    CREEP,
    DAMPING,
    LOG_F,
    OMEGA,
    SHAPE,
    STATIC,
    D,
    Extra,
    K,
    Window,
    acceleration,
    advance,
    at_level,
    belt_acceleration,
    belt_speed,
    bound_velocity,
    drag,
    free_force,
    level_at,
    load,
    resistance,
)
from rig_sim.flow.modes import NEGATIVE, POSITIVE, RAMP, STICK
from stickslip.compute.arrays import Array, Integers

# Longest step times the fastest rate: at 100 Hz positions of the rig scene's slips err by 2e-8 m, doubled by 1e-7 m,
# against microns of noise.  At 1 kHz one step a sample is shorter than that anyhow, but on steep ramps.
LONGEST_STEP = 0.1
SEARCH_STEP = 0.4  # longest step while searching: positions err by 0.5 um, which the last steps mend
# Way of a ramp's transient over the spring's stretch under F.  At 1e-5 a ramp's creep would miss a micron of its
# transient; at 1e-9 a steep ramp takes ten times as many steps.
TRANSIENT_HIDDEN = 1e-7
# Longest time constant of a ramp that creeps once its transient has died out, over the longest step of the oscillation.
# At twice that, tangents of a search err by 3e-3; at half, ramps of 12 mm/s take 9 steps a sample of 125 Hz, not 1.4.
STEEP_RAMP = 0.1
TRANSIENT_TIMES = 18.0  # time constants of a ramp after which its transient has died out: exp(-18) is 1.5e-8
# Step over the time to rest: at a half a sharp guide's force is followed to 1e-3 of its change in one step.
STEP_IN_TURN = 0.5
# Step of a difference over the time in which a creep changes: its rate errs by so much of itself, and by rounding,
# 1e-12 m/s over d.
CREEP_DIFFERENCE = 1e-4
MOST_EVENTS = 200  # changes of mode in one window; more is a motion that stays on an edge
INLINED = ("margin", "store_point")  # called each step with all of a `Window`: a path took half as long again
MOST_BISECTIONS = 60  # halvings that find an event: a double has 53 binary digits

# Rows of the table of points.
TIME, POSITION, VELOCITY, BELT, LEVEL, FRICTION, SLOPE, SPEED, RESISTANCE = range(9)
# Columns of the table of steps: first of its three points, window, sample at its end or -1.
FIRST_POINT, WINDOW, SAMPLE = range(3)
X_SLIP, V_SLIP, OWN, NEXT, X_STICK, V_STICK = (int(column) for column in PerCycle)


def margin(w: Window, mode: int, held: bool, t: float, x: float, v: float) -> float:
    """Return the distance of a state from the edge of its mode (m/s, in stick m/s^2); negative after its end."""
    if held:
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

    A ramp ends at the edge on the step's final side: it begins on the other one, within rounding.
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


def ramp_mode(w: Window, held: bool, t: float, x: float) -> int:
    """Return the mode in which a ramp is entered: CREEP where its transient would not show, else RAMP.

    Where the forces balance beyond the ramp, its transient carries the mass through it: no creep.
    """
    edge = edge_speed(w.contact)
    _, rise, _ = friction(w.contact, RAMP, 0.0, level_at(w, t))
    stretch = w.contact.F * w.contact.at_rest / w.u[K]
    return CREEP if edge < TRANSIENT_HIDDEN * rise * stretch and balances(w, held, t, x) else RAMP


def balances(w: Window, held: bool, t: float, x: float) -> bool:
    """Return whether the forces balance within the ramp, which has no edge where the contact is held."""
    return held or abs(belt_speed(w, t) - bound_velocity(w, CREEP, t, x)) < edge_speed(w.contact)


def settled(w: Window, held: bool, t: float, x: float, since: float, longest: float) -> bool:
    """Return whether a ramp entered at time ``since`` can creep in steps ``longest`` times the fastest rate.

    The error is of second order in K/rise^2, like that of a step.
    """
    _, rise, _ = friction(w.contact, RAMP, 0.0, level_at(w, t))
    steep = math.sqrt(w.u[K]) < STEEP_RAMP * longest * rise
    return steep and (t - since) * rise > TRANSIENT_TIMES and balances(w, held, t, x)


def turning_step(w: Window, mode: int, t: float, x: float, v: float) -> float:
    """Return the longest step (s) that resolves a steep change of drag as the mass turns round."""
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
    held: bool,
    landed: bool,
    overtakes: bool,
    earliest: float,
    next_level: float,
    t: float,
    x: float,
    v: float,
) -> tuple[int, bool, bool, float]:
    """Return the mode after one that has ended, whether it is held to the window's end, has landed, and the level.

    The first touch of the belt from ``earliest`` on is the landing: the next level holds, and the mass sticks to the
    window's end, or overtakes the belt and sticks when it comes back.
    """
    jump = edge_speed(w.contact) == 0.0
    if landed and before == POSITIVE:
        return STICK if jump else ramp_mode(w, True, t, x), True, True, w.level
    if landed or before != NEGATIVE or t < earliest:
        return next_mode(w, before, t, x, v), held, landed, w.level
    if jump:
        return POSITIVE if overtakes else STICK, not overtakes, True, next_level
    after = at_level(w, next_level)
    return ramp_mode(after, not overtakes, t, x), not overtakes, True, next_level


def contact_of(curve: int, own: Array, ramp: int, pieces: int, spline: Array) -> Contact:
    """Return the contact of a run with unknowns ``own`` (13,)."""
    F = math.exp(own[LOG_F])
    d = own[D] if ramp == 1 else 0.0
    q = own[COMPLIANCE] * F / own[K]
    c = Contact(curve, F, own[SHAPE], d, q, 1.0, 1.0, pieces, spline)
    static = own[STATIC] if ramp == 1 and q == 0.0 else 1.0
    return Contact(curve, F, own[SHAPE], d, q, static, normal_curve(c, 0.0)[0], pieces, spline)


def step_to_edge(
    w: Window, mode: int, held: bool, t: float, x: float, v: float, h: float
) -> tuple[float, float, float, bool]:
    """Return (x, v) after a step of length h, cut where the mode ends; its length, and whether the mode ends."""
    x1, v1 = advance(w, mode, t, x, v, h)
    ends = margin(w, mode, held, t + h, x1, v1) < 0.0 and math.isfinite(x1 + v1)
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
    own, part = u[table[row, 5]], local[table[row, 0]]
    c = contact_of(curve, own, ramp, pieces, spline)
    low, high = 0, 0
    if extra.along.size > 0:
        low, high = extra.first[row], extra.first[row + 1]
    acts = extra.along, extra.force, extra.belt, extra.drag, extra.turn
    w = Window(own, c, math.exp(part[OWN]), epoch[row], low, high, *acts)
    x, v = (part[X_STICK], part[V_STICK]) if table[row, 1] == 1 else (part[X_SLIP], part[V_SLIP])
    return w, x, v, math.exp(part[NEXT])


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
    held, landed = stick, stick
    mode, v = first_mode(w, stick, t, x, v)
    i, events, entered, since = 0, 0, True, t
    while True:
        if m + 4 > points.shape[1] or s >= steps.shape[0]:  # a change of mode, and the middle and end of a step
            return -1, 0
        if mode == RAMP and not entered and settled(w, held, t, x, since, longest):
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
        x1, v1, h, ends = step_to_edge(w, mode, held, t, x, v, h)
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
            mode, held, landed, level = mode_at_edge(w, before, held, landed, overtakes, earliest, next_level, t, x, v)
            w = at_level(w, level)
            if mode == STICK or mode == CREEP:
                v = bound_velocity(w, mode, t, x)
            # Off a ramp that ends at the level of slip, position, velocity and force go on, and so does a tangent.
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
