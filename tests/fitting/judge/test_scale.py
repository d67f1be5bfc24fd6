"""One contact at any scale: the fit measures times in slips, so a record in slow motion gives the same answer."""

from dataclasses import replace

import numpy as np
import pytest

from fitting import rank
from processing.smoothing import smooth

pytestmark = pytest.mark.usefixtures("asked_laws_alone", "unmeasured_curve")
DURATION = 9.0  # s, of the camera's record


@pytest.fixture(scope="module")
def track(belt_rig, tmp_path_factory):
    """Give a camera's record of law 5, times of which are divided by ``faster``."""
    time, position = belt_rig.camera(5, 5e-5, duration=DURATION)
    table = tmp_path_factory.mktemp("track") / "track.csv"

    def at(faster):
        recording = belt_rig.imported(table, time, position, decimals=7)
        return replace(recording, time=recording.time / faster, rate_hz=recording.rate_hz * faster)

    return at


@pytest.fixture(scope="module")
def expected(track, asked_laws_alone, unmeasured_curve):
    """Rank the record at its own speed."""
    return rank(smooth(track(1.0)), laws=(3, 5))


def test_a_motion_slower_by_a_power_of_two_gives_the_same_numbers(track, expected):
    """64 times slower a step of the flow did not end: the fit of all samples was given up, that of a third kept."""
    faster = 2.0**-6
    ranking = rank(smooth(track(faster)), laws=(3, 5))
    assert ranking.laws_in_set == (5,)
    assert ranking.adequacy.adequate
    assert len(ranking.events) == len(expected.events)
    found, expected = ranking.best, expected.best
    assert found.rms_m == pytest.approx(expected.rms_m, rel=1e-9)
    for name, power in (("k/m", 2), ("v_dr", 1), ("gamma", -1)):
        ours, theirs = found.parameters[name], expected.parameters[name]
        assert ours.value / faster**power == pytest.approx(theirs.value, rel=1e-6)
        assert ours.stderr / faster**power == pytest.approx(theirs.stderr, rel=1e-5)


def test_lengths_scaled_by_a_power_of_two_and_mirrored_give_the_same_numbers(track, expected):
    smoothed = smooth(track(1.0))
    factor = -(2.0**-7)
    record = replace(smoothed.recording, position=factor * smoothed.recording.position)
    names = ("position", "velocity", "acceleration", "belt_speed", "plateau_speed")
    errors = ("noise", "position_errors", "velocity_errors", "acceleration_errors")
    changes = {name: factor * getattr(smoothed, name) for name in names}
    changes |= {name: abs(factor) * getattr(smoothed, name) for name in errors}
    expected, found = expected.best, rank(replace(smoothed, recording=record, **changes), laws=(3, 5)).best
    units = {"k/m": 1.0, "v_dr": factor, "gamma": 1 / abs(factor), "c/m": 1.0, "Fs/m": abs(factor), "x0": factor}
    for name, unit in units.items():
        if name in expected.parameters:
            ours, theirs = found.parameters[name], expected.parameters[name]
            assert ours.value / unit == pytest.approx(theirs.value, abs=1e-4 * theirs.stderr)


def within_a_hundredth(found, expected, moved=()):
    """Assert that each law's parameters, but those that were ``moved``, are the same to 0.01 standard errors."""
    assert found.laws_in_set == expected.laws_in_set
    for row in expected.rows:
        others = found.row(row.law).parameters
        assert others.keys() == row.parameters.keys()
        for name in row.parameters.keys() - set(moved):
            ours, theirs = others[name], row.parameters[name]
            assert ours.value == pytest.approx(theirs.value, abs=0.01 * theirs.stderr), (row.law, name)


def test_it_does_not_matter_when_a_record_began(track, expected):
    """The time of a fading level was that of the record: 100 s later a wrong law moved by 0.41 errors."""
    record, later = track(1.0), 100.0
    found = rank(smooth(replace(record, time=record.time + later)), laws=(3, 5))
    within_a_hundredth(found, expected)
    assert [event.t - later for event in found.events] == pytest.approx(
        [event.t for event in expected.events], abs=3e-4
    )
    assert found.best.residuals["time_s"].to_numpy() - later == pytest.approx(
        expected.best.residuals["time_s"].to_numpy()
    )
    times = np.array([event.t for event in expected.events[2:5]])
    assert found.best.position(times + later) == pytest.approx(expected.best.position(times), abs=1e-6)


def test_it_does_not_matter_which_run_is_named_first(belt_rig, tmp_path):
    """Parameters that are one for all runs; the others stand in the rows of each run."""
    runs = []
    for number, noise in enumerate((5e-5, 8e-5)):
        time, position = belt_rig.camera(5, noise, duration=9.0)
        runs.append(smooth(belt_rig.imported(tmp_path / f"{number}.csv", time, position, decimals=7)))
    expected, found = rank(runs, laws=(3, 5)), rank(runs[::-1], laws=(3, 5))
    within_a_hundredth(found, expected, moved=[name for name in expected.best.parameters if name.endswith(")")])
    for side, other in zip(expected.runs, found.runs[::-1], strict=True):
        within_a_hundredth(other, side)
