"""Predicted positions: exact in closed form, and continuous where a window's start touches the belt."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from fitting.model.path import Curve, positions
from fitting.model.unknowns import PER_CYCLE
from fitting.model.windows import ShootingWindows

K, F, V = 35.184, 4.598, 0.22
OMEGA = K**0.5


def one_window(time, stick=0, overtakes=0, earliest_landing=0.0):
    return ShootingWindows(
        table=np.array([[0, stick, 0, time.size, overtakes, 0]], np.int64),
        level_epoch=np.array([time[0]]),
        earliest_landing=np.array([earliest_landing]),
        time=time,
        position=np.zeros(time.size),
        source=np.zeros(time.size, np.int64),
        rows=(slice(0, time.size),),
    )


STEADY = (0.0, 0.0, 0.0)


def predicted(
    windows,
    local,
    *,
    curve=0,
    ramp=False,
    shape=0.0,
    d=0.0,
    datum=0.0,
    c=0.0,
    fade=0.0,
    compliance=0.0,
    ripple=STEADY,
    static=1.0,
):
    u = np.array([K, np.log(F), V, shape, d, datum, c, fade, compliance, *ripple, static])
    return positions(windows, Curve(curve, ramp), u, local[None])


def start(x, v, stick=False, level=1.0, following=1.0):
    local = np.zeros(PER_CYCLE)
    local[2:4] = np.log(level), np.log(following)
    local[4 if stick else 0], local[5 if stick else 1] = x, v
    return local


def test_constant_slip_is_a_sine_about_its_level():
    time = 3.0 + np.linspace(0, 0.6, 101)
    x = predicted(one_window(time, earliest_landing=9.0), start(0.1, 0.1, level=1.1), datum=0.002)
    centre = 0.002 + 1.1 * F / K
    t = time - 3.0
    exact = centre + (0.1 - centre) * np.cos(OMEGA * t) + 0.1 / OMEGA * np.sin(OMEGA * t)
    velocity = -OMEGA * (0.1 - centre) * np.sin(OMEGA * t) + 0.1 * np.cos(OMEGA * t)
    before_landing = np.maximum.accumulate(velocity) < V
    assert before_landing.sum() > 10
    assert x[before_landing] == pytest.approx(exact[before_landing], abs=2e-8)


def test_a_jumps_stick_is_a_straight_line_whatever_the_load():
    time = np.linspace(1.0, 2.5, 37)
    x = predicted(one_window(time, stick=1), start(-0.1, 0.3, stick=True))
    assert x == pytest.approx(-0.1 + V * (time - 1.0), abs=1e-12)


def test_a_ramps_stick_creeps_as_far_as_the_load_goes():
    """Beyond the level of slip a window of stick used to slip away, and the law fitted worse than its jump law."""
    d, time = 0.02, np.linspace(1.0, 2.2, 37)
    rate = -K * d / F  # v - V = -d K x/F, once the start has died away
    x = predicted(one_window(time, stick=1), start(0.0, V, stick=True), ramp=True, d=d)
    assert K * x[-1] > 1.5 * F
    assert np.diff(x)[20:] / (time[1] - time[0]) == pytest.approx(V + rate * (x[21:] + x[20:-1]) / 2, rel=1e-3)


@pytest.mark.parametrize(
    ("stick", "overtakes", "static"), [(0, 0, 1.0), (0, 1, 1.0), (1, 0, 1.0), (0, 0, 1.4), (1, 0, 1.4)]
)
def test_a_ramp_law_contains_its_jump_law(stick, overtakes, static):
    time = np.linspace(0.0, 1.2, 121)
    first = start(-0.02, 0.2, stick=True) if stick else start(0.128, 0.1, level=1.05, following=0.6)
    windows, shape = (
        one_window(time, stick=stick, overtakes=overtakes, earliest_landing=0.2),
        {"curve": 2, "shape": 12.0},
    )
    jump = predicted(windows, first, **shape)
    assert predicted(windows, first, ramp=True, d=1e-6 * V, static=static, **shape) == pytest.approx(jump, abs=5e-7)


def test_touching_the_belt_at_the_start_changes_the_motion_continuously():
    time = np.linspace(0.0, 0.5, 51)
    place = F / K - 1e-4  # just short of the slip point: friction still wins, the belt is touched first
    ends = [predicted(one_window(time, earliest_landing=0.4), start(place, V - gap))[-1] for gap in (1e-9, 1e-6, 1e-5)]
    assert ends == pytest.approx([ends[0]] * 3, abs=1e-5)


def test_fading_lowers_the_level_as_a_smaller_level_would():
    """The level is a line that begins with the record: late cycles lose a larger fraction of theirs."""
    time = np.linspace(6.0, 6.4, 41)
    worn = predicted(one_window(time, earliest_landing=9.0), start(0.12, 0.1), fade=0.02)
    fine = np.linspace(0.0, 0.4, 40_001)
    h, fade = fine[1], 0.02 / (1 - 0.02 * 6.0)
    x, v, path = 0.12, 0.1, [0.12]
    for t in fine[:-1]:  # leap-frog with a level that falls at every step
        v += 0.5 * h * (F * (1 - fade * t) - K * x)
        x += h * v
        v += 0.5 * h * (F * (1 - fade * (t + h)) - K * x)
        path.append(x)
    assert worn == pytest.approx(np.array(path)[::1000], abs=6e-6)  # at four times the nominal wear


def test_stick_a_belt_that_ripples_is_its_own_motion():
    time = np.linspace(1.0, 1.7, 29)
    cosine, sine, omega = 3e-3, -2e-3, 17.0
    x = predicted(
        one_window(time, stick=1),
        start(-0.1, 0.3, stick=True),
        ripple=(cosine, sine, omega),
        c=0.1,
        shape=9.6,
        curve=2,
    )
    ripple_path = (cosine * np.sin(omega * time) - sine * np.cos(omega * time)) / omega
    assert x == pytest.approx(-0.1 + V * (time - 1.0) + ripple_path - ripple_path[0], abs=1e-9)


def test_a_slip_on_a_belt_that_ripples_is_the_brute_force_motion():
    gamma, c, ripple = 9.6, 0.05, (2e-3, 4e-3, 14.0)
    time = 2.0 + np.linspace(0.0, 0.4, 41)
    x = predicted(one_window(time, earliest_landing=9.0), start(0.12, 0.1), curve=2, shape=gamma, c=c, ripple=ripple)

    def rates(t, state):
        belt = V + ripple[0] * np.cos(ripple[2] * t) + ripple[1] * np.sin(ripple[2] * t)
        return state[1], F / (1 + gamma * (belt - state[1])) - c * state[1] - K * state[0]

    exact = solve_ivp(rates, (2.0, 2.4), (0.12, 0.1), t_eval=time, rtol=1e-12, atol=1e-14).y[0]
    assert x == pytest.approx(exact, abs=2e-8)


@pytest.mark.parametrize("stick", [0, 1])
def test_a_linear_jump_on_a_compliant_belt_is_the_ramp_law_of_the_flows_table(stick):
    time = np.linspace(0.0, 1.0 if stick == 0 else 0.6, 161)
    first = start(0.128, 0.1, level=1.05, following=0.97) if stick == 0 else start(-0.05, 0.219, stick=True)
    windows = one_window(time, stick=stick, earliest_landing=0.3)
    slope, droop = 0.435, 0.004  # G_slip/Fs (s/m), m/s
    compliant = predicted(windows, first, curve=1, shape=slope, compliance=droop * K / F)
    steeper = slope / (1 - droop * slope)
    assert compliant == pytest.approx(predicted(windows, first, curve=1, ramp=True, shape=steeper, d=droop), abs=2e-8)
    assert np.abs(compliant - predicted(windows, first, curve=1, shape=slope)).max() > 1e-4


def test_some_cycles_are_predicted_as_among_all():
    time = np.linspace(0.0, 1.2, 121)
    windows = ShootingWindows.join([one_window(time[:50]), one_window(time[50:90], stick=1), one_window(time[90:])])
    windows = replace(windows, table=windows.table * [1, 1, 1, 1, 1, 0], parts=())  # three cycles of one run
    u = np.array([K, np.log(F), V, 9.6, 0.03, 0.0, 0.02, 0.001, 0.02, *STEADY, 1.0])
    local = np.array([start(0.12, 0.15), start(-0.1, 0.2, stick=True), start(0.1, 0.05, level=1.1)])
    cycles = np.array([0, 2])

    position = positions(windows, Curve(2, True), u, local)
    own = positions(windows.some(cycles), Curve(2, True), u, local[cycles])
    assert np.array_equal(own, position[np.r_[0:50, 90:121]])
    assert windows.some(cycles).rows == (slice(0, 50), slice(50, 81))
