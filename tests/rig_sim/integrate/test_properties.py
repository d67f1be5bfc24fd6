"""What holds for every parameter: symmetries, energy, invariances, limits."""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from rig_sim.analyses.limit_cycles.limit_cycle import cycle
from rig_sim.flow.contact_state import force
from rig_sim.flow.modes import NEGATIVE
from rig_sim.friction.contact import force as force_of_law
from rig_sim.friction.law import LAWS
from rig_sim.integrate.events import list_events, new_samples
from rig_sim.integrate.phases import State, next_event, sample_phase
from rig_sim.integrate.work import new_work

from ..shared import flow_of


def log_span(low, high):
    return st.floats(math.log10(low), math.log10(high)).map(lambda exponent: 10.0**exponent)


flows = {
    "m": log_span(0.1, 10.0),
    "k": log_span(0.1, 10.0),
    "Fs": log_span(0.3, 3.0),
    "v_belt": log_span(0.05, 2.0),
    "gamma": log_span(0.1, 30.0),
    "G_slip": log_span(0.003, 0.03),
    "d": log_span(0.001, 0.04),
}


# Symmetries -----------------------------------------------------------------------------------------------------------


@given(
    law=st.sampled_from(sorted(LAWS)),
    w=st.one_of(log_span(1e-12, 1e3), st.just(0.0)),
    Fs=log_span(1e-6, 1e6),
    G_slip=log_span(1e-6, 10.0),
    gamma=log_span(1e-6, 1e6),
    d=log_span(1e-6, 10.0),
    static=st.floats(1.0, 2.0),
    factor=st.floats(0.05, 2.0),
)
def test_every_law_is_odd_and_opposes_slip(law, w, **parameters):
    forward, backward = (force_of_law(LAWS[law], sign * w, **parameters) for sign in (1.0, -1.0))
    assert forward == -backward
    if LAWS[law].curve != "linear":
        assert forward <= 0.0


@settings(max_examples=25, deadline=None)
@given(
    law=st.sampled_from(sorted(LAWS)),
    x=st.floats(-2.0, 2.0),
    v=st.floats(-1.0, 1.0),
    x0=st.floats(-0.5, 0.5),
    c=st.sampled_from([0.0, 0.02]),
    static=st.floats(1.0, 1.5),
    u0=st.sampled_from([0.0, 0.3]),
    **flows,
)
def test_the_mirrored_rig_moves_as_the_mirror_image(law, x, v, **fields):
    flow = flow_of(law, omega=0.7, phase=0.3, **fields)
    image = flow._replace(v_belt=-flow.v_belt, x0=-flow.x0, u0=-flow.u0)
    one, other = list_events(flow, x, v, 20.0), list_events(image, -x, -v, 20.0)
    swap = str.maketrans("NP", "PN")
    assert other.t == one.t
    assert other.x == tuple(-place for place in one.x)
    assert [kind.translate(swap) for kind in other.kinds] == list(one.kinds)


