"""The methods that estimate velocity from position, with one signature.

A method is two functions: ``learn(method, series, setting, noise)`` returns its `MethodModel`, and InputError for a
setting that is impossible; ``apply(series, model)`` returns the `Motion`.  The model learned from a record, or from
stretches that represent it, is applied to all of it, in one block or in many.  To add a method, add its line to
`METHODS`.

Every method must satisfy one contract (tests/processing/methods/test_methods.py): shapes are kept, zero gives zero, a
straight line is reproduced exactly, nothing crosses a gap, and errors are positive; bad samples are rejected before it,
by index.

Smoothers need no window: "rts" smooths all motion in one way, "segment" sticks and slips separately.  "auto", the
default, is "segment" if the record clearly contains sticks, else "rts".  A stick is clear if it raises the log
likelihood of the record by 1.5 ln n for each of its corners (`processing.stick_slip.accept`).

Savitzky-Golay.  The window is given, or chosen from the record without knowing the truth.  Cross-validation fails at
coarse counts, whose error is a slow sawtooth instead of white noise.  The likelihood of a smoother does not: the record
is smoothed by the default, and the filter (window, order) whose velocity is closest to the smoother's is chosen.  It is
within a few per cent of the best window for the true motion, from 1 to 200 um a count, with and without jitter
(tests/processing/methods/test_window_choice.py).  Uneven times are moved to the even grid for this choice only; the
smoothing uses the recorded times.

Finite differences: the thesis's first method, kept as the baseline that shows why smoothing is needed.  The velocity is
the gradient between a sample and the next, v_i = (x_{i+1} - x_i)/(t_{i+1} - t_i); the last sample of a piece repeats
the one before it.  One count over one interval is already pitch/interval: 7.7 mm/s at 1 kHz.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from processing.kalman import white_jerk
from processing.polynomial import savgol
from processing.polynomial.even import coefficients, convolve, even_grid
from processing.record.motion import Motion
from processing.record.noise import position_noise
from processing.record.series import Series
from processing.record.setting import DEFAULT_ORDER, Setting, check_window, longest_piece, reject_window
from processing.record.stretches import LEAST, MOST, representative_stretches, survey
from processing.stick_slip import smoother
from processing.stick_slip.plateaus import PlateauRule
from processing.stick_slip.smoother import FirstPass, StickSlip
from stickslip.compute.arrays import Array
from stickslip.errors import InputError, nearest


@dataclass(frozen=True, eq=False, kw_only=True)
class MethodModel:
    """The method that runs, and its learned parameters."""

    method: str  # never "auto"
    noise: float  # standard deviation of a position, m
    jerk: white_jerk.Noise  # of the record as a motion of white jerk, also used where readings are missing
    window: int = 0  # of Savitzky-Golay; 0 for the others
    order: int = 0
    rule: PlateauRule | None = None  # for finding sticks in the motion smoothed with ``jerk``; None without sticks
    sticks: StickSlip | None = None  # how the record sticks and slips; None if it does not, or for other methods
    stated: float | None = None  # belt speed that a person stated, m/s, signed
    # results of learning that are reused for the same series; not stored
    first_pass: FirstPass | None = field(default=None, metadata={"stored": False})


Learn = Callable[[str, Series, Setting, float], MethodModel]
Apply = Callable[[Series, MethodModel], Motion]


def learn_smoother(method: str, series: Series, setting: Setting, noise: float) -> MethodModel:
    """Fit the noise levels by maximum likelihood, and whether and how the record sticks and slips.

    A belt speed in the setting is that of the sticks; InputError for a window or an order.
    """
    reject_window(setting, method, f"{method} has no window: the smoothing is estimated from the record")
    jerk, stated = white_jerk.fit(series), setting.belt_speed
    if method == "rts":
        return MethodModel(method="rts", noise=noise, jerk=jerk, stated=stated)
    pilot = white_jerk.smooth(series, jerk)
    rule, sticks, first_pass = smoother.learn(series, jerk, pilot, stated, gated=method == "auto")
    chosen = "rts" if method == "auto" and sticks is None else "segment"
    return MethodModel(
        method=chosen, noise=noise, jerk=jerk, rule=rule, sticks=sticks, stated=stated, first_pass=first_pass
    )


def apply_smoother(series: Series, model: MethodModel) -> Motion:
    """Smooth the record, or a block of it; the motion states the window of the equivalent Savitzky-Golay filter."""
    first_pass = model.first_pass
    pilot = (
        first_pass.pilot
        if first_pass is not None and first_pass.series is series
        else white_jerk.smooth(series, model.jerk)
    )
    if model.sticks is None or model.rule is None:
        return replace(pilot, method=model.method)
    return smoother.apply(series, pilot, model.stated, model.rule, model.sticks, first_pass)


ORDERS = (2, 4, 6)  # an odd order has the velocity of the even one above it
EQUIVALENT = {2: 5.0, 4: 9.0, 6: 13.5}  # window times rho**(1/6) of the filter nearest to a white-jerk smoother
LONGEST = 3001  # samples: the longest window that `processing.polynomial.even` is tested for
COMPARED = 2**17  # samples that the filters are compared on; of a longer record, stretches spread over it
FACTORS = np.geomspace(0.6, 1.6, 14)  # windows tried, relative to the equivalent one, in steps of 8 %


@dataclass(frozen=True)
class WindowChoice:
    window: int
    order: int
    reading_error: float  # estimated for the choice, m; 0 for a record without information on it


def choose_window(series: Series, order: int | None = None) -> WindowChoice:
    """Choose the window (and the order, unless one is given) from the record, at most as long as its longest piece.

    A record without information on the noise (at rest, or of few samples) gets window 41 and order 4.
    """
    limit = min(longest_piece(series), LONGEST)
    stretches = representative_stretches(series, COMPARED)
    grids = [even_grid(series.time[stretch], series.position[stretch]) for stretch in stretches]
    if not any(np.any(np.diff(grid, 3)) for grid in grids):
        degree = 4 if order is None else order
        return WindowChoice(_limit_window(max(41, degree + 1 | 1), degree, limit), degree, 0.0)
    noise = white_jerk.fit(series)
    motion = estimate("auto", series, Setting())
    velocities = [
        _move_velocity_to_grid(series.time[stretch], motion.velocity[stretch], motion.acceleration[stretch])
        for stretch in stretches
    ]
    orders = (order,) if order is not None else ORDERS
    window, degree = _find_closest(grids, velocities, math.log(noise.rho(series.interval)), orders)
    return WindowChoice(_limit_window(window, degree, limit), degree, math.sqrt(noise.reading))


def _move_velocity_to_grid(time: Array, velocity: Array, acceleration: Array) -> Array:
    """Return the velocity, m per sample interval, moved to the even grid of `even_grid`."""
    step = (time[-1] - time[0]) / (time.size - 1)
    offset = time - (time[0] + step * np.arange(time.size))
    return np.asarray((velocity - offset * acceleration) * step)


def _limit_window(window: int, order: int, limit: int) -> int:
    """Return the longest odd window not above ``window`` or ``limit``, yet above the order."""
    return max(min(window, limit - 1 + limit % 2), order + 1 + order % 2)


def _find_closest(grids: list[Array], goals: list[Array], log_rho: float, orders: tuple[int, ...]) -> tuple[int, int]:
    """Return window and order of the filter whose velocity is closest to ``goals``, the smoother's, of each stretch."""
    best = (math.inf, 41, 4)
    for degree in orders:
        even = degree + degree % 2
        middle = EQUIVALENT.get(even, 2.25 * even) / math.exp(log_rho / 6)
        for window in sorted({min(max(int(middle * factor) | 1, even + 3), LONGEST) for factor in FACTORS}):
            best = min(best, (_mean_square_difference(grids, goals, window, degree), window, degree))
    return best[1], best[2]


