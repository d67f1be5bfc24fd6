"""Contacts with memory by scipy: a peer for tests and benchmarks that shares nothing with `rig_sim`, and its settings.

Bristles are solved in (x, v, z); rate and state in (x, ln e, z), where slip does not reverse.  As slip vanishes, ln e
falls within less time than the spacing of numbers at the time of the motion: time starts again every eight e-folds.
"""

import math
import time
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from rig_sim.scenes.model import Scene
from rig_sim.scenes.scene import validate_content

FOLDS = 8.0
RIPPLE_HZ = 1.5


@dataclass(frozen=True)
class Setting:
    """A contact at rest over ground on a belt that runs from t = 0."""

    law: str
    m: float
    k: float
    c: float
    speed: float
    until: float
    parameters: dict[str, float]
    x: float = 0.0
    ripple: float = 0.0  # m/s, at `RIPPLE_HZ`
    drive: dict[str, float] = field(default_factory=dict)

    def scene(self, **friction: float) -> Scene:
        sections: dict[str, Any] = {
            "mass": {"m": self.m},
            "spring": {"k": self.k},
            "damper": {"c": self.c},
            "belt": {"speed": self.speed, "ripple": self.ripple, "ripple_hz": RIPPLE_HZ},
            "friction": {"law": self.law, **self.parameters, **friction},
            "start": {"x": self.x, "v": 0.0},
        }
        return validate_content({"name": "case", **sections} | ({"drive": self.drive} if self.drive else {}), "case")

    def belt_speed(self, t: float) -> float:
        return self.speed + self.ripple * math.sin(2.0 * math.pi * RIPPLE_HZ * t)

    def force(self, t: float) -> float:
        return self.drive["u0"] * math.cos(self.drive["omega"] * t) if self.drive else 0.0


def bristle_rates(case: Setting, t: float, state: Any) -> list[float]:
    p = {"s1": 0.0, "s2": 0.0, **case.parameters}
    x, v, z = state
    e = case.belt_speed(t) - v
    g = p["Fc"] + (p["Fs"] - p["Fc"]) * math.exp(-((e / p["v_s"]) ** 2))
    dz = e - p["s0"] * abs(e) * z / g
    friction = p["s0"] * z + p["s1"] * dz + p["s2"] * e
    return [v, (friction + case.force(t) - case.k * x - case.c * v) / case.m, dz]


def rate_and_state_rates(case: Setting, t: float, state: Any) -> list[float]:
    p = case.parameters
    x, log_e, psi = state
    e = float(np.exp(log_e))
    theta = p["D"] / p["v0"] * math.exp(psi)
    if case.law == "ageing":
        dtheta = 1.0 - e * theta / p["D"]
    else:
        dtheta = -e * theta / p["D"] * math.log(e * theta / p["D"])
    exponent = (p["F0"] + p["b"] * psi) / p["a"] + log_e - math.log(2.0 * p["v0"])
    friction = p["a"] * (exponent + math.log(2.0) if exponent > 40.0 else math.asinh(math.exp(exponent)))
    v = case.speed - e
    return [v, -(friction + case.force(t) - case.k * x - case.c * v) / case.m / e, dtheta / theta]


def solve(case: Setting, times: Any, rtol: float = 1e-9, method: str = "Radau") -> tuple[Any, float]:
    """Return the positions (n,) at times from 0 on, and the CPU seconds; bristles are solved by LSODA at 0.01 rtol.

    LSODA takes a tenth of Radau's time for rate and state, but does not reach the end of every setting.
    """
    begun = time.process_time()
    if case.law in ("lugre", "dahl"):
        deflection = case.parameters["Fc"] / case.parameters["s0"]
        scales = np.array([case.parameters["Fc"] / case.k, case.speed, deflection])
        found = solve_ivp(
            lambda t, y: bristle_rates(case, t, y),
            (0.0, times[-1]),
            (case.x, 0.0, 0.0),
            method="LSODA",
            rtol=0.01 * rtol,
            atol=1e-3 * rtol * scales,
            t_eval=times,
        )
        if not found.success:
            raise RuntimeError(found.message)
        return found.y[0], time.process_time() - begun
    scales = np.array([0.1 * case.parameters["F0"] / case.k, 1.0, 1.0])
    top = math.log(case.speed)
    t, level, state, x = 0.0, 1, np.array([case.x, top, 0.0]), np.empty(len(times))
    while t < times[-1]:
        low, high = top - FOLDS * level, top - 3.0

        def falls(_: float, y: Any, low: float = low) -> float:
            return y[1] - low

        def rises(_: float, y: Any, high: float = high) -> float:
            return y[1] - high

        falls.terminal, falls.direction = True, -1.0
        rises.terminal, rises.direction = True, 1.0
        with np.errstate(all="ignore"):  # trial steps that are rejected
            found = solve_ivp(
                lambda tau, y, start=t: rate_and_state_rates(case, start + tau, y),
                (0.0, times[-1] - t),
                state,
                method=method,
                rtol=rtol,
                atol=0.1 * rtol * scales,
                events=[falls] if level == 1 else [falls, rises],
                dense_output=True,
            )
        if found.status < 0:
            raise RuntimeError(found.message)
        here = (times >= t) & (times <= t + found.t[-1])
        if here.any():
            x[here] = found.sol(times[here] - t)[0]
        t, state = t + found.t[-1], found.y[:, -1]
        level = level + 1 if len(found.t_events[0]) else 1
        if found.status == 0:
            break
    return x, time.process_time() - begun


