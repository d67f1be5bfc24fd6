"""Two coupled masses on the belt: the motion in each mode by Taylor series, and its events.

Each mass sticks or slips (`rig_sim.flow.two_mass` has the equations), backwards (NEGATIVE) or forwards (POSITIVE) of
the belt.  While both stick the motion is known; otherwise both positions are one power series in time, of ``degree``
terms, over a step at whose end the last terms fall below ``tolerance`` of the first ones.  A mass lands where its
relative velocity reaches 0, and breaks away where its load reaches the break-away level: the first root of a polynomial
in either case.

State and series stand in one flat buffer (`new_pair`): mirrored so that the belt moves forwards, y = x - x0.
"""

import math
from typing import Any

from rig_sim.flow.frame import Frame
from rig_sim.flow.modes import EVENT_RATE, FORCE_REVERSAL, NEGATIVE, NOT_FINITE, POSITIVE, STEP_LIMIT, STICK
from rig_sim.friction.curve import HYPERBOLIC, LINEAR
from rig_sim.integrate.buffer import ORDER, Buffer
from rig_sim.integrate.newton import EPS
from rig_sim.integrate.phases import RAPID_ALLOWED, RAPID_TIME
from rig_sim.integrate.polynomial import first_root, spread
from rig_sim.integrate.taylor import INVERSE

SERIES = ORDER + 2
# Series of the relative velocities (m/s), the positions (m), the friction over the mass (m/s in a unit of the series'
# time; coefficient n stands n places before the first one) and the load on the contact of the mass that sticks (N); the
# first coefficients of W1 ... Y2 are the state
W1, W2, Y1, Y2, LOAD, F1, F2 = (*range(0, 5 * SERIES, SERIES), 6 * SERIES - 1, 7 * SERIES - 1)
# Single numbers: the modes, the time, steps taken and allowed, events in a row without time passing, the unit of time
# of the last step, where the section's crossings are wanted 1, and steps that a caller may still take in all
MODE1, MODE2, TIME, STEPS, STEPS_ALLOWED, RAPID, TIME_SCALE, SECTION, STEPS_LEFT = range(7 * SERIES, 7 * SERIES + 9)
PAIR = 7 * SERIES + 9

# Events besides the end of the time allowed: which mass, times the side its velocity or load leaves by
FIRST, SECOND, CROSSING = 1, 2, 3  # CROSSING: the first mass's velocity over ground passes 0
ROUNDING = 16.0 * EPS  # of the largest term of a force, within which it counts as at its level; not swept
BEYOND = 1e-300  # m/s: next to nothing
LONGEST = 4.0  # of a step in units of TIME_SCALE, as in `rig_sim.integrate.taylor`
# Of TIME_SCALE, sqrt(m/k).  Masses that have come to rest exactly take steps each LONGEST times as long as the one
# before, up to this one, as nothing but overflow would end them; steps of a motion are a billion times shorter.
LONGEST_SCALE = 1e9


def new_pair(max_steps: int, *, compiled: bool = False) -> Buffer:
    """Return the kernels' working buffer: a list for interpreted calls, a float64 array for compiled ones."""
    work: Any = [0.0] * PAIR
    if compiled:
        import numpy

        work = numpy.zeros(PAIR)
    work[STEPS_ALLOWED] = float(max_steps)
    return work


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


def place(fr: Frame, a: float, b: float, y1: float, w1: float, y2: float, w2: float, t: float, work: Buffer) -> None:
    """Put both masses into a state (m and m/s, mirrored) at time t (s)."""
    work[Y1], work[W1], work[Y2], work[W2], work[TIME] = y1, w1, y2, w2, t
    work[MODE1] = float(contact_mode(fr, 1.0, a, y1, y2, w1))
    work[MODE2] = float(contact_mode(fr, b, a, y2, y1, w2))
    work[RAPID] = 0.0
    work[TIME_SCALE] = 0.5 / (fr.omega0 * math.sqrt(1.0 + 2.0 * a))


