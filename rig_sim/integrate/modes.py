"""The state machine of one mass on a belt: modes, transitions, and how a state is classified.

    m x'' + c x' + k (x - x0) = F(w) + u0 cos(omega t + phase),     w = x' - v_belt

Modes (integers) and the letters events are written with:

    STICK     S   w = 0, jump laws alone
    NEGATIVE  N   w < 0 (jump) or w < -d (ramp): the mass is slower than the belt, F > 0
    POSITIVE  P   w > 0 (jump) or w > d (ramp): the mass is faster than the belt, F < 0
    RAMP      S   abs(w) <= d, ramp laws alone

Transitions.  L = k (x - x0) + c v_belt - u0 cos(omega t + phase) is the load that friction must hold in stick,
Fs the level of the curve at rest (factor applied), B = static Fs the break-away level:

    from      when                         to
    STICK     L rises above +B             NEGATIVE
    STICK     L falls below -B             POSITIVE
    NEGATIVE  w reaches 0 and L >= -B      STICK       (of zero length when L >= B: the next event follows at once)
    NEGATIVE  w reaches 0 and L < -B       POSITIVE
    POSITIVE  w reaches 0 and L <= B       STICK
    POSITIVE  w reaches 0 and L > B        NEGATIVE
    NEGATIVE  w reaches -d                 RAMP
    POSITIVE  w reaches +d                 RAMP
    RAMP      w falls below -d, above +d   NEGATIVE, POSITIVE
    slip      linear curve at zero force   the end: outcome `force reversal`

A mode is authoritative at its edge: on the edge with the wrong rounding of the acceleration, the acceleration counts
as zero (slip that has just begun never falls back by an ulp).  A ramp of zero width is a jump.

Droop.  A belt that slows in proportion to the load it carries runs at v_belt - droop F/Fs (Fs with its factor: at the
level of the moment it has lost ``droop``).  With u = x' - v_belt and the true relative velocity w = u + droop F/Fs,
friction is a function of u alone, and again one of the six laws, to the letter for laws 1 to 4:

    jump      stick, w = 0         u = -droop F/Fs: the ramp of half-width ``droop``
    ramp      w = -d F/Fs          the ramp of half-width d + droop
    slip      abs(u) = s + d + droop curve(s)/Fs, so beyond the ramp's edge r = s - droop (1 - curve(s)/Fs)
              linear               r = s (1 - droop G_slip/Fs): linear, G_slip/(1 - droop G_slip/Fs)
              hyperbolic           `slip_speed` gives s from r: no hyperbola in r, the same recurrence one term longer

So w means u here and the frame holds the laws so changed; events are those of stick and slip all the same.  Friction
that falls faster than the belt gives way (droop curve'(0) >= Fs) has no single force at a speed: `validate` refuses.

Kernels work in a frame where nothing cancels: mirrored so that the belt moves forwards, with p = x - x_slip, the
displacement from the slip point k (x_slip - x0) = B - c v_belt.  There L = B + k p - drive.

Longer than most files: the table, the frame it is worked in and every rule that reads it stand together, to be checked
against each other.
"""

import math
from typing import Any, NamedTuple

from rig_sim.friction.curve import CONSTANT, HYPERBOLIC, LINEAR, reversal_speed

STICK = 0
NEGATIVE = 1
POSITIVE = 2
RAMP = 3

LETTERS = ("S", "N", "P", "S")

# A kernel's `kind`: 0 when the time was up, 4 * (old mode) + (new mode) for a transition, an outcome's code at an end.
COMPLETED = 0
FORCE_REVERSAL = 20
STEP_LIMIT = 21
EVENT_RATE = 22
NOT_FINITE = 23
LIST_FULL = 24
RECURRED = 25
EVENT_LIMIT = 26


class Outcome(NamedTuple):
    """How a run ended: its name, and what to do about it."""

    name: str
    advice: str