def relate(first: dict[str, float], **others: float) -> dict[str, float]:
    return {**first, **others}


RIG = {"m": 0.3, "k": 10.5, "c": 0.015}
LUGRE = {"s0": 1.5e4, "s1": 60.0, "Fc": 0.6, "Fs": 1.38, "v_s": 0.1}
AGEING = {"F0": 1.2, "a": 0.03, "b": 0.105, "D": 2e-3, "v0": 0.1}
SERVO = {"m": 5.0, "k": 2e4, "c": 10.0, "speed": 2e-3, "until": 4.0}
RUBBER = {"m": 2.0, "k": 2e3, "c": 1.0, "speed": 0.01, "until": 10.0}
ROCK = {"m": 1e3, "k": 1e7, "c": 0.0}
BRISTLES = (
    LUGRE,
    {"s0": 3e6, "s1": 2e3, "s2": 50.0, "Fc": 20.0, "Fs": 30.0, "v_s": 1e-3},
    {"s0": 1e4, "s1": 5.0, "s2": 0.0, "Fc": 8.0, "Fs": 14.0, "v_s": 0.05},
    {"s0": 1e9, "s1": 1e6, "s2": 0.0, "Fc": 4e4, "Fs": 5e4, "v_s": 1e-3},
)
STATE_SERVO = {"F0": 20.0, "a": 0.3, "b": 1.2, "D": 2e-5, "v0": 1e-3}
STATE_RUBBER = {"F0": 15.0, "a": 0.5, "b": 1.0, "D": 2e-4, "v0": 1e-3}
STATE_ROCK = {"F0": 6e4, "a": 800.0, "b": 1200.0, "D": 1e-5, "v0": 1e-6}


def bristle_settings(law: str) -> list[Setting]:
    """Ten settings: presliding (Fc/s0) from 1 um to 2 mm, with and without damping of the bristles."""
    rig, servo, rubber, rock = BRISTLES if law == "lugre" else [relate(each, Fs=each["Fc"]) for each in BRISTLES]
    return [
        Setting(law, **RIG, speed=0.22, until=8.0, parameters=rig),
        Setting(law, **RIG, speed=0.22, until=8.0, parameters=relate(rig, s0=6e5, s1=400.0)),
        Setting(law, **RIG, speed=0.22, until=4.0, parameters=relate(rig, s0=6e5, s1=0.0)),
        Setting(law, **RIG, speed=0.22, until=8.0, parameters=relate(rig, s0=300.0, s1=3.0)),
        Setting(law, **RIG, speed=0.22, until=8.0, parameters=relate(rig, s0=300.0, s1=0.0)),
        Setting(law, **RIG, speed=0.05, until=8.0, parameters=relate(rig, s0=6e4, s1=200.0), ripple=0.07),
        Setting(law, **RIG, speed=0.05, until=8.0, parameters=rig, drive={"u0": 0.3, "omega": 4.0}),
        Setting(law, **SERVO, parameters=servo),
        Setting(law, **RUBBER, parameters=rubber),
        Setting(law, **ROCK, speed=1e-5, until=800.0, parameters=rock),
    ]


def state_settings(law: str) -> list[Setting]:
    """Ten settings: D from 2 um to 5 mm."""
    return [
        Setting(law, **RIG, speed=0.22, until=8.0, parameters=AGEING, x=0.1),
        Setting(law, **RIG, speed=0.22, until=8.0, parameters=relate(AGEING, D=2e-6, b=0.09), x=0.1),
        Setting(law, **RIG, speed=0.22, until=8.0, parameters=relate(AGEING, D=2e-5), x=0.1),
        Setting(law, **RIG, speed=0.22, until=8.0, parameters=relate(AGEING, D=5e-3), x=0.1),
        Setting(law, **RIG, speed=0.05, until=12.0, parameters=relate(AGEING, D=1e-3, a=0.06, b=0.135), x=0.1),
        Setting(law, **RIG, speed=0.02, until=30.0, parameters=relate(AGEING, D=1e-3, b=0.08), x=0.1),
        Setting(law, **SERVO, parameters=STATE_SERVO, x=9e-4),
        Setting(law, **RUBBER, parameters=STATE_RUBBER, x=6e-3),
        Setting(law, **ROCK, speed=1e-6, until=2000.0, parameters=STATE_ROCK, x=5.5e-3),
        Setting(law, **ROCK, speed=1e-9, until=1e6, parameters=relate(STATE_ROCK, D=2e-6), x=5.5e-3),
    ]


SETTINGS = {
    "lugre": bristle_settings("lugre"),
    "dahl": bristle_settings("dahl"),
    "ageing": state_settings("ageing"),
    "slip": state_settings("slip"),
}
