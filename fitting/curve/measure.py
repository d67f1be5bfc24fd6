"""`measure_curve`: friction against relative speed, without a law, from the fits of the laws to a record."""

import math
import time as clock
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fitting import noise_levels
from fitting.curve.band import covariances, curve_columns, half_widths, seen_speeds
from fitting.curve.result import BandExit, MeasuredCurve
from fitting.curve.spline_fit import chi, fit_spline, linearised
from fitting.distributions import normal_quantile, student_quantile
from fitting.driver.fit import Fit
from fitting.estimation.result import Parameter
from fitting.model.parameters import Global
from stickslip.compute.arrays import Array

# Error over that of the nearest jump law: a ramp law contains its jump law and is always a little nearer, by 1 % at
# most where there is no ramp.
RAMP_NEARER = 0.97


def measure_curve(fits: Sequence[Fit], noise: Array, alpha: float = 0.05) -> MeasuredCurve | None:
    """Measure the friction curve of a record, or of several runs of one contact; None where no motion can be followed.

    ``fits``, best first, give windows, calibrations and starts; ``noise`` (runs,) is in m. Of jump and ramp, the ramp
    goes first where a ramp law comes near the noise and no jump law does; the other is tried where the first does not
    reach the noise and the laws prefer it, or where the search stalled. Without a datum the curve is determined but for
    a constant, unless the levels scatter (`fitting.curve.level`). Not modelled: friction that depends on anything but
    relative speed and its level in each cycle.
    """
    begun = clock.process_time()
    ordered, prefers_ramp = _contacts(fits, noise)
    best: tuple[Fit, float] | None = None
    for fit in ordered:
        found = fit_spline(fit, noise)
        left = math.inf if found is None else chi(found, noise)
        if found is not None and (best is None or left < best[1]):
            best = found, left
        if best is not None and (
            best[1] < noise_levels.DESCRIBES or not (prefers_ramp or best[0].outcome == "no progress")
        ):
            break
    return None if best is None else _measured(*best, noise, alpha, begun)


def _contacts(fits: Sequence[Fit], noise: Array) -> tuple[list[Fit], bool]:
    """Return the best fit of each contact, first that to try first, and whether the laws prefer a ramp."""
    by_error = sorted(fits, key=lambda fit: fit.geometric_mean_rms)
    nearest = [next((fit for fit in by_error if fit.law.ramp == ramp), None) for ramp in (False, True)]
    jump, ramp = nearest
    if jump is None or ramp is None:
        return [fit for fit in nearest if fit is not None], False
    prefers_ramp = ramp.geometric_mean_rms < RAMP_NEARER * jump.geometric_mean_rms
    near = ramp.geometric_mean_rms < noise_levels.NEAR * float(np.max(noise))
    return [ramp, jump] if prefers_ramp and near else [jump, ramp], prefers_ramp


def _measured(fit: Fit, left: float, noise: Array, alpha: float, begun: float) -> MeasuredCurve:
    linear = linearised(fit)
    both = covariances(linear)
    speeds = seen_speeds(fit)
    cycles = len(fit.rows)
    quantile = student_quantile(1 - alpha / 2, max(cycles - 1, 1))
    columns, widening = curve_columns(fit, speeds), quantile / normal_quantile(1 - alpha / 2)
    half = half_widths(columns, both, 1 - alpha, widening)
    friction = fit.spline(speeds)
    ramp = float(fit.u[Global.D]) if fit.problem.ramp else 0.0
    K, error = float(fit.u[Global.K]), float(np.sqrt(max(covariance[0, 0] for covariance in both)))
    return MeasuredCurve(
        speed=speeds + ramp,
        friction=friction,
        lo=np.maximum(friction - half, 0.0),  # friction opposes the motion
        hi=friction + half,
        shape_half=half_widths(columns - columns.mean(axis=0), both, 1 - alpha, widening),
        k_over_m=Parameter(K, error, K - quantile * error, K + quantile * error, "s^-2"),
        chi=left,
        ramp=ramp,
        spline_fit=fit,
        linear=linear,
        noise=noise,
        confidence=1 - alpha,
        cpu_s=clock.process_time() - begun,
    )


def furthest_exit(curve: MeasuredCurve, friction: Array) -> BandExit:
    """Return where a friction (k,) at the curve's speeds leaves the measured band the furthest."""
    off, half = friction - curve.friction, curve.hi - curve.friction
    if not curve.level_known:
        off, half = off - off.mean(), curve.shape_half
    away = np.abs(off) / half
    place = int(np.argmax(away))
    return BandExit(float(away[place]), float(curve.speed[place]))


def in_newtons(curve: MeasuredCurve, mass: float) -> MeasuredCurve:
    """Return the curve as a force (N) on a mass (kg); k/m stays."""
    return replace(curve, **{name: mass * getattr(curve, name) for name in ("friction", "lo", "hi", "shape_half")})
