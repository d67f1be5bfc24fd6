"""A stick-slip motion in closed form, and records of it fed to what the live view is made of."""

import math
from dataclasses import dataclass

import numpy as np

from daq.live.analysis import LiveAnalysis
from daq.live.tail import NewSamples
from daq.runfile.rig import Rig

K_OVER_M, BELT, LEVER, KINETIC = 35.0, 0.22, 0.12, 0.6  # s^-2, m/s, m, of LEVER


@dataclass(frozen=True)
class StickSlipMotion:
    time: np.ndarray
    x: np.ndarray
    break_aways: np.ndarray
    landings: np.ndarray


def stick_slip(cycles: int, rate_hz: float, noise: float = 0.0) -> StickSlipMotion:
    """Return ``cycles`` cycles under constant friction in the slip, beginning in the middle of a stick.

    The mass breaks away at the stretch LEVER; friction of the slip holds KINETIC * LEVER, about which the mass swings
    from the belt's speed to the belt's speed: x = c + A cos(omega t - phi), for (pi + 2 phi)/omega, to 2 c - LEVER.
    """
    omega, c = math.sqrt(K_OVER_M), KINETIC * LEVER
    A, phi = math.hypot(LEVER - c, BELT / omega), math.atan2(BELT / omega, LEVER - c)
    slip, stick = (math.pi + 2 * phi) / omega, 2 * (LEVER - c) / BELT
    time = np.arange(0, stick / 2 + cycles * (slip + stick), 1 / rate_hz)
    since = np.mod(time - stick / 2, slip + stick)
    x = np.where(since < slip, c + A * np.cos(omega * since - phi), 2 * c - LEVER + BELT * (since - slip))
    breaks = stick / 2 + np.arange(cycles) * (slip + stick)
    return StickSlipMotion(time, x + np.random.default_rng(2).normal(0, noise, time.size), breaks, breaks + slip)


def samples(time: np.ndarray, x: np.ndarray, fresh_at: tuple[int, ...] = (0,)) -> NewSamples:
    return NewSamples(time, x, np.isin(np.arange(time.size), fresh_at))


def pieces(whole: NewSamples, size: int) -> list[NewSamples]:
    own = [slice(k, k + size) for k in range(0, whole.time.size, size)]
    return [
        NewSamples(whole.time[k], whole.position[k], whole.fresh[k], None if whole.belt is None else whole.belt[k])
        for k in own
    ]


def analysed(time: np.ndarray, x: np.ndarray, rate_hz: float, rig: Rig | None = None, unit: str = "m") -> LiveAnalysis:
    """Return the analysis of a record that came in tenths of a second."""
    made = LiveAnalysis(rate_hz)
    made.rig, made.unit = rig or Rig(), unit
    for piece in pieces(samples(time, x), round(rate_hz / 10)):
        made.feed(piece)
    return made
