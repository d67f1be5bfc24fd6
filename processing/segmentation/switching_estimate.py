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
    OVERTAKE,
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
from processing.segmentation.switching_times import KERNELS, SwitchingTimes, state_after, stretches
from stickslip.compute.compile import compiled

# Empirical: widens the standard deviation of a landing's likelihood, whose noise levels were fitted with it in place,
# so that about 95 % of the true velocities near landings lie within two errors (benchmarks/velocity_seeds.py).
SHARP = 1.7
# Samples on either side of where a corner is looked for: with 3, some corners of slips of 10 to 17 samples stay where
# plateaus showed them; with 8 the velocity is as accurate.
LEAST = 6


def refine_switching_times(
    series: Series, workspace: Workspace, times: SwitchingTimes, levels: NoiseLevels, width: float
) -> SwitchingTimes:
    """Return each switching time where it is most likely, with its standard deviation.

    ``width`` scales how far from its place it is looked for: 1 at first, less when it is nearly known.
    """
    run = compiled(corner_kernel.refine_switching_times, KERNELS)
    unit, noise = times.unit, levels.process
    finest = series.interval / 4 if width >= 1 else 0.0
    new_at, new_sd = times.at.copy(), times.sd.copy()
    near, far = unit * np.array(NEAR_LANDING), unit * np.array(NEAR_ONSET)
    landing = [SLIP, LANDING + 3, LANDING + 2, LANDING + 1, LANDING]
    onset = [ONSET, ONSET + 1, ONSET + 2, ONSET + 3, SLIP]
    for stretch in stretches(series, times):
        if stretch.corners.start == stretch.corners.stop:
            continue
        time, position = series.time[stretch.own], series.position[stretch.own]
        _, stored = filter_stretch(series, times, levels, stretch, workspace)
        now, kinds = times.at[stretch.corners], times.kind[stretch.corners]
        before = np.concatenate(([time[0]], now[:-1]))
        behind = np.concatenate((now[1:], [time[-1]]))
        bounds = np.stack((now - 0.45 * (now - before), now + 0.45 * (behind - now)), axis=1)  # never past a neighbour
        first = np.array([stretch.first, *(state_after(int(kind)) for kind in kinds[:-1])])
        ahead = np.concatenate(([False], kinds[:-1] == OVERTAKE))
        for kind, state, over in sorted({*zip(kinds.tolist(), first.tolist(), ahead.tolist(), strict=True)}):
            pick = np.flatnonzero((kinds == kind) & (first == state) & (ahead == over))
            if kind in (LAND, STOP, MEET, OVERTAKE):
                edges = np.concatenate((-near[::-1], [0.0]))
                approach = [SLIP] * len(landing) if over else landing
                parts = [*approach, {LAND: STICK, STOP: REST, MEET: MET, OVERTAKE: SLIP}[kind]]
                corner, half, back, on = 4, unit / 64, unit / 64, unit / 12
                if kind == MEET:
                    edges, parts = np.append(edges, far[0]), [*parts, RIDE]
            else:
                edges, parts = np.concatenate(([0.0], far)), [state, *onset]
                corner, half, back, on = 0, unit / 16, unit / 64, unit / 8
                if state == RIDE:
                    edges, parts, corner = np.concatenate(([-far[0]], edges)), [RIDE, LEAVING, *onset], 1
            half = max(width * half, series.interval)
            back, on = (max(own, LEAST * series.interval) for own in (back, on))
            at, own = now[pick], bounds[pick]
            reach = np.stack((np.maximum(at - half - back, own[:, 0]), np.minimum(at + half + on, own[:, 1])), axis=1)
            found = np.empty((pick.size, 2))
            run(
                *(SNAP, time, position, stored, kind, at, own, np.searchsorted(time, reach), (half / 4, finest)),
                *(edges, np.array(parts, np.uint8), corner, noise, found),
            )
            new_at[stretch.corners.start + pick] = found[:, 0]
            new_sd[stretch.corners.start + pick] = found[:, 1] * (SHARP if kind in (LAND, STOP, OVERTAKE) else 1.0)
    return replace(times, at=new_at, sd=new_sd)