def begin_slip(
    fr: Frame, ratio: float, a: float, mode: int, W: int, Y: int, F: int, other: int, inertia: float, work: Buffer
) -> float:
    """Store a slipping mass's friction and first coefficients at the start of a step; return its friction's bend (s/m).

    The friction is a constant over 1 + bend (w - w0).  On the edge of slip the acceleration never points back over it,
    nor does rounding make one.
    """
    sign = 1.0 if mode == NEGATIVE else -1.0
    w = work[W]
    force = sign * ratio * fr.A
    damping = fr.c
    bend = 0.0
    if fr.curve == HYPERBOLIC:
        steepness = 1.0 / (1.0 + fr.gamma * abs(w))
        force *= steepness
        bend = -sign * fr.gamma * steepness
    elif fr.curve == LINEAR:
        damping -= ratio * fr.G
    held = fr.k * (1.0 + a) * work[Y]
    pulled = fr.k * a * work[other]
    balance = force - fr.c * fr.v - damping * w - held + pulled
    if w == 0.0 and (sign * balance > 0.0 or abs(balance) <= ROUNDING * (abs(force) + abs(held) + abs(pulled))):
        balance = 0.0
    work[F] = force * inertia
    work[W + 1] = balance * inertia
    return bend


def inner_terms(W: int, F: int, n: int, work: Buffer) -> float:
    """Return the sum of w_j F_(n - j) over j from 2 to n - 1, for n of 2 and more.

    The terms w_1 F_(n - 1) and w_n F_0 are left to the caller: their newest factors are known last, and no longer sum
    has to wait for them.
    """
    even = odd = 0.0
    i = F - n + 2
    whole = W + n - n % 2
    for j in range(W + 2, whole, 2):
        even += work[j] * work[i]
        odd += work[j + 1] * work[i + 1]
        i += 2
    if n % 2 == 1:
        even += work[W + n - 1] * work[F - 1]
    return even + odd


def expand(fr: Frame, a: float, b: float, degree: int, tolerance: float, work: Buffer) -> float:
    """Fill in the series of a step in which one mass slips, or both; return its length in units of TIME_SCALE.

    That unit is the length of the step before, so that no coefficient overflows.  The friction over the mass obeys
    F_n = -bend (w_1 F_(n - 1) + ... + w_n F_0), and w_(n + 1) = (F_n + forces of springs and damper) / (n + 1).
    """
    mode1, mode2 = int(work[MODE1]), int(work[MODE2])
    T = work[TIME_SCALE]
    inertia = T / fr.m
    work[W1 + 1] = work[W2 + 1] = 0.0
    work[Y1 + 1] = work[Y2 + 1] = fr.v * T
    bend1 = bend2 = 0.0
    if mode1 != STICK:
        bend1 = begin_slip(fr, 1.0, a, mode1, W1, Y1, F1, Y2, inertia, work)
        work[Y1 + 1] = (work[W1] + fr.v) * T
    if mode2 != STICK:
        bend2 = begin_slip(fr, b, a, mode2, W2, Y2, F2, Y1, inertia, work)
        work[Y2 + 1] = (work[W2] + fr.v) * T
    w1, y1, w2, y2 = work[W1 + 1], work[Y1 + 1], work[W2 + 1], work[Y2 + 1]
    lead1 = -bend1 * w1
    scaled1 = -bend1 * work[F1]
    f1 = scaled1 * w1
    work[F1 - 1] = f1
    lead2 = -bend2 * w2
    scaled2 = -bend2 * work[F2]
    f2 = scaled2 * w2
    work[F2 - 1] = f2
    curved = fr.curve == HYPERBOLIC
    damping1 = (fr.c - fr.G if fr.curve == LINEAR else fr.c) * inertia
    damping2 = (fr.c - b * fr.G if fr.curve == LINEAR else fr.c) * inertia
    own = fr.k * (1.0 + a) * inertia
    coupling = fr.k * a * inertia
    for n in range(1, degree):
        share = INVERSE[n + 1]
        sum1 = coupling * y2 - own * y1 - damping1 * w1
        sum2 = coupling * y1 - own * y2 - damping2 * w2
        y1 = y2 = 0.0
        if mode1 != STICK:
            y1 = T * w1 * share
            sum1 += f1
            w1 = sum1 * share
            work[W1 + n + 1] = w1
            if curved:
                f1 = lead1 * f1 - bend1 * inner_terms(W1, F1, n + 1, work) + scaled1 * share * sum1
                work[F1 - n - 1] = f1
        if mode2 != STICK:
            y2 = T * w2 * share
            sum2 += f2
            w2 = sum2 * share
            work[W2 + n + 1] = w2
            if curved:
                f2 = lead2 * f2 - bend2 * inner_terms(W2, F2, n + 1, work) + scaled2 * share * sum2
                work[F2 - n - 1] = f2
        work[Y1 + n + 1] = y1
        work[Y2 + n + 1] = y2
    growth = math.inf
    if mode1 != STICK:
        growth = allowance(fr, W1, degree, tolerance, work)
    if mode2 != STICK:
        growth = min(growth, allowance(fr, W2, degree, tolerance, work))
    if not growth > 0.0:  # the last terms have overflown
        return 0.0
    return min(math.exp2(math.log2(growth) * INVERSE[degree]), LONGEST)


