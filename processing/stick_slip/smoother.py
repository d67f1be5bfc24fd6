"""Smoothing of stick-slip: switching times fitted to the record, process noise of each part by likelihood.

A stick on an even belt is a straight line; a slip is a motion of white snap (`processing.kalman.stick_slip`), of
higher density near its ends, where friction changes fast, than in its middle.  The parts meet in corners: at a landing
x and v are continuous and the acceleration drops to 0; at a break-away the jerk jumps (the acceleration too, where the
break-away level differs from sliding friction).  A stick on an uneven belt is smoothed like a slip.

1. A first motion (`processing.kalman.white_jerk`) shows sticks (`processing.stick_slip.plateaus`), and rest before
   the belt starts.
2. Noise levels (`processing.stick_slip.noise`) and switching times
   (`processing.stick_slip.noise`) are made more likely in turns.
3. Model selection keeps the sticks that the record supports (`processing.stick_slip.accept`).
4. The motion and its errors are averaged over the uncertainty of the switching times (two nodes of Gauss and Hermite).
   One pass at their estimates is as accurate, but its errors cover 86 % near landings instead of 96 %.
5. In a stick on an even belt velocity and error are those of straight lines (`processing.stick_slip.line_fit`).

Not modelled: corners within a slip other than kicks, and counts that hardly change.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from processing.kalman import white_jerk
from processing.kalman.corner_kernel import BETWEEN
from processing.kalman.stick_slip import KICK, LAND, LEAVE, MEET, RIDE, SLIP, START, STICK, STOP, NoiseLevels
from processing.record.motion import Corner, Motion
from processing.record.series import Series
from processing.stick_slip import line_fit, plateaus
from processing.stick_slip.accept import (
    Gate,
    PlacedCorners,
    Span,
    accept_sticks,
    bic_penalty,
    find_odd_spans,
    learn_gate,
    stick_misfits,
)
from processing.stick_slip.corners import SwitchingTimes, group_by_stick, initial_switching_times, split_stretches
from processing.stick_slip.noise import (
    Workspace,
    guess_levels,
    learn_mean_snap,
    reestimate_noise,
    refine_switching_times,
    smooth_stretch,
)
from processing.stick_slip.plateaus import speed_of_sticks, sticks_at_corners
from stickslip.compute.arrays import HOLE, Array, Mask, runs
from stickslip.compute.compile import compiled

KERNELS = ("processing.stick_slip.line_fit",)
CORNER_NAMES = {
    LAND: "land",
    MEET: "land",
    LEAVE: "leave",
    KICK: "kick",
    START: "start",
    STOP: "stop",
}
ORDER = 7  # of the equivalent spline
BAD = 16.0  # times the median mean square innovation: misfit of a stick that may raise the noise of all
LINE = 1 / 3  # of a slip: the longest straight line through a stick (see `line_fit`)


@dataclass(frozen=True, eq=False)
class StickSlip:
    """How a record sticks and slips."""

    slip: float  # usual length of a slip, s
    first: NoiseLevels  # a rough guess, for the first search for corners
    even: NoiseLevels  # of slips, and of sticks on an even belt: for placing corners and accepting such sticks
    levels: NoiseLevels  # of slips, and of the accepted sticks on even and uneven belts
    corner: float  # log likelihood that a corner must gain
    gate: Gate | None  # for accepting sticks; None accepts all
    line: float  # factor of the variances of straight lines through sticks
    speed: float  # of the sticks, m/s


@dataclass(frozen=True, eq=False)
class FirstPass:
    """Results of `learn` that `apply` reuses for the same ``series``; for another one it computes them again."""

    series: Series
    pilot: Motion
    cut_series: Series  # without its longer holes
    corners: PlacedCorners | None = None  # None without sticks


def learn(
    series: Series, noise: white_jerk.Noise, pilot: Motion, stated: float | None, *, gated: bool
) -> tuple[plateaus.PlateauRule, StickSlip | None, FirstPass]:
    """Learn how a record sticks and slips; ``pilot`` is its motion smoothed with white jerk of level ``noise``.

    ``gated`` lets model selection decide on the sticks.  The model is None without any (accepted) stick.
    """
    rule, phases, _ = plateaus.learn(series, pilot, stated)
    first_pass = FirstPass(series, pilot, _cut_long_holes(series, rule))
    if first_pass.cut_series is not series:
        series = first_pass.cut_series
        phases = plateaus.segment(series, pilot, rule, math.nan, stated=stated).phases
    initial_times = initial_switching_times(series, phases)
    if not initial_times.time.size:
        return rule, None, first_pass
    workspace, needed = Workspace(), bic_penalty(int(np.count_nonzero(~np.isnan(series.position))))
    crude_levels = guess_levels(series, noise, pilot, initial_times.unit)
    early = _find_corners(series, workspace, initial_times, crude_levels)
    levels = _estimate_levels(series, workspace, early.times, crude_levels)
    crude_model = StickSlip(initial_times.unit, crude_levels, levels, levels, needed, None, 1.0, math.nan)
    corners = _place_corners(series, workspace, early, levels)
    times, gate = corners.times, None
    if gated:
        accepted = learn_gate(series, workspace, corners, levels, noise, needed)
        if isinstance(accepted, list):
            # One stick may fit so badly that it raises the noise of all, so that no other one is accepted either.
            bad = stick_misfits(series, workspace, early.times, crude_levels) > BAD
            odd = accepted or find_odd_spans(series, early.times, group_by_stick(early.times), bad)
            outside = _mask_outside(series, odd)
            if not odd or not outside.any():
                return rule, None, first_pass
            return learn(series.select(outside), noise, pilot.select(outside), stated, gated=True)
        times, levels, gate = accepted
    motion, stick = _smooth_at_times(series, workspace, _shift_times(series, times, -1.0), levels)
    line = _line_factor(_straighten(series, stick, times.unit, levels, motion, 1.0))
    sticks = sticks_at_corners(series, _list_corners(series, times))
    speed = speed_of_sticks(series, sticks, motion[1], pilot.window)
    model = replace(crude_model, levels=levels, gate=gate, line=line, speed=speed)
    return rule, model, replace(first_pass, corners=corners)


def _cut_long_holes(series: Series, rule: plateaus.PlateauRule) -> Series:
    """Return the record without holes longer than the shortest stick."""
    return series.cut_at_holes(max(HOLE * series.interval, rule.shortest))


def apply(
    series: Series,
    pilot: Motion,
    stated: float | None,
    rule: plateaus.PlateauRule,
    model: StickSlip,
    first_pass: FirstPass | None = None,
) -> Motion:
    """Smooth a block of a record by segments, but use the ``pilot`` where its sticks do not fit.

    Such sticks remain sticks, between their estimated switching times.
    """
    if not series.time.size:
        return pilot
    if first_pass is None or first_pass.series is not series:
        first_pass = FirstPass(series, pilot, _cut_long_holes(series, rule))
    series, workspace = first_pass.cut_series, Workspace()
    corners = first_pass.corners or _find_corners_of_block(series, workspace, pilot, stated, rule, model)
    times = corners.times
    if model.gate is not None:
        levels = model.even, model.levels
        accepted = accept_sticks(series, workspace, corners, *levels, model.gate, model.corner)
        if isinstance(accepted, list):
            outside = _mask_outside(series, accepted)
            smoothed = apply(series.select(outside), pilot.select(outside), stated, rule, model)
            rows = pilot.as_rows()
            rows[:, outside] = smoothed.as_rows()
            odd = [
                corner
                for corner in _list_corners(series, times)
                if any(low < corner.time < high for low, high in accepted)
            ]
            both = tuple(sorted((*smoothed.corners, *odd), key=lambda corner: corner.time))
            return replace(smoothed.with_rows(rows), corners=both, method="segment", order=ORDER)
        times = accepted
    return _average_over_times(series, pilot, workspace, times, model)


def _find_corners_of_block(
    series: Series,
    workspace: Workspace,
    pilot: Motion,
    stated: float | None,
    rule: plateaus.PlateauRule,
    model: StickSlip,
) -> PlacedCorners:
    """Find the corners of a block as `learn` does those of a record."""
    initial_times = initial_switching_times(
        series, plateaus.segment(series, pilot, rule, model.speed, stated=stated).phases
    )
    early = _find_corners(series, workspace, replace(initial_times, unit=model.slip), model.first)
    return _place_corners(series, workspace, early, model.even)


def _mask_outside(series: Series, spans: list[Span]) -> Mask:
    """Return a mask of the samples outside the spans, s."""
    outside = np.ones(series.time.size, bool)
    for low, high in spans:
        outside[slice(*np.searchsorted(series.time, (low, high)))] = False
    return outside


def _find_corners(
    series: Series, workspace: Workspace, initial_times: SwitchingTimes, levels: NoiseLevels
) -> PlacedCorners:
    return PlacedCorners(initial_times, refine_switching_times(series, workspace, initial_times, levels, 1.0))


def _place_corners(series: Series, workspace: Workspace, early: PlacedCorners, levels: NoiseLevels) -> PlacedCorners:
    """Return the corners refined once more, with these better ``levels``."""
    return PlacedCorners(early.unrefined, refine_switching_times(series, workspace, early.times, levels, 0.25))


def _estimate_levels(series: Series, workspace: Workspace, times: SwitchingTimes, levels: NoiseLevels) -> NoiseLevels:
    levels = reestimate_noise(series, workspace, times, levels, 1)
    return reestimate_noise(series, workspace, times, learn_mean_snap(series, times, levels), 1)


def _average_over_times(
    series: Series, pilot: Motion, workspace: Workspace, times: SwitchingTimes, model: StickSlip
) -> Motion:
    """Smooth with the switching times a standard deviation early and late, and average both.

    The variance of the smoother is the sum of a part from the readings and one from the process noise.  A slip is
    smooth except at its ends, so that only the former is its error.  A smoother of white snap has the response
    H = 1/(1 + w^8); the variance from the readings and the whole one are the integrals of w^(2d) H^2 and of w^(2d) H,
    and their ratio is 1 - (2 d + 1)/8 in the d-th derivative.
    """
    early, stick = _smooth_at_times(series, workspace, _shift_times(series, times, -1.0), model.levels)
    _straighten(series, stick, times.unit, model.levels, early, model.line)
    late, stick_late = _smooth_at_times(series, workspace, _shift_times(series, times, 1.0), model.levels)
    line = stick & stick_late
    for derivative in range(3):  # one at a time, so that intermediate arrays stay in the processor's cache
        share = 1 - (2 * derivative + 1) / 8
        value, variance = early[derivative], early[3 + derivative]
        half = (late[derivative] - value) / 2
        np.copyto(half, 0.0, where=line)
        value += half
        np.copyto(variance, share * (variance + late[3 + derivative]) / 2 + half**2, where=~line)
        np.sqrt(np.maximum(variance, 0.0, out=variance), out=variance)
    corners = tuple(_list_corners(series, times))
    motion = Motion.from_rows(
        series, early[:3], early[3:], window=pilot.window, order=ORDER, method="segment", corners=corners
    )
    outside = np.ones(series.time.size, bool)
    for piece in series.pieces:
        outside[piece] = False
    return motion.with_rows(np.where(outside, pilot.as_rows(), motion.as_rows())) if outside.any() else motion


def _list_corners(series: Series, times: SwitchingTimes) -> list[Corner]:
    """Return the corners; a piece that is one stick throughout has a landing at its start."""
    rows = zip(times.time.tolist(), times.sd.tolist(), times.kind.tolist(), strict=True)
    corners = [Corner(at, sd, CORNER_NAMES[kind]) for at, sd, kind in rows]
    for stretch in split_stretches(series, times):
        if stretch.first in (STICK, RIDE) and stretch.corners.start == stretch.corners.stop:
            corners.append(Corner(float(series.time[stretch.samples.start]), math.inf, "land"))
    return sorted(corners, key=lambda corner: corner.time)


def _shift_times(series: Series, times: SwitchingTimes, shift: float) -> SwitchingTimes:
    """Return the switching times moved by ``shift`` standard deviations, still in order and within their pieces."""
    corner_times, margin = times.time + shift * times.sd, BETWEEN * series.interval
    for stretch in split_stretches(series, times):
        time = series.time[stretch.samples]
        corner_times[stretch.corners] = np.clip(corner_times[stretch.corners], time[0] + margin, time[-1] - margin)
    return replace(times, time=np.maximum.accumulate(corner_times))


def _smooth_at_times(
    series: Series, workspace: Workspace, times: SwitchingTimes, levels: NoiseLevels
) -> tuple[Array, Mask]:
    """Smooth with fixed switching times; return x, v, a and their variances, (6, n), and a mask of the sticks."""
    motion, stick = np.zeros((6, series.time.size)), np.zeros(series.time.size, bool)
    for piece in series.pieces:
        if piece.stop - piece.start < white_jerk.SHORT:
            motion[:, piece] = white_jerk.fit_parabola(
                series.time[piece], series.position[piece], float(levels.reading_variance[SLIP])
            )
    for stretch in split_stretches(series, times):
        label, _, _ = smooth_stretch(series, times, levels, stretch, workspace, motion)
        stick[stretch.samples] = label == STICK
    return motion, stick


def _straighten(
    series: Series, stick: Mask, slip: float, levels: NoiseLevels, motion: Array, factor: float
) -> list[float]:
    """Replace the motion in sticks by straight lines, with variances times ``factor``; return ratios of `fit_lines`.

    ``slip`` is the usual length of a slip, s.
    """
    window = max(int(LINE * slip / series.interval), 16)
    variance = float(levels.reading_variance[STICK])
    run = compiled(line_fit.fit_lines, KERNELS)
    ratios = []
    for piece in series.pieces:
        for i, j in runs(stick[piece]):
            if j - i >= 8:
                samples = slice(piece.start + i, piece.start + j)
                ratios.append(run(series.time, series.position, samples.start, samples.stop, window, variance, motion))
                motion[3:, samples] *= factor
    return [ratio for ratio in ratios if ratio]


def _line_factor(differing: list[float]) -> float:
    """Return the factor of the variances of lines from ratios of `line_fit.fit_lines`, with a prior of four sticks."""
    return (sum(differing) + 4.0) / (len(differing) + 4.0)
