"""Motion between events: dense samples, single phases, turning points, energy."""

import math
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from rig_sim.analyses.limit_cycles.limit_cycle import cycle
from rig_sim.flow.contact_state import initial_mode
from rig_sim.flow.flow import Flow
from rig_sim.flow.modes import NEGATIVE, STICK
from rig_sim.friction.contact import force
from rig_sim.friction.law import LAWS
from rig_sim.integrate.events import list_events, new_samples
from rig_sim.integrate.phases import State, next_event, sample_phase
from rig_sim.integrate.work import new_work


def flow_of(law, **changes):
    return Flow(curve=LAWS[law].curve_code, ramp=LAWS[law].ramp, **changes)


@pytest.mark.parametrize("drive", [{}, {"u0": 0.2, "omega": 1.1, "phase": 0.4}])
@pytest.mark.parametrize("law", [2, 4, 6])
def test_samples_solve_the_equation_of_motion(law, drive, sampled):
    # ramp laws have a continuous right-hand side: a plain integrator can be the witness, up to its kinks
    flow = flow_of(law, m=1.3, k=0.8, x0=0.2, c=0.03, **drive)
    settings = {name: getattr(flow, name) for name in ("Fs", "G_slip", "gamma", "d")}

    def rhs(t, y):
        pull = flow.u0 * math.cos(flow.omega * t + flow.phase) - flow.c * y[1] - flow.k * (y[0] - flow.x0)
        return [y[1], (force(LAWS[law], y[1] - flow.v_belt, **settings) + pull) / flow.m]

    times = np.linspace(0.0, 12.0, 101)
    expected = solve_ivp(
        rhs, (0.0, 12.0), [0.3, -0.1], method="DOP853", t_eval=times, rtol=1e-10, atol=1e-12, max_step=0.02
    )
    x, v, _ = sampled(flow, 0.3, -0.1, times.tolist())
    assert np.max(np.abs(x - expected.y[0])) < 1e-7
    assert np.max(np.abs(v - expected.y[1])) < 1e-7


def test_stick_samples_ride_on_the_belt(sampled):
    times = np.linspace(0.0, 30.0, 301)
    x, v, mode = sampled(flow_of(5), 0.0, 0.0, times.tolist())
    stuck = mode == STICK
    assert 0.3 < stuck.mean() < 0.6
    assert np.all(v[stuck] == 0.5)
    both = stuck[1:] & stuck[:-1]
    assert np.allclose(np.diff(x)[both], 0.05, atol=1e-14)


def test_sampling_in_pieces_equals_sampling_at_once(sampled):
    flow = flow_of(6, u0=0.1, omega=0.7)
    times = np.linspace(0.0, 20.0, 201).tolist()
    x, v, _ = sampled(flow, 0.0, 0.0, times)
    samples = new_samples(times, compiled=False)
    work = new_work()
    at, i = State(initial_mode(flow, 0.0, 0.0, 0.0), 0.0, -0.5, 0.0), 0
    phases = 0
    while i < 201:
        _, at, i = sample_phase(flow, at, 20.0, samples, i, work)
        phases += 1
    assert phases == len(list_events(flow, 0.0, 0.0, 20.0).t) + 1
    assert np.allclose(samples.x, x, atol=1e-13)
    assert np.allclose(samples.v, v, atol=1e-13)


def test_flow_may_change_between_events():
    # scatter: each stick is left at its own level, so the slip point moves with the factor
    flow = flow_of(5)
    work = new_work()
    at = State(initial_mode(flow, 0.0, 0.0, 0.0), 0.0, -0.5, 0.0)
    slip_points = []
    for factor in (1.0, 1.1, 1.05):
        while at.mode != STICK:
            _, at = next_event(flow, at, 100.0, work)
        flow = flow._replace(factor=factor)
        _, at = next_event(flow, at, 100.0, work)
        slip_points.append(at.x)
        assert at.mode == NEGATIVE
    assert slip_points == pytest.approx([1.0, 1.1, 1.05], abs=1e-15)


@pytest.mark.parametrize(("law", "c"), [(3, 0.0), (4, 0.01), (5, 0.1), (6, 0.0)])
def test_energy_balances_over_a_cycle(law, c):
    # the friction's work on the mass equals what the damper takes: the spring and the mass come back to where they were
    flow = flow_of(law, c=c, m=1.4, k=0.7)
    orbit = cycle(flow)
    work = new_work()
    nodes, weights = np.polynomial.legendre.leggauss(20)
    at = State(NEGATIVE, orbit.x_slip, -flow.d if flow.ramp else 0.0, 0.0)
    balance = taken = 0.0
    settings = {name: getattr(flow, name) for name in ("Fs", "G_slip", "gamma", "d")}
    for _ in orbit.sequence:
        _, end = next_event(flow, at, 100.0, work)
        if at.mode == STICK:
            rise = flow.k * (end.x**2 - at.x**2) / 2.0 + c * flow.v_belt * (end.x - at.x)
            balance += rise
            taken += c * flow.v_belt**2 * (end.t - at.t)
        else:
            edges = np.linspace(at.t, end.t, 41)
            for a, b in pairwise(edges):
                samples = new_samples((0.5 * (a + b) + 0.5 * (b - a) * nodes).tolist(), compiled=False)
                sample_phase(flow, at, end.t, samples, 0, work)
                v = np.array(samples.v)
                F = force(LAWS[law], v - flow.v_belt, **settings)
                balance += 0.5 * (b - a) * float(weights @ (F * v))
                taken += 0.5 * (b - a) * float(weights @ (c * v * v))
        at = end
    assert at.t == pytest.approx(orbit.period, abs=1e-13)
    assert balance == pytest.approx(taken, abs=1e-10)
