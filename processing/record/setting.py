"""The setting of a method: window, order and belt speed, parsed from what a person types."""

import math
import re
from dataclasses import dataclass

from processing.record.series import Series
from stickslip.errors import InputError
from stickslip.units import Measured

HIGHEST_ORDER = 20  # polynomial degree to which coefficients are tested (`processing.polynomial.even`)
# Of a stated belt speed: range of stick speeds compatible with it, since sticks creep on a ramp; other sticks are used
# instead of the stated speed.
SLOWEST_STICKS, FASTEST_STICKS = 0.8, 1.05
DEFAULT_ORDER = 4  # for a window without an order: it keeps the curvature of v, as in the thesis


@dataclass(frozen=True)
class Setting:
    """None lets the method choose."""

    window: int | None = None  # samples
    order: int | None = None  # degree of the polynomial
    belt_speed: float | None = None  # m/s, signed


def parse_window(window: int | str, order: int | None, series: Series) -> Setting:
    """Parse a window: an odd number of samples, "auto", or a duration ("20ms", "500us"), rounded to odd samples.

    InputError for other text, an even window, one that does not exceed the order or is longer than the longest stretch,
    or an order outside 1 to 20.
    """
    if order is not None and not 1 <= order <= HIGHEST_ORDER:
        raise InputError(f"the order is {order}", "--order", f"it must be from 1 to {HIGHEST_ORDER}")
    typed = window.strip() if isinstance(window, str) else window
    if typed == "auto":
        return Setting(None, order)
    samples = _parse_samples(typed, series) if isinstance(typed, str) else typed
    check_window(samples, DEFAULT_ORDER if order is None else order)
    longest = longest_piece(series)
    if samples > longest:
        raise InputError(
            f"the window has {samples} samples, but the longest uninterrupted part of the record has {longest}",
            "--window",
            "choose a shorter window",
        )
    return Setting(samples, order)


def _parse_samples(text: str, series: Series) -> int:
    match = re.fullmatch(r"([0-9]*\.?[0-9]+(?:[eE][-+]?[0-9]+)?)\s*(us|ms|s)?", text)
    if match is None:
        raise InputError(
            f"window is {text!r}", "--window", "use 'auto', an odd number of samples, or a duration such as 20ms"
        )
    if match[2] is None:
        if not match[1].isdigit():
            raise InputError(
                f"window is {text!r}", "--window", "use a whole number of samples, or a duration such as 20ms"
            )
        return int(match[1])
    seconds = float(match[1]) * {"us": 1e-6, "ms": 1e-3, "s": 1.0}[match[2]]
    longest = longest_piece(series)
    if seconds > longest * series.interval:
        raise InputError(
            f"the window is {text} long, but the longest uninterrupted part of the record lasts "
            f"{longest * series.interval:.4g} s",
            "--window",
            "choose a shorter window",
        )
    samples = 2 * round(seconds / (2 * series.interval)) + 1
    if samples < 3:
        raise InputError(
            f"the window of {text} is shorter than two sample intervals of {series.interval * 1e3:.3g} ms",
            "--window",
            "choose a longer window",
        )
    return samples


def longest_piece(series: Series) -> int:
    """Return the number of samples of the longest stretch without a gap."""
    return int(max(piece.stop - piece.start for piece in series.pieces))


def check_window(window: int, order: int) -> None:
    """Raise InputError unless the window is odd and above the order."""
    if window % 2 == 0 or window <= order:
        raise InputError(
            f"the window must be an odd number above the order ({order}), not {window}",
            "--window",
            f"use {max(window + 1 - window % 2, order + 1 + order % 2)}",
        )


def reject_window(setting: Setting, method: str, why: str) -> None:
    """Raise InputError, with the text ``why``, if a window or an order was given to a method without one."""
    if setting.window is not None or setting.order is not None:
        raise InputError(why, f"--method {method}", "omit --window and --order, or use --method sg")


def parse_belt_speed(belt_speed: float | str) -> float | None:
    """Return the stated belt speed, m/s, or None for "auto"; InputError unless it is a finite number."""
    if belt_speed == "auto":
        return None
    try:
        value = float(belt_speed)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(f"belt speed is {belt_speed!r}", "--belt-speed", "use 'auto', or a signed speed in m/s")
    return value


def is_possible_speed(stated: Measured, stick_speed: float) -> bool:
    """Return whether sticks at ``stick_speed``, m/s, are compatible with the stated belt speed."""
    if stated.value == 0 or not math.isfinite(stick_speed):
        return stated.value != 0
    slack = 4 * stated.sd / abs(stated.value)
    return SLOWEST_STICKS - slack < stick_speed / stated.value < FASTEST_STICKS + slack
