"""Cases that broke prototypes, and their kin: each ends, with the outcome and the numbers that are right.

What is right comes from a closed form where there is one, else from 40-digit arithmetic, else from a property.
"""

import json
import math

import mpmath
import pytest

from rig_sim.analyses.limit_cycles.limit_cycle import cycle
from rig_sim.comparison.error_vs_time import difference
from rig_sim.flow.contact_state import initial_mode
from rig_sim.flow.flow import Flow
from rig_sim.flow.modes import COMPLETED, FORCE_REVERSAL, NEGATIVE, OUTCOMES
from rig_sim.friction.law import LAWS
from rig_sim.integrate.events import list_events
from rig_sim.integrate.phases import State, next_event
from rig_sim.integrate.work import new_work
from rig_sim.motion import play
from rig_sim.scenes.scene import scene
from stickslip.console import application


def flow_of(law, **changes):
    return Flow(curve=LAWS[law].curve_code, ramp=LAWS[law].ramp, **changes)


def at_the_end(flow, x, v, t):
    """Return (x, v) at time t."""
    at, work = State(initial_mode(flow, x, v, 0.0), x, v - flow.v_belt, 0.0), new_work()
    kind = None
    while kind != COMPLETED:
        kind, at = next_event(flow, at, t, work)
        assert kind < FORCE_REVERSAL
    return at.x, at.w + flow.v_belt


def meets_the_reference(reference_events, flow, x, v, t_max, tolerance, *, least=1):
    found = list_events(flow, x, v, t_max, every_cycle=True)
    expected = reference_events(flow, x, v, t_max)
    error, note = difference(found, [(t, kind) for t, kind, _ in expected], t_max)
    assert note == ""
    assert error <= tolerance
    assert len(found.t) >= least
    return found


# Slow contacts --------------------------------------------------------------------------------------------------------


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


# A belt at rest, and one that runs backwards --------------------------------------------------------------------------


def test_on_a_resting_belt_constant_friction_takes_twice_its_cone_off_each_swing():
    found = list_events(flow_of(1, v_belt=0.0), 3.3, 0.0, 1e6)
    assert (found.outcome, found.kinds) == ("completed", ("N>P", "P>S"))
    assert found.t == pytest.approx((math.pi, 2.0 * math.pi), abs=4e-15)
    assert found.x == pytest.approx((-1.3, -0.7), abs=4e-15)


@pytest.mark.parametrize("law", LAWS)
def test_a_mass_outside_the_cone_of_a_resting_belt_meets_the_reference(law, reference_events):
    found = meets_the_reference(reference_events, flow_of(law, v_belt=0.0), 3.3, 0.0, 40.0, 1e-14, least=2)
    assert found.kinds[-1] in ("P>S", "N>S")
    assert abs(found.x[-1]) <= 1.0


@pytest.mark.parametrize("law", LAWS)
def test_a_belt_that_runs_backwards_meets_the_reference(law, reference_events):
    meets_the_reference(reference_events, flow_of(law, v_belt=-0.6, c=0.02, x0=0.1), 0.2, 0.1, 40.0, 2e-14, least=2)


# Wide ramps, steep slip, no friction ----------------------------------------------------------------------------------


@pytest.mark.parametrize("d", [1.0, 0.5], ids=["G_stick -1: complex roots", "G_stick -2: double root"])
@pytest.mark.parametrize("law", [2, 4, 6])
def test_a_ramp_as_wide_as_the_belt_speed_rests_where_spring_and_ramp_balance(law, d):
    flow = flow_of(law, d=d)
    found = list_events(flow, 0.0, 0.0, 400.0)
    assert (found.outcome, found.kinds) == ("completed", ())
    assert at_the_end(flow, 0.0, 0.0, 400.0) == pytest.approx((0.5 / d, 0.0), abs=1e-14)


@pytest.mark.parametrize("law", [4, 6])
@pytest.mark.parametrize("d", [1.0, 0.5], ids=["G_stick -1: complex roots", "G_stick -2: double root"])
def test_a_wide_ramp_on_a_fast_belt_meets_the_reference(law, d, reference_events):
    meets_the_reference(reference_events, flow_of(law, d=d, v_belt=1.5), 0.0, 0.0, 40.0, 2e-14, least=8)


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


