"""Records that are no belt stick-slip get no ranking but a clear reason, whatever is known of the rig."""

import json
import math
import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import daq
from daq.cli import app as daq_cli
from daq.runfile import store
from daq.runfile.recording import Recording
from daq.runfile.rig import Rig
from fitting import cli, rank
from fitting.judge import screening
from fitting.search import exchange
from processing.smoothing import smooth
from stickslip.console import application
from stickslip.errors import DataError
from stickslip.units import Measured

from .. import scales, strangers

KNOWN = {
    "nothing": Rig(),
    "all": Rig(mass=Measured(0.3, 1e-3), datum=Measured(0.0, 5e-4), belt_speed=Measured(0.22, 2e-3)),
}
WHY = {
    "constant": "the mass does not move",
    "ramp": "the mass (moves at|never moves with)",
    "sine": "a sine without a start-up; constant friction is possible",
    "decay": r"(it has \d complete swings, but no stick|no law fits even roughly|a sine without a start-up)",
    "coulomb_decay": r"it has \d complete swings, but no stick",
    "steps": "the mass moves at a constant speed between sticks",
}


def standing(recording, seconds):
    """Let the belt stand from ``seconds`` on: the mass stays where it is."""
    x = recording.position.copy()
    x[np.searchsorted(recording.time, seconds) :] = x[np.searchsorted(recording.time, seconds)]
    return replace(recording, position=x)


@pytest.fixture(scope="module")
def smoothed_stranger(belt_rig):
    """Give a function that smooths a stranger, once for all that its rig may be known by but the belt's speed."""
    blank = belt_rig.recording(law=5, duration=1.0)

    def of(name, seed, belt_speed=None):
        time, position = strangers.ALL[name](np.random.default_rng(seed))
        segment = np.zeros(time.size, np.uint16)
        return smooth(replace(blank, time=time, position=position, segment=segment, rig=Rig(belt_speed=belt_speed)))

    return cache(of)


