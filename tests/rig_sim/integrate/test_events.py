"""Events of the exact motion: closed forms first, then symmetries, then the cases that broke prototypes."""

import math
from fractions import Fraction

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from rig_sim.flow.contact_state import initial_mode
from rig_sim.flow.flow import Flow
from rig_sim.flow.modes import COMPLETED, KINDS, NEGATIVE, NOT_FINITE, OUTCOMES, POSITIVE, RAMP, STICK
from rig_sim.friction.law import LAWS
from rig_sim.integrate.events import list_events
from rig_sim.integrate.phases import State, next_event
from rig_sim.integrate.work import new_work


def flow_of(law, **changes):
    return Flow(curve=LAWS[law].curve_code, ramp=LAWS[law].ramp, **changes)


def test_first_stick_of_law_1_is_the_closed_form():
    found = list_events(flow_of(1), 0.0, 0.0, 3.0)
    assert found.kinds == ("N>S", "S>N")
    assert found.t == pytest.approx((math.pi / 6, math.pi / 6 + math.sqrt(3)), abs=5e-16)
    assert found.x == pytest.approx((1 - math.cos(math.pi / 6), 1.0), abs=5e-16)


def test_law_1_grazes_with_sticks_of_zero_length():
    found = list_events(flow_of(1), 0.0, 0.0, 40.0)
    assert found.outcome == "completed"
    start = math.pi / 6 + math.sqrt(3)
    touches = [t for t, kind in zip(found.t, found.kinds, strict=True) if kind == "N>S"][1:]
    leaves = [t for t, kind in zip(found.t, found.kinds, strict=True) if kind == "S>N"][1:]
    assert touches == pytest.approx([start + 2 * math.pi * n for n in range(1, 7)], abs=1e-13)
    assert leaves == touches


@pytest.mark.parametrize("v", [0.5, math.nextafter(0.5, 1.0), math.nextafter(0.5, 0.0)])
def test_law_1_on_its_grazing_circle_and_an_ulp_beside_it_goes_on_for_ever(v):
    found = list_events(flow_of(1), 1.0, -v, 100.0)
    assert found.outcome == "completed"
    assert found.steps < 100


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("drive", [{}, {"u0": 0.2, "omega": 1.1, "phase": 0.3}])
def test_mirror_symmetry_is_exact(law, drive):
    flow = flow_of(law, c=0.02, static=1.1, **drive)
    mirrored = flow._replace(v_belt=-0.5, u0=-flow.u0)
    one = list_events(flow, 0.3, 0.1, 40.0)
    other = list_events(mirrored, -0.3, -0.1, 40.0)
    assert other.t == one.t
    assert other.x == tuple(-x for x in one.x)
    exchange = str.maketrans("NP", "PN")
    assert other.kinds == tuple(kind.translate(exchange) for kind in one.kinds)


@pytest.mark.parametrize("law", [2, 4, 6])
def test_a_ramp_that_breaks_away_above_its_level_is_the_motion_of_a_general_solver(law):
    """F = -(static Fs/d) w within the half-width d; beyond it the curve, from Fs on, at abs(w) - d."""
    flow = flow_of(law, static=1.3, c=0.03, d=0.15)
    found = list_events(flow, 0.2, 0.45, 20.0)

    def friction(w, inside):  # of the mode, also where a trial step of the solver leaves it
        if inside:
            return -1.3 / 0.15 * w
        s = -w - 0.15
        return {2: 1.0, 4: 1.0 - 0.05 * s, 6: 1.0 / (1.0 + 3.0 * s)}[law]

    def edge(_, state):
        return state[1] - 0.35

    edge.terminal = True
    t, state, times, inside = 0.0, [0.2, 0.45], [], True
    while len(times) < len(found.t):

        def rates(_, y, inside=inside):
            return y[1], friction(y[1] - 0.5, inside) - 0.03 * y[1] - y[0]

        edge.direction = -1.0 if inside else 1.0
        part = solve_ivp(rates, (t, t + 40.0), state, "DOP853", events=edge, rtol=1e-12, atol=1e-13)
        t, state = part.t_events[0][0], [part.y_events[0][0][0], 0.35]
        inside = not inside
        times.append(t)
    assert len(times) >= 4
    assert found.t == pytest.approx(times, abs=1e-9)