OUTCOMES = {
    COMPLETED: Outcome("completed", ""),
    FORCE_REVERSAL: Outcome(
        "force reversal",
        "the linear curve changes sign at slip speed Fs/G_slip: lower G_slip, slow the belt or take another law",
    ),
    STEP_LIMIT: Outcome("step limit", "raise the number of steps allowed, or shorten the time"),
    EVENT_RATE: Outcome(
        "event-rate limit",
        "events follow each other without time passing: the scene sits on an edge; move its start or its parameters",
    ),
    NOT_FINITE: Outcome("not finite", "a number overflowed or was not a number: check the scene's magnitudes"),
    LIST_FULL: Outcome("list full", "take the events found so far and call again"),
    RECURRED: Outcome("recurred", "the last events repeat for ever: `rig_sim.integrate.events` lists them"),
    EVENT_LIMIT: Outcome("event limit", "raise the number of events allowed, shorten the time, or list a later part"),
}

KINDS = {
    4 * old + new: f"{LETTERS[old]}>{LETTERS[new]}"
    for old, new in (
        (STICK, NEGATIVE),
        (STICK, POSITIVE),
        (NEGATIVE, STICK),
        (NEGATIVE, POSITIVE),
        (NEGATIVE, RAMP),
        (POSITIVE, STICK),
        (POSITIVE, NEGATIVE),
        (POSITIVE, RAMP),
        (RAMP, NEGATIVE),
        (RAMP, POSITIVE),
    )
}


class Flow(NamedTuple):
    """Everything the motion between events depends on; the defaults are the dimensionless base case, law 5.

    Parameters
    ----------
    m, k, x0, c : float
        Mass (kg, > 0), spring (N/m, > 0), the spring's rest position (m), viscous damping (N s/m).
    v_belt : float
        Belt velocity, m/s, either sign or 0.
    curve, ramp : int
        `rig_sim.friction.curve` code; 1 for a ramp contact, 0 for a jump.
    Fs, static, factor : float
        Level at rest (N, >= 0), break-away level / Fs (>= 1), scatter (multiplies the whole curve, d unchanged).
    G_slip, gamma, d : float
        N s/m, s/m, m/s; those the law does not use are ignored.
    u0, omega, phase : float
        Drive u0 cos(omega t + phase): N, rad/s, rad.
    droop : float
        How much slower the belt runs when it carries the load Fs, m/s (>= 0).

    Notes
    -----
    Pass floats as floats and ints as ints: compiled kernels are specialised on the types.
    With a ramp, static > 1 makes the ramp's peak static Fs, dropping to the curve at its edge.
    Kernels trust their flow; `validate` checks one.
    """

    m: float = 1.0
    k: float = 1.0
    x0: float = 0.0
    c: float = 0.0
    v_belt: float = 0.5
    curve: int = HYPERBOLIC
    ramp: int = 0
    Fs: float = 1.0
    static: float = 1.0
    factor: float = 1.0
    G_slip: float = 0.05
    gamma: float = 3.0
    d: float = 0.2
    u0: float = 0.0
    omega: float = 0.0
    phase: float = 0.0
    droop: float = 0.0


SMALLEST, LARGEST = 1e-100, 1e100  # of any number but 0: products of three stay finite
POSITIVE_FIELDS = ("m", "k")
NON_NEGATIVE_FIELDS = ("Fs", "factor", "gamma", "d", "droop")