def test_without_friction_nothing_is_lost_in_a_million_time_units():
    x, v = at_the_end(flow_of(5, Fs=0.0, v_belt=0.5), 0.3, 0.0, 1e6)
    assert x == pytest.approx(0.3 * math.cos(1e6), abs=1e-9)
    assert math.hypot(x, v) == pytest.approx(0.3, abs=1e-9)


def test_resonant_forcing_with_the_friction_s_fall_damped_away_meets_the_reference_and_reverses_the_force(
    reference_events,
):
    flow = flow_of(3, c=0.05, u0=0.3, omega=1.0)
    meets_the_reference(reference_events, flow, 0.0, 0.0, 30.0, 1e-14, least=8)
    # without stick the swing grows by u0/2 a unit of time: x = 1 - G v/k + (u0/2) t sin t - ... , so the force reverses
    free = flow_of(3, c=0.05, u0=2.0, omega=1.0, v_belt=8.0, G_slip=0.05)
    found = list_events(free, 0.6, 0.0, 1000.0)
    assert found.outcome == "force reversal"
    x, v = at_the_end(free, 0.6, 0.0, 7.0)
    assert x == pytest.approx(0.6 + 7.0 * math.sin(7.0), abs=1e-13)
    assert v == pytest.approx(math.sin(7.0) + 7.0 * math.cos(7.0), abs=1e-13)


# Edges met exactly ----------------------------------------------------------------------------------------------------


