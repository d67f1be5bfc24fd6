"""Landings, unstable orbits and locking of the driven mass: against its events and the figures of the thesis."""

import numpy as np
import pytest

from rig_sim.analyses.control.locking import lock
from rig_sim.analyses.control.search_and_lock import search_and_lock
from rig_sim.analyses.unstable_orbits import find_orbits_in_motion
from rig_sim.results import lock as control
from rig_sim.scenes.scene import scene
from rig_sim.systems.interface import difference, orbit
from rig_sim.systems.landing import LandingMap

from ...shared import CHAPTERS, answer, settings
from .events_of_driven_mass import list_passages

REFERENCE = CHAPTERS["chapter6"]


def driven(omega: float, **changes: object) -> LandingMap:
    return LandingMap(scene("forced", **{"drive.omega": omega, **changes}).flow())


@pytest.mark.parametrize(("omega", "change"), [(1.6, 0.0), (1.1, 0.004)])
def test_a_landing_is_that_of_the_events(omega: float, change: float) -> None:
    f = driven(omega)
    changed = f.flow._replace(u0=0.2 + change)
    state = f.first_landing(0.0, 0.0).state
    for _ in range(4):
        landing = f.find_landing(state, change)
        [broken], [landed] = list_passages(changed, state[1], 0.085, state[0] + 300.0, t=state[0], landings=1)
        assert difference(f, landing.state, landed) == pytest.approx([0.0, 0.0], abs=1e-11)
        assert (landing.duration, landing.x_slip) == pytest.approx((landed[0] - state[0], broken[1]), abs=1e-11)
        state = landing.state


@pytest.mark.parametrize("name", sorted(REFERENCE["unstable_orbits"]))
def test_unstable_orbits_meet_the_reference(name: str) -> None:
    omega, period = float(name.split("_")[0]), int(name.split("_")[1])
    expected = REFERENCE["unstable_orbits"][name]
    f = driven(omega)
    found = find_orbits_in_motion(f, orbit(f, f.first_landing(0.3, 0.0).state, 2000), period)[0]
    landings = [f.find_landing(point) for point in found.points]
    x_slip = [landing.x_slip for landing in landings]
    first = int(np.argmin(np.abs(np.array(x_slip) - expected["X_A"][0])))
    assert np.roll(x_slip, -first) == pytest.approx(expected["X_A"], abs=1e-11)
    assert sum(landing.duration for landing in landings) / f.period == pytest.approx(expected["K"], abs=1e-11)
    assert found.multipliers[0] == pytest.approx(expected["mult"], rel=1e-8)
    assert abs(found.multipliers[1]) < 1e-8  # a stick forgets all but one number
    # the orbit closes in the list of events too: errors of a landing grow by the multiplier
    t, x = found.points[0]
    _, landed = list_passages(f.flow, x, 0.085, t + 300.0, t=t, landings=period)
    assert np.max(np.abs(difference(f, landed[-1], found.points[0]))) < 1e-10 * abs(expected["mult"])


@pytest.mark.parametrize(
    ("omega", "period", "budget", "enough"),
    [
        (1.6, 2, 0.0235, 10),
        (1.1, 5, 0.0235, 10),
        pytest.param(1.6, 2, 0.003, 8, marks=pytest.mark.slow),
        (1.1, 5, 0.003, 8),
    ],
)
def test_both_orbits_of_the_thesis_lock_within_its_budgets(
    omega: float, period: int, budget: float, enough: int
) -> None:
    f = driven(omega)
    starts = [f.first_landing(x, v).state for x, v in np.random.default_rng(3).uniform(-1, 1, (10, 2)).tolist()]
    found = find_orbits_in_motion(f, orbit(f, starts[0], 3000), period)[0]
    held = [attempt for attempt in (lock(f, found, start, budget, 20_000) for start in starts) if attempt.locked]
    assert len(held) >= enough
    for attempt in held:
        assert np.max(np.abs(attempt.changes)) <= budget * 0.2
        assert abs(attempt.changes[-1]) < 1e-12
    # the changes and nothing else keep it there: played without them, the motion leaves the orbit
    free = orbit(f, held[0].states[held[0].events_to_lock], 30)
    nearest = np.min(np.linalg.norm(difference(f, free[:, None], found.points), axis=2), axis=1)
    assert np.max(nearest) > 0.05