def validate(flow: Flow) -> None:
    """Refuse a flow that is not physical.

    Raises
    ------
    ValueError
        Naming the field: not finite; above `LARGEST`; m or k not above 0, or below `SMALLEST`; Fs, factor, gamma, d or
        droop below 0; static below 1; droop with static above 1, without friction, or with friction that falls faster
        than the belt gives way.
    """
    for name, number in flow._asdict().items():
        if not math.isfinite(number):
            raise ValueError(f"{name} is {number}; need a finite number")
        if abs(number) > LARGEST or (name in POSITIVE_FIELDS and 0.0 < number < SMALLEST):
            raise ValueError(f"{name} is {number}; beyond {SMALLEST:g} to {LARGEST:g}: choose other units")
        if name in POSITIVE_FIELDS and not number > 0.0:
            raise ValueError(f"{name} is {number}; need a number above 0")
        if name in NON_NEGATIVE_FIELDS and number < 0.0:
            raise ValueError(f"{name} is {number}; need 0 or more")
    if flow.static < 1.0:
        raise ValueError(f"static is {flow.static}; friction at rest is not below friction in slip: need 1 or more")
    if flow.droop > 0.0:
        if flow.static != 1.0:
            raise ValueError(f"droop with static {flow.static} is not modelled; need static 1")
        if flow.Fs == 0.0:
            raise ValueError("droop is a share of the load Fs, which is 0; need Fs above 0")
        fall = steepest_fall(flow)
        if flow.droop * fall >= 1.0:
            raise ValueError(
                f"droop is {flow.droop:g} m/s: friction falls faster than the belt gives way, so the force is not one; "
                f"need less than {1.0 / fall:g}"
            )


def steepest_fall(flow: Flow) -> float:
    """Return how fast friction falls with speed where it does so fastest, over Fs (s/m)."""
    if flow.curve == HYPERBOLIC:
        return flow.gamma
    return flow.G_slip / flow.Fs if flow.curve == LINEAR and flow.Fs > 0.0 else 0.0


class Frame(NamedTuple):
    """A Flow as the kernels use it: belt forwards, slip point and levels worked out, the curve reduced.

    ``mirror`` is -1 when the belt runs backwards (x, velocities, drive and modes are mirrored), else 1; ``A`` and ``B``
    are the kinetic and the break-away level; ``d`` is 0 for a jump; ``G`` the linear curve's slope with the scatter;
    ``s_max`` the relative speed of force reversal; ``omega2`` = k/m = omega0^2; ``slip`` = x_slip - x0 (mirrored);
    ``lag`` = droop gamma on the hyperbola, else 0.
    """

    mirror: float
    x0: float
    slip: float
    m: float
    k: float
    c: float
    v: float
    curve: int
    A: float
    B: float
    G: float
    gamma: float
    d: float
    s_max: float
    u0: float
    omega: float
    phase: float
    omega2: float
    omega0: float
    lag: float


def frame(flow: Flow) -> Frame:
    """Return the flow as the kernels use it."""
    mirror = -1.0 if flow.v_belt < 0.0 else 1.0
    v = abs(flow.v_belt)
    A = flow.factor * flow.Fs
    B = flow.static * A
    G = flow.factor * flow.G_slip
    d = flow.d if flow.ramp == 1 else 0.0
    curve = flow.curve
    if curve == LINEAR and G == 0.0:
        curve = CONSTANT
    elif curve == HYPERBOLIC and (A == 0.0 or flow.gamma == 0.0):
        curve = CONSTANT
    lag = 0.0
    if flow.droop > 0.0:
        d += flow.droop
        if curve == LINEAR:
            G /= 1.0 - flow.droop * flow.G_slip / flow.Fs
        elif curve == HYPERBOLIC:
            lag = flow.droop * flow.gamma
    return Frame(
        mirror,
        flow.x0,
        (B - flow.c * v) / flow.k,
        flow.m,
        flow.k,
        flow.c,
        v,
        curve,
        A,
        B,
        G,
        flow.gamma,
        d,
        d + reversal_speed(curve, A, G),
        mirror * flow.u0,
        flow.omega,
        flow.phase,
        flow.k / flow.m,
        math.sqrt(flow.k / flow.m),
        lag,
    )


def displacement(fr: Frame, x: float) -> float:
    """Return p, the mirrored displacement from the slip point (m)."""
    return fr.mirror * (x - fr.x0) - fr.slip


def position(fr: Frame, p: float) -> float:
    """Return x (m) from the displacement p."""
    return fr.x0 + fr.mirror * (fr.slip + p)


