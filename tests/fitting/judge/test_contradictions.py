"""What was stated of the rig and contradicts the record is reported with both numbers, and the record is used."""

import re
from dataclasses import replace

import pytest

from fitting import rank
from processing.smoothing import smooth
from stickslip.units import Measured

pytestmark = pytest.mark.usefixtures("asked_laws_alone", "unmeasured_curve")
GENERATED = {"mass": Measured(0.3, 3e-4), "stiffness": Measured(0.3 * 35.184, 0.01)}


@pytest.fixture
def ranked_with(belt_rig):
    """Give a function that ranks law 5 alone under a changed calibration."""

    def of(stated=None, **changes):
        recording = belt_rig.recording(law=5, duration=10.0)
        return rank(smooth(recording), replace(recording.rig, **changes), laws=(5,), belt_speed=stated)

    return of


def contradictions(ranking):
    """Return the findings without those that say which stored value was replaced."""
    return [finding for finding in ranking.findings if finding.code != "replaced"]


def codes(ranking):
    return [finding.code for finding in contradictions(ranking)]


def test_a_sound_calibration_contradicts_nothing(ranked_with):
    assert codes(ranked_with(**GENERATED)) == []


@pytest.mark.parametrize("law", [1, 2])
def test_constant_friction_contradicts_no_datum(belt_rig, law):
    # It shows datum + Fs/k alone: the datum without its prior came out at 2e8 m, 2600 standard deviations off.
    assert codes(rank(smooth(belt_rig.recording(law=law, duration=10.0)), laws=(law,))) == []


@pytest.mark.parametrize("stale", [Measured(0.1), Measured(-0.22, 1e-3)])
def test_a_stale_belt_speed_is_named_and_the_records_own_is_used(ranked_with, stale):
    # 0.1 m/s in rig.toml made it "no belt stick-slip in this record"; 0.30 made Fs and gamma 29 % too large, silently.
    ranking = ranked_with(belt_speed=stale)
    assert codes(ranking) == ["belt-speed"]
    (finding,) = contradictions(ranking)
    assert finding.value == pytest.approx(0.22, rel=1e-3)
    assert finding.expected == stale.value
    assert finding.sigmas > 20
    assert finding.text in ranking.warnings
    assert vars(finding) in ranking.as_json()["findings"]
    assert ranking.best.parameters["v_dr"].value == pytest.approx(0.22, rel=1e-3)
    assert ranking.best.parameters["gamma"].value == pytest.approx(9.618, rel=0.02)


def test_a_belt_speed_that_the_command_states_is_compared_too(ranked_with):
    ranking = ranked_with(stated=0.30)
    assert codes(ranking) == ["belt-speed"]
    assert ranking.best.parameters["gamma"].value == pytest.approx(9.618, rel=0.02)


@pytest.mark.parametrize(
    ("code", "changes", "expected"),
    [
        ("datum", {"datum": Measured(0.02, 5e-4)}, 0.02),
        ("stiffness", {"stiffness": Measured(12.0, 0.05)}, 12.0),
        ("stiffness", {"mass": Measured(0.36), "stiffness": Measured(10.5552)}, 10.5552),
        ("damping", {"damping": Measured(0.3, 0.01)}, 0.3),
    ],
)
def test_a_wrong_calibration_is_named_with_both_numbers(ranked_with, code, changes, expected):
    # A wrong spring, mass, damping or datum changed the result without a word.
    ranking = ranked_with(**GENERATED | changes)
    finding = next(finding for finding in ranking.findings if finding.code == code)
    assert finding.expected == pytest.approx(expected)
    assert finding.sigmas > 4
    assert f"{finding.value:.4g}" in finding.text
    # A warning alone said so; the verdict named the law as if every calibration held.
    assert f"contradicts the stated {code}" in ranking.verdict
    assert ranking.adequacy.adequate or code == "datum"


@pytest.fixture
def ranked_at_rest(belt_rig):
    """Give a function that ranks law 5 with a rest position stated, m; it is 0."""

    def of(rest, duration):
        recording = belt_rig.recording(law=5, duration=duration)
        rig = replace(recording.rig, mass=Measured(0.3, 3e-4)).resting_at(Measured(rest, 1e-4))
        return rank(smooth(recording), rig, laws=(5,))

    return of


@pytest.mark.parametrize(("rest", "duration"), [(0.02, 14.0), (0.06, 14.0), (0.15, 14.0), (0.06, 10.0)])
def test_a_rest_position_that_keeps_every_law_away_is_named_with_what_holds(ranked_at_rest, rest, duration):
    # 60 mm made it "none of the six" without a word of x0, and of 10 s "no belt stick-slip"; of 20 mm the record was
    # said to show -122 mm.
    ranking = ranked_at_rest(rest, duration)
    assert not ranking.adequacy.adequate
    assert codes(ranking) == ["x0"]
    (finding,) = contradictions(ranking)
    assert finding.value == pytest.approx(0.0, abs=1e-3)
    assert finding.expected == rest
    assert finding.text in ranking.warnings
    assert re.search("; no law describes the record with the stated one$", finding.text)
    assert "it contradicts the stated x0" in ranking.verdict