def test_law_1_on_its_grazing_cycle_sticks_for_zero_time_once_a_turn():
    found = list_events(flow_of(1), 1.0, -0.5, 100.0)
    assert (found.outcome, set(found.kinds)) == ("completed", {"N>S", "S>N"})
    touches = [math.pi + 2.0 * math.pi * n for n in range(len(found.t) // 2)]
    assert len(touches) == 16
    assert found.t[::2] == pytest.approx(touches, abs=1e-7)  # a tangency: the square root of rounding
    assert found.t[1::2] == pytest.approx(touches, abs=1e-7)
    assert found.x == pytest.approx([1.0] * 32, abs=1e-7)


def test_law_1_an_ulp_outside_its_grazing_cycle_stays_there():
    v = math.nextafter(0.5, 1.0)
    found = list_events(flow_of(1), 1.0, -v, 1000.0)
    assert found.outcome == "completed"
    x, v_end = at_the_end(flow_of(1), 1.0, -v, 1000.0)
    assert math.hypot(x - 1.0, v_end) == pytest.approx(0.5, abs=1e-15)


def test_law_1_driven_may_touch_the_belt_within_less_than_an_ulp(reference_events):
    # omega = 3/10 exactly brings the mass back to the belt's speed at t = 78.026; the nearest float falls short
    # by 7e-18, less than rounding of w, and the next float passes: a stick of zero length, none, or one of 1e-8
    flow = flow_of(1, u0=0.2, omega=0.3)
    expected = reference_events(flow, 0.0, 0.0, 100.0)
    beyond = reference_events(flow._replace(omega=math.nextafter(0.3, 1.0)), 0.0, 0.0, 100.0)
    assert (len(expected), len(beyond)) == (6, 8)
    assert float(beyond[-1][0] - beyond[-2][0]) == pytest.approx(1.1e-8, rel=0.05)
    found = list_events(flow, 0.0, 0.0, 100.0)
    assert found.t[:6] == pytest.approx([float(t) for t, _, _ in expected], abs=1e-13)
    assert len(found.t) in (6, 8)
    assert found.t[6:] == pytest.approx([78.0260309] * (len(found.t) - 6), abs=2e-7)


@pytest.mark.parametrize("law", LAWS)
def test_a_start_on_the_slip_point_meets_the_reference(law, reference_events):
    if law in (1, 2):  # these touch at the end of every turn: the first slip
        found = list_events(flow_of(law), 1.0, 0.5, 6.0)
        assert found.kinds[0] == "S>N"
        return
    meets_the_reference(reference_events, flow_of(law), 1.0, 0.5, 30.0, 2e-14, least=5)


@pytest.mark.parametrize("law", [2, 4, 6])
@pytest.mark.parametrize("x", [-2.5, 0.0, 0.5, 1.0, 2.5])
@pytest.mark.parametrize("v", [0.0, 1.0])
def test_a_start_on_the_edge_of_the_ramp_goes_where_the_force_pushes(law, x, v, reference_events):
    flow = flow_of(law, d=0.5, c=0.1)
    found = list_events(flow, x, v, 12.0)
    expected = reference_events(flow, x, v, 12.0)
    assert difference(found, [(t, kind) for t, kind, _ in expected], 12.0) == (pytest.approx(0.0, abs=1e-14), "")


# The damped rig: the fold ---------------------------------------------------------------------------------------------

FOLD = 0.556168088639876


def test_just_below_the_fold_the_mass_sticks_and_just_above_it_comes_to_rest(reference_events):
    below, above = (flow_of(5, v_belt=0.6, c=FOLD + side) for side in (-1e-9, 1e-9))
    # w comes back at 9e-5 per unit of time: 2e-16 of it are 2e-12 of time, and the landings add up
    found = meets_the_reference(reference_events, below, 1.0 - FOLD * 0.6, 0.6, 60.0, 3e-11, least=18)
    assert found.kinds.count("N>S") >= 9
    orbit = cycle(below)
    assert (orbit.outcome, orbit.period) == ("cycle", pytest.approx(6.48057626545, abs=5e-9))
    assert cycle(above).outcome == "fixed point"
    assert list_events(above, 1.0 - FOLD * 0.6, 0.6, 1e6).kinds.count("N>S") == 0
    assert at_the_end(above, 1.0 - FOLD * 0.6, 0.6, 1e4) == pytest.approx((1.0 / 2.8, 0.0), abs=1e-12)


@pytest.mark.parametrize("law", LAWS)
def test_a_damper_stronger_than_friction_lets_the_mass_rest_below_the_springs_rest_position(law):
    flow = flow_of(law, c=3.0)
    assert (flow.Fs - flow.c * flow.v_belt) / flow.k < 0.0
    found = list_events(flow, 0.0, 0.0, 1e6)
    assert (found.outcome, found.kinds) == ("completed", ())
    s = flow.v_belt - (flow.d if flow.ramp else 0.0)
    level = (1.0, 1.0 - flow.G_slip * s, 1.0 / (1.0 + flow.gamma * s))[flow.curve]
    assert at_the_end(flow, 0.0, 0.0, 1e6) == pytest.approx((level, 0.0), abs=5e-14)  # it rests within 64 ulp


def test_law_6_on_a_slow_belt_rests_inside_its_ramp():
    flow = flow_of(6, v_belt=0.1)
    assert list_events(flow, 0.0, 0.0, 1e6).kinds == ()
    assert at_the_end(flow, 0.0, 0.0, 1e6) == pytest.approx((0.5, 0.0), abs=1e-15)


# Driven ---------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("law", [3, 5])
def test_driven_hard_the_stick_ends_at_its_lower_edge_and_slip_turns_over_without_stick(law, reference_events):
    found = meets_the_reference(
        reference_events, flow_of(law, v_belt=0.1, u0=2.5, omega=0.3), 0.0, 0.0, 40.0, 1e-12, least=8
    )
    assert {"S>P", "N>P"} <= set(found.kinds)


@pytest.mark.parametrize("law", [1, 3, 5])
def test_slips_far_shorter_than_a_step_are_all_seen(law, reference_events):
    flow = flow_of(law, u0=0.02, omega=87.3, v_belt=0.085)
    found = meets_the_reference(reference_events, flow, 0.0, 0.0, 11.9, 2e-13, least=4)
    slips = [b - a for a, b, kind in zip(found.t, found.t[1:], found.kinds, strict=False) if kind == "S>N"]
    if law == 1:
        assert min(slips) < 4.0 / (1.0 + 87.3)  # the longest step


# Magnitudes -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("law", [1, 5, 6])
def test_a_start_a_million_lengths_away_meets_the_reference(law, reference_events):
    meets_the_reference(reference_events, flow_of(law), 1e6, 0.0, 30.0, 1e-14, least=9)


@pytest.mark.parametrize(
    ("law", "gamma"), [(5, 1e-8), *((law, gamma) for law in (5, 6) for gamma in (1.0, 1e2, 1e4, 1e8))]
)
def test_any_gamma_meets_the_reference(law, gamma, reference_events):
    tolerance = 1e-11 if gamma < 1.0 else 2e-14  # gamma -> 0 is law 1, which grazes
    meets_the_reference(reference_events, flow_of(law, gamma=gamma), 1.0, 0.5, 40.0, tolerance, least=1)


def test_a_ramp_of_slope_1e16_is_a_jump():
    steep, jump = (list_events(flow_of(law, d=1e-16), 0.0, 0.0, 1000.0) for law in (6, 5))
    assert steep.kinds == jump.kinds
    assert steep.t == pytest.approx(jump.t, abs=2.3e-13)


def test_a_belt_at_1e_12_for_1e14_time_units_sticks_and_slips_as_the_closed_form_says():
    v = 1e-12
    flow = flow_of(5, v_belt=v)
    found = list_events(flow, 1.0, v, 1e14)
    assert (found.outcome, set(found.kinds)) == ("completed", {"S>N", "N>S"})
    # without speed the curve is flat: the slip returns to x with the work gamma v^2 ... all but undone, near x = 1
    period = found.t[2] - found.t[0]
    orbit = cycle(flow)
    assert period == pytest.approx(orbit.period, rel=1e-13)
    assert len(found.t) == pytest.approx(2e14 / orbit.period, abs=2)
    assert orbit.t_stick == pytest.approx((1.0 - orbit.x_stick) / v, rel=1e-12)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize(
    ("m", "k", "Fs"), [(1e-12, 1e12, 1e-12), (1e12, 1e-12, 1e12), (1e-12, 1e-12, 1e12), (1e12, 1e12, 1e-12)], ids=str
)
def test_units_of_1e_12_and_1e12_scale_the_motion_and_nothing_else(law, m, k, Fs):
    length, unit = Fs / k, math.sqrt(m / k)
    speed = length / unit
    base = flow_of(law)
    scaled = flow_of(
        law, m=m, k=k, Fs=Fs, v_belt=0.5 * speed, gamma=3.0 / speed, G_slip=0.05 * Fs / speed, d=0.2 * speed
    )
    one, other = cycle(base), cycle(scaled)
    assert other.outcome == one.outcome
    assert (other.period, other.t_slip) == pytest.approx((one.period * unit, one.t_slip * unit), rel=1e-13)
    assert (other.x_stick, other.x_max) == pytest.approx((one.x_stick * length, one.x_max * length), rel=1e-13)
    events = list_events(scaled, 0.0, 0.0, 30.0 * unit)
    assert events.outcome == "completed"
    if law > 2:
        assert events.t == pytest.approx([t * unit for t in list_events(base, 0.0, 0.0, 30.0).t], rel=1e-13)


@pytest.mark.parametrize("law", [1, 3, 4, 5, 6])
def test_the_last_turn_of_a_thousand_million_time_units_is_whole_periods_after_the_first(law):
    late = list_events(flow_of(law), 1.0, 0.5, 1e9, since=1e9 - 20.0, max_steps=1000)
    assert late.outcome == "completed"
    first = list_events(flow_of(law), 1.0, 0.5, 400.0, max_steps=1000)
    slips = [t for t, kind in zip(late.t, late.kinds, strict=True) if kind == "S>N"]
    assert len(slips) in (2, 3, 4)
    assert slips[1] - slips[0] == pytest.approx(cycle(flow_of(law)).period, abs=5e-7)
    landings = [x for x, kind in zip(late.x, late.kinds, strict=True) if kind == "N>S"]
    earlier = [x for x, kind in zip(first.x, first.kinds, strict=True) if kind == "N>S"]
    assert landings == pytest.approx(earlier[-1:] * len(landings), abs=1e-8 if law == 1 else 1e-15)


# Bounded, and refused -------------------------------------------------------------------------------------------------


def document(capsys, *line, code=0):
    from rig_sim.cli.app import app

    assert application.run(app, [*line, "--json"]) == code
    return json.loads(capsys.readouterr().out)


@pytest.mark.parametrize(
    ("changes", "until", "outcome"),
    [
        ([], "1e300", "event limit"),
        (["drive.u0=0.2", "drive.omega=1e6"], "1000", "step limit"),
        (["friction.law=2"], "1e300", "step limit"),
        (["spring.k=1e100"], "1e10", None),
        (["mass.m=1e100"], "1e10", None),
        (["friction.Fs=1e100"], "1e10", None),
        (["friction.gamma=1e100"], "1e10", None),
        (["belt.speed=1e100"], "1e10", None),
        (["belt.speed=1e-100"], "1e10", None),
        (["start.x=1e100"], "1e10", None),
        (["damper.c=1e100"], "1e10", None),
        (["drive.u0=1e100", "drive.omega=1e-100"], "1e10", None),
    ],
    ids=lambda value: "+".join(value) if isinstance(value, list) else str(value),
)
def test_every_run_ends_by_name(capsys, monkeypatch, changes, until, outcome):
    if outcome == "event limit":
        assert play.MOST_EVENTS == 1_000_000
        monkeypatch.setattr(play, "MOST_EVENTS", 10_000)
    sets = [word for change in changes for word in ("--set", change)]
    steps = [] if outcome == "event limit" else ["--max-steps", "5000"]
    found = document(capsys, "events", "base", "--until", until, *sets, *steps)
    assert found["outcome"] in {known.name for known in OUTCOMES.values()}
    assert found["steps"] <= 5_000
    if outcome:
        assert found["outcome"] == outcome
    if outcome == "event limit":
        assert len(found["events"]) == 10_000


def test_law_6_to_a_million_time_units_costs_its_transient():
    found = list_events(flow_of(6), 0.0, 0.0, 1e6)
    assert found.outcome == "completed"
    assert found.steps < 200
    assert len(found.t) == 245_609


@pytest.mark.parametrize(
    ("key", "value"),
    [("mass.m", "1e-300"), ("spring.k", "1e300"), ("start.x", "-1e101"), ("belt.speed", "1e-101")],
)
def test_a_number_beyond_arithmetic_is_refused_naming_the_key(capsys, key, value):
    error = document(capsys, "events", "base", "--until", "1", "--set", f"{key}={value}", code=2)["error"]
    assert key in error["what"]
    assert "1e-100 to 1e+100" in error["do"]


KEYS = ("mass.m", "spring.k", "friction.Fs", "friction.gamma", "belt.speed", "start.x", "damper.c", "drive.u0")


@pytest.mark.parametrize("key", KEYS)
@pytest.mark.parametrize("value", ["nan", "inf", "-inf"])
def test_what_is_no_finite_number_is_refused_naming_the_key(capsys, key, value):
    extra = ["--set", "drive.omega=1"] if key.startswith("drive") else []
    error = document(capsys, "events", "base", "--until", "1", "--set", f"{key}={value}", *extra, code=2)["error"]
    assert key in error["what"]


@pytest.mark.parametrize("key", ["mass.m", "spring.k"])
@pytest.mark.parametrize("value", ["-1", "0", "-1e-300"])
def test_mass_and_stiffness_that_are_not_positive_are_refused_naming_the_key(capsys, key, value):
    error = document(capsys, "cycle", "base", "--set", f"{key}={value}", code=2)["error"]
    assert key in error["what"]
    assert error["do"]


def test_a_scene_plays_what_the_flow_is_tested_with():
    assert scene("base", **{"friction.law": 5}).flow()._replace(G_slip=0.05, d=0.2) == flow_of(5)
