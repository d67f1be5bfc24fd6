"""Two coupled masses on the belt: the motion in each mode by Taylor series, and its events.

Each mass sticks or slips (`rig_sim.flow.two_mass` has the equations), backwards (NEGATIVE) or forwards (POSITIVE) of
the belt.  While both stick the motion is known; otherwise both positions are one power series in time, of ``degree``
terms, over a step at whose end the last terms fall below ``tolerance`` of the first ones.  A mass lands where its
relative velocity reaches 0, and breaks away where its load reaches the break-away level: the first root of a polynomial
in either case.

State and series stand in one record, a `Pair`: mirrored so that the belt moves forwards, y = x - x0.
"""

import math
from dataclasses import dataclass

from rig_sim.flow.frame import Frame
from rig_sim.flow.modes import EVENT_RATE, FORCE_REVERSAL, NEGATIVE, NOT_FINITE, POSITIVE, STEP_LIMIT, STICK
from rig_sim.friction.curve import HYPERBOLIC, LINEAR
from rig_sim.integrate.newton import EPS
from rig_sim.integrate.phases import RAPID_ALLOWED, RAPID_TIME
from rig_sim.integrate.polynomial import bound_spread, first_root
from rig_sim.integrate.taylor import INVERSE
from rig_sim.integrate.work import COEFFICIENTS, Series, new_record

LAST = COEFFICIENTS - 1  # index of the friction's first coefficient

# Events other than the end of time: the mass, times the side by which its velocity or load leaves
FIRST, SECOND, CROSSING = 1, 2, 3  # CROSSING: the first mass's velocity over ground passes 0
ROUNDING = 16.0 * EPS  # share of the largest term of a force within which it counts as at its level
BEYOND = 1e-300  # m/s: not 0, but negligible
LONGEST = 4.0  # length of a step in units of TIME_SCALE, as in `rig_sim.integrate.taylor`
# Of TIME_SCALE, sqrt(m/k): largest step of masses exactly at rest, whose steps grow by LONGEST each.
LONGEST_SCALE = 1e9


@dataclass(slots=True)
class Pair:
    """The record of two masses."""

    w1: Series  # relative velocities, m/s; the first coefficients are the state
    w2: Series
    y1: Series  # positions, m
    y2: Series
    load: Series  # load on the contact of the mass that sticks, N
    # friction over the mass, m/s per unit of the series' time; coefficient n is n places before the last one
    f1: Series
    f2: Series
    mode1: float
    mode2: float
    time: float  # s
    steps: float
    steps_allowed: float
    rapid: float  # events in a row without time passing
    time_scale: float  # unit of time of the last step, s
    section: float  # 1 if the section's crossings are requested


def new_pair(max_steps: int, *, compiled: bool = False) -> Pair:
    """Return the record of two masses, for interpreted or for compiled calls, with ``max_steps`` allowed."""
    pair = new_record(Pair, compiled=compiled)
    pair.steps_allowed = float(max_steps)
    return pair


def load(fr: Frame, a: float, y: float, other: float) -> float:
    """Return the load (N) on the contact of the mass at y while it sticks, the other at ``other``."""
    return fr.k * (1.0 + a) * y - fr.k * a * other + fr.c * fr.v


def contact_mode(fr: Frame, ratio: float, a: float, y: float, other: float, w: float) -> int:
    """Return the mode of a mass with relative velocity w, whose levels are ``ratio`` times those of the frame."""
    if w < 0.0:
        return NEGATIVE
    if w > 0.0:
        return POSITIVE
    L = load(fr, a, y, other)
    level = ratio * fr.B
    rounding = ROUNDING * (level + fr.k * (1.0 + a) * abs(y) + fr.k * a * abs(other))
    if L > level + rounding:
        return NEGATIVE
    return POSITIVE if L < -level - rounding else STICK


def set_state(fr: Frame, a: float, b: float, y1: float, w1: float, y2: float, w2: float, t: float, work: Pair) -> None:
    """Set both masses to a state (m and m/s, mirrored) at time t (s)."""
    work.y1[0], work.w1[0], work.y2[0], work.w2[0], work.time = y1, w1, y2, w2, t
    work.mode1 = float(contact_mode(fr, 1.0, a, y1, y2, w1))
    work.mode2 = float(contact_mode(fr, b, a, y2, y1, w2))
    work.rapid = 0.0
    work.time_scale = 0.5 / (fr.omega0 * math.sqrt(1.0 + 2.0 * a))


