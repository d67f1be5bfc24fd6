"""Findings on the faults of a sensor and on steps of the datum: one sentence each, with its numbers."""

import math

import numpy as np

from processing.defects.frames import FrameCount
from processing.record.finding import Finding
from processing.record.motion import Fault
from processing.record.position_steps import PositionStep
from processing.record.setting import is_possible_speed
from stickslip.compute.arrays import Array
from stickslip.units import Measured, with_error


def sensor_findings(faults: tuple[Fault, ...], frames: FrameCount, samples: int) -> list[Finding]:
    """Return the findings of a record: spikes, frozen stretches, frames lost or doubled.

    A frame that is lost or doubled makes a spike of a neighbour, so that many spikes are not reported.
    """
    findings = []
    spikes = sum(fault.samples for fault in faults if fault.kind == "spike")
    if spikes > frames.lost + frames.doubled:
        text = f"{_count(spikes, 'sample')} out of line with the neighbours (spikes, drop-outs): left out"
        findings.append(Finding("spikes", text, float(spikes), 0.0))
    frozen = [fault.samples for fault in faults if fault.kind == "frozen"]
    if frozen:
        text = f"the sensor held its value {_count(len(frozen), 'time')} while the mass moved"
        findings.append(Finding("frozen", f"{text}: {_count(sum(frozen), 'sample')} left out", float(sum(frozen)), 0.0))
    for name, number in (("dropped", frames.lost), ("doubled", frames.doubled)):
        if number:
            share = number / (frames.compared + number)
            findings.append(
                Finding(
                    f"{name}-frames",
                    f"about {100 * share:.1f} % of the frames are {name} although the times are even "
                    f"({number} of {frames.compared} steps): times and speeds are wrong by as much; "
                    "record the time of every frame",
                    share,
                    0.0,
                )
            )
    share = sum(fault.samples for fault in faults) / samples
    if share > MUCH:
        findings.append(
            Finding("faulty-sensor", f"{100 * share:.0f} % of the samples are faults: mend the sensor", share, MUCH)
        )
    return findings


def step_findings(steps: list[PositionStep], frames: FrameCount, unit: str, *, repaired: bool) -> list[Finding]:
    """Return the finding of steps of the datum; steps of counts are lost counts instead.

    Frames lost or doubled among even times are steps of the position too: then none is reported.
    """
    shifts = [step for step in steps if not step.counts]
    if not shifts or frames.lost or frames.doubled:
        return []
    largest = max(shifts, key=lambda step: abs(step.size)).size
    text = (
        f"the position steps by a constant {_count(len(shifts), 'time')} (largest {largest:.3g} {unit}), as when a "
        f"camera is moved or a wheel slips: "
        + ("taken out" if repaired else "marked; velocity and fit are without them")
    )
    return [Finding("position-steps", text, largest, 0.0)]


def drift_finding(time: Array, position: Array, unit: str) -> Finding | None:
    """Return the drift of a record that is one straight line, from means over parts of it; None if not significant."""
    t = time - time.mean()
    slope = float(t @ position / (t @ t))
    residual = position - position.mean() - slope * t
    error = float(np.sqrt(residual @ residual / (t.size - 2) / (t @ t)))
    travel = slope * float(np.ptp(time))
    if abs(slope) <= SIGNIFICANT * error or np.abs(residual).max() > STRAIGHT * abs(travel):
        return None
    text = (
        f"the position drifts by {slope:.3g} {unit}/s throughout and the mass never slips: a counter that is parked "
        "and dithers, or a belt that drags the mass all the time"
    )
    return Finding("drift", text, slope, 0.0, abs(slope) / error if error > 0 else math.inf)


def belt_findings(stated: Measured | None, speed: float, unit: str) -> list[Finding]:
    """Return the finding of a stated belt speed that differs from the speed of the sticks (NaN without one)."""
    if stated is None:
        return []
    text = f"belt speed: {stated.value:.4g} m/s was stated, "
    if unit != "m":
        text += "but the positions are in counts: this rig has no metres_per_count"
        if math.isfinite(speed) and stated.value:
            text += f"; the sticks' {speed:.5g} count/s would be that speed at {stated.value / speed:.4g} m per count"
        return [Finding("belt-speed-unit", text)]
    if is_possible_speed(stated, speed) or not math.isfinite(speed):
        return []
    text += f"but the mass sticks at {speed:.4g} m/s: the record's is used"
    sd = with_error(stated).sd
    return [Finding("belt-speed", text, speed, stated.value, abs(speed - stated.value) / sd if sd else math.nan)]


STRAIGHT = 0.05  # of the travel: largest distance of a part from the line; one slip in eight sticks moves it farther
SIGNIFICANT = 5.0  # standard deviations of the rate
MUCH = 0.2  # share of faulty samples: with more, the rest no longer records the motion between them


def _count(number: int, word: str) -> str:
    return f"{number} {word}{'s' if number != 1 else ''}"
