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
from dataclasses import dataclass, replace

import numpy as np

from processing.kalman import white_jerk
from processing.kalman.corner_kernel import BETWEEN
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
from processing.record.motion import Corner, Motion
from processing.record.series import Series
from processing.segmentation import line_fit, plateaus
from processing.segmentation.landing_snap import with_mean_snap
from processing.segmentation.missed_corners import misfits, with_ends, with_overtaking
from processing.segmentation.model_selection import (
    Gate,
    Judged,
    PlacedCorners,
    Span,
    accept_sticks,
    bic_penalty,
    learn_gate,
    odd_spans,
)
from processing.segmentation.noise_levels import (
    Workspace,
    first_levels,
    reestimate_noise,
    smooth_stretch,
)
from processing.segmentation.phase_layout import speed_of_sticks, sticks_at_corners
from processing.segmentation.switching_estimate import refine_switching_times
from processing.segmentation.switching_times import SwitchingTimes, initial_switching_times, sticks_of, stretches
from stickslip.compute.arrays import HOLE, Array, Mask, runs
from stickslip.compute.compile import compiled

KERNELS = ("processing.segmentation.line_fit",)
WHAT = {LAND: "land", MEET: "land", LEAVE: "leave", KICK: "kick", START: "start", STOP: "stop", OVERTAKE: "overtake"}
ORDER = 7  # of the equivalent spline
# Times the median mean square innovation: a stick that may raise the noise of all.  Half and twice smooth 26 records
# alike.
BAD = 16.0
LINE = 1 / 3  # of a slip: the longest straight line through a stick (`line_fit` describes the effect of longer ones)


@dataclass(frozen=True, eq=False)
class StickSlip:
    """How a record sticks and slips."""

    slip: float  # usual length of a slip, s
    first: NoiseLevels  # a rough guess, by which corners are looked for
    even: NoiseLevels  # of slips, and of sticks on an even belt: corners are placed by them, and such sticks accepted
    levels: NoiseLevels  # those of the sticks accepted, on an even belt and on an uneven one, and of slips
    misfit: float  # mean square innovation that the usual stick begins with (`with_overtaking`)
    corner: float  # log likelihood that a corner must gain
    gate: Gate | None  # what a stick is accepted by; None: every one is
    line: float  # what the variances of straight lines through sticks are multiplied by
    speed: float  # of the sticks, m/s


@dataclass(frozen=True, eq=False)
class FirstPass:
    """The motion and the corners of a record that were found while it was learned from.

    `apply` goes on from there where the record is the very one, ``series``, and finds the same again where it is not.
    ``parted`` is that record without its longer holes, ``corners`` is None where there is no stick, and ``judged``
    where every one is accepted.  ``early`` is what `_run` makes with the switching times of the sticks accepted,
    ``times``, a standard deviation early.
    """

    series: Series
    pilot: Motion
    parted: Series
    corners: PlacedCorners | None = None
    judged: Judged | None = None
    times: SwitchingTimes | None = None
    early: tuple[Array, Mask] | None = None

    def run_early(self, workspace: Workspace, times: SwitchingTimes, levels: NoiseLevels) -> tuple[Array, Mask]:
        """Smooth the record with these switching times a standard deviation early."""
        if self.early is not None and self.times is not None and times.is_as(self.times):
            return self.early[0].copy(), self.early[1]
        return _run(self.parted, workspace, _shifted(self.parted, times, -1.0), levels)


