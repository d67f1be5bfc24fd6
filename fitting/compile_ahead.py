"""Compile the largest kernels of a fit and keep them: ``python -m fitting.compile_ahead`` (`daq demo` runs it).

It does so on two windows of an imagined cycle, while another process records and smooths.  A process that needs a
kernel meanwhile waits for its machine code (`daq.compute.compile`).
"""

import math

import numpy as np

from fitting.model.parameters import PER_CYCLE, PER_RUN, Global, PerCycle
from fitting.model.shooting import ShootingWindows, evaluator
from fitting.sensitivity.path import follow, law_curve
from fitting.sensitivity.tangents import tangents

SAMPLES = 5  # of each window: compiled code does not depend on how many


def main() -> None:
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
    main()
