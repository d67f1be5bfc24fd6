"""Events of the exact motion: closed forms, an outside solver, edges met exactly, magnitudes, and bounds."""

import math

import mpmath
import pytest
from hypothesis import given
from hypothesis import settings as examples
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from rig_sim.analyses.limit_cycles.limit_cycle import cycle
from rig_sim.flow.contact_state import initial_mode
from rig_sim.flow.flow import Flow
from rig_sim.flow.modes import COMPLETED, FORCE_REVERSAL, NEGATIVE, OUTCOMES
from rig_sim.friction.law import LAWS
from rig_sim.integrate.events import list_events
from rig_sim.integrate.phases import State, next_event
from rig_sim.integrate.work import new_work
from rig_sim.motion import play

from ..shared import answer, flow_of, settings

GRAZING = math.pi / 6 + math.sqrt(3)  # law 1 from rest has slipped, stuck and is on the circle that touches the belt


def follow_to(flow, x, v, t):
    """Return (x, v) at time t."""
    at, work = State(initial_mode(flow, x, v, 0.0), x, v - flow.v_belt, 0.0), new_work()
    kind = None
    while kind != COMPLETED:
        kind, at = next_event(flow, at, t, work)
        assert kind < FORCE_REVERSAL
    return at.x, at.w + flow.v_belt


def times_of(found, kind):
    return [t for t, each in zip(found.t, found.kinds, strict=True) if each == kind]


# Closed forms ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("start", "touches", "within"),
    [
        ((0.0, 0.0), [GRAZING + 2 * math.pi * n for n in range(1, 7)], 1e-13),
        ((1.0, -0.5), [math.pi + 2 * math.pi * n for n in range(16)], 1e-7),  # a tangency: the square root of rounding
    ],
)
def test_law_1_grazes_with_sticks_of_zero_length(start, touches, within):
    found = list_events(flow_of(1), *start, touches[-1] + 1.0)
    assert found.outcome == "completed"
    n = len(touches)
    assert times_of(found, "N>S")[-n:] == pytest.approx(touches, abs=within)
    assert times_of(found, "S>N")[-n:] == pytest.approx(touches, abs=within)
    assert len(found.t) == 2 * n + 2 * (start == (0.0, 0.0))
    assert found.x[-2 * n :] == pytest.approx([1.0] * 2 * n, abs=1e-7)


def test_without_friction_nothing_is_lost_in_a_million_time_units():
    x, v = follow_to(flow_of(5, Fs=0.0, v_belt=0.5), 0.3, 0.0, 1e6)
    assert x == pytest.approx(0.3 * math.cos(1e6), abs=1e-9)
    assert math.hypot(x, v) == pytest.approx(0.3, abs=1e-9)


@pytest.mark.parametrize("G_slip", [2.0, 1.0], ids=["double root", "complex roots"])
def test_linear_friction_that_falls_fast_ends_where_its_force_would_change_sign(G_slip):
    flow = flow_of(3, G_slip=G_slip)
    work = new_work()
    _, at = next_event(flow, State(initial_mode(flow, 1.0, 0.5, 0.0), 1.0, 0.0, 0.0), 100.0, work)
    kind, (_, _, w, t, _) = next_event(flow, at, 100.0, work)
    assert OUTCOMES[kind].name == "force reversal"
    assert w == -1.0 / G_slip
    with mpmath.workdps(30):  # u'' - G u' + u = 0, u(0) = 1/2, u'(0) = 0
        half = mpmath.mpf(G_slip) / 2
        Omega = mpmath.sqrt(1 - half**2)

        def u(tau):
            if G_slip == 2.0:
                return mpmath.exp(tau) * (1 - tau) / 2
            return mpmath.exp(half * tau) * (mpmath.cos(Omega * tau) - half / Omega * mpmath.sin(Omega * tau)) / 2

        expected = mpmath.findroot(lambda tau: u(tau) - 0.5 + 1 / mpmath.mpf(G_slip), (0.5, 2.5), solver="anderson")
    assert abs(float(expected) - t) <= 4e-15


