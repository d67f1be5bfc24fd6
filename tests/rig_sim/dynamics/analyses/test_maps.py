"""Attractors, basins, exponents and sweeps of maps: textbook maps with known answers, and the thesis's two masses."""

import math

import numpy as np
import pytest

from rig_sim.analyses.basins import basins, merge_sets
from rig_sim.analyses.exponent import exponent
from rig_sim.analyses.map_branches import map_continuation
from rig_sim.analyses.periodic_points import find_periodic_orbits
from rig_sim.analyses.section import attractors_at
from rig_sim.flow.flow import Flow
from rig_sim.flow.two_mass import TwoMassFlow
from rig_sim.scenes.scene import scene
from rig_sim.systems.stick import StickMap

from ...shared import CHAPTERS, answer
from ..textbook import Logistic, OnInterval

REFERENCE = CHAPTERS["chapter4"]
SHARES = REFERENCE["basin_fraction_attractor2_of_d_range"]


def thesis(v_belt):
    return TwoMassFlow(Flow(v_belt=v_belt))


def test_the_logistic_map_has_the_periodic_points_of_the_textbook():
    r = 3.2
    (zero, fixed) = find_periodic_orbits(Logistic(r))
    assert (zero.points, fixed.points[0]) == ((0.0,), pytest.approx(1.0 - 1.0 / r, abs=1e-14))
    assert (zero.slope, fixed.slope) == (pytest.approx(r, abs=1e-8), pytest.approx(2.0 - r, abs=1e-8))
    (two,) = find_periodic_orbits(Logistic(r), 2)
    root = math.sqrt((r + 1.0) * (r - 3.0))
    assert two.points == pytest.approx(((r + 1.0 - root) / (2.0 * r), (r + 1.0 + root) / (2.0 * r)), abs=1e-14)
    assert two.slope == pytest.approx(4.0 + 2.0 * r - r * r, abs=1e-8)
    assert two.stable
    assert [orbit.period for orbit in find_periodic_orbits(Logistic(3.9), 3)] == [3, 3]


def test_an_orbit_that_leaves_has_no_exponent():
    f = OnInterval(lambda x: np.where(x < 0.9, x + 0.05, np.nan), 0.0, 1.0)
    assert exponent(f.motion(f.start), 100).outcome == "no attractor"
    assert basins(f, 50).attractors == ()
    assert basins(f, 50).nowhere == 1.0


def test_cycles_of_cells_of_one_chaotic_attractor_are_merged():
    found = basins(Logistic(3.9), 3000)
    assert [(attractor.period, attractor.share) for attractor in found.attractors] == [(None, 1.0)]
    assert merge_sets([{1, 2}, {3}, {2, 4}, {4, 3}]) == [0, 0, 0, 0]


def test_two_wells_share_the_interval():
    f = OnInterval(lambda x: 1.5 * x - 0.5 * x**3, -1.2, 1.2)
    found = basins(f, 1000)
    assert sorted(attractor.points for attractor in found.attractors) == [(-1.0,), (1.0,)]
    assert [attractor.share for attractor in found.attractors] == [0.5, 0.5]
    assert (found.fate[found.centres > 0.0] == found.fate[-1]).all()


@pytest.mark.parametrize("v_belt", ["0.1", "0.165"])
def test_basins_of_the_two_masses(v_belt):
    found = answer(f"basins two-mass --cells 4000 --set belt.speed={v_belt}")
    assert found["range"] == pytest.approx(SHARES["range"], abs=1e-14)
    assert found["cycles"] > len(found["shares"]) == 2
    assert found["shares"][1] == pytest.approx(SHARES["values"][v_belt], abs=SHARES["tol"])
    assert sum(found["shares"]) == pytest.approx(1.0)


@pytest.mark.parametrize("v_belt", ["0.083", "0.1", "0.15"])
def test_exponents_of_the_two_masses(v_belt):
    expected = REFERENCE["lyapunov_per_event"][v_belt]
    found = answer(f"lyapunov two-mass --events 1000 --set belt.speed={v_belt}")
    assert found["exponent"] == pytest.approx(expected["value"], abs=expected["tol"])
    assert found["per"] == "event"


@pytest.mark.slow
@pytest.mark.parametrize("v_belt", ["0.08060", "0.08075", "0.082"])
def test_exponents_of_chaotic_masses(v_belt):
    expected = REFERENCE["lyapunov_per_event"][v_belt]
    found = exponent(StickMap(thesis(float(v_belt))).motion(np.array([0.14])), 20_000)
    assert found.exponent == pytest.approx(expected["value"], abs=expected["tol"])
    assert found.stderr < 0.005


@pytest.mark.parametrize("case", [REFERENCE["X1p"][0], *REFERENCE["X1p"][4:9]], ids=lambda case: str(case["V"]))
def test_the_section_of_each_attractor(case):
    rows = attractors_at(thesis, "poincare", case["V"])
    (found,) = (row for row in rows if row.attractor == case["attractor"])
    assert found.points == pytest.approx(case["X1p"], abs=case["tol"])


def test_a_motion_without_global_stick_has_a_section_all_the_same():
    (row,) = attractors_at(lambda v_belt: TwoMassFlow(Flow(v_belt=v_belt), 1.2, 0.2), "poincare", 0.4)
    assert row.period is None
    assert row.share == 1.0


def test_the_start_may_be_an_attractor():
    assert scene("two-mass", **{"start.attractor": 2}).start.d is None
    found = answer("events two-mass --until 40 --set start.attractor=2")
    stuck = [event["x2"] - event["x1"] for event in found["events"] if event["kind"].endswith(">SS")]
    assert stuck == pytest.approx([0.12859314965090538] * len(stuck), abs=1e-8)
    assert len(stuck) > 1


def test_a_sweep_draws_both_attractors(tmp_path):
    path = tmp_path / "sweep.png"
    found = answer("sweep two-mass --over belt.speed=0.14:0.175:4 --section map --plot", path)
    assert path.stat().st_size > 10_000
    numbers = [[row["attractor"] for row in found["rows"] if row["parameter"] == value] for value in (0.14, 0.175)]
    assert numbers == [[1, 2], [1]]  # attractor 2 ends at the fold, 0.1697


def test_a_map_that_touches_the_diagonal_is_a_fold():
    def quadratic(r):
        return OnInterval(lambda x: x * x + r, -1.0, 1.0)

    points = map_continuation(quadratic, [0.1, 0.2, 0.3]).points
    assert [(point.kind, point.value) for point in points] == [("fold", pytest.approx(0.25, abs=1e-10))]


@pytest.mark.parametrize(
    ("span", "kind", "name"),
    [
        pytest.param("0.0804:0.0808:3", "crisis", "boundary_crisis", marks=pytest.mark.slow),
        ("0.083:0.085:2", "period-doubling", "reverse_period_doubling"),
        pytest.param("0.168:0.172:3", "fold", "period2_fold", marks=pytest.mark.slow),
    ],
)
def test_bifurcations_of_the_two_masses(span, kind, name):
    found = answer(f"continue two-mass --over belt.speed={span}")
    expected = REFERENCE["bifurcations_V"][name]
    (point,) = found["points"]
    assert (point["kind"], point["parameter"]) == (kind, "belt.speed")
    assert point["value"] == pytest.approx(expected["value"], abs=1e-9)
