"""Two coupled masses: events, fixed point and the map from stick to stick, against published numbers and scipy."""

import math

import numpy as np
import pytest

from rig_sim.analyses import section
from rig_sim.analyses.limit_cycles.fixed_point import two_mass_fixed_point
from rig_sim.analyses.periodic_points import find_periodic_orbits
from rig_sim.flow.flow import Flow
from rig_sim.flow.two_mass import TwoMassFlow, slip_start
from rig_sim.friction.curve import CONSTANT, LINEAR
from rig_sim.integrate.events import list_events
from rig_sim.integrate.pair_motion import SAMPLES, PairMotion
from rig_sim.motion.two_masses import two_mass_events
from rig_sim.results import maps
from rig_sim.scenes.scene import scene
from rig_sim.systems import stick as stick_map
from rig_sim.systems.stick import COARSE, FINE, StickMap

from ...shared import BENCHMARKS, CHAPTERS, answer

REFERENCE = CHAPTERS["chapter4"]


def thesis(v_belt=0.1, a=1.2, b=1.3, **mass):
    return TwoMassFlow(Flow(v_belt=v_belt, **mass), a, b)


@pytest.mark.parametrize("case", REFERENCE["map"], ids=lambda case: f"{case['V']}-{case['d']}")
def test_the_map_of_the_thesis(case):
    found = answer(f"map two-mass --d {case['d']} --set belt.speed={case['V']}")
    assert found["f"] == pytest.approx(case["f"], abs=1e-12)
    assert found["word"] == ("12" if case["d"] == 0.05 else "21")


@pytest.mark.parametrize(
    ("flow", "d"),
    [
        (thesis(0.15), -0.4),
        (thesis(0.3), 0.3),
        (thesis(-0.12), 0.2),
        (thesis(0.1, c=0.2, static=1.2), 0.1),
        (thesis(0.1, m=2.0, k=3.0, x0=0.5, Fs=1.7), 0.1),
        (thesis(0.1, a=30.0, b=0.7), 0.01),
        (thesis(0.05, curve=LINEAR, G_slip=0.3), -0.1),
        (thesis(0.02, curve=CONSTANT, static=1.5), 0.1),
        (thesis(0.5, gamma=20.0, b=4.0), -0.2),
    ],
)
def test_an_event_is_that_of_a_general_solver(monkeypatch, flow, d):
    monkeypatch.syspath_prepend(BENCHMARKS)
    from oracles.two_masses import next_stick  # type: ignore[import-not-found]

    found = StickMap(flow).event(d)
    expected, word, duration = next_stick(flow, d)
    assert (found.d, found.duration) == pytest.approx((expected, duration), abs=1e-9)
    assert found.word == word


def test_without_coupling_each_mass_moves_as_if_alone():
    flow = Flow(v_belt=0.3)
    both = two_mass_events(
        scene("two-mass", coupling={"a": 0.0, "b": 1.0}, belt={"speed": 0.3}, start={"d": 0.4}), 40.0
    )
    x1, x2 = slip_start(thesis(0.3, 0.0, 1.0), 0.4)
    for which, x in ((0, x1), (1, x2)):
        alone = list_events(flow, x, 0.3, 40.0)
        changes = [(event.t, event.kind) for event in both.events if event.kind[which] != event.kind[3 + which]]
        assert [t for t, _ in changes] == pytest.approx(alone.t, abs=1e-11)
        assert tuple(f"{kind[which]}>{kind[3 + which]}" for _, kind in changes) == alone.kinds


def test_equal_masses_that_begin_alike_move_as_one():
    """A mass that came to the belt's speed together with the other used to count as one that begins to slip."""
    flow = thesis(0.3, b=1.0)
    assert StickMap(flow).event(0.0).d == pytest.approx(0.0, abs=1e-14)
    assert StickMap(flow).event(0.0).duration == pytest.approx(list_events(flow.mass, 1.0, 0.3, 20.0).t[1], abs=1e-11)


def test_a_belt_that_runs_backwards_mirrors_the_map():
    d = np.linspace(-0.6, 0.6, 13)
    assert StickMap(thesis(-0.1)).images(-d) == pytest.approx(-StickMap(thesis(0.1)).images(d), abs=0.0)


def test_the_fixed_point_has_the_right_eigenvalues_not_those_printed_in_the_thesis():
    found = answer("fixed-point two-mass")
    expected = REFERENCE["fixed_point_V0.1"]
    assert found["x"] == pytest.approx(expected["X"], abs=expected["tol"])
    for pair in expected["eig"]:
        assert min(abs(complex(*pair) - complex(*root)) for root in found["eigenvalues"]) < expected["tol"]
    assert found["stable"] is False


def test_masses_on_the_fixed_point_stay():
    flow = thesis(0.4, c=3.0, a=0.3)
    point = two_mass_fixed_point(flow)
    assert point.stable
    motion = PairMotion(flow, (point.x[0], 0.0, point.x[1], 0.0), 10_000)
    ((_, y1, w1, _, y2, w2, *_),) = motion.rows([20.0], SAMPLES)
    assert (y1, y2, w1, w2) == pytest.approx((*point.x, -0.4, -0.4), abs=1e-14)