def mirrored(fr: Frame, mode: int) -> int:
    """Exchange NEGATIVE and POSITIVE when the frame is mirrored; its own inverse."""
    if fr.mirror < 0.0 and (mode == NEGATIVE or mode == POSITIVE):
        return NEGATIVE + POSITIVE - mode
    return mode


def drive(fr: Frame, t: float) -> float:
    """Return the driving force at time t (N, mirrored)."""
    if fr.u0 == 0.0:
        return 0.0
    return fr.u0 * math.cos(fr.omega * t + fr.phase)


def line(fr: Frame, mode: int) -> tuple[float, float]:
    """Return (C, e) of m w' = -C w - k p + e + D + drive in a slip or ramp; D = 0 except on the hyperbola.

    The linear curve and the ramp are part of C; e is what remains at w = 0, relative to the slip point.
    """
    if mode == RAMP:
        return fr.c + fr.B / fr.d, -fr.B
    sign = 1.0 if mode == NEGATIVE else -1.0
    e = sign * fr.A - fr.B
    if fr.curve == LINEAR:
        return fr.c - fr.G, e + sign * fr.G * fr.d
    return fr.c, e


def slip_speed(fr: Frame, r: float) -> float:
    """Return the slip speed s on a drooping belt from r = s - lag s/(1 + gamma s), the speed beyond the edge (m/s)."""
    # gamma s^2 + (1 - lag - gamma r) s - r = 0, by the root formula that does not cancel
    linear = 1.0 - fr.lag - fr.gamma * r
    # below 0 only far before the edge, where a general solver's trial step may stray
    root = math.sqrt(max(0.0, linear * linear + 4.0 * fr.gamma * r))
    return 2.0 * r / (root + linear) if linear > 0.0 else (root - linear) / (2.0 * fr.gamma)


def drop(fr: Frame, mode: int, w: float) -> float:
    """Return D, how far the hyperbola has fallen below its level at rest, signed as a force in slip (N)."""
    if fr.curve != HYPERBOLIC or mode == RAMP:
        return 0.0
    s = -w - fr.d if mode == NEGATIVE else w - fr.d
    if fr.lag != 0.0:
        s = slip_speed(fr, s)
    fall = -fr.A * fr.gamma * s / (1.0 + fr.gamma * s)
    return fall if mode == NEGATIVE else -fall


def edges(fr: Frame, mode: int) -> tuple[float, float]:
    """Return the interval of w a slip or ramp mode lives in."""
    if mode == NEGATIVE:
        return -fr.s_max, -fr.d
    if mode == POSITIVE:
        return fr.d, fr.s_max
    return -fr.d, fr.d


def acceleration(fr: Frame, mode: int, p: float, w: float, t: float) -> float:
    """Return w' (m/s^2) in the given mode; on the mode's edge never pointing out of it by a rounding error."""
    if mode == STICK:
        return 0.0
    C, e = line(fr, mode)
    return kept_inside(fr, mode, w, (-C * w - fr.k * p + e + drop(fr, mode, w) + drive(fr, t)) / fr.m)


def kept_inside(fr: Frame, mode: int, w: float, a: float) -> float:
    """Return the acceleration ``a``, or 0 where it would leave the mode from the mode's own edge."""
    lo, hi = edges(fr, mode)
    if w == hi and mode != POSITIVE:
        return min(a, 0.0)
    if w == lo and mode != NEGATIVE:
        return max(a, 0.0)
    return a


def classify(fr: Frame, p: float, w: float, t: float) -> int:
    """Return the mode of a state in the frame."""
    if fr.d > 0.0:
        if w < -fr.d:
            return NEGATIVE
        if w > fr.d:
            return POSITIVE
        if abs(w) < fr.d:
            return RAMP
        C, e = line(fr, RAMP)
        a = -C * w - fr.k * p + e + drive(fr, t)
        turn = -fr.k * (w + fr.v)  # m w'' on an undriven edge where w' = 0
        if w < 0.0:
            return NEGATIVE if a < 0.0 or (a == 0.0 and turn < 0.0) else RAMP
        return POSITIVE if a > 0.0 or (a == 0.0 and turn > 0.0) else RAMP
    if w < 0.0:
        return NEGATIVE
    if w > 0.0:
        return POSITIVE
    excess = fr.k * p - drive(fr, t)  # L - B
    if excess > 0.0:
        return NEGATIVE
    if excess < -2.0 * fr.B:
        return POSITIVE
    return STICK


