"""Smoothing of stick-slip: switching times fitted to the record, process noise of each part by likelihood.

A stick on an even belt is a straight line; a slip is a motion of white snap (`processing.kalman.stick_slip`), of
higher density near its ends, where friction changes fast, than in its middle.  The parts meet in corners: at a landing
x and v are continuous and the acceleration drops to 0; at a break-away the jerk jumps (the acceleration too, where the
break-away level differs from sliding friction).  A stick on an uneven belt is smoothed like a slip.

1. A first motion (`processing.kalman.white_jerk`) shows sticks (`processing.segmentation.plateaus`), and rest before
   the belt starts; the likelihood shows the corners that plateaus do not (`processing.segmentation.missed_corners`).
2. Noise levels (`processing.segmentation.noise_levels`) and switching times
   (`processing.segmentation.switching_estimate`) are made more likely in turns.
3. Model selection keeps the sticks that the record supports (`processing.segmentation.model_selection`).
4. The motion is averaged over the uncertainty of the switching times (two nodes of Gauss and Hermite), and so are its
   errors.  One pass at their estimates is as accurate, but its errors cover 86 % near landings instead of 96 %.
5. In a stick on an even belt velocity and error are those of straight lines (`processing.segmentation.line_fit`).

Not modelled: corners within a slip other than kicks, and counts that hardly change.
"""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np

from daq.compute.arrays import Array, Mask, runs
from daq.compute.compile import compiled
from processing.kalman import white_jerk
from processing.kalman.stick_slip import (
    KICK,
    LAND,
    LEAVE,
    MEET,
    OVERTAKE,
    RIDE,
    SLIP,
    START,
    STICK,
    STOP,
    NoiseLevels,
)
from processing.record.estimates import RecordEstimates
from processing.record.motion import Corner, Motion
from processing.record.series import Series
from processing.record.setting import Setting
from processing.segmentation import line_fit, model_selection, plateaus
from processing.segmentation.landing_snap import with_mean_snap
from processing.segmentation.missed_corners import misfits, with_ends, with_overtaking
from processing.segmentation.noise_levels import Workspace, first_levels, reestimate_noise, smooth_stretch
from processing.segmentation.switching_estimate import refine_switching_times
from processing.segmentation.switching_times import SwitchingTimes, initial_switching_times, sticks_of, stretches

KERNELS = ("processing.segmentation.line_fit",)
WHAT = {LAND: "land", MEET: "land", LEAVE: "leave", KICK: "kick", START: "start", STOP: "stop", OVERTAKE: "overtake"}
ORDER = 7  # of the equivalent spline
BAD = 16.0  # times the median mean square innovation: a stick that may raise the noise of all; not swept
LINE = 1 / 3  # of a slip: the longest straight line through a stick (`line_fit` describes the effect of longer ones)


def segmented(
    series: Series, noise: white_jerk.Noise, pilot: Motion, setting: Setting, estimates: RecordEstimates, *, gated: bool
) -> Motion | None:
    """Return the motion by segments, or None when there is no stick (or none that model selection accepts).

    In a block of a record whose estimates are closed it is None only where the whole record has none.
    """
    while estimates.closed and estimates.has_part("rest"):
        estimates = estimates.part("rest")
    if estimates.closed and not estimates.known("accepted"):
        return None
    found = plateaus.segment(series, pilot, None, setting.belt_speed, estimates=estimates.part("plateaus"))
    first = initial_switching_times(series, found)
    if not first.at.size and not estimates.closed:
        return None
    first = replace(first, unit=estimates.once("unit", lambda: first.unit))
    workspace = Workspace()
    crude = estimates.once("first levels", lambda: first_levels(series, noise, pilot, first.unit))
    times = refine_switching_times(series, workspace, first, crude, 1.0)
    times = with_overtaking(series, workspace, times, crude, estimates)
    first = _with_overtakes_of(first, times)
    levels = estimates.once("levels", lambda: _estimated(series, workspace, times, crude))
    speed = found.plateau_speed if setting.belt_speed is None else setting.belt_speed
    ended = with_ends(series, workspace, first, times, levels, speed, estimates)
    missed = ended is not first
    if missed:
        first, times = ended, refine_switching_times(series, workspace, ended, crude, 1.0)
    early = times, crude
    levels = estimates.once("levels with ends", lambda: _estimated(series, workspace, *early) if missed else levels)
    times = refine_switching_times(series, workspace, times, levels, 0.25)
    if gated:
        kept = model_selection.accept_sticks(series, workspace, times, levels, noise, first, estimates.part("gate"))
        if isinstance(kept, list):
            # One stick may fit so badly that it raises the noise of all: then none of the others is accepted either.
            bad = misfits(series, workspace, *early) > BAD
            odd = kept or model_selection.odd_spans(series, early[0], sticks_of(early[0]), bad)
            return _around(series, noise, pilot, setting, estimates, times, odd) if odd else None
        times, levels = kept
    estimates.once("accepted", lambda: True)
    return _averaged(series, workspace, times, levels, pilot.window, estimates)


