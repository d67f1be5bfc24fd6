"""Savitzky-Golay as samples come: what a stream gives is what the whole record gives, bit for bit.

A sample's motion is told when half a window has come behind it; the last half window is told by `finish`.  Times are
even: a stream cannot know the rest of an uneven clock.
"""

import numpy as np

from daq.compute.arrays import Array, Integers
from daq.errors import InputError
from processing.methods import window_choice as windows
from processing.polynomial import moments, savgol


class SavgolStream:
    """The filter at work on counts.

    Parameters
    ----------
    window, order : int
        Odd number of samples, and degree below it.
    interval : float
        Seconds between samples.
    pitch : float
        Metres per count, with its sign.

    Raises
    ------
    InputError
        For an even window, one not above its order, or an interval that is not positive.
    """

    def __init__(self, window: int, order: int, interval: float, pitch: float = 1.0) -> None:
        windows.check(window, order)
        if not interval > 0:
            raise InputError(f"interval is {interval:g} s", "stream", "give a positive number of seconds")
        self.window, self.order, self.pitch = window, order, pitch
        self._scale = np.array([1.0, 1.0 / interval, 1.0 / interval**2])[:, None]
        self._held: Integers = np.empty(0, np.int64)
        self._origin = 0
        self._begun: bool | None = None

    def push(self, count: Integers) -> Array:
        """Take the next counts; return x, v, a (m from the first count, m/s, m/s^2) of those told now, (3, k).

        Raises
        ------
        InputError
            For counts that change faster than whole numbers of 64 bits can take in such a window.
        """
        if self._begun is None and len(count):
            self._begun, self._origin = False, int(count[0])
        held = np.concatenate((self._held, np.asarray(count, np.int64) - self._origin))
        limit = moments.fastest(self.window, self.order)
        if limit and held.size > 1 and float(np.abs(np.diff(held)).max()) > limit:
            raise InputError(f"more than {limit:.0f} counts in a sample", "stream", "take a shorter window")
        self._held = held
        if held.size < self.window:
            return np.empty((3, 0))
        half = self.window // 2
        position = np.asarray(held * self.pitch, np.float64)
        values = np.empty((3, position.size))
        counted = savgol.Counted(held if self.pitch > 0 else -held, abs(self.pitch))
        savgol.inside(position, self.window, self.order, counted, values)
        told = values[:, half + 1 if self._begun else half : position.size - half]  # what was told is not told again
        if not self._begun:
            self._begun = True
            begin = savgol.ends(position[: self.window], position[: self.window], self.order)[0]
            told = np.concatenate((begin, told), axis=1)
        self._held = held[held.size - self.window :]
        return np.asarray(told * self._scale)

    def finish(self) -> Array:
        """Return the motion of the last half window, (3, half).

        Raises
        ------
        InputError
            When fewer samples came than the window holds.
        """
        if self._held.size < self.window:
            raise InputError(
                f"{self._held.size} samples came; the window holds {self.window}", "stream", "take a shorter window"
            )
        position = np.asarray(self._held * self.pitch, np.float64)
        return np.asarray(savgol.ends(position, position, self.order)[1] * self._scale)