def landing(fr: Frame, mode: int, side: int, p: float, t: float) -> int:
    """Return the mode entered, or the outcome, when w leaves ``mode`` at its lower (-1) or upper (+1) edge."""
    if mode == RAMP:
        return NEGATIVE if side < 0 else POSITIVE
    if mode == STICK:
        return NEGATIVE if side > 0 else POSITIVE
    if (mode == NEGATIVE) != (side > 0):
        return FORCE_REVERSAL
    if fr.d > 0.0:
        return RAMP
    excess = fr.k * p - drive(fr, t)
    if mode == NEGATIVE:
        return POSITIVE if excess < -2.0 * fr.B else STICK
    return NEGATIVE if excess > 0.0 else STICK


def initial_mode(flow: Flow, x: float, v: float, t: float) -> int:
    """Return the mode of the state (x m, v m/s absolute velocity) at time t (s).

    A jump law sticks where v equals the belt's velocity exactly and the load is within the break-away level; on the
    slip point itself it sticks for zero time.
    """
    fr = frame(flow)
    return mirrored(fr, classify(fr, displacement(fr, x), fr.mirror * (v - flow.v_belt), t))


def force(flow: Flow, mode: int, x: float, w: float, t: float) -> float:
    """Return the friction force on the mass (N, along x) in the given mode; in stick the force that holds it."""
    fr = frame(flow)
    p = displacement(fr, x)
    own = mirrored(fr, mode)
    if own == STICK:
        return fr.mirror * (fr.B + fr.k * p - drive(fr, t))
    sliding = fr.mirror * w
    C, e = line(fr, own)
    # m w' = -c v - k x + F + drive, so F is what `line` and `drop` add to -c w, relative to the slip point's B
    return fr.mirror * (-(C - fr.c) * sliding + e + fr.B + drop(fr, own, sliding))


Buffer = Any  # list of floats (interpreted) or one-dimensional float64 array (compiled)

ORDER = 28  # of the Taylor series: 24 to 32 cost about the same per unit of time
# The working buffer, one and flat (compiled code counts the references of every array it hands on): five series ...
W = 0  # w
P = ORDER + 2  # p
Q = 2 * P  # 1/q0 of the hyperbola's denominator
D = 3 * P  # the hyperbola's fall
U = 4 * P  # the drive
# ... and single numbers: steps taken and allowed, events in a row without time passing, the unit of time of the last
# Taylor step, the closed form's damping and acceleration at its start and its solution at its exit, how much later than
# its duration says a phase was left, and what compensated summation holds below the last digit of t, p and w
STEPS, STEPS_ALLOWED, RAPID, TIME_SCALE, ZETA, START, EXIT, EXIT_S, EXIT_E, LATE, CARRY, P_REST, W_REST = range(
    5 * P, 5 * P + 13
)
WORK = 5 * P + 13


def new_work(max_steps: int = 1_000_000, *, compiled: bool = False) -> Buffer:
    """Return the kernels' working buffer: a list for interpreted calls, a float64 array for compiled ones.

    A step is one closed-form phase or one Taylor step; they are counted over the buffer's life, and a kernel that would
    exceed ``max_steps`` ends in the outcome `step limit`.
    """
    work: Buffer
    if compiled:
        import numpy

        work = numpy.zeros(WORK)
    else:
        work = [0.0] * WORK
    work[STEPS_ALLOWED] = float(max_steps)
    work[TIME_SCALE] = 1.0
    return work
