"""Published curves beside the six: none of them passes for one of the six alone, and true laws keep their sets."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fitting import job, rank
from fitting.laws import PUBLISHED
from processing.smoothing import smooth
from stickslip.units import Measured

STRIBECK = {"curve": "stribeck", "Fs": 2.0, "Fc": 1.2, "v_s": 0.05, "Fv": 0.0, "m": 0.5, "k": 80.0, "c": 0.02}


@pytest.fixture(scope="module")
def seen_by_camera(belt_rig, tmp_path_factory):
    """Give a function that ranks law 5 and its rivals on a contact as a camera of 250 Hz shows it."""

    def of(noise, seed, rig=None, **changes):
        contact = belt_rig.Contact(**STRIBECK | {"belt": 0.05, "duration": 9.0, "seed": seed} | changes)
        time = np.arange(0, contact.duration, 1 / 250)
        position = belt_rig.simulate(contact, time) + np.random.default_rng(seed).normal(0, noise, time.size)
        path: Path = tmp_path_factory.mktemp("camera") / "track.csv"
        recording = belt_rig.imported(path, time, position, 7)
        return rank(smooth(recording), rig and replace(recording.rig, **rig), laws=(5,))

    return of


@pytest.mark.parametrize(
    ("power", "named"), [(1.0, "stribeck"), pytest.param(2.0, "stribeck-gaussian", marks=pytest.mark.slow)]
)
def test_a_stribeck_contact_is_not_one_of_the_six_alone(seen_by_camera, power, named):
    # It was "law 5, adequate" alone, with exit code 0.
    ranking = seen_by_camera(5e-5, 3, power=power)
    document = ranking.as_json()
    assert named in document["rivals"]
    assert job.exit_code(document) == (5 if document["set"] else 6)
    assert ranking.adequacy.adequate
    assert ranking.best is ranking.rows[0]
    row = next(row for row in document["ranking"] if row["law"] == named)
    assert row["asked"] is False
    assert row["formula"].startswith("Fc + (Fs - Fc)*exp(")
    fall = row["parameters"]["v_s"]
    assert abs(fall["value"] - 0.05) < 4 * fall["stderr"]
    stiffness = row["parameters"]["k/m"]
    assert abs(stiffness["value"] - 160.0) < 4 * stiffness["stderr"]
    assert document["ranking"][0]["in_set"]
    assert "stribeck" in ranking.verdict


def test_the_true_rest_position_is_not_contradicted_where_a_rival_fits_it(seen_by_camera):
    # Law 5 moved it: the true one was "contradicted", and the wrong law stayed.
    ranking = seen_by_camera(5e-5, 3, rig={"x0": Measured(0.0, 1e-4)})
    document = ranking.as_json()
    assert document["set"] == []
    assert "stribeck" in document["rivals"]
    assert [one["code"] for one in document["findings"]] == []
    found = document["ranking"][0]["parameters"]
    for name, true in (("Fs/m", 4.0), ("Fc/m", 2.4), ("v_s", 0.05)):
        assert abs(found[name]["value"] - true) < 4 * found[name]["stderr"]


def test_every_published_law_is_fitted_or_says_why_not(ranked):
    # Which were fitted was decided by the measured curve, whose level is free without a rest position.
    document = ranked(law=5).as_json()
    rows = {row["law"]: row for row in document["ranking"]}
    assert set(PUBLISHED) < set(rows)
    assert all(row["fitted"] is (row["reason"] is None) is (row["rms_m"] is not None) for row in rows.values())
    constant = rows[1]["rms_m"]
    assert all(row["rms_m"] <= constant for row in rows.values() if row["fitted"])
    assert document["ranking"][0]["law"] == 5
    assert (document["set"], document["rivals"], job.exit_code(document)) == ([5], [], 0)
    fitted = [row for row in document["ranking"] if row["fitted"]]
    assert document["ranking"][: len(fitted)] == fitted


def test_a_law_that_contains_one_that_describes_the_record_is_not_fitted(ranked):
    unfitted = {one.law: one.reason for one in ranked(law=3).unfitted}
    assert unfitted["stribeck"] == "it contains law 3 as a special case, and no curve fits better than that law"
