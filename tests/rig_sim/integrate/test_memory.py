"""Friction with memory: against scipy in other coordinates, closed forms, and results that the laws are known for."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from rig_sim.flow import modes
from rig_sim.flow.flow import Flow
from rig_sim.flow.memory import MemoryFlow, make_memory_flow
from rig_sim.friction.memory import AGEING, BRISTLE, SLIP
from rig_sim.integrate.memory import initial_mode, new_memory_work, sample_memory_phase
from rig_sim.integrate.phases import Samples, State
from rig_sim.motion.play import ScenePlayer
from rig_sim.scenes.scene import validate_content

from ..shared import BENCHMARKS

LUGRE = {"s0": 1.5e4, "s1": 60.0, "s2": 0.3, "Fc": 0.6, "Fs": 1.35, "v_s": 0.1}
STATE = {"F0": 1.2, "a": 0.03, "b": 0.105, "D": 2e-3, "v0": 0.1}
LAWS = {"lugre": (BRISTLE, LUGRE), "ageing": (AGEING, STATE), "slip": (SLIP, STATE)}
FAST = [("lugre", 0), ("lugre", 5), ("dahl", 6), ("ageing", 3), ("slip", 4)]  # the scenes of which are solved soon
BY_LSODA = (0, 3, 4, 5, 6, 7)  # the settings whose end it reaches
ALL = [(law, number) for law in ("lugre", "dahl", "ageing", "slip") for number in range(10)]


def rig(law: str, *, m: float = 0.3, k: float = 10.5, c: float = 0.1, v: float = 0.22, **changes: float) -> MemoryFlow:
    code, parameters = LAWS[law]
    drive = {name: changes.pop(name) for name in ("u0", "omega", "phase") if name in changes}
    return make_memory_flow(Flow(m=m, k=k, c=c, v_belt=v, **drive), code, v, parameters | changes)


def follow(flow: MemoryFlow, x: float, v: float, times: Sequence[float], work: Any = None) -> tuple[Any, Any, Any, Any]:
    """Return x (m), v (m/s) and friction (N), (n,) each, at times from the start of a motion on, and its work."""
    n = len(times)
    samples = Samples(list(times), [0.0] * n, [0.0] * n, [0.0] * n, n)
    work = work or new_memory_work(1e6)
    state, i = State(initial_mode(flow, v), x, v - flow.v_belt, float(times[0])), 0
    while i < n:
        kind, state, i = sample_memory_phase(flow, state, float(times[-1]), samples, i, work)
        assert kind < modes.FORCE_REVERSAL, modes.OUTCOMES[kind]
    return np.array(samples.x), np.array(samples.v), np.array(samples.mode), work


@pytest.mark.parametrize(
    ("law", "number"),
    [pytest.param(*case, marks=() if case in FAST else pytest.mark.slow) for case in ALL],
)
def test_the_motion_is_that_of_scipy(monkeypatch, law, number):
    """Within 0.5 um rms and 1e-5 of the travel; scipy at rtol 1e-9, bristles at 1e-11."""
    monkeypatch.syspath_prepend(BENCHMARKS)
    from oracles import memory  # type: ignore[import-not-found]

    case = memory.SETTINGS[law][number]
    player = ScenePlayer(case.scene())
    t, x, _, _ = player.columns(np.linspace(0.0, case.until, 2001))
    expected, _ = memory.solve(case, t, method="LSODA" if number in BY_LSODA else "Radau")
    assert player.outcome.name == "completed"
    assert np.sqrt(np.mean((x - expected) ** 2)) < min(0.5e-6, 1e-5 * np.ptp(expected))


@pytest.mark.parametrize("law", ["ageing", "slip"])
def test_slip_that_reverses_is_that_of_scipy(law):
    """In (x, v, z), which a contact with a gentle direct effect allows; the drive turns the slip round and round."""
    flow = rig(law, a=0.2, b=0.3, F0=0.8, v=0.05, u0=2.5, omega=3.0)

    def slopes(t: float, y: Any) -> list[float]:
        x, v, z = y
        e = flow.v_belt - v
        F = flow.a * math.asinh(e / (2.0 * flow.v0) * math.exp((flow.F0 + flow.b * z) / flow.a))
        s = abs(e)
        growth = flow.v0 * math.exp(-z) - s if law == "ageing" else -s * (math.log(s / flow.v0) + z) if s else 0.0
        return [v, (F + 2.5 * math.cos(3.0 * t) - flow.k * x - flow.c * v) / flow.m, growth / flow.D]

    times = np.linspace(0.0, 6.0, 1501)
    expected = solve_ivp(slopes, (0.0, 6.0), [0.0, 0.0, 0.0], "LSODA", times, rtol=1e-11, atol=1e-13)
    x, v, F, _ = follow(flow, 0.0, 0.0, times)
    assert np.ptp(x) > 0.1
    assert (np.diff(np.sign(v - flow.v_belt)) != 0).sum() >= 5
    assert np.abs(x - expected.y[0]).max() < 1e-7
    assert np.abs(v - expected.y[1]).max() < 1e-6
    accelerations = [slopes(t, y)[1] for t, y in zip(times, expected.y.T, strict=True)]
    balance = flow.m * np.array(accelerations) + flow.k * expected.y[0] + flow.c * expected.y[1]
    assert np.abs(F - balance + 2.5 * np.cos(3.0 * times)).max() < 1e-4


@pytest.mark.parametrize(
    ("law", "changes", "x", "v"),
    [
        ("lugre", {"s0": 1e12}, 0.0, 0.0),
        ("lugre", {"s0": 1e9, "s1": 0.0}, 0.0, 0.22),  # bristles that ring at 6e4/s
        ("lugre", {"Fc": 1e-6, "Fs": 1e-6}, 0.1, -3.0),
        ("lugre", {"v": 1e-9}, 0.0, 0.0),
        ("lugre", {"c": 1e4}, 0.1, 2.0),
        ("ageing", {"D": 1e-10}, 0.1, 0.0),
        ("slip", {"D": 1e3}, 0.1, 0.0),
        ("ageing", {"a": 2e-4}, 0.1, 0.0),  # exp((F0 + b z)/a) is 10^2600
        ("ageing", {"v": 1e-12}, 0.0, 0.0),
        ("ageing", {}, 0.0, 0.22),  # on the belt, without slip
        ("slip", {}, -5.0, 40.0),
        ("ageing", {"b": 0.0}, 0.1, 0.0),
        ("ageing", {"k": 1e5}, 0.0, 0.0),
    ],
)
def test_extreme_contacts_are_followed(law, changes, x, v):
    """To their end, in a bounded number of steps, within what energy allows."""
    flow = rig(law, **changes)
    positions, _, forces, work = follow(flow, x, v, np.linspace(0.0, 4.0, 401))
    assert np.isfinite(positions).all()
    assert np.isfinite(forces).all()
    assert work.steps < 60_000
    level = max(flow.Fs, flow.F0) * 4.0
    assert np.abs(positions).max() < abs(x) + level / flow.k + (abs(v) + abs(flow.v_belt)) * math.sqrt(flow.m / flow.k)


@pytest.mark.parametrize(("s0", "s1"), [(1e8, 0.0), (1e9, 0.0), (1e10, 60.0), (1e12, 1e6)])
def test_stiff_bristles_are_a_stribeck_curve(s0, s1):
    """Steps over a break-away were kept, and a stick lasted until the spring held 1.05 to 1.2 Fs."""
    sections = {"mass": {"m": 0.3}, "spring": {"k": 10.5}, "damper": {"c": 0.1}, "belt": {"speed": 0.22}}
    friction = {name: LUGRE[name] for name in ("Fc", "Fs", "s2", "v_s")}
    formula = "Fc + (Fs - Fc)*exp(-(s/v_s)**2) + s2*s"
    content = {"name": "curve", **sections, "friction": {"formula": formula, **friction}}
    _, expected, _, _ = ScenePlayer(validate_content(content, "curve")).columns(np.linspace(0.0, 4.0, 401))
    x, _, _, _ = follow(rig("lugre", s0=s0, s1=s1), 0.0, 0.0, np.linspace(0.0, 4.0, 401))
    assert np.abs(x - expected).max() < 1e-4


@pytest.mark.parametrize("law", ["ageing", "slip"])
@pytest.mark.parametrize("faster", [10.0, 0.1])
def test_a_velocity_step_decays_as_published(law, faster):
    """Held stiffly, friction jumps by a ln(v2/v1), and then falls by b ln(v2/v1) over a slip of D.

    The slip law's decay is exponential in the slip; of the ageing law, theta's is (Marone, Annu. Rev. Earth Planet.
    Sci. 26 (1998) 643, eqs. 4 to 6).
    """
    slow = 1e-4
    flow = rig(law, m=1e-6, k=1e5, c=0.0, v=slow)._replace(tolerance=1e-16)
    x = (STATE["F0"] + (STATE["a"] - STATE["b"]) * math.log(slow / STATE["v0"])) / flow.k
    _, _, before, work = follow(flow, x, 0.0, np.linspace(0.0, 20.0 * STATE["D"] / slow, 10))
    times = np.linspace(0.0, 5.0 * STATE["D"] / (faster * slow), 201)
    settled = before[-1] / flow.k
    _, _, F, _ = follow(flow._replace(v_belt=faster * slow), settled, 0.0, times, work)
    share = np.exp(-times * faster * slow / STATE["D"])
    log_theta = share * math.log(faster) if law == "slip" else np.log(1.0 + (faster - 1.0) * share)
    expected = before[-1] + (STATE["a"] - STATE["b"]) * math.log(faster) + STATE["b"] * log_theta
    assert before[-1] == pytest.approx(x * flow.k, rel=1e-6)
    assert F[1:] == pytest.approx(expected[1:], abs=2e-3 * STATE["b"])  # the spring yields by 4e-4 D


def test_presliding_is_dahls_and_begins_with_the_stiffness_of_the_bristles():
    """At a slip much slower than v_s, F = Fs (1 - exp(-s0 d/Fs)) after a displacement d (Canudas de Wit et al.)."""
    slow = 1e-6
    flow = rig("lugre", m=1e-6, k=1e9, c=0.0, v=slow, s1=0.0, s2=0.0)._replace(tolerance=1e-15)
    times = np.linspace(0.0, 400.0, 401)
    _, _, F, _ = follow(flow, 0.0, 0.0, times)
    expected = LUGRE["Fs"] * (1.0 - np.exp(-LUGRE["s0"] * times * slow / LUGRE["Fs"]))
    assert F == pytest.approx(expected, abs=1e-3 * LUGRE["Fs"])
    assert F[1] / slow == pytest.approx(LUGRE["s0"], rel=0.01)


def test_the_break_away_force_falls_with_the_rate_of_the_force():
    """From near Fs to near Fc, with the parameters of Canudas de Wit et al. (1995), table I; against scipy."""
    parameters = {"s0": 1e5, "s1": math.sqrt(1e5), "s2": 0.4, "Fc": 1.0, "Fs": 1.5, "v_s": 1e-3}
    peaks = []
    for rate in (1.0, 2.0, 5.0, 10.0, 20.0, 50.0):
        k = 1e-3  # a soft spring whose end moves fast is a force that grows steadily
        flow = rig("lugre", m=1.0, k=k, c=0.0, v=rate / k, **parameters)._replace(tolerance=1e-10)
        times = np.linspace(0.0, 2.0 / rate, 2001)
        _, _, F, _ = follow(flow, 0.0, rate / k, times)

        def slopes(t: float, y: Any, rate: float = rate) -> list[float]:
            v, z = y
            g = 1.0 + 0.5 * math.exp(-((v / 1e-3) ** 2))
            dz = v - 1e5 * abs(v) * z / g
            return [rate * t - 1e5 * z - math.sqrt(1e5) * dz - 0.4 * v, dz]

        found = solve_ivp(slopes, (0.0, times[-1]), [0.0, 0.0], "Radau", times, rtol=1e-9, atol=1e-13)
        expected = [rate * t - slopes(t, y)[0] for t, y in zip(times, found.y.T, strict=True)]
        assert F.max() == pytest.approx(max(expected), rel=1e-4)
        peaks.append(F.max())
    assert (np.diff(peaks) < 0.0).all()
    assert 1.4 < peaks[0] < 1.5
    assert 1.0 < peaks[-1] < 1.05