# A mass that comes to rest --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("flow", "until", "rest", "within"),
    [
        # a ramp as wide as the belt's speed, where spring and ramp balance: complex roots and a double root
        *((flow_of(law, d=d), 400.0, 0.5 / d, 1e-14) for law in (2, 4, 6) for d in (1.0, 0.5)),
        (flow_of(6, v_belt=0.1), 1e6, 0.5, 1e-15),  # inside a ramp
        # a damper stronger than friction; it rests within 64 ulp
        (flow_of(1, c=3.0), 1e6, 1.0, 5e-14),
        (flow_of(2, c=3.0), 1e6, 1.0, 5e-14),
        (flow_of(3, c=3.0), 1e6, 1.0 - 0.05 * 0.5, 5e-14),
        (flow_of(4, c=3.0), 1e6, 1.0 - 0.05 * 0.3, 5e-14),
        (flow_of(5, c=3.0), 1e6, 1.0 / 2.5, 5e-14),
        (flow_of(6, c=3.0), 1e6, 1.0 / 1.9, 5e-14),
    ],
)
def test_the_mass_rests_where_spring_and_friction_balance(flow, until, rest, within):
    found = list_events(flow, 0.0, 0.0, until)
    assert (found.outcome, found.kinds) == ("completed", ())
    assert follow_to(flow, 0.0, 0.0, until) == pytest.approx((rest, 0.0), abs=within)


# An outside solver, and the kernel against itself ---------------------------------------------------------------------


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


# Magnitudes -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("slower", [2.0**-7, 1.0, 2.0**6])
def test_a_phase_of_any_length_ends_in_few_steps(slower):
    """The last step ended an ulp early, the next an ulp of what was left, and so on: 2 of these ended in no time.

    Where the unit of time was below 2 s, rounding of the smallest number of all, 5e-324 s, ended that after 20 steps.
    """
    flow = Flow(k=1e-4 / slower**2, v_belt=3e-3 / slower, Fs=1e-4 / slower**2, gamma=300.0 * slower)
    begin = 600.0 * slower
    steps = []
    for number in range(1000):
        work, end = new_work(100), begin + (5.0 + 0.01 * number) * slower
        kind, at = next_event(flow, State(NEGATIVE, 1.5, -2e-3 / slower, begin), end, work)
        assert (kind, at.t) == (COMPLETED, end)
        steps.append(work.steps)
    assert max(steps) <= 5


@pytest.mark.parametrize("G_stick", [5.0, 5e2, 5e4, 5e6, 5e8, 1e16])
def test_steep_ramps_cost_nothing_extra(G_stick):
    mild = list_events(flow_of(6), 1.0, 0.0, 300.0, every_cycle=True)
    steep = list_events(flow_of(6, d=1.0 / G_stick), 1.0, 0.0, 300.0, every_cycle=True)
    assert steep.steps <= 1.15 * mild.steps


def test_a_belt_at_1e_12_for_1e14_time_units_sticks_and_slips_as_the_closed_form_says():
    v = 1e-12
    flow = flow_of(5, v_belt=v)
    found = list_events(flow, 1.0, v, 1e14)
    assert (found.outcome, set(found.kinds)) == ("completed", {"S>N", "N>S"})
    # without speed the curve is flat: the slip returns to x with the work gamma v^2 ... all but undone, near x = 1
    orbit = cycle(flow)
    assert found.t[2] - found.t[0] == pytest.approx(orbit.period, rel=1e-13)
    assert len(found.t) == pytest.approx(2e14 / orbit.period, abs=2)
    assert orbit.t_stick == pytest.approx((1.0 - orbit.x_stick) / v, rel=1e-12)


