"""When lines came, against their own times: what shows that a clock without sequence numbers has leapt.

Lines hold nothing but their times to tell a gap from a restart of the board.  A board that has run for an hour and is
reset shows a time that is smaller; modulo 2^32 that is as well a step forward, of minutes.  The host decides: nothing
comes before it was sent.  The delay of a line, host minus device, is at least the least one so far; a time that leaps
ahead of the host makes it less.  Late reads, stalls and a suspended computer make it more, and prove nothing.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

# By how much a line may seem to come before the least delay: the share of a gap by which the clocks may differ (a
# crystal 0.01 %, a ceramic resonator 0.5 %), and the least delay's own uncertainty, s (reads every 20 ms, chips that
# collect for 16 ms).  Half of the latter takes a busy computer's reads for a restart; double takes a reset within
# 0.2 s of the clock's roll-over for a gap.  Not swept.
BELIEVABLE = 0.02
DELAY_DOUBT_S = 0.1


class LeastDelay:
    """The least delay of a board's lines since it started."""

    def __init__(self) -> None:
        self.begin()

    def begin(self) -> None:
        """Forget all: the board has started anew."""
        self._first: tuple[float, float] | None = None  # device's time and delay of the first line, s
        self._least = float("inf")

    def note(
        self, device_s: Sequence[float] | NDArray[np.float64], delay_s: Sequence[float] | NDArray[np.float64]
    ) -> None:
        """Take lines, (n,): the device's time and the delay of each, s."""
        if len(delay_s) == 0:
            return
        if self._first is None:
            self._first = float(device_s[0]), float(delay_s[0])
        self._least = min(self._least, float(np.min(delay_s)))

    def leapt(self, device_s: float, delay_s: float, gap_s: float) -> bool:
        """Return whether a line behind a gap in the device's time cannot have been sent yet when it came.

        False, too, where the clocks cannot be compared: bytes that were played faster than they were recorded.
        """
        if self._first is None:
            return False
        began_s, first_s = self._first
        comparable = self._least > first_s - DELAY_DOUBT_S - BELIEVABLE * (device_s - gap_s - began_s)
        return comparable and delay_s < self._least - DELAY_DOUBT_S - BELIEVABLE * gap_s