def begin_slip(
    fr: Frame, ratio: float, a: float, mode: int, w_s: Series, y_s: Series, f_s: Series, other: Series, inertia: float
) -> float:
    """Store a slipping mass's friction and first coefficients at the start of a step; return its friction's bend (s/m).

    The friction is a constant over 1 + bend (w - w0).  On the edge of slip the acceleration never points back over it,
    nor does rounding make one.
    """
    sign = 1.0 if mode == NEGATIVE else -1.0
    w = w_s[0]
    force = sign * ratio * fr.A
    damping = fr.c
    bend = 0.0
    if fr.curve == HYPERBOLIC:
        steepness = 1.0 / (1.0 + fr.gamma * abs(w))
        force *= steepness
        bend = -sign * fr.gamma * steepness
    elif fr.curve == LINEAR:
        damping -= ratio * fr.G
    spring_pull = fr.k * (1.0 + a) * y_s[0]
    coupling_pull = fr.k * a * other[0]
    balance = force - fr.c * fr.v - damping * w - spring_pull + coupling_pull
    if w == 0.0 and (
        sign * balance > 0.0 or abs(balance) <= ROUNDING * (abs(force) + abs(spring_pull) + abs(coupling_pull))
    ):
        balance = 0.0
    f_s[LAST] = force * inertia
    w_s[1] = balance * inertia
    return bend


def inner_terms(w: Series, f: Series, n: int) -> float:
    """Return the sum of w_j F_(n - j) over j from 2 to n - 1, for n of 2 and more.

    The caller adds the terms w_1 F_(n - 1) and w_n F_0: their newest factors are known last, and no longer sum has to
    wait for them.
    """
    even = odd = 0.0
    i = LAST - n + 2
    even_end = n - n % 2
    for j in range(2, even_end, 2):
        even += w[j] * f[i]
        odd += w[j + 1] * f[i + 1]
        i += 2
    if n % 2 == 1:
        even += w[n - 1] * f[LAST - 1]
    return even + odd


def expand(fr: Frame, a: float, b: float, degree: int, tolerance: float, work: Pair) -> float:
    """Fill in the series of a step in which one mass slips, or both; return its length in units of TIME_SCALE.

    That unit is the length of the step before, so that no coefficient overflows.  The friction over the mass obeys
    F_n = -bend (w_1 F_(n - 1) + ... + w_n F_0), and w_(n + 1) = (F_n + forces of springs and damper) / (n + 1).
    """
    mode1, mode2 = int(work.mode1), int(work.mode2)
    T = work.time_scale
    inertia = T / fr.m
    work.w1[1] = work.w2[1] = 0.0
    work.y1[1] = work.y2[1] = fr.v * T
    bend1 = bend2 = 0.0
    if mode1 != STICK:
        bend1 = begin_slip(fr, 1.0, a, mode1, work.w1, work.y1, work.f1, work.y2, inertia)
        work.y1[1] = (work.w1[0] + fr.v) * T
    if mode2 != STICK:
        bend2 = begin_slip(fr, b, a, mode2, work.w2, work.y2, work.f2, work.y1, inertia)
        work.y2[1] = (work.w2[0] + fr.v) * T
    w1, y1, w2, y2 = work.w1[1], work.y1[1], work.w2[1], work.y2[1]
    lead1 = -bend1 * w1
    scaled1 = -bend1 * work.f1[LAST]
    f1 = scaled1 * w1
    work.f1[LAST - 1] = f1
    lead2 = -bend2 * w2
    scaled2 = -bend2 * work.f2[LAST]
    f2 = scaled2 * w2
    work.f2[LAST - 1] = f2
    curved = fr.curve == HYPERBOLIC
    damping1 = (fr.c - fr.G if fr.curve == LINEAR else fr.c) * inertia
    damping2 = (fr.c - b * fr.G if fr.curve == LINEAR else fr.c) * inertia
    spring = fr.k * (1.0 + a) * inertia
    coupling = fr.k * a * inertia
    for n in range(1, degree):
        share = INVERSE[n + 1]
        sum1 = coupling * y2 - spring * y1 - damping1 * w1
        sum2 = coupling * y1 - spring * y2 - damping2 * w2
        y1 = y2 = 0.0
        if mode1 != STICK:
            y1 = T * w1 * share
            sum1 += f1
            w1 = sum1 * share
            work.w1[n + 1] = w1
            if curved:
                f1 = lead1 * f1 - bend1 * inner_terms(work.w1, work.f1, n + 1) + scaled1 * share * sum1
                work.f1[LAST - n - 1] = f1
        if mode2 != STICK:
            y2 = T * w2 * share
            sum2 += f2
            w2 = sum2 * share
            work.w2[n + 1] = w2
            if curved:
                f2 = lead2 * f2 - bend2 * inner_terms(work.w2, work.f2, n + 1) + scaled2 * share * sum2
                work.f2[LAST - n - 1] = f2
        work.y1[n + 1] = y1
        work.y2[n + 1] = y2
    growth = math.inf
    if mode1 != STICK:
        growth = allowance(fr, work.w1, degree, tolerance)
    if mode2 != STICK:
        growth = min(growth, allowance(fr, work.w2, degree, tolerance))
    if not growth > 0.0:  # the last terms have overflown
        return 0.0
    return min(math.exp2(math.log2(growth) * INVERSE[degree]), LONGEST)


