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
    slip      a formula's range is left    the end: outcome `end of the curve`

At its edge a mode is kept: where rounding makes the acceleration point back out of it, the acceleration counts as zero
(slip that has just begun never returns by an ulp).  A ramp of zero width is a jump.

Droop.  A compliant belt drive slows in proportion to the load: v_belt - droop F/Fs.  ``droop`` (m/s) is the speed drop
at the present friction level Fs, so the drive's compliance is droop/Fs (m/s per N).  With u = x' - v_belt and the true
relative velocity w = u + droop F/Fs, friction is a function of u alone, and again one of the six laws, exactly for
laws 1 to 4:

    jump      stick, w = 0         u = -droop F/Fs: the ramp of half-width ``droop``
    ramp      w = -d F/Fs          the ramp of half-width d + droop
    slip      abs(u) = s + d + droop curve(s)/Fs, so beyond the ramp's edge r = s - droop (1 - curve(s)/Fs)
              linear               r = s (1 - droop G_slip/Fs): linear, G_slip/(1 - droop G_slip/Fs)
              hyperbolic           `slip_speed` gives s from r: not a hyperbola in r; the recurrence has one term more

Kernels use u as their w, and the frame holds the laws so changed; the events are still those of stick and slip.
Friction that falls faster than the drive yields (droop curve'(0) >= Fs) has no unique force at a speed: `validate`
refuses it.

Kernels work in a frame without cancellation of large numbers: mirrored so that the belt moves forwards, with
p = x - x_slip, the displacement from the slip point k (x_slip - x0) = B - c v_belt.  There L = B + k p - drive.

`rig_sim.flow.flow` holds the numbers of the equation, `frame` its form in these coordinates, and `contact_state`
the rules of the table as code.
"""

from typing import NamedTuple

STICK = 0
NEGATIVE = 1
POSITIVE = 2
RAMP = 3

LETTERS = ("S", "N", "P", "S")

# A kernel's `kind`: 0 when the end time was reached, 4 * (old mode) + (new mode) for a transition, else an outcome.
COMPLETED = 0
FORCE_REVERSAL = 20
STEP_LIMIT = 21
EVENT_RATE = 22
NOT_FINITE = 23
LIST_FULL = 24
RECURRED = 25
EVENT_LIMIT = 26
CURVE_END = 27

STICK_TO_NEGATIVE = 4 * STICK + NEGATIVE
RAMP_TO_NEGATIVE = 4 * RAMP + NEGATIVE


class Outcome(NamedTuple):
    """How a run ended, and what to do about it."""

    name: str
    advice: str


OUTCOMES = {
    COMPLETED: Outcome("completed", ""),
    FORCE_REVERSAL: Outcome(
        "force reversal",
        "the linear curve changes sign at the slip speed Fs/G_slip; reduce G_slip or the belt speed, or use "
        "another law",
    ),
    STEP_LIMIT: Outcome("step limit", "allow more steps, or shorten the time"),
    EVENT_RATE: Outcome(
        "event-rate limit",
        "events follow each other without a delay, because the motion stays at the border of two modes; "
        "change its start or parameters",
    ),
    NOT_FINITE: Outcome("not finite", "a number overflowed or is undefined; check the magnitudes in the scene"),
    LIST_FULL: Outcome("list full", "use the events found so far and call again"),
    RECURRED: Outcome("recurred", "the last events repeat periodically; `rig_sim.integrate.events` lists them"),
    CURVE_END: Outcome(
        "end of the curve",
        "the slip speed exceeds the range in which friction.formula is smooth, finite and not negative, or 64 "
        "times the speed that the energy allows; change the formula, or reduce the drive",
    ),
    EVENT_LIMIT: Outcome("event limit", "allow more events, shorten the time, or list a later part"),
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
