"""The smoothers on the bench, where the truth is known: their errors are as claimed, and are reported."""

from dataclasses import replace

import numpy as np
import pytest

import processing
from processing import methods
from processing.kalman import corner_kernel, stick_slip, white_jerk
from processing.kalman.white_jerk import first_state
from processing.record import series
from processing.record.setting import Setting
from processing.stick_slip.corners import KERNELS
from stickslip.compute.compile import compiled

BELT = 0.22  # m/s, as the motions have it


def velocity_error(found, v):
    error = 1e3 * (found.velocity - v)
    return float(np.sqrt(np.mean(error**2))), float(np.abs(error).max())


# Pitch, jitter, times, and the limits in mm/s of rms and largest error.
CLAIMED = [
    (7.67e-6, 30e-6, "recorded", 0.07, 1.8),
    (50e-6, 30e-6, "recorded", 0.22, 5.0),
    (7.67e-6, 30e-6, "nominal", 0.30, 3.2),
]


@pytest.mark.parametrize(("pitch", "jitter", "times", "rms", "largest"), CLAIMED)
def test_sticks_and_slips_smoothed_apart_keep_the_flat_top(motion, recorded, pitch, jitter, times, rms, largest):
    true = motion(5, 60.0, jitter, seed=2)
    found = methods.estimate("auto", series.from_recording(recorded(true, pitch), times), Setting())
    error = velocity_error(found, true.v)
    assert found.method == "segment"
    assert error[0] < rms
    assert error[1] < largest


@pytest.mark.parametrize("speed", [1e-3, 1e-2])
def test_a_mass_that_rests_and_is_then_dragged_slowly_is_no_straight_line(speed):
    # The likelihood of the part that moves knows no bend: the whole record was a line, 51 um off its readings.
    time, pitch = np.arange(2000) * 1e-3, 7.67e-6
    true = speed * np.maximum(time - 0.5, 0.0)
    count = np.floor(true / pitch)
    data = series.Series(time, pitch * count, 0.0, pitch, 1e-3, (slice(0, 2000),))
    for method in ("rts", "auto"):
        found = methods.estimate(method, data, Setting())
        assert np.sqrt(np.mean((found.position - true + pitch / 2) ** 2)) < pitch
        assert found.velocity[:400] == pytest.approx(0.0, abs=0.05 * speed)
        assert found.velocity[600:1900] == pytest.approx(speed, rel=0.05)


def test_corners_sticks_and_coverage_are_as_claimed(motion, recorded):
    covered, covered_near = [], []
    for seed in (1, 2, 3):
        true = motion(5, 30.0, seed=seed)
        data = series.from_recording(recorded(true))
        found = methods.estimate("auto", data, Setting())
        error = found.velocity - true.v
        near = np.abs(true.time[:, None] - [start for start, _ in true.sticks[1:]]).min(axis=1) < 0.01
        assert 1e3 * np.sqrt(np.mean(error[near] ** 2)) < 0.4
        assert 1e3 * np.sqrt(np.mean(error[true.stuck] ** 2)) < 0.02
        inside = np.abs(error) <= 2 * found.velocity_errors
        covered.append(inside.mean())
        covered_near.append(inside[near].mean())
        rough, sg = (methods.estimate(name, data, own) for name, own in (("fd", Setting()), ("sg", Setting(41, 4))))
        assert velocity_error(rough, true.v)[0] > 45 * velocity_error(found, true.v)[0]
        assert velocity_error(sg, true.v)[0] > 7 * velocity_error(found, true.v)[0]
    assert 0.93 <= np.mean(covered) <= 0.97
    assert np.mean(covered_near) >= 0.90


