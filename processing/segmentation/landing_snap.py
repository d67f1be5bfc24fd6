"""The mean snap of a slip near its landing, learned from all landings together.

Friction rises ever faster as the mass approaches the belt's speed, and equally at every landing.  Assuming a mean snap
of 0 there delays every landing: by a tenth of a millisecond on the bench, with an error of 1 mm/s in the velocity
before it.  One landing cannot separate its time from its snap; many determine the snap they share.

The predicted samples are linear in the means, so those of greatest likelihood solve normal equations.  The uncertain
time of each landing is included: it shifts the velocity after it.
"""

from dataclasses import replace

import numpy as np

from processing.kalman import mean_snap_kernel
from processing.kalman.first_state import first_state
from processing.kalman.stick_slip import LAND, LANDING, NEAR_LANDING, SLIP, SNAP, STICK, NoiseLevels
from processing.record.series import Series
from processing.segmentation.switching_times import SwitchingTimes
from stickslip.compute.compile import compiled

KERNELS = ("processing.kalman.motion_kernel", "processing.kalman.mean_snap_kernel")

PARTS = len(NEAR_LANDING)
BEFORE, BEHIND = 1 / 3, 1 / 12  # of a slip: samples used before and after a landing
OPEN = 1.5  # standard deviations by which the time of a landing may be wrong
MOST = 64  # landings used


def learn_mean_snap(series: Series, times: SwitchingTimes, levels: NoiseLevels) -> NoiseLevels:
    """Return the levels with the mean snap of a slip's parts near its landing on an even belt.

    With n landings the means are (n - 1)/n of those of greatest likelihood, since one landing contains no information.
    """
    unit = times.unit
    landings = np.flatnonzero(times.kind == LAND)
    if landings.size < 2:
        return levels
    landing_variance = np.array([0.0, (OPEN * levels.peak * float(np.median(times.sd[landings]))) ** 2, 0.0, 0.0])
    noise = levels.process
    edges = np.concatenate((-unit * np.array(NEAR_LANDING)[::-1], [0.0]))
    parts = np.array([SLIP, *range(LANDING + PARTS - 1, LANDING - 1, -1), STICK], np.uint8)
    gram, rhs = np.zeros((PARTS, PARTS)), np.zeros(PARTS)
    run = compiled(mean_snap_kernel.accumulate_normal_equations, KERNELS)
    starts = np.array([piece.start for piece in series.pieces])
    seen = 0
    for k in landings[np.unique(np.linspace(0, landings.size - 1, MOST).astype(int))].tolist():
        landing = float(times.time[k])
        piece = series.pieces[int(np.searchsorted(series.time[starts], landing, side="right")) - 1]
        begin, end = landing - BEFORE * unit, landing + BEHIND * unit
        if k:
            begin = max(begin, float(times.time[k - 1]))
        if k + 1 < times.time.size:
            end = min(end, float(times.time[k + 1]))
        i, j = piece.start + np.searchsorted(series.time[piece], (begin, end))
        if j - i < 16 or landing - begin < unit * NEAR_LANDING[-1]:
            continue
        time, position = series.time[i:j], series.position[i:j]
        state = first_state(time, position, float(levels.reading_variance[SLIP]), 3)
        run(SNAP, time, position, state, landing, edges, parts, noise, landing_variance, gram, rhs)
        seen += 1
    if seen < 2:
        return levels
    full = gram + np.tril(gram, -1).T
    means = np.linalg.solve(full + np.diag(np.diag(full) / (seen - 1) + 1e-300), rhs)
    mean_snap = levels.mean_snap.copy()
    mean_snap[LANDING : LANDING + PARTS] = means[::-1]
    return replace(levels, mean_snap=mean_snap)