def _mean_square_difference(grids: list[Array], goals: list[Array], window: int, order: int) -> float:
    """Return the mean square difference of the filter's velocity from the smoother's, where the window is centred."""
    weights = coefficients(window, order)[:2]
    half = window // 2
    differences = [
        convolve(grid, weights)[1] - goal[half : goal.size - half]
        for grid, goal in zip(grids, goals, strict=True)
        if grid.size >= window
    ]
    return float(np.mean(np.concatenate(differences) ** 2)) if differences else math.inf


def learn_savgol(method: str, series: Series, setting: Setting, noise: float) -> MethodModel:
    """Return the model with window and order, chosen from the record if they are None in the setting.

    InputError for an even window, or one that does not exceed the order.
    """
    if setting.window is None:
        chosen = choose_window(series, setting.order)
        length, order = chosen.window, chosen.order
    else:
        length, order = setting.window, DEFAULT_ORDER if setting.order is None else setting.order
    check_window(length, order)
    jerk = white_jerk.fit(series)
    return MethodModel(method=method, noise=noise, jerk=jerk, window=length, order=order, stated=setting.belt_speed)


def apply_savgol(series: Series, model: MethodModel) -> Motion:
    """Fit local polynomials."""
    length, order = model.window, model.order
    values, norms, probe, probe_norms = (np.empty((3, series.time.size)) for _ in range(4))
    for piece in series.pieces:
        samples = series.time[piece], series.position[piece]
        values[:, piece], norms[:, piece] = savgol.fit(*samples, length, order)
        probe[:, piece], probe_norms[:, piece] = savgol.fit(*samples, savgol.probe_window(length, order), order)
    errors = np.empty_like(values)
    floor = series.pitch / np.sqrt(12) if length > order + 3 else model.noise
    for piece in series.pieces:
        errors[:, piece] = savgol.standard_errors(
            series.position[piece],
            (values[:, piece], norms[:, piece]),
            (probe[:, piece], probe_norms[:, piece]),
            length,
            floor,
        )
    return Motion.from_rows(series, values, errors, window=length, order=order, method=model.method)


