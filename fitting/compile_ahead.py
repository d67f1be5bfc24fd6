"""Compile kernels of a fit and cache them: ``python -m fitting.compile_ahead [motion]`` (`daq demo` runs both).

The kernel that predicts positions, on two windows of an artificial cycle, while another process records and smooths,
then the smaller ones; ``motion``: the kernel that follows the motion, in a second process while the fit waits for the
first.  A process that needs a kernel meanwhile waits for its machine code (`stickslip.compute.compile`).
"""

import math
import sys

import numpy as np

from fitting.least_squares import elimination
from fitting.model.path import Curve, FrictionSpline, Path, follow, positions
from fitting.model.tangents import tangents
from fitting.model.unknowns import PER_CYCLE, PER_RUN, Global, PerCycle
from fitting.model.windows import ShootingWindows
from stickslip.compute.arrays import Array
from stickslip.compute.compile import compiled

SAMPLES = 5  # samples of each window: compiled code does not depend on how many


def compile_arithmetic() -> None:
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
    ):
        compiled(function, (function.__module__,))(*arguments)
    FrictionSpline.over(np.linspace(0.0, 1.0, SAMPLES)).basis(np.zeros(1))


def compile_predictions() -> None:
    windows, run, local = _imagined()
    positions(windows, Curve(1, ramp=False), run, local)


def compile_motion() -> None:
    windows, run, local = _imagined()
    follow(windows, Curve(1, ramp=False), run, local)


def compile_derivatives() -> None:
    """Compile what integrates the derivatives of a motion, along a path without steps."""
    windows, run, local = _imagined()
    begin, point = np.zeros(windows.table.shape[0] + 1, int), np.zeros(1)
    path = Path(
        windows=windows,
        curve=Curve(1, ramp=False),
        u=run,
        local=local,
        time=point,
        position=point,
        velocity=point,
        belt_speed=point,
        level=point,
        friction=point,
        friction_slope=point,
        slip_speed=point,
        damping=point,
        mode=np.zeros(1, int),
        landed=np.zeros(1, bool),
        first_point=begin,
        first_step=begin,
        steps=np.zeros((0, 3), int),
        jumps=np.zeros((0, 3)),
        reached=np.zeros(windows.time.size, int),
    )
    tangents(path, np.zeros((1, 1)))


def _imagined() -> tuple[ShootingWindows, Array, Array]:
    """Return a slip and a stick window of one cycle, and the unknowns of its run and cycle."""
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
    return windows, run, local


if __name__ == "__main__":
    if sys.argv[1:] == ["motion"]:
        compile_motion()
    else:
        compile_predictions()
        compile_arithmetic()
        compile_derivatives()
