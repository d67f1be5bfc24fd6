"""Error against run time: every method and a range of its settings on one record.

The true errors are available only if the run file of a simulated rig contains the truth; this is the only module of
`processing` that may read it.
"""

import math
import time as clock
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from daq.runfile.recording import Recording
from daq.runfile.run_data import Truth
from processing import methods
from processing.record import series
from processing.record.motion import Motion
from processing.record.series import Series
from processing.record.setting import Setting, parse_window
from stickslip.compute.arrays import Array

WINDOWS = (11, 21, 41, 81, 161)  # samples: windows in the table
ORDER = 4  # of their polynomials


@dataclass(frozen=True)
class MethodError:
    """The errors of one method in one setting."""

    method: str  # what was run
    setting: str
    cpu_s: float  # CPU time of one run, s
    sigma_v: float  # root mean square of the velocity's own standard errors, m/s
    rms_error: float | None  # velocity against truth, m/s; None without truth
    max_error: float | None


def compare_methods(
    recording: Recording, truth: Truth | None, progress: Callable[[float], None] = lambda share: None
) -> list[MethodError]:
    """Run every method on nominal and on recorded times; ``progress`` is called with the percentage done."""
    for times in series.TIMES:
        for method in ("sg", "segment"):  # compile their kernels before timing; an even grid needs other ones
            methods.estimate(method, series.from_recording(recording, times), Setting())
    true = velocity_at(recording, truth) if truth is not None else None
    errors: list[MethodError] = []
    for times in reversed(series.TIMES):
        data = series.from_recording(recording, times)
        longest = max(piece.stop - piece.start for piece in data.pieces)
        windows = [(f"{length},{ORDER}", Setting(length, ORDER)) for length in WINDOWS if length <= longest]
        windows.append(("auto", parse_window("auto", None, data)))
        runs = [("fd", times, Setting()), *(("sg", f"{name} {times}", window) for name, window in windows)]
        runs += [(method, times, Setting()) for method in ("rts", "segment", "auto")]
        for method, name, setting in runs:
            errors.append(_measure_method(method, name, data, setting, true))
            progress(100.0 * len(errors) / (len(series.TIMES) * len(runs)))
    return errors


def _measure_method(method: str, setting: str, data: Series, choice: Setting, true: Array | None) -> MethodError:
    started = clock.process_time()
    motion = methods.estimate(method, data, choice)
    cpu = clock.process_time() - started
    if setting.startswith("auto"):
        setting = f"auto = {motion.window},{motion.order}{setting[4:]}"
    if method == "auto":
        setting = f"{setting} = {motion.method}"
    rms, worst = _measure_errors(motion, true) if true is not None else (None, None)
    finite = np.isfinite(motion.velocity_errors)
    sigma = float(np.sqrt(np.mean(motion.velocity_errors[finite] ** 2))) if finite.any() else math.inf
    return MethodError(method, setting, cpu, sigma, rms, worst)


def _measure_errors(motion: Motion, true: Array) -> tuple[float, float] | tuple[None, None]:
    error = (motion.velocity - true)[np.isfinite(true) & np.isfinite(motion.velocity_errors)]
    if not error.size:
        return None, None
    return float(np.sqrt(np.mean(error**2))), float(np.abs(error).max())


def velocity_at(recording: Recording, truth: Truth) -> Array:
    """Return the true velocity at the recorded samples, m/s; NaN where the truth has no sample nearby.

    If both have equally many samples, these are the same; otherwise (rows were lost) each recorded sample is paired
    with the true one nearest in time.
    """
    if truth.v.size == recording.time.size:
        return truth.v
    if truth.v.size < 2:
        return np.full(recording.time.size, np.nan)
    after = np.clip(np.searchsorted(truth.time, recording.time), 1, truth.time.size - 1)
    nearest = after - (recording.time - truth.time[after - 1] < truth.time[after] - recording.time)
    velocity = truth.v[nearest].copy()
    velocity[np.abs(truth.time[nearest] - recording.time) > 0.5 / recording.rate_hz] = np.nan
    return velocity