def test_corner_times_lie_within_their_uncertainties(motion, recorded):
    true = motion(5, 60.0)
    found = processing.smooth(recorded(true))
    starts = np.array([start for start, _ in true.sticks[1:]]) - true.time[0]
    ends = np.array([end for _, end in true.sticks[1:-1]]) - true.time[0]
    for at, fitted, sd in (
        (starts, [s.start for s in found.sticks[-starts.size :]], [s.start_sd for s in found.sticks[-starts.size :]]),
        (ends, [s.end for s in found.sticks[1 : ends.size + 1]], [s.end_sd for s in found.sticks[1 : ends.size + 1]]),
    ):
        off = (np.array(fitted) - at[: len(fitted)]) / np.array(sd)
        assert np.mean(np.abs(off) < 3) > 0.9
    assert np.median([s.start_sd for s in found.sticks[1:]]) < 3e-4


def test_landings_are_not_told_late(motion, recorded):
    """A snap of no mean before landings placed them 52 to 90 us late (74 on average), and v before them 0.22 mm/s low.

    Of eight records a mass ahead of the belt lands once each in the third, fourth and sixth.  It has reached the belt's
    speed 9 to 30 ms earlier, and which of the two the smoother calls the landing is not at stake here.
    """
    late, error = [], []
    for seed in (1, 2, 3):
        true = motion(5, 60.0, seed=seed)
        found = processing.smooth(recorded(true))
        time = true.time - true.time[0]
        begins = np.array([stick.start for stick in found.sticks])
        for landing in (start - true.time[0] for start, _ in true.sticks[1:]):
            if (true.v[(time > landing - 0.1) & (time < landing)] < BELT).all():
                late.append(begins[np.argmin(np.abs(begins - landing))] - landing)
                just_before = (time > landing - 2e-3) & (time < landing)
                error.append((found.velocity - true.v)[just_before].mean())
    assert len(late) == 33 + 33 + 32
    assert abs(np.mean(late)) < 2.5e-5
    assert abs(np.mean(error)) < 1e-4
    assert np.abs(late).max() < 2.5e-4


@pytest.mark.parametrize(
    "make",
    [
        *[pytest.param({"law": law}, id=f"law {law}") for law in (1, 3, 6)],
        pytest.param({"law": 5, "gap": 20}, id="gaps of 20 ms"),
        pytest.param({"law": 5, "gap": 50}, id="gaps of 50 ms"),
        pytest.param({"law": 5, "start": 0.5}, id="rest at first"),
        pytest.param({"law": 5, "belt": -0.22}, id="belt backwards"),
        pytest.param({"ripple": 2e-3}, id="ripple of 2 mm/s"),
        pytest.param({"swing": True}, id="pure sine"),
        pytest.param({"ride": True}, id="all stick"),
    ],
)
def test_the_default_is_never_worse_than_the_smoother_without_corners(motion, recorded, make):
    true = motion(make.get("law", 5), 20.0, seed=3, start=make.get("start", 0.0), belt=make.get("belt", 0.22))
    if "swing" in make:
        true = replace(true, x=0.1 * np.sin(6 * true.time), v=0.6 * np.cos(6 * true.time))
    if "ride" in make:
        true = replace(true, x=BELT * true.time, v=np.full(true.time.size, BELT))
    if "ripple" in make:
        own = np.where(true.stuck, make["ripple"] * np.sin(6 * np.pi * true.time), 0.0)
        true = replace(true, x=true.x + np.cumsum(own) * 1e-3, v=true.v + own)
    true = true.without((np.arange(true.time.size) - 700) % 2903 < make.get("gap", 0))
    data = series.from_recording(recorded(true))
    plain, default = (methods.estimate(name, data, Setting()) for name in ("rts", "auto"))
    assert velocity_error(default, true.v)[0] <= 1.03 * velocity_error(plain, true.v)[0]


