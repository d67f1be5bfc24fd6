"""Whether a stated rest position of the spring can be that of a record, by the travel of the mass.

Friction draws the mass along with the belt, so that the spring is stretched where the mass breaks away: the rest
position lies behind the end of the travel towards which the belt runs.  How far behind is not bounded, but tells how
much friction falls.  In a slip the mass swings about x0 + Fk/k, from x0 + Fs/k to as far on the other side, hence

    (Fs - Fk) / Fs = travel / (2 (x_break-away - x0))

without damping and with one kinetic friction Fk.  This is a question to the user, not a limit.
"""

from stickslip.output.lengths import format_length, shown_range
from stickslip.units import Measured

# Travels between the travel and a rest position that is asked about: friction would fall by less than 10 % of Fs in a
# slip.  Chosen: at 2 those who measure a fall of 15 % are asked each time; at 8 a sign that is wrong by five travels
# passes, unless it is seen by its mirror image.
FAR = 4.0
X0_ERRORS = 4.0  # standard deviations of x0 that are granted first, as for any contradiction of a calibration


def question_rest_position(x0: Measured, low: float, high: float) -> str:
    """Ask about an x0 `FAR` travels outside the travel, m, or outside it with -x0 inside it; else ""."""
    outside = max(low - x0.value, x0.value - high)
    if outside <= X0_ERRORS * x0.sd or high <= low:
        return ""
    if low <= -x0.value <= high:
        return (
            f"{_describe_outside(x0, outside, low, high)}, and {format_length(-x0.value)} lies inside it. Is "
            "its sign correct? x0 is the reading with the spring relaxed (--x0), and a datum is -x0"
        )
    if outside - X0_ERRORS * x0.sd <= FAR * (high - low):
        return ""
    fall = 50 * (high - low) / (outside + (high - low))
    return (
        f"{_describe_outside(x0, outside, low, high)}. Are its sign and its unit correct? Friction would fall "
        f"by {fall:.2g} % of Fs in a slip"
    )


def explain_impossible(x0: Measured, low: float, high: float, direction: float) -> str:
    """Return why an x0 is impossible for a belt of this direction (0: unknown); "" where it is possible."""
    beyond = direction * x0.value - max(direction * low, direction * high)
    if not direction or beyond <= X0_ERRORS * x0.sd:
        return ""
    return (
        f"{_describe_outside(x0, beyond, low, high)}, on the side towards which the belt moves. The spring "
        "would then pull the mass along with the belt, and friction would hold it back"
    )


def _describe_outside(x0: Measured, outside: float, low: float, high: float) -> str:
    travel = shown_range(low, high, "m")
    return f"x0 ({format_length(x0.value)}) is {format_length(outside)} outside the travel of {travel}"