@pytest.mark.parametrize(("known", "seed"), [("nothing", 11), pytest.param("all", 13, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", [name for name in strangers.ALL if name != "sawtooth"])
def test_no_stick_slip_is_never_ranked(smoothed_stranger, name, known, seed):
    kinematics = smoothed_stranger(name, seed, KNOWN[known].belt_speed)
    kinematics = replace(kinematics, recording=replace(kinematics.recording, rig=KNOWN[known]))
    with pytest.raises(DataError, match="no stick-slip was detected: " + WHY.get(name, "")):
        rank(kinematics)


@pytest.mark.parametrize("seed", [0, 1])
def test_a_mass_that_swings_without_sticking_shows_no_stick(smoothed_stranger, seed):
    """Lulls and turning points were up to 14 sticks "at the belt's speed", a small part of the speed of the swings.

    What was said followed from them: that it sticks for some of the time, or "stick-slip, but none of the six laws".
    """
    kinematics = smoothed_stranger("shaken", seed)
    assert kinematics.sticks == ()
    assert np.isnan(kinematics.belt_speed)
    with pytest.raises(DataError, match="no stick-slip was detected: ") as refused:
        rank(kinematics)
    assert "frames" not in str(refused.value)


@pytest.mark.parametrize(
    ("name", "seed", "why"),
    [
        # "3 complete stick-slip cycles, but a verdict needs 4; record longer" was said where nothing sticks.
        ("positioning_sweep", 13, r"it has \d complete swings, but no stick"),
        # The reason was that the mass "never moves back", whatever it did within what was taken for slips.
        ("sawtooth", 2, "the mass moves at a constant speed between sticks"),
        ("sawtooth", 1, ""),  # a triangular wave is no ramp that is never left
        ("positioning_drive", 27, r"the mass sticks for \d+ % of the time"),
    ],
)
def test_the_reason_is_true(smoothed_stranger, name, seed, why):
    with pytest.raises(DataError, match=f"no stick-slip was detected: .*{why}") as refused:
        rank(smoothed_stranger(name, seed), laws=(3, 5))
    assert "never" not in str(refused.value)


@pytest.mark.parametrize("seed", [1, 5, 7])
def test_a_drive_at_nearly_constant_speed_is_no_stick_slip(smoothed_stranger, seed):
    assert not screening.is_stick_slip(smoothed_stranger("positioning_drive", seed))


@pytest.mark.usefixtures("no_rivals")
@pytest.mark.parametrize("law", [4, *(pytest.param(law, marks=pytest.mark.slow) for law in (3, 5))])
def test_a_belt_that_stands_for_most_of_the_record_leaves_the_law_as_it_is(belt_rig, law):
    # Standing counted as record without a stick: laws 3 and 4 became constant friction.
    ranking = rank(smooth(standing(belt_rig.recording(law=law, seed=2, duration=20.0), 8.0)))
    assert ranking.laws_in_set[0] == law
    assert ranking.cut.plateau_fraction > 0.24


@pytest.mark.slow
@pytest.mark.usefixtures("no_rivals")
def test_a_slip_in_which_the_belt_stood_is_left_out(belt_rig):
    run = belt_rig.recording(law=5, seed=4, duration=12.0)
    x = run.position
    joined = np.r_[x, np.full(6000, x[-1]), np.linspace(x[-1], x[0], 500), x]
    time = np.arange(joined.size) / 1000
    ranking = rank(smooth(replace(run, position=joined, time=time, segment=np.zeros(time.size, np.uint16))))
    assert ranking.laws_in_set[0] == 5
    assert [event.flag for event in ranking.events].count("rest") == 1


@pytest.mark.parametrize("slower", [1.0, 64.0, 0.01])
def test_slips_of_too_few_samples_are_refused_with_the_rate_to_take(tmp_path, belt_rig, slower, capsys):
    """The reasons were false: "no slip between two sticks", "every cycle is left out", or a law that noise chose.

    A slip was said to have 5 samples where it has 7.6: those slower than half the belt's speed.
    """
    time, position = belt_rig.recorded(belt_rig.Contact(duration=30.0), rate=11.0)
    table, run = tmp_path / "track.csv", tmp_path / "run.h5"
    np.savetxt(table, np.c_[slower * time, position], delimiter=",", header="t,x", comments="", fmt="%.9g")
    assert application.run(daq_cli.app, ["import", str(table), "-o", str(run), "--x-unit", "m", "--t-unit", "s"]) == 0
    capsys.readouterr()
    assert application.run(cli.app, [str(run), "--json"]) == 4
    document = json.loads(capsys.readouterr().out)
    assert document["error"]["what"] == "the record has 7 samples per slip, but a verdict needs 8"
    rate = float(document["error"]["do"].removeprefix("record at ").split(" Hz")[0])
    assert 13 <= rate * slower <= 16  # slips last 0.69 s, of which the mass is slower than half the belt's speed 0.5 s
    (found,) = (row for row in document["findings"] if row["code"] == "samples-per-slip")
    assert found["value"] == pytest.approx(7.0)
    assert found["expected"] == 8


def test_sticks_of_two_samples_are_not_said_to_be_missing_alone(tmp_path):
    """A hard spring, 9 samples a slip: "it shows no stick", without a word of the samples."""
    drawn = scales.draw(99)
    scales.write_table(drawn, tmp_path / "track.csv")
    with pytest.raises(DataError, match=r"the mass never sticks \(9 samples per slip\)") as refused:
        rank(smooth(daq.load(tmp_path / "track.csv")))
    rate = float(refused.value.do.partition("record at ")[2].partition(" Hz")[0])
    assert 20 / 9.5 < rate / drawn.rate_hz < 20 / 8.5


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"duration": 6.0, "belt_start": 99.0}, "no stick-slip was detected: the mass does not move"),
        ({"duration": 1.2}, "there is no slip between two sticks"),
        ({"duration": 2.0}, "^.*1 complete stick-slip cycle, but a verdict needs 4; record longer"),
        ({"duration": 5.0}, "^.*2 complete stick-slip cycles, but a verdict needs 4; record longer"),
        ({"duration": 7.0}, "^.*3 complete stick-slip cycles, but a verdict needs 4; record longer"),
    ],
)
def test_cycles_are_counted_and_more_asked_for(smoothed, changes, said):
    with pytest.raises(DataError, match=said):
        rank(smoothed(law=5, **changes))