@settings(max_examples=25, deadline=None)
@given(
    law=st.sampled_from([3, 4, 5, 6]),
    shift=st.floats(0.1, 50.0),
    u0=st.sampled_from([0.0, 0.1]),
    omega=st.floats(0.2, 0.6),
    **flows,
)
def test_a_shift_of_time_shifts_the_events_and_nothing_else(law, shift, omega, **fields):
    assume(fields["m"] / fields["k"] < 20.0)
    flow = flow_of(law, omega=omega, phase=0.4, **fields)
    later = flow._replace(phase=flow.phase - omega * shift)
    unit = math.sqrt(flow.m / flow.k)
    one = list_events(flow, 0.0, 0.0, 10.0 * unit)
    other = list_events(later, 0.0, 0.0, shift + 10.0 * unit, t=shift)
    assume(one.outcome == "completed")
    # an event on the last instant may fall to either side; one that all but touches its edge moves by more
    n = min(len(one.t), len(other.t))
    assert abs(len(one.t) - len(other.t)) <= 1
    assert other.kinds[:n] == one.kinds[:n]
    assert [t - shift for t in other.t[:n]] == pytest.approx(one.t[:n], abs=1e-9 * unit)
    assert sorted(abs(a - shift - b) for a, b in zip(other.t, one.t, strict=False))[: n // 2] == pytest.approx(
        [0.0] * (n // 2), abs=1e-12 * unit + 2e-14 * shift
    )


@settings(max_examples=25, deadline=None)
@given(
    law=st.sampled_from(sorted(LAWS)),
    longer=st.integers(-40, 40),
    slower=st.integers(-40, 40),
    heavier=st.integers(-40, 40),
    x=st.floats(-2.0, 2.0),
    c=st.sampled_from([0.0, 0.02]),
    static=st.floats(1.0, 1.5),
    u0=st.sampled_from([0.0, 0.1]),
    **flows,
)
def test_lengths_times_and_masses_in_other_units_give_the_same_motion_to_the_last_bit(
    law, longer, slower, heavier, x, c, static, u0, **fields
):
    """Logarithms of m/s decided how long a step is: their rounding changed with the unit, and the bits with it."""
    speed, force_unit = 2.0 ** (longer - slower), 2.0 ** (longer - 2 * slower + heavier)
    flow = flow_of(law, c=c, static=static, u0=u0, omega=0.7, phase=0.3, **fields)
    other = flow._replace(
        m=flow.m * 2.0**heavier,
        k=flow.k * 2.0 ** (heavier - 2 * slower),
        c=flow.c * 2.0 ** (heavier - slower),
        v_belt=flow.v_belt * speed,
        Fs=flow.Fs * force_unit,
        G_slip=flow.G_slip * 2.0 ** (heavier - slower),
        gamma=flow.gamma / speed,
        d=flow.d * speed,
        u0=flow.u0 * force_unit,
        omega=flow.omega * 2.0**-slower,
    )
    unit = math.sqrt(flow.m / flow.k)
    ours = list_events(flow, x, 0.0, 30.0 * unit)
    theirs = list_events(other, x * 2.0**longer, 0.0, 30.0 * unit * 2.0**slower)
    assert theirs.outcome == ours.outcome
    assert theirs.kinds == ours.kinds
    assert theirs.t == tuple(t * 2.0**slower for t in ours.t)
    assert theirs.x == tuple(place * 2.0**longer for place in ours.x)
    one, another = cycle(flow), cycle(other)
    assert (another.outcome, another.sequence) == (one.outcome, one.sequence)
    if one.outcome == "cycle":
        assert (another.period, another.t_slip) == (one.period * 2.0**slower, one.t_slip * 2.0**slower)
        assert (another.x_stick, another.v_min) == (one.x_stick * 2.0**longer, one.v_min * speed)


# Energy ---------------------------------------------------------------------------------------------------------------


def energies(flow, orbit):
    """Return the belt's work over a cycle, what friction turns to heat, and what the damper takes."""
    nodes, weights = np.polynomial.legendre.leggauss(20)
    work = new_work()
    at = State(NEGATIVE, orbit.x_slip, -flow.d if flow.ramp else 0.0, 0.0)
    belt = heat = damper = 0.0
    for _ in orbit.sequence:
        _, end = next_event(flow, at, 1e9, new_work())
        # pieces refined towards both ends, where a ramp's fast root and slip's beginning live
        half = 0.5 * (end.t - at.t) * np.geomspace(1e-9, 1.0, 40)
        cuts = np.concatenate(([at.t], at.t + half, (end.t - half[::-1])[1:], [end.t]))
        for a, b in pairwise(cuts):
            times = (0.5 * (a + b) + 0.5 * (b - a) * nodes).tolist()
            samples = new_samples(times, compiled=False)
            sample_phase(flow, at, end.t, samples, 0, work)
            v = np.array(samples.v)
            F = np.array(
                [
                    force(flow, at.mode, x, speed - flow.v_belt, time)
                    for x, speed, time in zip(samples.x, samples.v, times, strict=True)
                ]
            )
            share = 0.5 * (b - a) * weights
            belt += flow.v_belt * float(share @ F)
            heat -= float(share @ (F * (v - flow.v_belt)))
            damper += flow.c * float(share @ v**2)
        at = end
    return belt, heat, damper


@settings(max_examples=12, deadline=None)
@given(law=st.sampled_from([3, 4, 5, 6]), c=st.sampled_from([0.0, 0.002, 0.02]), **flows)
def test_over_a_cycle_the_belts_work_is_what_friction_and_damper_dissipate(law, c, **fields):
    flow = flow_of(law, c=c, **fields)
    orbit = cycle(flow)
    assume(orbit.outcome == "cycle")
    belt, heat, damper = energies(flow, orbit)
    assert heat >= 0.0
    assert damper >= 0.0
    assert belt == pytest.approx(heat + damper, rel=1e-10, abs=1e-10)


# Laws against each other ----------------------------------------------------------------------------------------------


@given(v=log_span(1e-12, 3.0), G_slip=log_span(1e-3, 0.2), m=log_span(0.1, 10.0))
def test_the_period_of_law_3_does_not_depend_on_the_belts_speed(v, G_slip, m):
    Fs = 10.0  # far from where the force would change its sign
    one, other = (cycle(flow_of(3, v_belt=speed, G_slip=G_slip, m=m, Fs=Fs)) for speed in (0.3, v))
    assert one.outcome == other.outcome == "cycle"
    assert other.period == pytest.approx(one.period, rel=1e-13)
    assert other.t_stick == pytest.approx(one.t_stick, rel=1e-11)


@pytest.mark.parametrize(("ramp", "jump"), [(4, 3), (6, 5)])
@pytest.mark.parametrize("changes", [{}, {"v_belt": 0.2, "gamma": 6.0}, {"c": 0.02, "m": 2.0}], ids=str)
def test_ramp_laws_tend_to_jump_laws_as_one_over_the_slope(ramp, jump, changes):
    limit = cycle(flow_of(jump, **changes))
    gaps = [
        [
            getattr(found, name) - getattr(limit, name)
            for found in (cycle(flow_of(ramp, d=1.0 / slope, **changes)) for slope in (1e3, 1e4, 1e5))
        ]
        for name in ("period", "x_stick")
    ]
    for far, middle, near in gaps:
        assert abs(near) < 1e-3
        assert far / middle == pytest.approx(10.0, rel=0.15)
        assert middle / near == pytest.approx(10.0, rel=0.03)