def allowance(fr: Frame, W: int, degree: int, tolerance: float, work: Buffer) -> float:
    """Return by how much the terms of highest degree may grow until ``tolerance`` of the first ones is reached.

    The larger of the last two coefficients is compared with the belt's speed or the largest of the first three.
    """
    last = max(abs(work[W + degree]), abs(work[W + degree - 1]))
    first = max(abs(work[W]), abs(work[W + 1]), abs(work[W + 2]), fr.v)
    return tolerance * first / last if last > 0.0 else math.inf


def fill_load(fr: Frame, a: float, ratio: float, own: int, other: int, degree: int, work: Buffer) -> None:
    """Fill in the series of the load on the mass that sticks; within rounding of a level it is on it."""
    stiff = fr.k * (1.0 + a)
    coupling = fr.k * a
    for j in range(degree + 1):
        work[LOAD + j] = stiff * work[own + j] - coupling * work[other + j]
    work[LOAD] += fr.c * fr.v
    level = ratio * fr.B
    rounding = ROUNDING * (level + stiff * abs(work[own]) + coupling * abs(work[other]))
    if abs(work[LOAD] - level) <= rounding:
        work[LOAD] = level
    elif abs(work[LOAD] + level) <= rounding:
        work[LOAD] = -level


def first_event(fr: Frame, a: float, b: float, degree: int, end: float, work: Buffer) -> tuple[int, float]:
    """Return the first event of a step of length ``end`` and where it is; (0, end) without one."""
    mode1, mode2 = int(work[MODE1]), int(work[MODE2])
    level = math.inf
    if mode1 == STICK:
        fill_load(fr, a, 1.0, Y1, Y2, degree, work)
        level = fr.B
    elif mode2 == STICK:
        fill_load(fr, a, b, Y2, Y1, degree, work)
        level = b * fr.B
    if level < math.inf and abs(work[LOAD]) + spread(work, LOAD, degree, end) < level:
        level = math.inf
    event = 0
    for candidate in range(7):
        at, side, which, edge = W1, 0, 0, 0.0
        if candidate < 2:
            if mode1 != STICK and (candidate == 0 or not math.isinf(fr.s_max)):
                which, side = FIRST, slip_side(mode1, candidate)
                edge = 0.0 if candidate == 0 else side * fr.s_max
        elif candidate < 4:
            if mode2 != STICK and (candidate == 2 or not math.isinf(fr.s_max)):
                at, which, side = W2, SECOND, slip_side(mode2, candidate - 2)
                edge = 0.0 if candidate == 2 else side * fr.s_max
        elif candidate < 6:
            if not math.isinf(level):
                at, which, side = LOAD, (FIRST if mode1 == STICK else SECOND), 9 - 2 * candidate
                edge = side * level
        elif work[SECTION] == 1.0 and mode1 == NEGATIVE:
            edge = -fr.v
            which, side = CROSSING, -1 if work[W1] > edge or (work[W1] == edge and work[W1 + 1] > 0.0) else 1
        if side == 0:
            continue
        xi = first_root(work, at, degree, edge, side, end)
        if xi >= 0.0:
            event, end = side * which, xi
    return event, end


def slip_side(mode: int, far: int) -> int:
    """Return the side on which a slip ends: near 0 (``far`` 0), or at force reversal (1)."""
    return 1 if (mode == NEGATIVE) != (far == 1) else -1


def move(degree: int, xi: float, work: Buffer) -> None:
    """Move the state to ``xi`` (in units of TIME_SCALE) within the step."""
    y1, y2, w1, w2 = work[Y1 + degree], work[Y2 + degree], work[W1 + degree], work[W2 + degree]
    slips1, slips2 = work[MODE1] != STICK, work[MODE2] != STICK
    for j in range(degree - 1, -1, -1):
        y1 = y1 * xi + work[Y1 + j]
        y2 = y2 * xi + work[Y2 + j]
        w1 = w1 * xi + work[W1 + j]
        w2 = w2 * xi + work[W2 + j]
    work[Y1], work[Y2] = y1, y2
    if slips1:
        work[W1] = arrived(int(work[MODE1]), w1, xi)
    if slips2:
        work[W2] = arrived(int(work[MODE2]), w2, xi)


