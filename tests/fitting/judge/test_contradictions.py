"""What was stated of the rig and contradicts the record, or a stored value, is reported with both numbers."""

from dataclasses import replace
from pathlib import Path

import pytest

import daq
from fitting import rank
from stickslip.units import Measured

pytestmark = pytest.mark.usefixtures("asked_laws_alone", "unmeasured_curve")
RUN = Path(__file__).parents[3] / "data_samples" / "law5.h5"
GENERATED = {"mass": Measured(0.3, 3e-4), "stiffness": Measured(0.3 * 35.184, 0.01)}


@pytest.fixture
def ranked_with(smoothed):
    """Give a function that ranks law 5 alone under a changed calibration."""

    def of(stated=None, duration=10.0, rest=None, **changes):
        record = smoothed(law=5, duration=duration)
        rig = replace(record.recording.rig, **changes)
        return rank(record, rig if rest is None else rig.resting_at(rest), laws=(5,), belt_speed=stated)

    return of


def codes(ranking):
    """Return the codes of findings without those that say which stored value was replaced."""
    return [finding.code for finding in ranking.findings if finding.code != "replaced"]


def finding_of(ranking, code):
    (finding,) = (finding for finding in ranking.findings if finding.code == code)
    assert finding.text in ranking.warnings
    assert vars(finding) in ranking.as_json()["findings"]
    return finding


def test_a_sound_calibration_contradicts_nothing(ranked_with):
    assert codes(ranked_with(**GENERATED)) == []


@pytest.mark.parametrize("law", [1, 2])
def test_constant_friction_contradicts_no_datum(smoothed, law):
    # It shows datum + Fs/k alone: the datum without its prior came out at 2e8 m, 2600 standard deviations off.
    assert codes(rank(smoothed(law=law, duration=10.0), laws=(law,))) == []


@pytest.mark.parametrize(
    "stale", [{"belt_speed": Measured(0.1)}, {"belt_speed": Measured(-0.22, 1e-3)}, {"stated": 0.30}]
)
def test_a_stale_belt_speed_is_named_and_the_records_own_is_used(ranked_with, stale):
    # 0.1 m/s in rig.toml made it "no belt stick-slip in this record"; 0.30 made Fs and gamma 29 % too large, silently.
    ranking = ranked_with(**stale)
    assert codes(ranking) == ["belt-speed"]
    finding = finding_of(ranking, "belt-speed")
    assert finding.value == pytest.approx(0.22, rel=1e-3)
    assert finding.expected == getattr(*stale.values(), "value", 0.30)
    assert finding.sigmas > 20
    assert ranking.best.parameters["v_dr"].value == pytest.approx(0.22, rel=1e-3)
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
    finding = finding_of(ranking, code)
    assert finding.expected == pytest.approx(expected)
    assert finding.sigmas > 4
    assert f"{finding.value:.4g}" in finding.text
    # A warning alone said so; the verdict named the law as if every calibration held.
    assert f"contradicts the stated {code}" in ranking.verdict
    assert ranking.adequacy.adequate or code == "datum"


@pytest.mark.parametrize(("rest", "duration"), [(0.02, 14.0), (0.06, 14.0), (0.15, 14.0), (0.06, 10.0)])
def test_a_rest_position_that_keeps_every_law_away_is_named_with_what_holds(ranked_with, rest, duration):
    # 60 mm made it "none of the six" without a word of x0, and of 10 s "no belt stick-slip"; of 20 mm the record was
    # said to show -122 mm.
    ranking = ranked_with(rest=Measured(rest, 1e-4), mass=Measured(0.3, 3e-4), duration=duration)
    assert not ranking.adequacy.adequate
    assert codes(ranking) == ["x0"]
    finding = finding_of(ranking, "x0")
    assert finding.value == pytest.approx(0.0, abs=1e-3)
    assert finding.expected == rest
    assert finding.text.endswith(". No law describes the record with the stated value")
    assert "This contradicts the stated x0" in ranking.verdict


@pytest.mark.parametrize(
    ("flags", "words"),
    [
        ({"mass": "300 kg"}, "mass: 300 kg overrides the stored value, 0.299"),
        ({"stiffness": "10.5 N/mm"}, "overrides the stored value, 0.299"),  # which implies a mass of 300 kg
        ({"mass": "300 g"}, None),
        ({"stiffness": "10.5 N/m"}, None),
    ],
)
def test_a_stored_value_replaced_by_more_than_the_errors_is_a_finding(flags, words):
    ranking = rank(daq.load(RUN), laws=5, **flags)
    assert ("replaced" in [finding.code for finding in ranking.findings]) == (words is not None)
    if words:
        finding = finding_of(ranking, "replaced")
        assert words in finding.text
        assert finding.value == pytest.approx(300, rel=0.03)
        assert finding.expected == pytest.approx(0.3, rel=0.01)
        assert finding.sigmas > 10
