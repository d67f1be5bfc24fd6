"""What was stated of the rig and contradicts the record is reported with both numbers, and the record is used."""

from dataclasses import replace

import pytest

from daq.base.measured import Measured
from fitting.selection.ranking import rank
from processing.smoothing import smooth

pytestmark = pytest.mark.usefixtures("asked_laws_alone", "unmeasured_curve")
GENERATED = {"mass": Measured(0.3, 3e-4), "stiffness": Measured(0.3 * 35.184, 0.01)}


@pytest.fixture
def ranked_with(belt_rig):
    """Give a function that ranks law 5 alone under a changed calibration."""

    def of(stated=None, **changes):
        recording = belt_rig.recording(law=5, duration=10.0)
        return rank(smooth(recording), replace(recording.rig, **changes), laws=(5,), belt_speed=stated)

    return of


def codes(ranking):
    return [finding.code for finding in ranking.findings]


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
    finding = ranking.findings[0]
    assert finding.value == pytest.approx(0.22, rel=1e-3)
    assert finding.expected == stale.value
    assert finding.sigmas > 20
    assert finding.text in ranking.warnings
    assert ranking.as_json()["findings"] == [vars(finding)]
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
    if ranking.adequacy.adequate:
        assert f"contradicts the stated {code}" in ranking.verdict
    assert ranking.adequacy.adequate or code == "datum"
