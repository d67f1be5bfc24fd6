"""The mean snap of a slip near its landing, learned from all landings together.

Friction rises ever faster as the mass comes up to the belt's speed, and does so at every landing alike.  A snap whose
mean is taken for 0 there makes every landing seem late: by a tenth of a millisecond on the bench, and the velocity
before it wrong by 1 mm/s.  One landing cannot separate its time from its snap; many determine the snap they share.

What is expected of a sample moves in proportion to the means, so those of greatest likelihood solve normal equations.
The time of each landing is left open by what it is uncertain by: it shifts the velocity behind it.
"""

from dataclasses import replace

import numpy as np

from processing.kalman import mean_snap_kernel
from processing.kalman.first_state import first_state
from processing.kalman.stick_slip import LAND, LANDING, NEAR_LANDING, OVERTAKE, SLIP, SNAP, STICK, NoiseLevels
from processing.record.series import Series
from processing.segmentation.switching_times import SwitchingTimes
from stickslip.compute.compile import compiled

KERNELS = ("processing.kalman.motion_kernel", "processing.kalman.mean_snap_kernel")

PARTS = len(NEAR_LANDING)
BEFORE, BEHIND = 1 / 3, 1 / 12  # of a slip: what is looked at around a landing
OPEN = 1.5  # standard deviations of its time that a landing is left open for
MOST = 64  # landings looked at


def with_mean_snap(series: Series, times: SwitchingTimes, levels: NoiseLevels) -> NoiseLevels:
    """Return the levels with the mean snap of a slip's parts near its landing on an even belt.

    With n landings the means are (n - 1)/n of those of greatest likelihood: one alone carries no information.
    """
    unit = times.unit
    landings = np.flatnonzero(times.kind == LAND)
    if landings.size < 2:
        return levels
    loose = np.array([0.0, (OPEN * levels.peak * float(np.median(times.sd[landings]))) ** 2, 0.0, 0.0])
    noise = levels.process
    edges = np.concatenate((-unit * np.array(NEAR_LANDING)[::-1], [0.0]))
    parts = np.array([SLIP, *range(LANDING + PARTS - 1, LANDING - 1, -1), STICK], np.uint8)
    gram, rhs = np.zeros((PARTS, PARTS)), np.zeros(PARTS)
    run = compiled(mean_snap_kernel.accumulate_normal_equations, KERNELS)
    starts = np.array([piece.start for piece in series.pieces])
    seen = 0
    for k in landings[np.unique(np.linspace(0, landings.size - 1, MOST).astype(int))].tolist():
        at = float(times.at[k])
        piece = series.pieces[int(np.searchsorted(series.time[starts], at, side="right")) - 1]
        begin, end = at - BEFORE * unit, at + BEHIND * unit
        if k:
            begin = max(begin, float(times.at[k - 1]))
        if k + 1 < times.at.size:
            end = min(end, float(times.at[k + 1]))
        i, j = piece.start + np.searchsorted(series.time[piece], (begin, end))
        overtaken = k and times.kind[k - 1] == OVERTAKE
        if j - i < 16 or at - begin < unit * NEAR_LANDING[-1] or overtaken:
            continue
        time, position = series.time[i:j], series.position[i:j]
        state = first_state(time, position, float(levels.reading_variance[SLIP]), 3)
        run(SNAP, time, position, state, at, edges, parts, noise, loose, gram, rhs)
        seen += 1
    if seen < 2:
        return levels
    full = gram + np.tril(gram, -1).T
    means = np.linalg.solve(full + np.diag(np.diag(full) / (seen - 1) + 1e-300), rhs)
    mean_snap = levels.mean_snap.copy()
    mean_snap[LANDING : LANDING + PARTS] = means[::-1]
    return replace(levels, mean_snap=mean_snap)