@pytest.mark.parametrize("law", [5, 6])
@pytest.mark.parametrize("drive", [{}, {"u0": 0.2, "omega": 1.1}])
def test_gamma_0_equals_constant_friction(law, drive):
    assert list_events(flow_of(law, gamma=0.0, **drive), 0.0, 0.0, 30.0) == list_events(
        flow_of(law - 4, **drive), 0.0, 0.0, 30.0
    )


@pytest.mark.parametrize("law", [1, 5])
def test_closed_form_series_and_steep_ramp_agree(law):
    # a drive too weak to see takes another road: series for slip, driven closed form for the ramp
    for flow in (flow_of(law), flow_of(law + 1, d=1e-4), flow_of(law + 1)):
        plain = list_events(flow._replace(c=0.05, static=1.2), 0.0, 0.0, 25.0)
        driven = list_events(flow._replace(c=0.05, static=1.2, u0=1e-300, omega=1.3), 0.0, 0.0, 25.0)
        assert driven.kinds == plain.kinds
        assert driven.t == pytest.approx(plain.t, abs=1e-12)
        assert driven.x == pytest.approx(plain.x, abs=1e-12)


@pytest.mark.parametrize("law", [2, 6])
def test_time_shift_moves_the_events_only(law):
    flow = flow_of(law, u0=0.2, omega=1.1)
    shift = 2.0 * math.pi / 1.1
    one = list_events(flow, 0.0, 0.0, 20.0)
    other = list_events(flow, 0.0, 0.0, 20.0 + shift, t=shift)
    assert [t - shift for t in other.t] == pytest.approx(one.t, abs=1e-11)
    assert other.kinds == one.kinds


@pytest.mark.parametrize("x", [1.0, 1.2, -3.0, 1e6])
@pytest.mark.parametrize("law", [1, 5])
def test_a_belt_at_rest_brings_the_mass_to_rest(law, x):
    flow = flow_of(law, v_belt=0.0, c=0.1)
    found = list_events(flow, x, 0.0, 400.0)
    assert found.outcome == "completed"
    assert x == 1.0 or found.kinds[-1] in ("N>S", "P>S")
    if found.x:
        assert abs(found.x[-1]) <= 1.0


def test_mass_within_the_cone_of_a_resting_belt_has_no_events():
    flow = flow_of(5, v_belt=0.0)
    assert initial_mode(flow, -0.99, 0.0, 0.0) == STICK
    rest = State(STICK, -0.99, 0.0, 0.0)
    assert next_event(flow, rest, 1e6, new_work()) == (COMPLETED, rest._replace(t=1e6))


@pytest.mark.parametrize(
    ("law", "G_slip"), [(3, 2.0), (3, 1.0), (4, 2.0), (4, 1.0)], ids=["double root", "base", "ramp double", "ramp"]
)
def test_force_reversal_of_the_linear_curve_ends_the_run(law, G_slip):
    found = list_events(flow_of(law, G_slip=G_slip), 0.9, 0.5, 100.0)
    assert found.outcome == "force reversal"
    assert "G_slip" in found.advice


@pytest.mark.parametrize("law", [2, 4, 6])
@pytest.mark.parametrize("d", [1.0, 0.5], ids=["G_stick -1: complex roots", "G_stick -2: double root"])
def test_wide_ramps_settle_without_endless_events(law, d):
    found = list_events(flow_of(law, d=d), 0.0, 0.0, 1000.0)
    assert found.outcome == "completed"
    assert len(found.t) < 10


