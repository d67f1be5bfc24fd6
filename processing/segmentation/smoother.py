"""Smoothing that knows sticks from slips: corners fitted to the record, the roughness of each part by likelihood.

A stick on an even belt is a straight line; a slip is a motion of white snap (`processing.kalman.snap_kernel`), rougher
near its ends, where friction changes fast, than in its middle.  The parts meet in corners: at a landing x and v go on
and the acceleration drops to 0, at an onset the jerk jumps (the acceleration too, where the break-away level differs).
A belt that does not run evenly is ridden, smoothly, instead of stuck to.

1. A first motion (`processing.kalman.white_jerk`) shows sticks (`processing.segmentation.plateaus`), and rest before
   the belt starts.
2. Noise levels (`processing.segmentation.noise_levels`) and switching times
   (`processing.segmentation.switching_estimate`) are made more likely in turns.
3. Model selection keeps the sticks that the record supports (`processing.segmentation.model_selection`).
4. The motion is averaged over the uncertainty of the switching times (two nodes of Gauss and Hermite), and so are its
   errors.  One pass at their estimates is as accurate, but its errors cover 86 % near landings instead of 96 %.
5. In a stick on an even belt velocity and error are those of straight lines (`processing.segmentation.line_fit`).

Not modelled: corners within a slip other than kicks, and counts that hardly change.
"""

from dataclasses import replace

import numpy as np

from daq.compute.arrays import Array, Mask, runs
from daq.compute.compile import compiled
from processing.kalman import snap_kernel, white_jerk
from processing.kalman.snap_kernel import KICK, LABELS, LAND, LEAVE, MEET, SLIP, START, STICK, STOP
from processing.record.motion import Corner, Motion
from processing.record.series import Series
from processing.record.setting import Setting
from processing.segmentation import model_selection, plateaus
from processing.segmentation.landing_snap import with_means
from processing.segmentation.line_fit import fit_lines
from processing.segmentation.noise_levels import Levels, Room, filtered, first_levels, learned
from processing.segmentation.switching_estimate import placed
from processing.segmentation.switching_times import KERNELS, Layout, laid_out, stretches

WHAT = {LAND: "land", MEET: "land", LEAVE: "leave", KICK: "kick", START: "start", STOP: "stop"}
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
    """Smooth, averaging over the uncertainty of the switching times: each a standard deviation early, and late.

    The smoother's variance is that of readings and of the motion's own noise.  A slip is smooth but for its ends, and
    errs by the readings' share alone: about 1 - (2 d + 1)/8 of that variance in the d-th derivative.
    """
    early, stick = _run(series, room, layout, -1.0, levels)
    _straighten(series, stick, layout, levels, early)
    late, stick_late = _run(series, room, layout, 1.0, levels)
    mean = (early[:3] + late[:3]) / 2
    apart = (early[:3] - mean) ** 2 + (late[:3] - mean) ** 2
    share = 1 - (2 * np.arange(3)[:, None] + 1) / 8
    variance = (share * (early[3:] + late[3:]) + apart) / 2
    both = stick & stick_late
    x, v, a = np.where(both, early[:3], mean)
    errors = np.sqrt(np.maximum(np.where(both, early[3:], variance), 0.0))
    return Motion(
        position=series.origin + x,
        velocity=v,
        acceleration=a,
        position_errors=errors[0],
        velocity_errors=errors[1],
        acceleration_errors=errors[2],
        window=window,
        order=ORDER,
        method="segment",
        corners=tuple(
            Corner(float(at), float(sd), WHAT[int(kind)])
            for at, sd, kind in zip(layout.at, layout.sd, layout.kind, strict=True)
        ),
    )


def _run(series: Series, room: Room, layout: Layout, shift: float, levels: Levels) -> tuple[Array, Mask]:
    """Smooth with the switching times moved by ``shift`` standard deviations, in order still.

    Returns
    -------
    motion : array of shape (6, n)
        x, v, a and their variances.
    stick : array of bool, shape (n,)
    """
    layout = replace(layout, at=np.maximum.accumulate(layout.at + shift * layout.sd))
    motion, stick = np.empty((6, series.time.size)), np.zeros(series.time.size, bool)
    for piece in series.pieces:
        if piece.stop - piece.start < white_jerk.SHORT:
            motion[:, piece] = white_jerk.parabola(series.time[piece], series.position[piece], float(levels.r[SLIP]))
    back = compiled(snap_kernel.backward, KERNELS)
    for stretch in stretches(series, layout):
        label, stored = filtered(series, layout, levels, stretch, room)
        at, kind = layout.at[stretch.corners], layout.kind[stretch.corners]
        noise, steps = np.zeros((LABELS, 4)), np.zeros((snap_kernel.JUMPS, 2))
        back(series.time[stretch.own], label, at, kind, stored, True, motion[:, stretch.own], noise, steps)
        stick[stretch.own] = label == STICK
    return motion, stick


def _straighten(series: Series, stick: Mask, layout: Layout, levels: Levels, motion: Array) -> None:
    """Replace what lies in sticks by straight lines; their errors are scaled to what neighbouring lines differ by."""
    window = max(int(LINE * layout.unit / series.interval), 16)
    for piece in series.pieces:
        sticks = [slice(piece.start + i, piece.start + j) for i, j in runs(stick[piece]) if j - i >= 8]
        differing = []
        for own in sticks:
            motion[:, own], ratio = fit_lines(series.time[own], series.position[own], window, float(levels.r[STICK]))
            differing += [ratio] if ratio else []
        # A prior of four sticks on an even belt: few windows do not scale the errors by chance.
        factor = (sum(differing) + 4.0) / (len(differing) + 4.0)
        for own in sticks:
            motion[3:, own] *= factor
