"""When corners happened: each moved to where it makes the record most likely, with the spread of that likelihood."""

from dataclasses import replace

import numpy as np

from daq.compute.compile import compiled
from processing.kalman import corner_kernel
from processing.kalman.snap_kernel import (
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
    STICK,
    STOP,
)
from processing.record.series import Series
from processing.segmentation.noise_levels import Levels, Room, filtered
from processing.segmentation.switching_times import KERNELS, Layout, state_after, stretches

SHARP = 1.7  # times the spread of a landing's likelihood: the levels it is taken at were learned with it


def placed(series: Series, room: Room, layout: Layout, levels: Levels, width: float) -> Layout:
    """Return the layout with each corner where it is most likely; ``width`` scales how far away it may lie."""
    place = compiled(corner_kernel.place, KERNELS)
    unit = layout.unit
    finest = series.interval / 4 if width >= 1 else 0.0
    at, sd = layout.at.copy(), layout.sd.copy()
    near, far = unit * np.array(NEAR_LANDING), unit * np.array(NEAR_ONSET)
    landing = [SLIP, LANDING + 3, LANDING + 2, LANDING + 1, LANDING]
    onset = [ONSET, ONSET + 1, ONSET + 2, ONSET + 3, SLIP]
    for stretch in stretches(series, layout):
        if stretch.corners.start == stretch.corners.stop:
            continue
        time, position = series.time[stretch.own], series.position[stretch.own]
        _, stored = filtered(series, layout, levels, stretch, room)
        now, kinds = layout.at[stretch.corners], layout.kind[stretch.corners]
        before = np.concatenate(([time[0]], now[:-1]))
        behind = np.concatenate((now[1:], [time[-1]]))
        low, high = now - 0.45 * (now - before), now + 0.45 * (behind - now)  # never past its neighbour
        first = np.array([stretch.first, *(state_after(int(kind)) for kind in kinds[:-1])])
        for kind in np.unique(kinds):
            for state in np.unique(first[kinds == kind]):
                pick = np.flatnonzero((kinds == kind) & (first == state))
                if kind in (LAND, STOP, MEET):
                    edges = np.concatenate((-near[::-1], [0.0]))
                    parts = [*landing, {LAND: STICK, STOP: REST, MEET: MET}[int(kind)]]
                    corner, half, back, on = 4, unit / 64, unit / 64, unit / 12
                    if kind == MEET:
                        edges, parts = np.append(edges, far[0]), [*parts, RIDE]
                else:
                    edges = np.concatenate(([0.0], far))
                    parts = [int(state), *onset]
                    corner, half, back, on = 0, unit / 16, unit / 64, unit / 8
                    if state == RIDE:
                        edges, parts, corner = np.concatenate(([-far[0]], edges)), [RIDE, LEAVING, *onset], 1
                found = np.empty((pick.size, 2))
                place(
                    *(time, position, stored, now, pick, int(kind), low[pick], high[pick]),
                    *(max(width * half, series.interval), finest, back, on, edges, np.array(parts, np.uint8), corner),
                    *(levels.q, levels.u, levels.r, levels.jump, found),
                )
                at[stretch.corners.start + pick] = found[:, 0]
                sd[stretch.corners.start + pick] = found[:, 1] * (SHARP if kind in (LAND, STOP) else 1.0)
    return replace(layout, at=at, sd=sd)
