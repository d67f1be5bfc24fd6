"""What was asked of a method: window, order and belt speed, as a person types them and as a method takes them."""

import math
import re
from dataclasses import dataclass

from processing.record.series import Series
from stickslip.errors import InputError
from stickslip.units import Measured

HIGHEST_ORDER = 20  # of a window given by a person; coefficients are tested to this degree (`polynomial.even_fit`)
# Of a stated belt speed, sticks that may be its own: on a ramp they creep, by up to its half-width.  Sticks outside
# are used instead of the statement; whether that is a contradiction, the fitted belt speed decides.
SLOWEST_STICKS, FASTEST_STICKS = 0.8, 1.05
DEFAULT_ORDER = 4  # beside a window that was given: as in the thesis's own filter class, it keeps the curvature of v


@dataclass(frozen=True)
class Setting:
    """Samples in the window, degree of the polynomial, belt speed (m/s, signed); None lets the method choose."""

    window: int | None = None
    order: int | None = None
    belt_speed: float | None = None


def parse_window(window: int | str, order: int | None, series: Series) -> Setting:
    """Read a window as a person gives it.

    window: Odd number of samples; "auto"; or a duration with its unit ("20ms", "0.02 s", "500us"), rounded to the odd
        number of samples that spans it.
    order: Degree of the polynomial.
    series: For the sample interval and the longest stretch.
    Raises InputError: for text that is none of these, an even window, one that does not exceed the order or that is
        longer than the record's longest stretch, or an order outside 1 to 20.
    """
    if order is not None and not 1 <= order <= HIGHEST_ORDER:
        raise InputError(f"order is {order}", "--order", f"give 1 to {HIGHEST_ORDER}")
    typed = window.strip() if isinstance(window, str) else window
    if typed == "auto":
        return Setting(None, order)
    samples = _parse_samples(typed, series) if isinstance(typed, str) else typed
    check_window(samples, DEFAULT_ORDER if order is None else order)
    longest = longest_piece(series)
    if samples > longest:
        raise InputError(
            f"window is {samples} samples; the longest stretch of the record has {longest}",
            "--window",
            "give a shorter one",
        )
    return Setting(samples, order)


def _parse_samples(text: str, series: Series) -> int:
    match = re.fullmatch(r"([0-9]*\.?[0-9]+(?:[eE][-+]?[0-9]+)?)\s*(us|ms|s)?", text)
    if match is None:
        raise InputError(f"window is {text!r}", "--window", "give auto, an odd number of samples, or 20ms")
    if match[2] is None:
        if not match[1].isdigit():
            raise InputError(f"window is {text!r}", "--window", "give a whole number of samples, or a unit: 20ms")
        return int(match[1])
    seconds = float(match[1]) * {"us": 1e-6, "ms": 1e-3, "s": 1.0}[match[2]]
    longest = longest_piece(series)
    if seconds > longest * series.interval:
        raise InputError(
            f"window is {text}; the longest stretch of the record lasts {longest * series.interval:.4g} s",
            "--window",
            "give a shorter one",
        )
    samples = 2 * round(seconds / (2 * series.interval)) + 1
    if samples < 3:
        raise InputError(
            f"window is {text}, less than two sample intervals of {series.interval * 1e3:.3g} ms",
            "--window",
            "give a longer one",
        )
    return samples


def longest_piece(series: Series) -> int:
    """Return how many samples the longest stretch without a gap has."""
    return int(max(piece.stop - piece.start for piece in series.pieces))


def check_window(window: int, order: int) -> None:
    """Raise InputError unless the window is odd and above the order."""
    if window % 2 == 0 or window <= order:
        raise InputError(
            f"window is {window}; need an odd number above order {order}",
            "--window",
            f"take {max(window + 1 - window % 2, order + 1 + order % 2)}",
        )


def refuse_window(setting: Setting, method: str, why: str) -> None:
    """Raise InputError, saying ``why``, when a window or an order was asked of a method that has none."""
    if setting.window is not None or setting.order is not None:
        raise InputError(why, f"--method {method}", "leave out --window and --order, or take --method sg")


def parse_belt_speed(belt_speed: float | str) -> float | None:
    """Return the belt speed that a person states, m/s, or None for "auto"; InputError unless it is a finite number."""
    if belt_speed == "auto":
        return None
    try:
        value = float(belt_speed)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(f"belt speed is {belt_speed!r}", "--belt-speed", "give auto, or a speed in m/s with its sign")
    return value


def is_possible_speed(stated: Measured, seen: float) -> bool:
    """Return whether sticks at the speed ``seen``, m/s, may be those of a belt that runs at the stated speed."""
    if stated.value == 0 or not math.isfinite(seen):
        return stated.value != 0
    slack = 4 * stated.sd / abs(stated.value)
    return SLOWEST_STICKS - slack < seen / stated.value < FASTEST_STICKS + slack
