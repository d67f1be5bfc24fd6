"""Switching times of greatest likelihood, each with the spread of its likelihood."""

from dataclasses import replace

import numpy as np

from processing.kalman import corner_kernel
from processing.kalman.stick_slip import (
    LAND,
    LANDING,
    LEAVING,
    MEET,
    MET,
    NEAR_LANDING,
    NEAR_ONSET,
    ONSET,
    REST,
    RIDE,
    SLIP,
    SNAP,
    STICK,
    STOP,
    NoiseLevels,
)
from processing.record.series import Series
from processing.segmentation.noise_levels import Workspace, filter_stretch
from processing.segmentation.switching_times import KERNELS, SwitchingTimes, label_after, split_stretches
from stickslip.compute.compile import compiled

# Empirical: widens the standard deviation of a landing's likelihood, whose noise levels were fitted with it in place,
# so that about 95 % of the true velocities near landings lie within two errors (benchmarks/velocity_seeds.py).
SHARP = 1.7
LEAST = 6  # samples on either side of the range in which a corner is searched, at least


def refine_switching_times(
    series: Series, workspace: Workspace, times: SwitchingTimes, levels: NoiseLevels, width: float
) -> SwitchingTimes:
    """Return the most likely switching times, with their standard deviations.

    ``width`` scales the range that is searched: 1 at first, less when a time is nearly known.
    """
    run = compiled(corner_kernel.refine_switching_times, KERNELS)
    unit, noise = times.unit, levels.process
    finest = series.interval / 4 if width >= 1 else 0.0
    new_at, new_sd = times.time.copy(), times.sd.copy()
    near, far = unit * np.array(NEAR_LANDING), unit * np.array(NEAR_ONSET)
    landing = [SLIP, LANDING + 3, LANDING + 2, LANDING + 1, LANDING]
    onset = [ONSET, ONSET + 1, ONSET + 2, ONSET + 3, SLIP]
    for stretch in split_stretches(series, times):
        if stretch.corners.start == stretch.corners.stop:
            continue
        time, position = series.time[stretch.samples], series.position[stretch.samples]
        _, stored = filter_stretch(series, times, levels, stretch, workspace)
        corner_times, kinds = times.time[stretch.corners], times.kind[stretch.corners]
        before = np.concatenate(([time[0]], corner_times[:-1]))
        following = np.concatenate((corner_times[1:], [time[-1]]))
        bounds = np.stack(
            (corner_times - 0.45 * (corner_times - before), corner_times + 0.45 * (following - corner_times)), axis=1
        )  # never past a neighbour
        first = np.array([stretch.first, *(label_after(int(kind)) for kind in kinds[:-1])])
        for kind, state in sorted({*zip(kinds.tolist(), first.tolist(), strict=True)}):
            pick = np.flatnonzero((kinds == kind) & (first == state))
            if kind in (LAND, STOP, MEET):
                edges = np.concatenate((-near[::-1], [0.0]))
                parts = [*landing, {LAND: STICK, STOP: REST, MEET: MET}[kind]]
                corner, half, back, forth = 4, unit / 64, unit / 64, unit / 12
                if kind == MEET:
                    edges, parts = np.append(edges, far[0]), [*parts, RIDE]
            else:
                edges, parts = np.concatenate(([0.0], far)), [state, *onset]
                corner, half, back, forth = 0, unit / 16, unit / 64, unit / 8
                if state == RIDE:
                    edges, parts, corner = np.concatenate(([-far[0]], edges)), [RIDE, LEAVING, *onset], 1
            half = max(width * half, series.interval)
            back, forth = (max(picked_bounds, LEAST * series.interval) for picked_bounds in (back, forth))
            picked_times, picked_bounds = corner_times[pick], bounds[pick]
            reach = np.stack(
                (
                    np.maximum(picked_times - half - back, picked_bounds[:, 0]),
                    np.minimum(picked_times + half + forth, picked_bounds[:, 1]),
                ),
                axis=1,
            )
            estimates = np.empty((pick.size, 2))
            run(
                *(
                    SNAP,
                    time,
                    position,
                    stored,
                    kind,
                    picked_times,
                    picked_bounds,
                    np.searchsorted(time, reach),
                    (half / 4, finest),
                ),
                *(edges, np.array(parts, np.uint8), corner, noise, estimates),
            )
            new_at[stretch.corners.start + pick] = estimates[:, 0]
            new_sd[stretch.corners.start + pick] = estimates[:, 1] * (SHARP if kind in (LAND, STOP) else 1.0)
    return replace(times, time=new_at, sd=new_sd)