@pytest.mark.parametrize("law", [1, 3, 4, 5, 6])
def test_the_last_turn_of_a_thousand_million_time_units_is_whole_periods_after_the_first(law):
    late = list_events(flow_of(law), 1.0, 0.5, 1e9, since=1e9 - 20.0, max_steps=500)
    assert late.outcome == "completed"
    assert 1e9 - 20.0 <= late.t[0] <= late.t[-1] <= 1e9
    first = list_events(flow_of(law), 1.0, 0.5, 400.0, max_steps=1000)
    slips = times_of(late, "S>N")
    assert len(slips) in (2, 3, 4)
    assert slips[1] - slips[0] == pytest.approx(cycle(flow_of(law)).period, abs=5e-7)
    landings = [x for x, kind in zip(late.x, late.kinds, strict=True) if kind == "N>S"]
    earlier = [x for x, kind in zip(first.x, first.kinds, strict=True) if kind == "N>S"]
    assert landings == pytest.approx(earlier[-1:] * len(landings), abs=1e-8 if law == 1 else 1e-15)


# Bounds ---------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("law", "changes"), [(1, {}), (3, {}), (5, {}), (5, {"v_belt": -0.5, "static": 1.2, "c": 0.01, "x0": 0.3})], ids=str
)
def test_a_million_time_units_of_a_jump_law_are_the_work_of_a_transient_and_one_cycle(law, changes):
    flow = flow_of(law, **changes)
    once = list_events(flow, 0.0, 0.0, 60.0, every_cycle=True)
    slips = [t for t, kind in zip(once.t, once.kinds, strict=True) if kind[:2] == "S>"]
    short = list_events(flow, 0.0, 0.0, slips[2], every_cycle=True)
    long = list_events(flow, 0.0, 0.0, 1e6, max_steps=short.steps)
    assert long.outcome == "completed"
    assert long.steps <= short.steps
    assert long.t[-1] > 1e6 - 20.0


def test_law_6_to_a_million_time_units_costs_its_transient():
    found = list_events(flow_of(6), 0.0, 0.0, 1e6)
    assert found.outcome == "completed"
    assert found.steps < 200
    assert len(found.t) == 245_609


@pytest.mark.parametrize(
    ("changes", "until", "outcome"),
    [
        ((), "1e300", "event limit"),
        (("drive.u0=0.2", "drive.omega=1e6"), "1000", "step limit"),
        (("friction.law=2",), "1e300", "step limit"),
        (("spring.k=1e100",), "1e10", None),
        (("friction.gamma=1e100",), "1e10", None),
        (("belt.speed=1e-100",), "1e10", None),
        (("drive.u0=1e100", "drive.omega=1e-100"), "1e10", None),
    ],
    ids=lambda value: "+".join(value) if isinstance(value, tuple) else str(value),
)
def test_every_run_ends_by_name(monkeypatch, changes, until, outcome):
    if outcome == "event limit":
        assert play.MOST_EVENTS == 1_000_000
        monkeypatch.setattr(play, "MOST_EVENTS", 10_000)
    steps = "" if outcome == "event limit" else "--max-steps 5000"
    found = answer(f"events base --until {until} {steps}", *settings(*changes))
    assert found["outcome"] in ({outcome} if outcome else {known.name for known in OUTCOMES.values()})
    assert found["steps"] <= 5_000
    if outcome == "event limit":
        assert len(found["events"]) == 10_000


@pytest.mark.parametrize(
    ("field", "number"),
    [("m", 0.0), ("k", -1.0), ("m", math.nan), ("v_belt", math.inf), ("Fs", -1.0), ("static", 0.9), ("droop", -1.0)],
)
def test_unphysical_flow_is_refused_by_name(field, number):
    with pytest.raises(ValueError, match=f"^{field} must be .*, not {number}"):
        list_events(Flow(**{field: number}), 0.0, 0.0, 1.0)


span = st.floats(-6.0, 6.0).map(lambda exponent: 10.0**exponent)


@examples(max_examples=60)
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


@pytest.mark.parametrize(
    ("v", "within"), [(0.5, 1e-7), (math.nextafter(0.5, 1.0), 1e-15), (math.nextafter(0.5, 0.0), 1e-15)]
)
def test_law_1_on_its_grazing_circle_and_an_ulp_beside_it_stays_there(v, within):
    found = list_events(flow_of(1), 1.0, -v, 1000.0)
    assert found.outcome == "completed"
    assert found.steps < 1000
    x, v_end = follow_to(flow_of(1), 1.0, -v, 1000.0)
    assert math.hypot(x - 1.0, v_end) == pytest.approx(0.5, abs=within)
