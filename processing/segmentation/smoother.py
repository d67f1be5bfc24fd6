"""Smoothing that knows sticks from slips: corners fitted to the record, the roughness of each part by likelihood.

A stick on an even belt is a straight line; a slip is a motion of white snap (`processing.kalman.snap_kernel`), rougher
near its ends, where friction changes fast, than in its middle.  The parts meet in corners: at a landing x and v go on
and the acceleration drops to 0, at an onset the jerk jumps (the acceleration too, where the break-away level differs).
A belt that does not run evenly is ridden, smoothly, instead of stuck to.

1. A first motion (`processing.kalman.white_jerk`) shows sticks (`processing.segmentation.plateaus`), and rest before
the belt starts. 2. Noise levels (`processing.segmentation.noise_levels`) and corners
(`processing.segmentation.switching_estimate`) are made more likely in turns. 3. A gate keeps the sticks that the record
speaks for (`processing.segmentation.model_selection`). 4. The motion is averaged over what the record leaves open of
the corners' times (two nodes of Gauss and Hermite), and
   so are its errors.
5. In a stick on an even belt velocity and error are those of a straight line through at most a third of a slip's
   length: a belt is not trusted to keep its speed for longer.

Not modelled: corners within a slip other than kicks, and counts that hardly change.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from daq.compute.arrays import Array, Mask, runs
from daq.compute.compile import compiled
from processing.kalman import corner_kernel, snap_kernel, white_jerk
from processing.kalman.snap_kernel import KICK, LABELS, LAND, LEAVE, MEET, SLIP, START, STICK, STOP
from processing.record.motion import Corner, Motion
from processing.record.series import Series
from processing.record.setting import Setting
from processing.segmentation import line_fit, model_selection, plateaus
from processing.segmentation.landing_snap import with_means
from processing.segmentation.noise_levels import Levels, Room, filtered, first_levels, learned
from processing.segmentation.switching_estimate import placed
from processing.segmentation.switching_times import KERNELS, Labels, Layout, Stretch, laid_out, stretches

WHAT = {LAND: "land", MEET: "land", LEAVE: "leave", KICK: "kick", START: "start", STOP: "stop"}
LINES = ("processing.segmentation.line_fit",)
ORDER = 7  # of the spline
WIDTHS = (0.25,)
LINE = 1 / 3  # of a slip: the longest straight line through a stick


def segmented(
    series: Series, noise: white_jerk.Noise, pilot: Motion, setting: Setting, *, gated: bool
) -> Motion | None:
    """Return the motion by segments, or None when there is no stick (or none that passes the gate)."""
    found = plateaus.segment(series, pilot, None, setting.belt_speed)
    layout = laid_out(series, found)
    if not layout.at.size:
        return None
    room = Room()
    begun, levels = layout, first_levels(series, noise, pilot, layout.unit)
    layout = placed(series, room, layout, levels, 1.0)
    for width in WIDTHS:
        levels = learned(series, room, layout, levels, 1)
        levels = learned(series, room, layout, with_means(series, layout, levels), 1)
        layout = placed(series, room, layout, levels, width)
    if gated:
        kept = model_selection.passed(series, room, layout, levels, noise, begun)
        if kept is None:
            return None
        layout, levels = kept
    return _averaged(series, room, layout, levels, pilot.window)


def _averaged(series: Series, room: Room, layout: Layout, levels: Levels, window: int) -> Motion:
    """Smooth, averaging over what is open of the corners' times: each a standard deviation early, and late."""
    back = compiled(snap_kernel.backward, KERNELS)
    total, still = _run(series, room, replace(layout, at=_moved(layout, -1.0)), levels, back, lines=True)
    behind, still_behind = _run(series, room, replace(layout, at=_moved(layout, 1.0)), levels, back, lines=False)
    compiled(corner_kernel.average, KERNELS)(total, behind, still & still_behind)
    return Motion(
        position=series.origin + total[0],
        velocity=total[1],
        acceleration=total[2],
        position_errors=total[3],
        velocity_errors=total[4],
        acceleration_errors=total[5],
        window=window,
        order=ORDER,
        method="segment",
        corners=tuple(
            Corner(float(at), float(sd), WHAT[int(kind)])
            for at, sd, kind in zip(layout.at, layout.sd, layout.kind, strict=True)
        ),
    )


def _moved(layout: Layout, shift: float) -> Array:
    """Return the corners' times moved by ``shift`` standard deviations, in order still."""
    at = layout.at + shift * layout.sd
    return np.asarray(np.maximum.accumulate(at))


def _run(
    series: Series, room: Room, layout: Layout, levels: Levels, back: Callable[..., None], *, lines: bool
) -> tuple[Array, Mask]:
    """Smooth with the corners where they are; return the motion and its variances (6, n), and what lies in sticks."""
    motion, still = np.empty((6, series.time.size)), np.zeros(series.time.size, bool)
    for piece in series.pieces:
        if piece.stop - piece.start < white_jerk.SHORT:
            motion[:, piece] = white_jerk.parabola(series.time[piece], series.position[piece], float(levels.r[SLIP]))
    for stretch in stretches(series, layout):
        label, stored = filtered(series, layout, levels, stretch, room)
        at, kind = layout.at[stretch.corners], layout.kind[stretch.corners]
        noise, steps = np.zeros((LABELS, 4)), np.zeros((snap_kernel.JUMPS, 2))
        back(series.time[stretch.own], label, at, kind, stored, True, motion[:, stretch.own], noise, steps)
        still[stretch.own] = label == STICK
        if lines:
            _straighten(series, stretch, label, layout, levels, motion)
    return motion, still


def _straighten(series: Series, stretch: Stretch, label: Labels, layout: Layout, levels: Levels, motion: Array) -> None:
    """Replace what lies in sticks by straight lines; their errors are scaled to what neighbouring lines differ by."""
    run = compiled(line_fit.lines, LINES)
    window = max(int(LINE * layout.unit / series.interval), 16)
    own, variance = motion[:, stretch.own], float(levels.r[STICK])
    time, position = series.time[stretch.own], series.position[stretch.own]
    fitted = [(i, j) for i, j in runs(label == STICK) if j - i >= 8]
    differing = np.array([run(time, position, i, j, window, variance, own) for i, j in fitted])
    known = differing > 0
    factor = (differing[known].sum() + 4.0) / (known.sum() + 4.0)
    for i, j in fitted:
        own[3:, i:j] *= factor