def learn(
    series: Series, noise: white_jerk.Noise, pilot: Motion, stated: float | None, *, gated: bool
) -> tuple[plateaus.PlateauRule, StickSlip | None, FirstPass]:
    """Learn how a record sticks and slips.

    series, noise, pilot: The record, its noise as one of white jerk, and the motion smoothed with that.
    stated: Belt speed that a person stated, m/s, signed.
    gated: Whether model selection decides on the sticks.
    Returns: By which sticks are found in the pilot.
    Returns: None where there is no stick, or none that model selection accepts.
    """
    rule, phases, _ = plateaus.learn_phases(series, pilot, stated)
    plain = FirstPass(series, pilot, _parted(series, rule))
    if plain.parted is not series:
        series = plain.parted
        phases = plateaus.segment(series, pilot, rule, math.nan, stated=stated).phases
    first = initial_switching_times(series, phases)
    if not first.at.size:
        return rule, None, plain
    workspace, needed = Workspace(), bic_penalty(int(np.count_nonzero(~np.isnan(series.position))))
    crude = first_levels(series, noise, pilot, first.unit)
    misfit, early = _looked_for(series, workspace, first, crude, None)
    levels = _estimated(series, workspace, early.times, crude)
    found = StickSlip(first.unit, crude, levels, levels, misfit, needed, None, 1.0, math.nan)
    corners = _placed(series, workspace, early, found, _aim(rule, stated))
    times, gate, judged = corners.times, None, None
    if gated:
        kept = learn_gate(series, workspace, corners, levels, noise, needed)
        if isinstance(kept, list):
            # One stick may fit so badly that it raises the noise of all: then none of the others is accepted either.
            bad = misfits(series, workspace, early.times, crude) > BAD
            odd = kept or odd_spans(series, early.times, sticks_of(early.times), bad)
            others = _outside(series, odd)
            if not odd or not others.any():
                return rule, None, plain
            return learn(series.taken(others), noise, pilot.taken(others), stated, gated=True)
        times, levels, gate, judged = kept
    run = _run(series, workspace, _shifted(series, times, -1.0), levels)
    motion, stick = run[0].copy(), run[1]
    line = _line_factor(_straighten(series, stick, times.unit, levels, motion, 1.0))
    sticks = sticks_at_corners(series, _corners(series, times))
    speed = speed_of_sticks(series, sticks, motion[1], pilot.window)
    model = replace(found, levels=levels, gate=gate, line=line, speed=speed)
    return rule, model, replace(plain, corners=corners, judged=judged, times=times, early=run)


def _parted(series: Series, rule: plateaus.PlateauRule) -> Series:
    """Return the record without holes longer than the shortest stick."""
    return series.parted(max(HOLE * series.interval, rule.shortest))


def _aim(rule: plateaus.PlateauRule, stated: float | None) -> float:
    """Return the speed that the sticks near the ends of a piece have, m/s."""
    return rule.speed if stated is None else stated


def apply(
    series: Series,
    pilot: Motion,
    stated: float | None,
    rule: plateaus.PlateauRule,
    model: StickSlip,
    known: FirstPass | None = None,
) -> Motion:
    """Smooth a block of a record by segments; where its sticks do not fit it is the ``pilot``, smoothed without them.

    Sticks found where they do not fit stay sticks, from and to the switching times estimated.  ``known`` is what was
    found already of some record.
    """
    if not series.time.size:
        return pilot
    if known is None or known.series is not series:
        known = FirstPass(series, pilot, _parted(series, rule))
    series, workspace = known.parted, Workspace()
    corners = known.corners or _corners_of_block(series, workspace, pilot, stated, rule, model)
    times = corners.times
    if model.gate is not None:
        levels = model.even, model.levels
        kept = accept_sticks(series, workspace, corners, *levels, model.gate, model.corner, known.judged)
        if isinstance(kept, list):
            others = _outside(series, kept)
            found = apply(series.taken(others), pilot.taken(others), stated, rule, model)
            rows = pilot.rows()
            rows[:, others] = found.rows()
            odd = [own for own in _corners(series, times) if any(low < own.time < high for low, high in kept)]
            both = tuple(sorted((*found.corners, *odd), key=lambda corner: corner.time))
            return replace(found.with_rows(rows), corners=both, method="segment", order=ORDER)
        times = kept
    return _averaged(known, workspace, times, model)


def _corners_of_block(
    series: Series,
    workspace: Workspace,
    pilot: Motion,
    stated: float | None,
    rule: plateaus.PlateauRule,
    model: StickSlip,
) -> PlacedCorners:
    """Return the corners of a block, as `learn` finds those of a record."""
    first = initial_switching_times(series, plateaus.segment(series, pilot, rule, model.speed, stated=stated).phases)
    _, early = _looked_for(series, workspace, replace(first, unit=model.slip), model.first, model.misfit)
    return _placed(series, workspace, early, model, _aim(rule, stated))


def _outside(series: Series, spans: list[Span]) -> Mask:
    """Return True for the samples outside the spans, s."""
    outside = np.ones(series.time.size, bool)
    for low, high in spans:
        outside[slice(*np.searchsorted(series.time, (low, high)))] = False
    return outside


def _looked_for(
    series: Series, workspace: Workspace, first: SwitchingTimes, levels: NoiseLevels, misfit: float | None
) -> tuple[float, PlacedCorners]:
    """Return the usual misfit of `with_overtaking`, and corners where they are most likely, those of overtaking too.

    That is ``misfit`` where it is known.
    """
    times = refine_switching_times(series, workspace, first, levels, 1.0)
    usual, times = with_overtaking(series, workspace, times, levels, misfit)
    return usual, PlacedCorners(_with_overtakes_of(first, times), times)