def test_a_ramp_law_and_a_backward_belt_have_landings_too() -> None:
    ramp = driven(1.1, **{"friction.law": 6, "friction.G_stick": -50.0})
    states = orbit(ramp, ramp.first_landing(0.1, 0.0).state, 300)
    assert len(states) == 300
    found = find_orbits_in_motion(ramp, states, 1)
    assert found
    assert abs(np.max(np.abs(difference(ramp, ramp.after(found[0].points[0]), found[0].points[0])))) < 1e-10
    # mirrored, the drive is half a period later
    there, back = driven(1.6), driven(1.6, **{"belt.speed": -0.085})
    state = there.first_landing(0.2, 0.0).state
    mirrored = back.after(np.array([state[0] + 0.5 * there.period, -state[1]]))
    assert difference(back, mirrored, there.after(state) * [1, -1] + [0.5 * there.period, 0]) == pytest.approx(
        0, abs=1e-12
    )


@pytest.mark.slow
def test_the_search_of_the_thesis_needs_far_more_than_its_budget() -> None:
    f = driven(1.6)
    start = f.first_landing(0.0, 0.0).state
    assert search_and_lock(f, start, 2, 0.0235, steps=8).change is None
    found = search_and_lock(f, start, 2, 0.25, steps=50)
    assert found.change is not None
    assert found.change > 0.1 * 0.2
    assert not found.stays


@pytest.mark.parametrize(
    ("flags", "outcome"),
    [
        ("--period 1 --budget 0.01 --set drive.omega=0.3", "stable orbit"),
        ("--period 1 --budget 0.01 --set drive.omega=20 --set drive.u0=10", "no landing"),
        ("--period 1 --budget 0.01 --set belt.speed=0 --set drive.u0=0.1", "no landing"),
        ("--period 1 --budget 0.01 --set friction.law=1 --set damper.c=20", "no landing"),
        pytest.param("--period 2 --budget 0.01 --method search", "not locked", marks=pytest.mark.slow),
    ],
)
def test_what_cannot_be_locked_has_a_name(flags: str, outcome: str) -> None:
    found = answer(f"lock forced {flags}")
    assert found["outcome"] == outcome
    assert found["locked"] == (outcome == "stable orbit")
    assert (found["advice"] == "") == (outcome == "stable orbit")


@pytest.mark.parametrize("method", ["ogy", "search"])
def test_a_search_is_bounded_in_integrator_steps(monkeypatch: pytest.MonkeyPatch, method: str) -> None:
    """Under Coulomb friction landings may be hundreds of steps apart and no orbit be found: it took 24 s."""
    for limit in ("STEPS_IN_ALL", "STEPS_PER_EVENT"):
        monkeypatch.setattr(control, limit, getattr(control, limit) // 20)
    coulomb = settings("friction.law=1", "drive.u0=0.01", "drive.omega=100")
    found = answer(f"lock forced --period 7 --budget 0.01 --method {method}", *coulomb)
    assert (found["outcome"], found["locked"], found["orbit"]) == ("step limit", False, None)
    assert "shorter period" in found["advice"]


def test_control_that_meets_the_step_limit_keeps_the_orbits(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(control, "STEPS_IN_ALL", 450_000)  # 350 000 are taken up to the control
    monkeypatch.setattr(control, "STEPS_PER_EVENT", 0)
    found = answer("lock forced --period 2 --budget 0.0001")
    assert (found["outcome"], found["locked"], found["events_to_lock"]) == ("step limit", False, None)
    assert len(found["orbits"]) > 1