def test_masses_at_rest_to_the_last_bit_do_not_overflow():
    # With every coefficient of the series 0 each step was four times as long as the one before: soon the time was
    # infinite, and the motion 'completed' there.
    motion = PairMotion(thesis(curve=CONSTANT, a=1.0, b=1.0), (1.0, 0.0, 1.0, 0.0), 1000)
    assert not list(motion.rows([math.inf], SAMPLES))
    assert motion.outcome.name == "step limit"


@pytest.mark.parametrize("case", REFERENCE["map_fixed_points"], ids=lambda case: str(case["V"]))
def test_fixed_points_of_the_map_and_their_slopes(case):
    orbits = find_periodic_orbits(StickMap(thesis(case["V"])))
    nearest = min(orbits, key=lambda orbit: abs(orbit.points[0] - case["d"]))
    assert nearest.points[0] == pytest.approx(case["d"], abs=case["tol_d"])
    assert nearest.slope == pytest.approx(case["slope"], abs=case["tol_slope"])


@pytest.mark.parametrize("case", REFERENCE["map_period2"], ids=lambda case: str(case["V"]))
def test_orbits_of_period_two(case):
    orbits = find_periodic_orbits(StickMap(thesis(case["V"])), 2)
    stable = case.get("d_stable", case.get("d"))
    assert any(orbit.stable and orbit.points == pytest.approx(stable, abs=case["tol"]) for orbit in orbits)
    if "d_unstable" in case:
        unstable = [orbit for orbit in orbits if not orbit.stable]
        assert any(orbit.points == pytest.approx(case["d_unstable"], abs=case["tol"]) for orbit in unstable)


def test_lower_precision_keeps_its_promise():
    d = np.linspace(-0.6, 0.6, 501)
    exact = StickMap(thesis()).images(d)
    for precision, allowed in ((FINE, 1e-9), (COARSE, 1e-5)):
        errors = np.abs(StickMap(thesis(), precision).images(d) - exact)
        assert np.quantile(errors, 0.99) < allowed  # the rest stands beside a jump of the map


@pytest.mark.parametrize(
    ("flow", "d", "outcome"),
    [
        (thesis(b=0.0), 0.1, "no global stick"),  # the second mass never sticks
        (thesis(0.2, curve=CONSTANT), 0.1, "no global stick"),  # a Coulomb pair that never sticks again
        (thesis(c=4.0), 0.1, "no global stick"),  # it comes to rest
        (thesis(a=0.0), 0.1, "completed"),
        (thesis(a=1e5), 1e-6, "completed"),
        (thesis(b=1e12), 0.1, "completed"),
        (thesis(gamma=1e8), 0.1, "no global stick"),  # next to no friction in slip
        (thesis(1e-9), 0.1, "completed"),
        (thesis(curve=LINEAR, G_slip=1.0), 0.1, "force reversal"),
        (thesis(), 0.7, "outside"),
    ],
)
def test_every_event_ends_in_a_named_outcome(flow, d, outcome):
    found = StickMap(flow).event(d)
    assert found.outcome == outcome
    assert math.isnan(found.d) == (outcome != "completed")


def test_an_analysis_of_a_very_stiff_coupling_ends_by_name(monkeypatch):
    # Basins at coupling.a = 1e6 used to take days: 50 000 steps an event, hundreds of attractors.
    for place, name in ((stick_map, "STEPS_IN_ALL"), (maps, "STEPS_PER_EVENT"), (section, "STEPS_OF_VALUE")):
        monkeypatch.setattr(place, name, 2000 if place is not maps else 1)
    assert "step limit" in answer("basins two-mass --cells 300", code=2)["error"]["what"]
    swept = answer("sweep two-mass --over coupling.a=1:1.2:2")["rows"]
    assert [(row["attractor"], row["points"], row["outcome"]) for row in swept] == [(0, [], "step limit")] * 2


def test_a_belt_at_rest_has_no_map():
    with pytest.raises(ValueError, match="at rest"):
        StickMap(thesis(0.0))


def test_events_and_motion_agree(tmp_path):
    listed = answer("events two-mass --until 30")
    assert [event["kind"] for event in listed["events"]][:4] == ["SS>SN", "SN>NN", "NN>SN", "SN>SS"]
    assert listed["events"][3]["x2"] - listed["events"][3]["x1"] == pytest.approx(0.1193418518572602, abs=1e-12)
    path = tmp_path / "motion.csv"
    answer("run two-mass --until 30 --rate 10 -o", path)
    columns = np.genfromtxt(path, delimiter=",", names=True)
    assert columns.dtype.names == ("t", "x1", "v1", "F1", "x2", "v2", "F2")
    assert len(columns) == 301
    inside = (columns["t"] > 5.0) & (columns["t"] < 19.0)  # in global stick
    assert columns["v1"][inside] == pytest.approx(0.1, abs=1e-15)
    assert np.ptp((columns["x2"] - columns["x1"])[inside]) < 1e-13
    # Newton's law: the accelerations are those that springs and friction give, away from events
    t, x1, x2 = columns["t"], columns["x1"], columns["x2"]
    slipping = np.flatnonzero((t > 1.0) & (t < 4.0))
    forces = columns["F1"] - x1 - 1.2 * (x1 - x2)
    acceleration = np.gradient(columns["v1"], t)
    assert acceleration[slipping] == pytest.approx(forces[slipping], abs=0.02)
