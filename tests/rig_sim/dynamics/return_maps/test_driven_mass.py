"""A driven mass: sections, periods and exponents, against published numbers and its list of events."""

import math

import numpy as np
import pytest

from rig_sim.analyses.settling import find_attractors
from rig_sim.flow.flow import Flow
from rig_sim.friction.curve import CONSTANT, LINEAR
from rig_sim.systems.driven import DrivenMap, driven_map_with_starts

from ...shared import CHAPTERS, answer
from .events_of_driven_mass import list_passages, list_strobes

REFERENCE = CHAPTERS["chapter6"]
EXPONENTS = REFERENCE["lambda_per_landing"]


def thesis(omega=1.6, **changes):
    return Flow(**{"v_belt": 0.085, "u0": 0.2, "omega": omega, **changes})


@pytest.mark.parametrize(
    ("flow", "start"),
    [
        (thesis(1.6), (0.0, 0.0)),
        (thesis(0.41), (0.3, 0.085)),
        (thesis(2.3, u0=1.4, c=0.1, m=1.3, k=0.8), (0.0, 0.0)),  # sticks in both directions of slip
        (thesis(1.1, curve=LINEAR, G_slip=0.1, v_belt=0.3), (0.5, 0.0)),
        (thesis(0.7, curve=CONSTANT, u0=0.6), (0.0, 0.0)),
    ],
)
def test_sections_are_those_of_the_events(flow, start):
    until = 25.0 if flow.omega == 1.6 else 40.0  # of a chaotic motion no longer
    broken, _ = list_passages(flow, *start, until)
    strobes = list_strobes(flow, *start, until)
    slip = DrivenMap(flow, "slip").motion(start).follow(len(broken))
    assert len(broken) >= 2
    assert slip.times * 2.0 * math.pi / flow.omega == pytest.approx(broken[:, 0], abs=1e-10)
    assert slip.states[:, 0] == pytest.approx(broken[:, 1], abs=1e-10)
    strobe = DrivenMap(flow).motion(start).follow(len(strobes))
    assert strobe.states == pytest.approx(strobes, abs=1e-10)


@pytest.mark.parametrize(
    "flow",
    [
        thesis(1.6),
        thesis(1.6, static=1.3),
        thesis(1.6, ramp=1, d=0.02),
        thesis(1.6, ramp=1, d=0.05, static=1.2),
        thesis(2.0, u0=1.5, c=0.1),
        thesis(1.6, droop=0.01, gamma=2.0),
        thesis(-1.3, v_belt=-0.085, curve=LINEAR),
    ],
    ids=["stick", "drop at break-away", "ramp", "ramp with a drop", "both directions", "droop", "backwards"],
)
def test_growth_is_that_of_two_neighbouring_motions(flow):
    """The variational equation with its jumps at events, against the difference of two motions."""
    passages, h = 6, 1e-6
    mass = DrivenMap(flow).motion((0.1, 0.0))
    total = float(np.sum(mass.follow(passages, tangent=True).growth))
    ends = [DrivenMap(flow).motion((0.1 + side * h, 0.0)).follow(passages).states[-1] for side in (1.0, -1.0)]
    omega0 = math.sqrt(flow.k / flow.m)
    difference = (ends[0] - ends[1]) / (2.0 * h)
    assert total == pytest.approx(math.log(math.hypot(omega0 * difference[0], difference[1]) / omega0), abs=1e-5)


def test_exponent_of_a_mass_that_never_sticks_is_that_of_its_damper():
    """Without friction it is -c T/2m per drive period; the growth of a single period used to be taken for it."""
    found = answer("lyapunov forced --set friction.Fs=0 --set damper.c=0.1 --set mass.m=1.7 --events 2000")
    assert (found["per"], found["stderr"], found["period"]) == ("drive period", 0.0, 1)
    assert found["exponent"] == pytest.approx(-0.1 / (2.0 * 1.7) * 2.0 * math.pi / 1.6, abs=1e-9)


@pytest.mark.parametrize("omega", EXPONENTS)
def test_exponents_of_the_thesis_s_case(omega):
    found = answer(f"lyapunov forced --events 10000 --set drive.omega={omega}")
    assert found["exponent"] == pytest.approx(EXPONENTS[omega]["value"], abs=EXPONENTS[omega]["tol"])
    assert (found["per"], found["period"]) == ("landing", None)
    assert found["stderr"] < 0.02


def test_periods_of_the_thesis_s_case():
    found = answer("sweep forced --over drive.omega=0.3:0.41:2 --section slip")
    (one, two) = found["rows"]
    assert (one["period"], one["drive_periods"], len(one["points"])) == (1, 1, 1)
    assert (two["period"], two["drive_periods"], len(two["points"])) == (2, 3, 2)
    strobe = answer("sweep forced --over drive.omega=0.3:0.41:2")
    assert [row["period"] for row in strobe["rows"]] == [1, 3]


def test_break_away_lies_where_spring_and_drive_balance_the_level():
    found = answer("sweep forced --over drive.omega=1.1:1.6:2 --section slip")
    lowest, highest = REFERENCE["X_A_range"]["value"]
    for row in found["rows"]:
        assert (row["attractor"], row["period"], row["drive_periods"]) == (1, None, None)
        assert lowest - 1e-9 <= min(row["points"]) < lowest + 0.01
        assert 1.0 < max(row["points"]) <= highest + 1e-9


@pytest.mark.parametrize(
    ("flow", "outcomes"),
    [
        (thesis(1.0, u0=2.0), {"growing"}),  # resonance: friction cannot take up the power
        (thesis(1.0, curve=CONSTANT), {"completed"}),
        (thesis(v_belt=2.0, curve=CONSTANT, c=0.3), {"no passage"}),  # Coulomb, and never sticks again
        (thesis(u0=3.0, curve=LINEAR, G_slip=1.0), {"force reversal"}),
        (thesis(v_belt=0.0), {"no passage"}),
        (thesis(gamma=1e4), {"completed"}),
        (thesis(Fs=0.0), {"no passage"}),
        (thesis(u0=0.0, Fs=0.0, v_belt=0.0), {"no passage"}),  # nothing moves the mass: its scale used to be 0
        (thesis(0.0005), {"step limit"}),
        (thesis(ramp=1, d=1e-12), {"completed"}),
        (thesis(c=50.0), {"no passage"}),
        (thesis(c=-1.0, v_belt=1e-6), {"no passage"}),  # in stick, far from its end: not growing
    ],
    ids=str,
)
def test_every_motion_ends_in_a_named_outcome(flow, outcomes):
    rows = find_attractors(*driven_map_with_starts(flow, 0.0, 0.0, "slip", 1), 0.0)
    assert {row.outcome for row in rows} == outcomes
    assert all(bool(row.points) == (row.outcome == "completed") for row in rows)


def test_a_sweep_names_a_drive_without_force_and_one_without_period():
    (still, _) = answer("sweep forced --over drive.u0=0:0.6:2 --section slip")["rows"]
    assert (still["outcome"], still["points"], still["drive_periods"]) == ("no drive", [1.0], None)
    (none, _) = answer("sweep forced --over drive.omega=0:0.3:2")["rows"]
    assert (none["outcome"], none["points"], none["attractor"]) == ("no drive period", [], 0)
