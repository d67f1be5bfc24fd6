"""The noise of a position is estimated from what a fit leaves, whatever made it."""

from types import SimpleNamespace

import numpy as np
import pytest

from fitting.judge.goodness import PositionNoise, estimate_noise

RATE = 1000.0


def left_over(noise, seed=1, belt_speed=0.0):
    """Return a fit of one slip of 20 s that is right, and its motion, read with the noise; half of it on a belt."""
    rng = np.random.default_rng(seed)
    time = np.arange(20_000) / RATE
    velocity = 0.3 * np.sin(2 * np.pi * 0.8 * time)
    position = 0.06 * (1 - np.cos(2 * np.pi * 0.8 * time))
    if belt_speed:
        velocity[10_000:] = belt_speed
        position[10_000:] = position[9_999] + belt_speed * np.arange(1, 10_001) / RATE
    residual = noise.draw(position, velocity, rng, rng.uniform(-0.5, 0.5))
    n = time.size
    windows = SimpleNamespace(table=np.array([[0, 0, 0, n, 0, 0]]), source=np.arange(n))
    resolution = max(noise.pitch / np.sqrt(12), noise.white)
    read = {"step": noise.pitch, "time": time, "velocity": velocity, "resolution": resolution}
    return windows, residual, np.array([True]), SimpleNamespace(**read, belt_speed=belt_speed)


@pytest.mark.parametrize(
    "noise",
    [
        PositionNoise(50e-6, 0.0, 0.0),
        PositionNoise(50e-6, 0.0, 100e-6),
        PositionNoise(7.67e-6, 0.0, 30e-6),
        PositionNoise(1e-5, 2e-4, 0.0),
        PositionNoise(0.0, 2e-4, 0.0),
        PositionNoise(1e-6, 2e-5, 200e-6),
    ],
)
def test_rounding_white_noise_and_jitter_are_found_apart(noise):
    windows, residual, inliers, motion = left_over(noise)
    found = estimate_noise(windows, residual, inliers, motion)
    assert found.white == pytest.approx(noise.white, rel=0.1, abs=1e-12)
    assert found.jitter == pytest.approx(noise.jitter, rel=0.1, abs=2e-6)
    assert found.sd(motion.velocity) == pytest.approx(np.std(residual), rel=0.06)


@pytest.mark.parametrize("counts", [41.46, 41.01])
def test_the_pattern_of_counts_in_the_sticks_is_no_noise(counts):
    """At 41.46 counts a sample errors alternate: the noise was 37 % too large, and a curve left 0.75 times it."""
    noise = PositionNoise(7.67e-6, 0.0, 0.0)
    found = estimate_noise(*left_over(noise, belt_speed=counts * noise.pitch * RATE))
    assert (found.white, found.jitter) == (0.0, 0.0)
