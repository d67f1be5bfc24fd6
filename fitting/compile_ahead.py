"""Compile kernels of a fit and keep them: ``python -m fitting.compile_ahead [arithmetic]`` (`daq demo` runs both).

The largest ones, on two windows of an imagined cycle, while another process records and smooths; ``arithmetic``: the
many small ones, while the fit waits for the largest.  A process that needs a kernel meanwhile waits for its machine
code (`daq.compute.compile`).
"""

import math
import sys

import numpy as np

from daq.compute.compile import compiled
from fitting.estimation import elimination
from fitting.model.parameters import PER_CYCLE, PER_RUN, Global, PerCycle
from fitting.model.shooting import ShootingWindows, evaluator
from fitting.selection.nearest import nearest_distances
from fitting.sensitivity.path import follow, law_curve
from fitting.sensitivity.tangents import tangents

SAMPLES = 5  # of each window: compiled code does not depend on how many


def compile_arithmetic() -> None:
    """Compile the sums and eliminations of a search, and the distance of orbits."""
    rows, first = np.ones((2, 1)), np.array([0, 2])
    residual, matrix, matrices = np.ones(2), np.ones((1, 1)), np.ones((1, 1, 1))
    for function, arguments in (
        (elimination.sum_products, (rows, residual, first, matrices.copy(), matrix.copy())),
        (elimination.invert, (matrices, matrices.copy())),
        (elimination.eliminate, (matrices, matrices, matrix.copy(), matrices.copy())),
        (elimination.eigen, (matrix.copy(), matrix.copy())),
        (elimination.along, (rows, first, matrix, residual.copy())),
        (elimination.sum_gradients, (rows, residual, first, matrix.copy())),
        (elimination.sum_cross, (rows, rows, first, matrices.copy())),
        (elimination.add_along, (rows, first, matrices, rows.copy())),
        (nearest_distances, (residual, residual, residual, residual, residual.copy())),
    ):
        compiled(function, (function.__module__,))(*arguments)


def compile_motion() -> None:
    """Compile what predicts positions, follows the motion and integrates its derivatives."""
    run = np.zeros(PER_RUN)
    run[[Global.K, Global.LOG_F, Global.V_DR, Global.SHAPE, Global.STATIC]] = 100.0, math.log(5.0), 0.1, 1.0, 1.0
    local = np.zeros((1, PER_CYCLE))
    local[0, [PerCycle.X_SLIP, PerCycle.V_SLIP, PerCycle.V_STICK]] = 0.05, 0.09, 0.1
    time = np.linspace(0.0, 0.01, 2 * SAMPLES)
    windows = ShootingWindows(
        table=np.array([[0, 1, 0, SAMPLES, 0, 0], [0, 0, SAMPLES, SAMPLES, 0, 0]]),
        level_epoch=np.full(2, time[SAMPLES]),
        earliest_landing=np.full(2, math.inf),
        time=time,
        position=np.zeros(time.size),
        source=np.arange(time.size),
        rows=(slice(0, time.size),),
    )
    unknowns = [int(Global.K)]
    predict = evaluator(1, False, windows, run, unknowns, np.ones(PER_RUN), np.ones(PER_CYCLE))
    predict(run[unknowns], local, True)
    path = follow(windows, law_curve(1, ramp=False), run, local)
    if path is not None:
        tangents(path, np.zeros((path.time.size, 1)))


if __name__ == "__main__":
    compile_arithmetic() if sys.argv[1:] == ["arithmetic"] else compile_motion()