DIFFERENCE = 2  # samples in a finite difference


def learn_differences(method: str, series: Series, setting: Setting, noise: float) -> MethodModel:
    """Return the model; InputError for a window or an order, since the method is a line through two points."""
    reject_window(setting, method, "finite differences have no window")
    jerk = white_jerk.fit(series)
    return MethodModel(method=method, noise=noise, jerk=jerk, window=DIFFERENCE, order=1, stated=setting.belt_speed)


def apply_differences(series: Series, model: MethodModel) -> Motion:
    """Differentiate by differences: the forward one for velocity, the second one of three samples for acceleration.

    The errors assume independent reading errors and exclude the truncation error a dt/2 of a one-sided difference.
    """
    n = series.time.size
    velocity, acceleration = np.zeros(n), np.zeros(n)
    velocity_errors, acceleration_errors = np.full(n, np.inf), np.full(n, np.inf)
    sigma = model.noise
    for piece in series.pieces:
        t, x = series.time[piece], series.position[piece]
        if t.size < 2:
            continue
        step = np.diff(t)
        v = np.diff(x) / step
        velocity[piece] = np.append(v, v[-1])
        velocity_errors[piece] = np.sqrt(2.0) * sigma / np.append(step, step[-1])
        if t.size < 3:
            continue
        h, k = step[:-1], step[1:]
        a = 2 * np.diff(v) / (h + k)
        acceleration[piece] = np.concatenate((a[:1], a, a[-1:]))
        weight = 2 / (h + k) * np.sqrt(1 / h**2 + (1 / h + 1 / k) ** 2 + 1 / k**2)
        acceleration_errors[piece] = sigma * np.concatenate((weight[:1], weight, weight[-1:]))
    return Motion(
        position=series.origin + series.position,
        velocity=velocity,
        acceleration=acceleration,
        position_errors=np.full(n, sigma),
        velocity_errors=velocity_errors,
        acceleration_errors=acceleration_errors,
        window=model.window,
        order=model.order,
        method=model.method,
    )


METHODS: dict[str, tuple[Learn, Apply]] = {
    "auto": (learn_smoother, apply_smoother),
    "segment": (learn_smoother, apply_smoother),
    "rts": (learn_smoother, apply_smoother),
    "sg": (learn_savgol, apply_savgol),
    "fd": (learn_differences, apply_differences),
}
SMOOTHERS = ("segment", "rts")  # they handle missing readings


def check_method(name: str) -> None:
    """Raise InputError for an unknown method."""
    if name not in METHODS:
        raise InputError(f"method is {name!r}", "--method", nearest(name, tuple(METHODS)))


def choose_method(name: str, setting: Setting) -> str:
    """Return the method that runs: a window or an order applies to Savitzky-Golay alone, so "auto" with one is "sg"."""
    return "sg" if name == "auto" and (setting.window is not None or setting.order is not None) else name


def learn(name: str, series: Series, setting: Setting, noise: float | None = None) -> MethodModel:
    """Learn the model of the method ``name`` from a record; its ``method`` is the one that "auto" chose.

    ``noise`` is the standard deviation of a position, m, by default that of the series.
    """
    check_method(name)
    method = choose_method(name, setting)
    if method not in ("auto", *SMOOTHERS):
        series = series.drop_missing()
    return METHODS[method][0](method, series, setting, position_noise(series) if noise is None else noise)


def apply(series: Series, model: MethodModel) -> Motion:
    """Estimate the motion of the record that the model was learned from, or of a block of it.

    For methods other than the smoothers, the motion where readings are missing (NaN) is one of white jerk.
    """
    smooth, present = METHODS[model.method][1], ~np.isnan(series.position)
    if model.method in SMOOTHERS or present.all():
        return smooth(series, model)
    motion = smooth(series.select(present), model)
    rows = white_jerk.smooth(series, model.jerk).as_rows()
    rows[:, present] = motion.as_rows()
    return motion.with_rows(rows)


def estimate(name: str, series: Series, setting: Setting) -> Motion:
    """Estimate the motion of a record: learn from stretches that represent it, and apply the model to all of it."""
    record = survey(series.position.__getitem__, series.time.size)
    for least in sample_counts(name, setting):
        kept = np.zeros(series.time.size, bool)
        for stretch in record.stretches(least):
            kept[stretch] = True
        model = learn(name, series if kept.all() else series.select(kept), setting)
        if model.sticks is not None or kept.all():
            break
    return apply(series, model)


def sample_counts(name: str, setting: Setting) -> tuple[int, ...]:
    """Return how many samples a method learns from, at least: the first number, then more if those show no sticks."""
    return (LEAST, MOST) if choose_method(name, setting) in ("auto", "segment") else (MOST,)