def test_the_mean_snaps_kernel_runs_as_written_as_it_runs_compiled(motion, recorded):
    data = series.from_recording(recorded(motion(5, 2.0)))
    landing = next(start for start, _ in motion(5, 2.0).sticks[1:]) - motion(5, 2.0).time[0]
    i, j = np.searchsorted(data.time, (landing - 0.2, landing + 0.05))
    edges, parts = np.array([-0.02, -0.005, 0.0]), np.array([stick_slip.SLIP, 2, 1, stick_slip.STICK], np.uint8)
    levels = stick_slip.NoiseLevels(*(np.full(18, value) for value in (1e5, 0.0, 5e-12)), np.zeros(9), 9.5)
    outcomes = []
    state = first_state(data.time[i:j], data.position[i:j], 5e-12, 3)
    kernel = corner_kernel.accumulate_normal_equations
    noise, loose = levels.process, np.array([0.0, 1e-6, 0.0, 0.0])
    for run in (kernel, compiled(kernel, KERNELS)):
        gram, rhs = np.zeros((2, 2)), np.zeros(2)
        run(stick_slip.SNAP, data.time[i:j], data.position[i:j], state, landing, edges, parts, noise, loose, gram, rhs)
        outcomes.append(np.concatenate((gram.ravel(), rhs)))
    assert np.abs(outcomes[0]).min(initial=np.inf, where=outcomes[0] != 0) > 0
    assert outcomes[1] == pytest.approx(outcomes[0], rel=1e-9)


def test_noise_levels_are_those_that_were_put_in(imported):
    rng = np.random.default_rng(6)
    h, q, r = 1e-3, 50.0, (3e-5) ** 2
    n = 30_000
    a = np.cumsum(np.sqrt(q * h) * rng.standard_normal(n))
    a -= np.linspace(0, a[-1], n)
    v = np.cumsum(a) * h
    x = np.cumsum(v) * h
    noise = white_jerk.fit(series.from_recording(imported(np.arange(n) * h, x + np.sqrt(r) * rng.standard_normal(n))))
    assert noise.reading == pytest.approx(r, rel=0.05)
    assert noise.jerk == pytest.approx(q, rel=0.5)


def test_counts_put_back_give_the_velocity_of_the_clean_record(motion, recorded):
    true = motion(5, 20.0)
    run = recorded(true)
    count = run.count.copy()
    for at, size in ((4000, 40), (9500, -15), (14_600, 200)):
        count[at:] += size
    lossy = replace(run, count=count, position=count * 7.67e-6 + 7.67e-6 / 2)
    clean = velocity_error(processing.smooth(run), true.v)
    for repair in ("flag", "fix"):
        found = processing.smooth(lossy, repair_counts=repair)
        assert found.lost_counts == 3
        assert found.repaired == (repair == "fix")
        assert velocity_error(found, true.v)[0] < 1.15 * clean[0]
        right = run.position if repair == "fix" else lossy.position
        assert np.abs(found.position - right).max() < 3e-5
    off = processing.smooth(lossy, "rts", repair_counts="off")
    assert off.losses == ()
    assert velocity_error(off, true.v)[1] > 10


@pytest.mark.parametrize("pitch", [1e-3, 0.3])
def test_the_least_noise_of_a_reading_does_not_make_the_jerk_larger(pitch):
    # Where a record of ten samples a slip shows no noise, the least one, of the pitch, multiplied the jerk by 1e10 too:
    # velocities of 0.4 m/s came out as 200 m/s.
    density, interval, n = 3.0, 1.0, 4000
    step = np.array([[1.0, interval, interval**2 / 2], [0.0, 1.0, interval], [0.0, 0.0, 1.0]])
    spread = density * np.array([[1 / 20, 1 / 8, 1 / 6], [1 / 8, 1 / 3, 1 / 2], [1 / 6, 1 / 2, 1.0]])
    kicks = np.random.default_rng(4).normal(size=(n, 3)) @ np.linalg.cholesky(spread).T
    state, position = np.zeros(3), np.zeros(n)
    for i in range(1, n):
        state = step @ state + kicks[i]
        position[i] = state[0]
    found = white_jerk.fit(series.Series(interval * np.arange(n), position, 0.0, pitch, interval, (slice(0, n),)))
    assert found.jerk == pytest.approx(density, rel=0.1)