def arrived(mode: int, w: float, xi: float) -> float:
    """Return a slip's w after a step: one that has come to exactly 0 just beyond it, as 0 is a slip that begins."""
    if w != 0.0 or xi == 0.0:
        return w
    return BEYOND if mode == NEGATIVE else -BEYOND


def global_stick(fr: Frame, a: float, b: float, tau_max: float, work: Buffer) -> tuple[int, float]:
    """Go on in global stick to its end or by tau_max (s); return the event and the time it took."""
    y1, y2 = work[Y1], work[Y2]
    L1, L2 = load(fr, a, y1, y2), load(fr, a, y2, y1)
    rounding = ROUNDING * fr.k * (1.0 + a) * (abs(y1) + abs(y2))
    if L1 < -fr.B - rounding:
        return -FIRST, 0.0
    if L2 < -b * fr.B - rounding:
        return -SECOND, 0.0
    margin = min(fr.B - L1, b * fr.B - L2)
    if fr.v == 0.0 and margin >= 0.0:
        return 0, tau_max
    which = FIRST if fr.B - L1 <= b * fr.B - L2 else SECOND
    tau = max(0.0, margin / (fr.k * fr.v)) if margin > 0.0 else 0.0
    if tau > tau_max:
        which, tau = 0, tau_max
    work[Y1] = y1 + fr.v * tau
    work[Y2] = y2 + fr.v * tau
    return which, tau


def enter(fr: Frame, a: float, b: float, event: int, work: Buffer) -> int:
    """Let an event change the mode of its mass; return 0, or the outcome FORCE_REVERSAL."""
    which = abs(event)
    side = 1 if event > 0 else -1
    if which == CROSSING:
        work[W1] = -fr.v
        return 0
    mode = int(work[MODE1] if which == FIRST else work[MODE2])
    entered = NEGATIVE if side > 0 else POSITIVE
    if mode != STICK:
        if (mode == NEGATIVE) != (side > 0):
            return FORCE_REVERSAL
        if which == FIRST:
            entered = contact_mode(fr, 1.0, a, work[Y1], work[Y2], 0.0)
        else:
            entered = contact_mode(fr, b, a, work[Y2], work[Y1], 0.0)
        if entered == mode:
            entered = STICK
    if which == FIRST:
        work[W1] = 0.0
        work[MODE1] = float(entered)
    else:
        work[W2] = 0.0
        work[MODE2] = float(entered)
    return 0


def pair_event(
    fr: Frame, a: float, b: float, t_max: float, degree: int, tolerance: float, work: Buffer
) -> tuple[int, int]:
    """Go on to the next event, or to t_max (s); return (event, outcome): (0, 0) when t_max was reached first."""
    begun = work[TIME]
    while True:
        rest = t_max - work[TIME]
        if rest <= 0.0:
            return 0, 0
        if work[STEPS] >= work[STEPS_ALLOWED]:
            return 0, STEP_LIMIT
        work[STEPS] += 1.0
        if work[MODE1] == STICK and work[MODE2] == STICK:
            work[TIME_SCALE] = 0.5 / (fr.omega0 * math.sqrt(1.0 + 2.0 * a))
            event, tau = global_stick(fr, a, b, rest, work)
        else:
            step = expand(fr, a, b, degree, tolerance, work)
            scale = work[TIME_SCALE]
            if not scale * step > 0.0:
                return 0, NOT_FINITE
            work[TIME_SCALE] = min(scale * step, LONGEST_SCALE / fr.omega0)
            event, xi = first_event(fr, a, b, degree, min(step, rest / scale), work)
            move(degree, xi, work)
            tau = xi * scale
        if not math.isfinite(work[Y1] + work[Y2] + work[W1] + work[W2]):
            return 0, NOT_FINITE
        if event == 0 and tau >= rest:
            work[TIME] = t_max
            return 0, 0
        work[TIME] += tau
        if event == 0:
            continue
        outcome = enter(fr, a, b, event, work)
        if (work[TIME] - begun) * fr.omega0 > RAPID_TIME:
            work[RAPID] = 0.0
        else:
            work[RAPID] += 1.0
            if work[RAPID] > RAPID_ALLOWED:
                outcome = EVENT_RATE
        return event, outcome
