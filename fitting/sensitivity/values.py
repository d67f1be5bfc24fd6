"""Positions along the windows alone, by the same steps as `fitting.sensitivity.flow` with nothing stored for tangents.

The steps are as long as the motion allows, whatever the samples: between two ends of a step a position is that of
Hermite's cubic.  A search asks for positions alone three times for each time that it asks for tangents too.
"""

import math

import numpy as np

from fitting.model.windows import ShootingWindows
from fitting.sensitivity import rates
from fitting.sensitivity.flow import (
    LONGEST_STEP,
    MOST_EVENTS,
    fastest_rate,
    first_mode,
    mode_at_edge,
    settled,
    step_to_edge,
    turning_step,
    window_at,
)
from fitting.sensitivity.path import (
    FARTHEST,
    KERNELS,
    MOST_STEPS,
    MOST_STEPS_A_SAMPLE,
    NO_DRAG,
    Curve,
    Path,
    kernel_arguments,
)
from fitting.sensitivity.rates import CREEP, Extra, Window, at_level, bound_velocity
from rig_sim.flow.modes import RAMP, STICK
from stickslip.compute.arrays import Array, Integers
from stickslip.compute.compile import compiled

# Longest step over that of a path.  The cubic between its ends errs by the fourth power: by 1e-9 m in slips of the rig
# scene, at twice that by 2e-8 m, as a path at 100 Hz does; half takes twice the time.
VALUE_STEP = 0.4


def positions(
    windows: ShootingWindows,
    curve: Curve,
    u: Array,
    local: Array,
    *,
    along: Path | None = None,
    acceleration: Array | None = None,
    belt_speed: Array | None = None,
    drag: rates.Drag = NO_DRAG,
    longest_step: float = LONGEST_STEP,
) -> Array | None:
    """Return the position at every sample, m, shape (N,); None where it cannot be followed.  Arguments of `follow`."""
    out = np.empty(windows.time.size)
    kernel = compiled(follow_values, (*KERNELS, __name__), _nrt=False)
    arguments = kernel_arguments(windows, curve, u, local, along, acceleration, belt_speed, drag)
    status = kernel(*arguments, longest_step, max(MOST_STEPS, MOST_STEPS_A_SAMPLE * out.size), out)
    return out if status == 0 and float(np.abs(out).max()) < FARTHEST else None


def window_values(
    w: Window,
    stick: bool,
    x: float,
    v: float,
    earliest: float,
    overtakes: bool,
    next_level: float,
    longest: float,
    times: Array,
    out: Array,
    most: int,
) -> int:
    """Fill ``out`` (n,) with the positions of one window; return the number of steps, or -1.

    It fails where the motion is not finite, stays on an edge, or takes more than ``most`` steps.
    """
    t, end = times[0], times[times.size - 1]
    held, landed = stick, stick
    mode, v = first_mode(w, stick, t, x, v)
    out[0] = x
    i, events, since, steps = 1, 0, t, 0
    while i < times.size:
        if steps == most:
            return -1
        steps += 1
        if mode == RAMP and settled(w, held, t, x, since, longest):
            mode = CREEP
            v = bound_velocity(w, mode, t, x)
        # What a step leaves out of a ramp dies away with its transient.
        step = longest if mode == RAMP else VALUE_STEP * longest
        rate = fastest_rate(w, mode, t, v)
        h = step / rate if rate * (end - t) > step else end - t
        h = min(h, turning_step(w, mode, t, x, v))
        last = h >= end - t
        x1, v1, h, ends = step_to_edge(w, mode, held, t, x, v, h)
        if not math.isfinite(x1 + v1):
            return -1
        now = end if last and not ends else t + h
        while i < times.size and times[i] <= now:
            r = (times[i] - t) / h if h > 0.0 else 1.0
            out[i] = x + r * r * (3.0 - 2.0 * r) * (x1 - x) + h * r * (1.0 - r) * ((1.0 - r) * v - r * v1)
            i += 1
        t, x, v = now, x1, v1
        if ends:
            events += 1
            if events > MOST_EVENTS:
                return -1
            mode, held, landed, level = mode_at_edge(w, mode, held, landed, overtakes, earliest, next_level, t, x, v)
            w = at_level(w, level)
            if mode == STICK or mode == CREEP:
                v = bound_velocity(w, mode, t, x)
            since = t
    return steps


def follow_values(
    curve: int,
    u: Array,
    local: Array,
    table: Integers,
    epoch: Array,
    earliest: Array,
    time: Array,
    pieces: int,
    spline: Array,
    ramp: int,
    extra: Extra,
    longest: float,
    most: int,
    out: Array,
) -> int:
    """Fill ``out`` (N,) along all windows in ``most`` steps; return 0, or 1 + the window that cannot be followed.

    Other arguments are those of `fitting.sensitivity.flow.follow_windows`.
    """
    for row in range(table.shape[0]):
        first, n = table[row, 2], table[row, 3]
        w, x, v, next_level = window_at(row, curve, u, local, table, epoch, pieces, spline, ramp, extra)
        steps = window_values(
            w,
            table[row, 1] == 1,
            x,
            v,
            earliest[row],
            table[row, 4] == 1,
            next_level,
            longest,
            time[first : first + n],
            out[first : first + n],
            most,
        )
        if steps < 0:
            return 1 + row
        most -= steps
    return 0