@pytest.mark.parametrize("law", LAWS)
def test_no_friction_swings_freely(law):
    found = list_events(flow_of(law, Fs=0.0, v_belt=0.1), 0.3, 0.0, 100.0)
    if law in (3, 4):
        assert found.outcome == "force reversal"
        return
    assert found.outcome == "completed"
    if law in (1, 5):  # v = -0.3 sin t crosses the belt's 0.1
        first = math.pi + math.asin(1 / 3)
        assert found.kinds[:2] == ("N>P", "P>N")
        assert found.t[:2] == pytest.approx((first, 3 * math.pi - first), abs=1e-14)


@pytest.mark.parametrize("law", LAWS)
def test_start_on_the_slip_point_begins_slip_once(law):
    found = list_events(flow_of(law), 1.0, 0.5, 6.2)
    assert found.kinds[0] == "S>N"
    assert found.kinds.count("S>N") == 1


@pytest.mark.parametrize("gamma", [1e-300, 1e-8, 1e2, 1e4, 1e8, 1e12])
def test_any_gamma_ends_within_few_steps(gamma):
    found = list_events(flow_of(5, gamma=gamma), 1.0, 0.5, 100.0)
    assert found.outcome == "completed"
    assert found.steps < 5000


def test_tiny_belt_speed_over_huge_time_keeps_its_stick_times():
    found = list_events(flow_of(5, v_belt=1e-12), 1.0, 1e-12, 3e12)
    sticks = [b - a for a, b in zip(found.t[1::2], found.t[2::2], strict=False)]
    assert found.outcome == "completed"
    assert sticks[0] == pytest.approx((1.0 - found.x[1]) / 1e-12, rel=1e-12)


@pytest.mark.parametrize("G_stick", [5.0, 5e2, 5e4, 5e6, 5e8, 1e16])
def test_steep_ramps_cost_nothing_extra(G_stick):
    mild = list_events(flow_of(6), 1.0, 0.0, 300.0, every_cycle=True)
    steep = list_events(flow_of(6, d=1.0 / G_stick), 1.0, 0.0, 300.0, every_cycle=True)
    assert steep.steps <= 1.15 * mild.steps


def test_resonant_drive_with_cancelled_damping_grows_until_force_reversal():
    found = list_events(flow_of(3, c=0.05, u0=2.0, omega=1.0), 0.0, 0.0, 400.0)
    assert found.outcome in ("force reversal", "completed")


def test_driven_stick_can_end_at_the_lower_edge_and_slip_can_change_sign():
    found = list_events(flow_of(5, v_belt=0.1, u0=2.5, omega=0.3), 0.0, 0.0, 60.0)
    assert {"S>P", "N>P"} <= set(found.kinds)


def test_step_limit_is_an_outcome_with_advice():
    found = list_events(flow_of(5), 0.0, 0.0, 1e9, max_steps=1000, every_cycle=True)
    assert (found.outcome, found.steps) == ("step limit", 1000)
    assert "steps" in found.advice


@pytest.mark.parametrize("law", [1, 3, 5])
@pytest.mark.parametrize("changes", [{}, {"v_belt": -0.5}, {"static": 1.2, "c": 0.01, "x0": 0.3}], ids=str)
def test_a_million_time_units_of_a_jump_law_are_the_work_of_a_transient_and_one_cycle(law, changes):
    flow = flow_of(law, **changes)
    once = list_events(flow, 0.0, 0.0, 60.0, every_cycle=True)
    slips = [t for t, kind in zip(once.t, once.kinds, strict=True) if kind[:2] == "S>"]
    short = list_events(flow, 0.0, 0.0, slips[2], every_cycle=True)
    long = list_events(flow, 0.0, 0.0, 1e6, max_steps=short.steps)
    assert long.outcome == "completed"
    assert long.steps <= short.steps
    assert long.t[-1] > 1e6 - 20.0


