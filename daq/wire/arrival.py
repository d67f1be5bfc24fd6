"""When lines arrived, compared with their time stamps: how a leap of a clock without sequence numbers is detected.

Lines contain only their time stamps to tell a gap from a restart of the board.  A board that has run for an hour and
is reset sends a smaller time; modulo 2^32 that is also a step forward, of minutes.  The host decides: no line arrives
before it was sent.  The delay of a line, host minus device, is at least the smallest one so far; a time that leaps
ahead of the host makes it smaller.  Late reads, stalls and a suspended computer make it larger, and prove nothing.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

# By how much a line may seem to precede the least delay: the share of a gap by which the clocks may differ (a crystal
# 0.01 %, a ceramic resonator 0.5 %), and the uncertainty of the least delay, s (reads every 20 ms, USB chips 16 ms).
BELIEVABLE = 0.02
DELAY_DOUBT_S = 0.1


class LeastDelay:
    """The least delay of a board's lines since it started."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget all lines: the board has restarted."""
        self._first: tuple[float, float] | None = None  # device's time and delay of the first line, s
        self._least = float("inf")

    def note(
        self, device_s: Sequence[float] | NDArray[np.float64], delay_s: Sequence[float] | NDArray[np.float64]
    ) -> None:
        """Add lines, (n,): the device's time and the delay of each, s."""
        if len(delay_s) == 0:
            return
        if self._first is None:
            self._first = float(device_s[0]), float(delay_s[0])
        self._least = min(self._least, float(np.min(delay_s)))

    def has_leapt(self, device_s: float, delay_s: float, gap_s: float) -> bool:
        """Return whether a line after a gap in the device's time came before it can have been sent.

        False, too, where the clocks cannot be compared: bytes that were played faster than they were recorded.
        """
        if self._first is None:
            return False
        first_device_s, first_delay_s = self._first
        comparable = self._least > first_delay_s - DELAY_DOUBT_S - BELIEVABLE * (device_s - gap_s - first_device_s)
        return comparable and delay_s < self._least - DELAY_DOUBT_S - BELIEVABLE * gap_s