def _placed(
    series: Series, workspace: Workspace, early: PlacedCorners, model: StickSlip, speed: float
) -> PlacedCorners:
    """Return the corners where they are most likely, with those near the ends of a piece, of sticks of this speed."""
    first = with_ends(series, workspace, early.first, early.times, model.even, speed, model.corner)
    times = early.times
    if first is not early.first:
        times = refine_switching_times(series, workspace, first, model.first, 1.0)
    return PlacedCorners(first, refine_switching_times(series, workspace, times, model.even, 0.25))


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


def _averaged(known: FirstPass, workspace: Workspace, times: SwitchingTimes, model: StickSlip) -> Motion:
    """Smooth, averaging over the uncertainty of the switching times: each a standard deviation early, and late.

    The smoother's variance has a share of the readings and one of the process noise.  A slip is smooth but for its
    ends, so there the readings' share alone is its error.  A smoother of white snap has the response
    H = 1/(1 + w^8), the two variances are the integrals of w^(2d) H^2 and of w^(2d) H, and their ratio is
    1 - (2 d + 1)/8 in the d-th derivative.
    """
    series, pilot = known.parted, known.pilot
    early, stick = known.run_early(workspace, times, model.levels)
    _straighten(series, stick, times.unit, model.levels, early, model.line)
    late, stick_late = _run(series, workspace, _shifted(series, times, 1.0), model.levels)
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
    found = Motion.from_rows(
        series, early[:3], early[3:], window=pilot.window, order=ORDER, method="segment", corners=corners
    )
    outside = np.ones(series.time.size, bool)
    for piece in series.pieces:
        outside[piece] = False
    return found.with_rows(np.where(outside, pilot.rows(), found.rows())) if outside.any() else found


def _corners(series: Series, times: SwitchingTimes) -> list[Corner]:
    """Return the corners; a piece that is one stick throughout has landed where it begins."""
    rows = zip(times.at.tolist(), times.sd.tolist(), times.kind.tolist(), strict=True)
    found = [Corner(at, sd, WHAT[kind]) for at, sd, kind in rows]
    for stretch in stretches(series, times):
        if stretch.first in (STICK, RIDE) and stretch.corners.start == stretch.corners.stop:
            found.append(Corner(float(series.time[stretch.own.start]), math.inf, "land"))
    return sorted(found, key=lambda corner: corner.time)


def _shifted(series: Series, times: SwitchingTimes, shift: float) -> SwitchingTimes:
    """Return the switching times moved by ``shift`` standard deviations, in order still, each within its piece."""
    at, aside = times.at + shift * times.sd, BETWEEN * series.interval
    for stretch in stretches(series, times):
        own = series.time[stretch.own]
        at[stretch.corners] = np.clip(at[stretch.corners], own[0] + aside, own[-1] - aside)
    return replace(times, at=np.maximum.accumulate(at))


def _run(series: Series, workspace: Workspace, times: SwitchingTimes, levels: NoiseLevels) -> tuple[Array, Mask]:
    """Smooth with the switching times as they are.

    Returns: x, v, a and their variances.
    """
    motion, stick = np.zeros((6, series.time.size)), np.zeros(series.time.size, bool)
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
    series: Series, stick: Mask, slip: float, levels: NoiseLevels, motion: Array, factor: float
) -> list[float]:
    """Replace what lies in sticks by straight lines; return what neighbouring lines differ by (`line_fit.fit_lines`).

    ``slip`` is the usual length of one, s; ``factor`` scales the variances.
    """
    window = max(int(LINE * slip / series.interval), 16)
    variance = float(levels.reading_variance[STICK])
    run = compiled(line_fit.fit_lines, KERNELS)
    found = []
    for piece in series.pieces:
        for i, j in runs(stick[piece]):
            if j - i >= 8:
                own = slice(piece.start + i, piece.start + j)
                found.append(run(series.time, series.position, own.start, own.stop, window, variance, motion))
                motion[3:, own] *= factor
    return [ratio for ratio in found if ratio]


def _line_factor(differing: list[float]) -> float:
    """Return what the errors of lines are scaled by, from the ratios of `line_fit.fit_lines`.

    A prior of four sticks on an even belt: few windows do not scale the errors by chance.
    """
    return (sum(differing) + 4.0) / (len(differing) + 4.0)