def allowance(fr: Frame, w: Series, degree: int, tolerance: float) -> float:
    """Return the factor by which the terms of highest degree may grow until ``tolerance`` of the first ones is reached.

    The larger of the last two coefficients is compared with the belt's speed or the largest of the first three.
    """
    last = max(abs(w[degree]), abs(w[degree - 1]))
    first = max(abs(w[0]), abs(w[1]), abs(w[2]), fr.v)
    return tolerance * first / last if last > 0.0 else math.inf


def fill_load(
    fr: Frame, a: float, ratio: float, position: Series, other_position: Series, degree: int, work: Pair
) -> None:
    """Fill in the series of the load on the mass that sticks; within rounding of a level it is set to it."""
    stiff = fr.k * (1.0 + a)
    coupling = fr.k * a
    for j in range(degree + 1):
        work.load[j] = stiff * position[j] - coupling * other_position[j]
    work.load[0] += fr.c * fr.v
    level = ratio * fr.B
    rounding = ROUNDING * (level + stiff * abs(position[0]) + coupling * abs(other_position[0]))
    if abs(work.load[0] - level) <= rounding:
        work.load[0] = level
    elif abs(work.load[0] + level) <= rounding:
        work.load[0] = -level


def first_event(fr: Frame, a: float, b: float, degree: int, end: float, work: Pair) -> tuple[int, float]:
    """Return the first event of a step of length ``end`` and where it is; (0, end) without one."""
    mode1, mode2 = int(work.mode1), int(work.mode2)
    level = math.inf
    if mode1 == STICK:
        fill_load(fr, a, 1.0, work.y1, work.y2, degree, work)
        level = fr.B
    elif mode2 == STICK:
        fill_load(fr, a, b, work.y2, work.y1, degree, work)
        level = b * fr.B
    if level < math.inf and abs(work.load[0]) + bound_spread(work.load, degree, end) < level:
        level = math.inf
    event = 0
    for candidate in range(7):
        series, side, mass, edge = work.w1, 0, 0, 0.0
        if candidate < 2:
            if mode1 != STICK and (candidate == 0 or not math.isinf(fr.s_max)):
                mass, side = FIRST, slip_side(mode1, candidate)
                edge = 0.0 if candidate == 0 else side * fr.s_max
        elif candidate < 4:
            if mode2 != STICK and (candidate == 2 or not math.isinf(fr.s_max)):
                series, mass, side = work.w2, SECOND, slip_side(mode2, candidate - 2)
                edge = 0.0 if candidate == 2 else side * fr.s_max
        elif candidate < 6:
            if not math.isinf(level):
                series, mass, side = work.load, (FIRST if mode1 == STICK else SECOND), 9 - 2 * candidate
                edge = side * level
        elif work.section == 1.0 and mode1 == NEGATIVE:
            edge = -fr.v
            mass, side = CROSSING, -1 if work.w1[0] > edge or (work.w1[0] == edge and work.w1[1] > 0.0) else 1
        if side == 0:
            continue
        xi = first_root(series, degree, edge, side, end)
        if xi >= 0.0:
            event, end = side * mass, xi
    return event, end


def slip_side(mode: int, far: int) -> int:
    """Return the side on which a slip ends: near 0 (``far`` 0), or at force reversal (1)."""
    return 1 if (mode == NEGATIVE) != (far == 1) else -1


def move(degree: int, xi: float, work: Pair) -> None:
    """Move the state to ``xi`` (in units of TIME_SCALE) within the step."""
    y1, y2, w1, w2 = work.y1[degree], work.y2[degree], work.w1[degree], work.w2[degree]
    slips1, slips2 = work.mode1 != STICK, work.mode2 != STICK
    for j in range(degree - 1, -1, -1):
        y1 = y1 * xi + work.y1[j]
        y2 = y2 * xi + work.y2[j]
        w1 = w1 * xi + work.w1[j]
        w2 = w2 * xi + work.w2[j]
    work.y1[0], work.y2[0] = y1, y2
    if slips1:
        work.w1[0] = avoid_zero(int(work.mode1), w1, xi)
    if slips2:
        work.w2[0] = avoid_zero(int(work.mode2), w2, xi)