@pytest.mark.parametrize("law", LAWS)
def test_repeated_cycles_are_the_stepped_ones(law):
    short = list_events(flow_of(law), 0.0, 0.0, 1000.0)
    stepped = list_events(flow_of(law), 0.0, 0.0, 1000.0, every_cycle=True)
    assert short.kinds == stepped.kinds
    assert max(abs(a - b) for a, b in zip(short.t, stepped.t, strict=True)) <= 1.2e-13  # an ulp of 1000
    assert short.x == stepped.x


@pytest.mark.parametrize("law", [3, 5])
def test_event_times_are_whole_periods_apart_after_a_thousand_time_units(law):
    period = {3: Fraction("6.33848094122856082"), 5: Fraction("8.28274352267811740")}[law]
    found = list_events(flow_of(law), 1.0, 0.5, 1000.0)
    slips = [t for t, kind in zip(found.t, found.kinds, strict=True) if kind == "S>N"]
    assert max(abs(float(t - n * period)) for n, t in enumerate(slips)) <= 2.3e-13


@pytest.mark.parametrize("law", [1, 3, 4, 5, 6])
def test_the_end_of_a_thousand_million_time_units_is_listed(law):
    found = list_events(flow_of(law), 0.0, 0.0, 1e9, since=1e9 - 20.0, max_steps=500)
    assert found.outcome == "completed"
    assert 4 <= len(found.t) <= 8
    assert 1e9 - 20.0 <= found.t[0]
    assert found.t[-1] <= 1e9


def test_a_list_without_end_ends_at_the_event_limit():
    found = list_events(flow_of(5), 0.0, 0.0, 1e9, max_events=1001)
    assert (found.outcome, len(found.t)) == ("event limit", 1001)
    assert found.t == list_events(flow_of(5), 0.0, 0.0, 1e9, max_events=5000).t[:1001]


def test_constant_friction_with_a_ramp_never_quite_repeats_and_is_stepped_to_its_limit():
    found = list_events(flow_of(2), 0.0, 0.0, 1e9, max_steps=2000)
    assert (found.outcome, found.steps) == ("step limit", 2000)


def test_numbers_that_are_not_end_in_an_outcome():
    kind, _ = next_event(flow_of(5), State(NEGATIVE, math.nan, -0.5, 0.0), 1.0, new_work())
    assert OUTCOMES[kind].name == OUTCOMES[NOT_FINITE].name


@pytest.mark.parametrize(
    ("field", "number"),
    [("m", 0.0), ("k", -1.0), ("m", math.nan), ("v_belt", math.inf), ("Fs", -1.0), ("static", 0.9)],
)
def test_unphysical_flow_is_refused_by_name(field, number):
    with pytest.raises(ValueError, match=f"{field} is"):
        list_events(Flow(**{field: number}), 0.0, 0.0, 1.0)


def test_every_transition_has_a_name():
    assert KINDS[4 * NEGATIVE + RAMP] == "N>S"
    assert KINDS[4 * NEGATIVE + POSITIVE] == "N>P"
    assert len(set(KINDS)) == 10


span = st.floats(-6.0, 6.0).map(lambda exponent: 10.0**exponent)


@settings(max_examples=60)
@given(
    law=st.sampled_from(sorted(LAWS)),
    m=span,
    k=span,
    c=st.one_of(st.just(0.0), span),
    v_belt=st.one_of(st.just(0.0), span, span.map(lambda v: -v)),
    Fs=st.one_of(st.just(0.0), span),
    G_slip=span,
    gamma=span,
    d=span,
    u0=st.one_of(st.just(0.0), span),
    x=st.one_of(st.just(0.0), span),
    t_max=span,
)
def test_any_parameters_end_in_a_named_outcome(law, x, t_max, **fields):
    found = list_events(flow_of(law, omega=1.0, **fields), x, 0.0, t_max, max_steps=300)
    assert found.outcome in {outcome.name for outcome in OUTCOMES.values()}
    assert found.steps <= 300
    assert all(a <= b for a, b in zip(found.t, found.t[1:], strict=False))