def _with_overtakes_of(first: SwitchingTimes, times: SwitchingTimes) -> SwitchingTimes:
    """Return the times before the first refinement, with the overtaking landings that were found after it."""
    over = np.flatnonzero(times.kind == OVERTAKE)
    if not over.size:
        return first
    at, sd = (
        np.insert(first.at, over - np.arange(over.size), 0.0),
        np.insert(first.sd, over - np.arange(over.size), 0.0),
    )
    both = np.concatenate((over, over + 1))
    at[both], sd[both] = times.at[both], times.sd[both]
    return replace(times, at=at, sd=sd)


def _estimated(series: Series, workspace: Workspace, times: SwitchingTimes, levels: NoiseLevels) -> NoiseLevels:
    levels = reestimate_noise(series, workspace, times, levels, 1)
    return reestimate_noise(series, workspace, times, with_mean_snap(series, times, levels), 1)


def _around(
    series: Series,
    noise: white_jerk.Noise,
    pilot: Motion,
    setting: Setting,
    estimates: RecordEstimates,
    times: SwitchingTimes,
    odd: list[tuple[float, float]],
) -> Motion | None:
    """Smooth all but the spans ``odd``, s, by segments, and these by the first motion; None if the rest fails too.

    Sticks inside the spans stay sticks, from and to the switching ``times`` estimated.
    """
    kept = np.ones(series.time.size, bool)
    for low, high in odd:
        kept[slice(*np.searchsorted(series.time, (low, high)))] = False
    parts = [(piece.start + i, piece.start + j) for piece in series.pieces for i, j in runs(kept[piece])]
    ends = np.cumsum([0, *(j - i for i, j in parts)]).tolist()
    rest = replace(
        series,
        time=series.time[kept],
        position=series.position[kept],
        pieces=tuple(slice(i, j) for i, j in pairwise(ends)),
    )
    names = [f"{name}{end}" for name in ("position", "velocity", "acceleration") for end in ("", "_errors")]
    first = replace(pilot, **{name: getattr(pilot, name)[kept] for name in names})
    others = estimates if estimates.closed else estimates.part("rest")
    found = segmented(rest, noise, first, setting, others, gated=True) if rest.time.size else None
    if found is None:
        return None
    whole = {name: getattr(pilot, name).copy() for name in names}
    for name in names:
        whole[name][kept] = getattr(found, name)
    inside = [corner for corner in _corners(series, times) if any(low < corner.time < high for low, high in odd)]
    return replace(found, **whole, corners=tuple(sorted((*found.corners, *inside), key=lambda corner: corner.time)))


