"""A contact at any scale is the same contact: records scaled by powers of two, mirrored and shifted.

The contacts are drawn at random by a simulator that shares no model with the smoother (`tests.fitting.scales`).
"""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from daq.runfile.recording import Recording
from daq.runfile.rig import Rig
from processing import statistics
from processing.smoothing import smooth
from stickslip.units import Measured

from ..fitting import scales
from ..rig import follow

MOST = 4_000  # samples of a record
DIMENSIONS = {"time": (0, 1), "position": (1, 0), "velocity": (1, -1), "acceleration": (1, -2)}
AT = "2026-01-01T00:00:00+00:00"


def numbers(first, wanted):
    """Return the numbers of so many contacts with few samples."""
    drawn = (scales.draw(number) for number in range(first, first + 400))
    return [own.number for own in drawn if 400 < own.contact.duration * own.rate_hz < MOST][:wanted]


@cache
def record(number, faulty=False):
    """Return the record of a contact, with spikes and steps of the position where it is ``faulty``."""
    drawn = scales.draw(number)
    times = np.arange(0, drawn.contact.duration, 1 / drawn.rate_hz)
    x = drawn.x0_m + (-1 if drawn.mirrored else 1) * follow(drawn.contact, times).position
    rng = np.random.default_rng(number)
    if faulty:
        span = np.ptp(x)
        spikes = rng.choice(times.size, times.size // 60, replace=False)
        x[spikes] += rng.choice([-1, 1], spikes.size) * rng.uniform(0.1, 0.5, spikes.size) * span
        for at in rng.integers(20, times.size - 20, 4).tolist():
            x[at:] += rng.choice([-1, 1]) * 60 * drawn.noise_m
    common = {"title": "contact", "started": AT, "ended": AT, "rate_hz": drawn.rate_hz, "time": drawn.begin_s + times}
    common["source"] = Path("contact.h5")
    if not drawn.counts:
        return Recording(rig=Rig(), position=x + rng.normal(0, drawn.noise_m, x.size), **common)
    count = np.floor(x / drawn.noise_m).astype(np.int64)
    rig = Rig(metres_per_count=Measured(drawn.noise_m), belt_speed=Measured(drawn.contact.belt * 1.01))
    return Recording(rig=rig, count=count, position=count * drawn.noise_m, **common)


def scaled(run, length, time):
    """Return a record whose lengths and times are multiplied by these factors."""
    rig = run.rig
    if rig.metres_per_count is not None:
        speed = rig.belt_speed
        rig = replace(
            rig,
            metres_per_count=Measured(rig.metres_per_count.value * length),
            belt_speed=Measured(speed.value * length / time, speed.sd * abs(length) / time),
        )
    return replace(run, rig=rig, time=run.time * time, position=run.position * length, rate_hz=run.rate_hz / time)


def answers(motion, length=1.0, time=1.0):
    """Return all that a smoothing answers, its lengths and times multiplied by these factors."""
    found = {}
    for name, (lengths, times) in DIMENSIONS.items():
        unit = length**lengths * time**times
        found[name] = getattr(motion, name) * unit
        if name != "time":
            found[f"{name}_errors"] = getattr(motion, f"{name}_errors") * abs(unit)
    found["phases"] = [
        (own.kind, own.first, own.last, *(time * value for value in (own.start, own.end, own.start_sd, own.end_sd)))
        for own in motion.phases
    ]
    way = 1 if length > 0 else -1
    found["losses"] = [(own.first, own.last, way * own.counts, own.size * length) for own in motion.losses]
    found["kicks"] = [(own.sample, own.step * length / time) for own in motion.kicks]
    found["faults"] = list(motion.faults)
    found["how"] = [motion.method, motion.window, motion.order, motion.dropped_frames]
    found["codes"] = [own.code for own in motion.findings]
    found["numbers"] = np.array([motion.noise * abs(length), motion.belt_speed * length / time])
    events = statistics.from_kinematics(motion).events
    found["events"] = np.array(
        [
            (
                own.t * time,
                own.stick_s * time,
                own.slip_s * time,
                own.drop_m * abs(length),
                own.break_away_m * abs(length),
            )
            for own in events
        ]
    )
    return found


def assert_same(one, two):
    """Assert that two records have the same answers, to the last bit."""
    for name, value in one.items():
        if isinstance(value, np.ndarray):
            np.testing.assert_array_equal(value, two[name], name)
        else:
            assert value == two[name], name


@pytest.mark.parametrize(("number", "faulty"), [(number, place % 4 > 1) for place, number in enumerate(numbers(8, 5))])
def test_a_record_scaled_by_powers_of_two_or_mirrored_is_the_same_to_the_last_bit(number, faulty):
    """Thresholds were seconds and powers of ten of a metre; a contact of 19 Hz was another one than one of 1 Hz."""
    run, rng = record(number, faulty), np.random.default_rng(number)
    length, time = 2.0 ** rng.integers(-12, 13, 2)
    length *= -1 if number % 2 else 1
    assert_same(answers(smooth(run), length, time), answers(smooth(scaled(run, length, time))))


@pytest.mark.parametrize("number", numbers(400, 3))
def test_the_origins_of_time_and_length_do_not_matter(number):
    run = record(number)
    plain = smooth(run)
    shifted = [replace(run, time=run.time + 100.0 / run.rate_hz)]
    if run.count is None:
        shifted.append(replace(run, position=run.position + 3.0 * np.ptp(run.position)))
    else:
        shifted.append(
            replace(run, count=run.count + 12_345, position=(run.count + 12_345) * run.rig.metres_per_count.value)
        )
    for other in shifted:
        found = smooth(other)
        assert [(own.kind, own.first, own.last) for own in found.phases] == [
            (own.kind, own.first, own.last) for own in plain.phases
        ]
        assert np.abs(found.velocity - plain.velocity).max() < 1e-9 * np.abs(plain.velocity).max()
        assert found.belt_speed == pytest.approx(plain.belt_speed, rel=1e-9, nan_ok=True)


@pytest.mark.parametrize("number", [9, 54])  # slips of 17 and 41 samples
def test_corners_of_slips_of_few_samples_are_placed_between_samples(number):
    """They stayed where plateaus showed them: the velocity erred by 1.1 to 6.1 % of its range."""
    drawn, run = scales.draw(number), record(number)
    times, ahead = np.arange(0, drawn.contact.duration, 1 / drawn.rate_hz), 1e-4 / drawn.rate_hz
    before, behind = np.maximum(times - ahead, 0.0), times + ahead
    moved = follow(drawn.contact, behind).position - follow(drawn.contact, before).position
    true = (-1 if drawn.mirrored else 1) * moved / (behind - before)
    found = smooth(run)
    assert found.method == "segment"
    assert np.sqrt(np.mean((found.velocity - true) ** 2)) < 3e-3 * np.ptp(true)
    assert np.mean(np.abs(found.velocity - true) <= 2 * found.velocity_errors) > 0.93
