"""Error against run time: every method and a range of its settings on one record.

The true errors are stated only where the run file of a simulated rig holds the truth; this is the one place in
`processing` that may look at it.
"""

import math
import time as clock
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from daq.runfile.recording import Recording, Truth
from processing.methods import registry
from processing.record import series
from processing.record.motion import Motion
from processing.record.series import Series
from processing.record.setting import Setting, parse_window
from stickslip.compute.arrays import Array

WINDOWS = (11, 21, 41, 81, 161)  # samples: what a table of windows shows
ORDER = 4  # of the polynomials in that table


@dataclass(frozen=True)
class MethodError:
    """The errors of one method in one setting."""

    method: str  # what was run
    setting: str
    cpu_s: float  # CPU time of one run, s
    sigma_v: float  # root mean square of the velocity's own standard errors, m/s
    rms_error: float | None  # velocity against truth, m/s; None without truth
    max_error: float | None


def rows(
    recording: Recording, truth: Truth | None, progress: Callable[[float], None] = lambda share: None
) -> list[MethodError]:
    """Run every method on the recording.

    recording: The run.
    truth: Its exact motion, where it is known.
    progress: Called after each row with the percentage of rows done.
    Returns: Finite differences, Savitzky-Golay, both smoothers and auto, on nominal and on recorded times.
    """
    for times in series.TIMES:
        for method in ("sg", "segment"):  # compiles what it needs now, an even grid needs other kernels
            registry.estimate(method, series.from_recording(recording, times), Setting())
    true = velocity_at(recording, truth) if truth is not None else None
    found: list[MethodError] = []
    for times in reversed(series.TIMES):
        data = series.from_recording(recording, times)
        longest = max(piece.stop - piece.start for piece in data.pieces)
        windows = [(f"{length},{ORDER}", Setting(length, ORDER)) for length in WINDOWS if length <= longest]
        windows.append(("auto", parse_window("auto", None, data)))
        asked = [("fd", times, Setting()), *(("sg", f"{name} {times}", window) for name, window in windows)]
        asked += [(method, times, Setting()) for method in ("rts", "segment", "auto")]
        for method, name, setting in asked:
            found.append(_row(method, name, data, setting, true))
            progress(100.0 * len(found) / (len(series.TIMES) * len(asked)))
    return found


def _row(method: str, setting: str, data: Series, asked: Setting, true: Array | None) -> MethodError:
    begun = clock.process_time()
    motion = registry.estimate(method, data, asked)
    cpu = clock.process_time() - begun
    if setting.startswith("auto"):
        setting = f"auto = {motion.window},{motion.order}{setting[4:]}"
    if method == "auto":
        setting = f"{setting} = {motion.method}"
    rms, worst = _errors(motion, true) if true is not None else (None, None)
    known = np.isfinite(motion.velocity_errors)
    sigma = float(np.sqrt(np.mean(motion.velocity_errors[known] ** 2))) if known.any() else math.inf
    return MethodError(method, setting, cpu, sigma, rms, worst)


def _errors(motion: Motion, true: Array) -> tuple[float, float] | tuple[None, None]:
    error = (motion.velocity - true)[np.isfinite(true) & np.isfinite(motion.velocity_errors)]
    if not error.size:
        return None, None
    return float(np.sqrt(np.mean(error**2))), float(np.abs(error).max())


def velocity_at(recording: Recording, truth: Truth) -> Array:
    """Return the true velocity at the recorded samples, m/s; NaN where the truth holds no sample near.

    Both are on the run's time axis.  They name the same samples when they are equally many; otherwise (rows were lost
    on the way) each recorded sample takes the true one nearest in time.
    """
    if truth.v.size == recording.time.size:
        return truth.v
    if truth.v.size < 2:
        return np.full(recording.time.size, np.nan)
    after = np.clip(np.searchsorted(truth.time, recording.time), 1, truth.time.size - 1)
    nearest = after - (recording.time - truth.time[after - 1] < truth.time[after] - recording.time)
    found = truth.v[nearest].copy()
    found[np.abs(truth.time[nearest] - recording.time) > 0.5 / recording.rate_hz] = np.nan
    return found
