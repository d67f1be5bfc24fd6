"""Positions that a law predicts in every window by the exact flow of rig_sim: what the fit's own steps are held to.

Interpreted: to compile it takes longer than all that the tests ask of it.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fitting.model import unknowns
from fitting.model.flow import remaining
from fitting.model.unknowns import PER_CYCLE, PER_RUN, Global, PerCycle, Values
from fitting.model.windows import ShootingWindows
from rig_sim.flow.flow import Flow
from rig_sim.flow.modes import FORCE_REVERSAL, NEGATIVE, NOT_FINITE, POSITIVE, RAMP, STICK
from rig_sim.friction.spline import NO_TABLE
from rig_sim.integrate.phases import Samples, State, sample_phase
from rig_sim.integrate.work import Work, new_work
from stickslip.compute.arrays import Array

STEP = 1e-6  # of each unknown's scale: derivative error about 1e-6 from curvature, 1e-9 from rounding
STICK_LOCK = 10.0  # break-away level over Fs of a stick inside a window: the break-away itself lies in no window
# How often the level is lowered, in times of 1/omega of mass and spring: a tenth of a slip.  Chosen: what that leaves
# out is less than a tenth of a count in records that lose a tenth of their level; at half it takes more steps, at twice
# it is four times as much.
FADE_STEP = 0.3
WORK_STEPS = 10_000  # phases and Taylor steps one window may take
# Slots and columns as plain integers.
V_DR, COMPLIANCE, OMEGA = int(Global.V_DR), int(Global.COMPLIANCE), int(Global.OMEGA)
X_SLIP, V_SLIP, LEVEL, NEXT_LEVEL, X_STICK, V_STICK = (int(column) for column in PerCycle)


class WindowArrays(NamedTuple):
    """What is read of all windows; shapes and units as in `ShootingWindows`."""

    table: NDArray[np.int64]
    level_epoch: Array
    earliest_landing: Array
    time: Array


class ShootingWindow(NamedTuple):
    """One window: what it is, the times (s) that `ShootingWindows` explains, and those of its samples (n,), s."""

    stick: int
    overtakes: int
    level_epoch: float
    earliest_landing: float
    times: Array


class DerivativeSteps(NamedTuple):
    """Steps of the derivatives: slot of each unknown in each run (runs, p), -1 where the run does not have it.

    ``shared`` (p,) and ``local`` (6,) are the steps themselves, in the units of `Global` and `PerCycle`.
    """

    columns: NDArray[np.int64]
    shared: Array
    local: Array


def evaluator(
    curve: int, ramp: bool, windows: ShootingWindows, full: Array, active: list[int], scale: Array, local_scale: Array
) -> Callable[[Array, Array, bool], tuple[Array, Array] | None]:
    """Return ``evaluate(u, local, derivatives)`` for one law; u holds the active unknowns only.

    ``full`` and ``scale`` hold the unknowns of all runs end to end (`fitting.model.unknowns`), ``active`` their
    places.
    """
    runs = full.size // PER_RUN
    columns = unknowns.columns(active, runs)
    steps = DerivativeSteps(columns, STEP * scale[active], STEP * local_scale)
    arrays = WindowArrays(windows.table, windows.level_epoch, windows.earliest_landing, windows.time)
    n = windows.time.size
    whole = full.reshape(runs, PER_RUN).copy()
    known = columns >= 0
    run, place = np.nonzero(known)
    slot = columns[known]
    room = np.empty((3, n))
    work = new_work(WORK_STEPS)

    def evaluate(u: Array, local: Array, derivatives: bool) -> tuple[Array, Array] | None:
        whole[run, slot] = u[place]
        model = np.empty(n)
        jacobian = np.zeros((n if derivatives else 0, columns.shape[1] + PER_CYCLE))
        own = np.array(local, order="C")
        status = window_positions(curve, int(ramp), whole, own, arrays, steps, model, jacobian, room, work)
        return None if status != 0 else (model - windows.position, jacobian)

    return evaluate


def window_positions(
    curve: int,
    ramp: int,
    u: Array,
    local: Array,
    windows: WindowArrays,
    steps: DerivativeSteps,
    model: Array,
    jacobian: Array,
    room: Array,
    work: Work,
) -> int:
    """Fill ``model`` (N,) with the positions of all windows and ``jacobian`` (N, p + 6) with forward differences.

    ``u`` (runs, 13) and ``local`` (cycles, 6) are the unknowns, ``room`` (3, N) is scratch space;
    ``u`` and ``local`` are stepped in place and put back.  ``jacobian`` of no rows: positions only.  Returns 0, or the
    outcome that ended the flow.
    """
    p = steps.columns.shape[1]
    for row in range(windows.table.shape[0]):
        stick, first = windows.table[row, 1], windows.table[row, 2]
        end = first + windows.table[row, 3]
        run = windows.table[row, 5]
        part, own = local[windows.table[row, 0]], u[run]
        epoch, earliest = windows.level_epoch[row], windows.earliest_landing[row]
        window = ShootingWindow(stick, windows.table[row, 4], epoch, earliest, windows.time[first:end])
        base, near = model[first:end], room[2, : end - first]
        bad = integrate_window(curve, ramp, own, part, window, base, room, work)
        if bad != 0:
            return bad
        # A jump's stick is a straight line: it knows its start and the belt's speed, nothing else.
        line = stick == 1 and ramp == 0 and own[COMPLIANCE] == 0.0 and own[OMEGA] == 0.0
        for j in range(p + PER_CYCLE if jacobian.shape[0] > 0 else 0):
            if j < p:
                vector, slot, h = own, steps.columns[run, j], steps.shared[j]
                used = slot >= 0 and (not line or slot == V_DR)
            else:
                vector, slot, h = part, j - p, steps.local[j - p]
                if stick == 1:
                    used = slot == X_STICK or (not line and (slot == V_STICK or slot == LEVEL))
                else:
                    used = slot <= NEXT_LEVEL
            if not used:
                continue
            kept = vector[slot]
            vector[slot] += h
            bad = integrate_window(curve, ramp, own, part, window, near, room, work)
            vector[slot] = kept
            if bad != 0:
                return bad
            for m in range(end - first):
                jacobian[first + m, j] = (near[m] - base[m]) / h
    return 0


def values_of(u: Array) -> Values:
    """Return the global parameters u (13,) of one run by name, as `parameters.values`."""
    return Values(u[0], math.exp(u[1]), u[2], u[3], u[4], u[5], u[6], u[7], u[8], u[9], u[10], u[11], u[12])


def integrate_window(
    curve: int, ramp: int, u: Array, part: Array, window: ShootingWindow, out: Array, room: Array, work: Work
) -> int:
    """Follow one window from its own start and store the position at its times; return 0 or an outcome.

    The level is the cycle's own until the landing and the next one from there on, less what it has faded by.  A
    touch of the belt before ``earliest_landing`` is no landing: the mass slips on as soon as the load exceeds its
    level, so the motion depends continuously on where the window starts.  After the landing, and in a stick window,
    the contact holds whatever the load: the next break-away lies in no window.  A jump's stick has a large level there;
    of a ramp level and width are both raised, which keeps its slope.  So a ramp law contains its jump law.  Where the
    mass was seen to overtake the belt it slips on forwards under the new level, until that stops it.

    A slip window that starts within a ramp contains the break-away: there the ramp ends at the break-away level, static
    times that of slip, at the half-width d.

    A compliant belt is the flow's own droop, compliance F/K: a jump's contact then sticks on the ramp that the belt
    makes, and overtakes it as a ramp law would.

    A belt that ripples, by cosine cos(omega t) + sine sin(omega t) in m/s, is followed in coordinates that move with
    it (`rig_sim.effects.ripple`): there it runs steadily and the mass is driven.  No ripple where omega is 0.

    Parameters
    ----------
    curve, ramp : int
        Code of the law's curve; 1 for a ramp, 0 for a jump.
    u : (13,) f8
        The run's parameters, ordered and in the units of `Global`.
    part : (6,) f8
        The cycle's own, ordered and in the units of `PerCycle`.
    window : ShootingWindow
        n samples.
    out : (n,) f8
        Filled with positions, m.
    room : (2 or more, n or more) f8
        Scratch space.
    work : Work
    """
    p, times = values_of(u), window.times
    stick, n, omega = window.stick == 1, times.size, p.omega
    x, v = (part[X_STICK], part[V_STICK]) if stick else (part[X_SLIP], part[V_SLIP])
    amplitude, phase = 0.0, 0.0
    if omega > 0.0:
        cosine, sine = math.cos(omega * times[0]), math.sin(omega * times[0])
        x -= (p.cosine * sine - p.sine * cosine) / omega
        v -= p.cosine * cosine + p.sine * sine
        stiff = p.K / omega - omega
        even, odd = p.sine * stiff - p.damping * p.cosine, -p.cosine * stiff - p.damping * p.sine
        amplitude, phase = math.hypot(even, odd), math.atan2(-odd, even)
    w = v - p.v_dr
    droop = p.compliance * p.F / p.K
    edge = droop + p.d if ramp == 1 else droop
    jump = edge == 0.0
    static = p.static if ramp == 1 and droop == 0.0 else 1.0
    hold = 1.0
    if stick and jump:
        mode = STICK
        static = STICK_LOCK
        w = 0.0
    elif stick:
        mode = RAMP
        hold = STICK_LOCK
        w = min(max(w, -hold * edge), hold * edge)
    elif not jump and abs(w) <= edge:
        mode = RAMP
    else:
        mode = NEGATIVE if w <= 0.0 else POSITIVE
    work.steps = 0.0
    t, last, i = times[0], times[n - 1], 0
    landed, level = stick, math.exp(part[LEVEL])
    while i < n:
        # The level fades steadily; the flow's is constant, so it is lowered in small steps.
        steady = p.fade == 0.0 or mode == STICK
        end = last if steady else min(t + FADE_STEP / math.sqrt(p.K), last)
        factor = level * remaining(p.fade, 0.5 * (t + end), window.level_epoch)
        if not factor > 0.0:
            return NOT_FINITE
        factor *= hold
        # per unit mass; the curve reads the one shape parameter that it has
        law = (curve, ramp, p.F, static, factor, p.shape * p.F, p.shape, hold * p.d)
        flow = Flow(1.0, p.K, p.datum, p.damping, p.v_dr, *law, amplitude, omega, phase, hold * droop, 0, NO_TABLE)
        before = mode
        samples = Samples(times, out, room[0], room[1], n)
        kind, at, i = sample_phase(flow, State(mode, x, w, t, 0.0), end, samples, i, work)
        mode, x, w, t, _ = at
        if kind >= FORCE_REVERSAL:
            return kind
        if not landed and before == NEGATIVE and kind != 0 and t >= window.earliest_landing:
            landed = True
            level = math.exp(part[NEXT_LEVEL])
            if jump:
                static = STICK_LOCK
                w = 0.0
                mode = POSITIVE if window.overtakes == 1 else STICK
            elif window.overtakes == 0:
                hold = STICK_LOCK
        elif landed and not stick and not jump and before == POSITIVE and kind != 0:
            hold = STICK_LOCK
    if omega > 0.0:
        for j in range(n):
            out[j] += (p.cosine * math.sin(omega * times[j]) - p.sine * math.cos(omega * times[j])) / omega
    return 0