def _averaged(
    series: Series,
    workspace: Workspace,
    times: SwitchingTimes,
    levels: NoiseLevels,
    window: int,
    estimates: RecordEstimates,
) -> Motion:
    """Smooth, averaging over the uncertainty of the switching times: each a standard deviation early, and late.

    The smoother's variance has a share of the readings and one of the process noise.  A slip is smooth but for its
    ends, so there the readings' share alone is its error.  A smoother of white snap has the response
    H = 1/(1 + w^8), the two variances are the integrals of w^(2d) H^2 and of w^(2d) H, and their ratio is
    1 - (2 d + 1)/8 in the d-th derivative.
    """
    early, stick = _run(series, workspace, times, -1.0, levels)
    _straighten(series, stick, times, levels, early, estimates)
    late, stick_late = _run(series, workspace, times, 1.0, levels)
    line = stick & stick_late
    for derivative in range(3):  # one at a time, so that what is computed on the way stays in the processor's cache
        share = 1 - (2 * derivative + 1) / 8
        value, variance = early[derivative], early[3 + derivative]
        half = (late[derivative] - value) / 2
        np.copyto(half, 0.0, where=line)
        value += half
        np.copyto(variance, share * (variance + late[3 + derivative]) / 2 + half**2, where=~line)
        np.sqrt(np.maximum(variance, 0.0, out=variance), out=variance)
    corners = tuple(_corners(series, times))
    return Motion.from_rows(series, early[:3], early[3:], window=window, order=ORDER, method="segment", corners=corners)


def _corners(series: Series, times: SwitchingTimes) -> list[Corner]:
    """Return the corners; a piece that is one stick throughout has landed where it begins."""
    rows = zip(times.at.tolist(), times.sd.tolist(), times.kind.tolist(), strict=True)
    found = [Corner(at, sd, WHAT[kind]) for at, sd, kind in rows]
    for stretch in stretches(series, times):
        if stretch.first in (STICK, RIDE) and stretch.corners.start == stretch.corners.stop:
            found.append(Corner(float(series.time[stretch.own.start]), math.inf, "land"))
    return sorted(found, key=lambda corner: corner.time)


def _run(
    series: Series, workspace: Workspace, times: SwitchingTimes, shift: float, levels: NoiseLevels
) -> tuple[Array, Mask]:
    """Smooth with the switching times moved by ``shift`` standard deviations, in order still.

    Returns
    -------
    motion : array of shape (6, n)
        x, v, a and their variances.
    stick : array of bool, shape (n,)
    """
    times = replace(times, at=np.maximum.accumulate(times.at + shift * times.sd))
    motion, stick = np.empty((6, series.time.size)), np.zeros(series.time.size, bool)
    for piece in series.pieces:
        if piece.stop - piece.start < white_jerk.SHORT:
            motion[:, piece] = white_jerk.parabola(
                series.time[piece], series.position[piece], float(levels.reading_variance[SLIP])
            )
    for stretch in stretches(series, times):
        label, _, _ = smooth_stretch(series, times, levels, stretch, workspace, motion)
        stick[stretch.own] = label == STICK
    return motion, stick


def _straighten(
    series: Series, stick: Mask, times: SwitchingTimes, levels: NoiseLevels, motion: Array, estimates: RecordEstimates
) -> None:
    """Replace what lies in sticks by straight lines; their errors are scaled to what neighbouring lines differ by."""
    window = max(int(LINE * times.unit / series.interval), 16)
    variance = float(levels.reading_variance[STICK])
    run = compiled(line_fit.fit_lines, KERNELS)
    every = []
    for piece in series.pieces:
        sticks = [(piece.start + i, piece.start + j) for i, j in runs(stick[piece]) if j - i >= 8]
        ratios = [run(series.time, series.position, i, j, window, variance, motion) for i, j in sticks]
        differing = [ratio for ratio in ratios if ratio]
        every += differing
        factor = estimates.once("line factor", lambda: math.nan) if estimates.closed else _line_factor(differing)
        for i, j in sticks:
            motion[3:, i:j] *= factor
    estimates.once("line factor", lambda: _line_factor(every))


def _line_factor(differing: list[float]) -> float:
    """Return what the errors of lines are scaled by, from the ratios of `line_fit.fit_lines`.

    A prior of four sticks on an even belt: few windows do not scale the errors by chance.
    """
    return (sum(differing) + 4.0) / (len(differing) + 4.0)
