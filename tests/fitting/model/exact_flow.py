"""Positions that a law predicts in a window by the exact flow of rig_sim: what the fit's own steps are held to.

Interpreted: to compile it takes longer than all that the tests ask of it.
"""

import math

import numpy as np

from fitting.model.flow import fade_factor
from fitting.model.unknowns import PER_RUN, Global, PerCycle, Values
from rig_sim.flow.flow import Flow
from rig_sim.flow.modes import FORCE_REVERSAL, NEGATIVE, POSITIVE, RAMP, STICK
from rig_sim.friction.spline import NO_TABLE
from rig_sim.integrate.phases import Samples, State, sample_phase
from rig_sim.integrate.work import new_work

K, F, V, DAMPING = 35.184, 4.598, 0.22, 0.03
CONSTANT, LINEAR, HYPERBOLIC = 0, 1, 2
STICK_LOCK = 10.0  # break-away level over Fs of a stick inside a window: the break-away itself lies in no window
# How often the level is lowered, in times of 1/omega of mass and spring: a tenth of a slip.  Chosen: what that leaves
# out is less than a tenth of a count in records that lose a tenth of their level; at half it takes more steps, at twice
# it is four times as much.
FADE_STEP = 0.3
WORK_STEPS = 10_000  # phases and Taylor steps one window may take


def unknowns(**changes):
    """Return the unknowns of a run by the rig of the design, changed by name."""
    u = np.zeros(PER_RUN)
    u[: Global.D] = K, np.log(F), V, 9.6
    u[[Global.DAMPING, Global.STATIC]] = DAMPING, 1.0
    for name, value in changes.items():
        u[Global[name.upper()]] = value
    return u


def exact_positions(curve, ramp, windows, u, local):
    """Follow the one window from its own start; return the positions at its times.

    The level is the cycle's own until the landing and the next one from there on, less what it has faded by.  A
    touch of the belt before the earliest landing is no landing: the mass slips on as soon as the load exceeds its
    level, so the motion depends continuously on where the window starts.  After the landing, and in a stick window,
    the contact holds whatever the load: the next break-away lies in no window.  A jump's stick has a large level there;
    of a ramp level and width are both raised, which keeps its slope.  So a ramp law contains its jump law.  Where the
    mass was seen to overtake the belt it slips on forwards under the new level, until that stops it.

    A slip window that starts within a ramp contains the break-away: there the ramp ends at the break-away level, static
    times that of slip, at the half-width d.

    A compliant belt is the flow's own droop, compliance F/K: a jump's contact then sticks on the ramp that the belt
    makes, and overtakes it as a ramp law would.

    A belt that ripples is followed in coordinates that move with it (`rig_sim.effects.ripple`): there it runs steadily
    and the mass is driven.
    """
    (_, stick, _, n, overtakes, _), times, part = windows.table[0], windows.time, local[0]
    out, room, work = np.empty(n), np.empty((2, n)), new_work(WORK_STEPS)
    p, omega = Values(u[0], math.exp(u[1]), *u[2:]), u[Global.OMEGA]
    x, v = part[[PerCycle.X_STICK, PerCycle.V_STICK] if stick else [PerCycle.X_SLIP, PerCycle.V_SLIP]]
    path = np.zeros(n)  # of the ripple
    amplitude, phase = 0.0, 0.0
    if omega > 0.0:
        path = (p.cosine * np.sin(omega * times) - p.sine * np.cos(omega * times)) / omega
        x -= path[0]
        v -= p.cosine * math.cos(omega * times[0]) + p.sine * math.sin(omega * times[0])
        stiff = p.K / omega - omega
        even, odd = p.sine * stiff - p.damping * p.cosine, -p.cosine * stiff - p.damping * p.sine
        amplitude, phase = math.hypot(even, odd), math.atan2(-odd, even)
    w = v - p.v_dr
    droop = p.compliance * p.F / p.K
    edge = droop + p.d if ramp else droop
    jump = edge == 0.0
    static = p.static if ramp and droop == 0.0 else 1.0
    hold = 1.0
    if stick and jump:
        mode, static, w = STICK, STICK_LOCK, 0.0
    elif stick:
        mode, hold = RAMP, STICK_LOCK
        w = min(max(w, -hold * edge), hold * edge)
    elif not jump and abs(w) <= edge:
        mode = RAMP
    else:
        mode = NEGATIVE if w <= 0.0 else POSITIVE
    t, last, i = times[0], times[-1], 0
    landed, level = stick, math.exp(part[PerCycle.LEVEL])
    while i < n:
        # The level fades steadily; the flow's is constant, so it is lowered in small steps.
        steady = p.fade == 0.0 or mode == STICK
        end = last if steady else min(t + FADE_STEP / math.sqrt(p.K), last)
        factor = hold * level * fade_factor(p.fade, 0.5 * (t + end), windows.level_epoch[0])
        # per unit mass; the curve reads the one shape parameter that it has
        law = (curve, int(ramp), p.F, static, factor, p.shape * p.F, p.shape, hold * p.d)
        flow = Flow(1.0, p.K, p.datum, p.damping, p.v_dr, *law, amplitude, omega, phase, hold * droop, 0, NO_TABLE)
        before = mode
        samples = Samples(times, out, room[0], room[1], n)
        kind, at, i = sample_phase(flow, State(mode, x, w, t, 0.0), end, samples, i, work)
        mode, x, w, t, _ = at
        assert kind < FORCE_REVERSAL, kind
        if not landed and before == NEGATIVE and kind != 0 and t >= windows.earliest_landing[0]:
            landed, level = True, math.exp(part[PerCycle.NEXT_LEVEL])
            if jump:
                static, w = STICK_LOCK, 0.0
                mode = POSITIVE if overtakes else STICK
            elif not overtakes:
                hold = STICK_LOCK
        elif landed and not stick and not jump and before == POSITIVE and kind != 0:
            hold = STICK_LOCK
    return out + path