def test_a_refused_record_keeps_its_statistics(belt_rig, tmp_path, capsys):
    # The error stood alone: what the record shows without any law was printed only with a ranking.
    run = tmp_path / "run.h5"
    store.write(run, belt_rig.recording(law=5, duration=7.0))
    assert application.run(cli.app, [str(run), "--json"]) == 4
    document = json.loads(capsys.readouterr().out)
    assert set(document) == {"error", "statistics", "findings"}
    assert document["statistics"]["slips"] >= 3
    assert document["statistics"]["break_away_m"]["mean"] > 0.05
    assert application.run(cli.app, [str(run)]) == 4
    shown = capsys.readouterr()
    assert shown.out.splitlines()[-1].startswith("break-away ")
    assert shown.err.startswith("fit-friction: ")
    assert "a verdict needs 4" in shown.err


def test_paper_on_paper_is_stick_slip_that_no_law_describes(published, tmp_path, capsys):
    # "no belt stick-slip in this record" was said of 93 and of 227 sticks, and later an error with exit code 4.
    run = tmp_path / "run.h5"
    store.write(run, published("k168Nm_v1100"))
    assert application.run(cli.app, [str(run), "--json"]) == 6
    document = json.loads(capsys.readouterr().out)
    assert document["verdict"].startswith("the record shows stick-slip, but none of the six laws describes it: ")
    assert document["adequacy"]["verdict"] == "none of the six"
    assert document["set"] == document["ranking"] == []
    assert document["statistics"]["slips"] > 60
    assert "Phase portrait" in (tmp_path / "run.report.html").read_text()


def test_sticks_of_one_speed_that_fill_a_fifth_of_a_record_are_stick_slip(published):
    # "no belt stick-slip in this record": 38 sticks, and every slip leads back as far as a stick led on.
    ranking = rank(smooth(published("k168Nm_v4300")), laws=(3, 5))
    assert ranking.verdict.startswith("the record shows stick-slip, but none of the laws fitted: ")


def driven(belt, gamma=9.6, c=0.02, seconds=40.0, Fs=1.3):
    """Return the record of a mass of 0.3 kg on a belt of speed ``belt(t)``, by steps of 0.1 ms, with encoder counts."""
    k, m, dt, count = 10.555, 0.3, 1e-4, 7.67e-6
    x = v = 0.0
    stuck, positions = False, []
    for i in range(round(seconds / dt)):
        b = belt(i * dt)
        if i % 20 == 0:
            positions.append(x)
        if stuck and abs(k * x + c * b) <= Fs:
            x, v = x + b * dt, b
            continue
        stuck, slip = False, b - v
        force = math.copysign(Fs / (1 + gamma * abs(slip)), slip)
        landed = v + dt * (force - k * x - c * v) / m
        if (b - landed) * slip <= 0 and abs(k * x + c * b) <= Fs:
            stuck, landed = True, b
        x, v = x + dt * landed, landed
    readings = 0.05 + count * np.floor(np.array(positions) / count)
    return smooth(Recording.from_arrays(2e-3 * np.arange(readings.size), readings))


@pytest.mark.parametrize(
    ("pause", "back"),
    [(20.0, 20.0), (9.0, 12.0)],
)
def test_a_belt_that_reverses_is_named_with_the_time(pause, back):
    """Used to be "the mass slips back at constant speed, which a spring cannot cause"."""
    record = driven(lambda t: 0.15 if t < pause else 0.0 if t < back else -0.15)
    ranking = rank(record)
    assert ranking.rows == ()
    said = re.search(r"the belt reverses at about ([\d.]+) s; .*--to \1 and with --from \1", ranking.verdict)
    assert said is not None, ranking.verdict
    assert back - 0.5 < float(said[1]) < back + 2.5


@pytest.mark.parametrize("c", [0.1, 0.3])
def test_of_an_oscillation_that_dies_away_no_longer_record_is_asked_for(c):
    record = driven(lambda t: 0.0 if t < 1.0 else 0.1, gamma=0.0, c=c, Fs=0.8)
    with pytest.raises(DataError, match=r"a verdict needs 4; the oscillation dies away .* fit them jointly"):
        rank(record)


@pytest.mark.parametrize("name", ["smooth_noise", "two_sines", "sine"])
def test_what_no_law_comes_near_is_refused_before_six_laws_are_fitted(smoothed_stranger, name, monkeypatch):
    # Fitting six laws to noise took 20 to 40 CPU s, only to refuse it.
    monkeypatch.setattr(exchange, "fit_laws", None)
    with pytest.raises(
        DataError, match=r"no stick-slip was detected: (no law fits even roughly|a sine without a start-up)"
    ):
        rank(smoothed_stranger(name, 12))