def avoid_zero(mode: int, w: float, xi: float) -> float:
    """Return a slip's w after a step: just beyond 0 instead of exactly 0, which would be a slip that starts."""
    if w != 0.0 or xi == 0.0:
        return w
    return BEYOND if mode == NEGATIVE else -BEYOND


def global_stick(fr: Frame, a: float, b: float, tau_max: float, work: Pair) -> tuple[int, float]:
    """Continue in global stick to its end or by tau_max (s); return the event and the elapsed time."""
    y1, y2 = work.y1[0], work.y2[0]
    L1, L2 = load(fr, a, y1, y2), load(fr, a, y2, y1)
    rounding = ROUNDING * fr.k * (1.0 + a) * (abs(y1) + abs(y2))
    if L1 < -fr.B - rounding:
        return -FIRST, 0.0
    if L2 < -b * fr.B - rounding:
        return -SECOND, 0.0
    margin = min(fr.B - L1, b * fr.B - L2)
    if fr.v == 0.0 and margin >= 0.0:
        return 0, tau_max
    mass = FIRST if fr.B - L1 <= b * fr.B - L2 else SECOND
    tau = max(0.0, margin / (fr.k * fr.v)) if margin > 0.0 else 0.0
    if tau > tau_max:
        mass, tau = 0, tau_max
    work.y1[0] = y1 + fr.v * tau
    work.y2[0] = y2 + fr.v * tau
    return mass, tau


def enter(fr: Frame, a: float, b: float, event: int, work: Pair) -> int:
    """Apply an event to the mode of its mass; return 0, or the outcome FORCE_REVERSAL."""
    mass = abs(event)
    side = 1 if event > 0 else -1
    if mass == CROSSING:
        work.w1[0] = -fr.v
        return 0
    mode = int(work.mode1 if mass == FIRST else work.mode2)
    entered = NEGATIVE if side > 0 else POSITIVE
    if mode != STICK:
        if (mode == NEGATIVE) != (side > 0):
            return FORCE_REVERSAL
        if mass == FIRST:
            entered = contact_mode(fr, 1.0, a, work.y1[0], work.y2[0], 0.0)
        else:
            entered = contact_mode(fr, b, a, work.y2[0], work.y1[0], 0.0)
        if entered == mode:
            entered = STICK
    if mass == FIRST:
        work.w1[0] = 0.0
        work.mode1 = float(entered)
    else:
        work.w2[0] = 0.0
        work.mode2 = float(entered)
    return 0


def pair_event(
    fr: Frame, a: float, b: float, t_max: float, degree: int, tolerance: float, work: Pair
) -> tuple[int, int]:
    """Continue to the next event, or to t_max (s); return (event, outcome): (0, 0) when t_max was reached first."""
    start = work.time
    while True:
        rest = t_max - work.time
        if rest <= 0.0:
            return 0, 0
        if work.steps >= work.steps_allowed:
            return 0, STEP_LIMIT
        work.steps += 1.0
        if work.mode1 == STICK and work.mode2 == STICK:
            work.time_scale = 0.5 / (fr.omega0 * math.sqrt(1.0 + 2.0 * a))
            event, tau = global_stick(fr, a, b, rest, work)
        else:
            step = expand(fr, a, b, degree, tolerance, work)
            scale = work.time_scale
            if not scale * step > 0.0:
                return 0, NOT_FINITE
            work.time_scale = min(scale * step, LONGEST_SCALE / fr.omega0)
            event, xi = first_event(fr, a, b, degree, min(step, rest / scale), work)
            move(degree, xi, work)
            tau = xi * scale
        if not math.isfinite(work.y1[0] + work.y2[0] + work.w1[0] + work.w2[0]):
            return 0, NOT_FINITE
        if event == 0 and tau >= rest:
            work.time = t_max
            return 0, 0
        work.time += tau
        if event == 0:
            continue
        outcome = enter(fr, a, b, event, work)
        if (work.time - start) * fr.omega0 > RAPID_TIME:
            work.rapid = 0.0
        else:
            work.rapid += 1.0
            if work.rapid > RAPID_ALLOWED:
                outcome = EVENT_RATE
        return event, outcome
