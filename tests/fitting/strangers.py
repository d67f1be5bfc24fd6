"""Records that are no belt stick-slip: what people point `fit-friction` at by mistake, or out of curiosity.

Each maker takes a seeded generator and returns time (s) and position (m) of a record at 1 kHz, counted in steps of
7.67 um as the rig's encoder would.  Sizes and rates are drawn, so that no single record is learnt by heart.
"""

import math

import numpy as np

RATE = 1000.0
COUNT = 7.67e-6


def _times(seconds):
    return np.arange(round(seconds * RATE)) / RATE


def counted(x):
    return np.round(x / COUNT) * COUNT


def ramp(rng):
    t = _times(20)
    return t, counted(rng.uniform(-0.3, 0.3) * t)


def ramp_with_noise(rng):
    t = _times(20)
    return t, counted(rng.uniform(0.05, 0.3) * t + 1e-4 * rng.standard_normal(t.size))


def constant(rng):
    t = _times(20)
    return t, np.full(t.size, rng.uniform(-0.1, 0.1))


def noise(rng):
    t = _times(20)
    return t, counted(10 ** rng.uniform(-5, -2) * rng.standard_normal(t.size))


def random_walk(rng):
    t = _times(20)
    return t, counted(10 ** rng.uniform(-5, -3) * np.cumsum(rng.standard_normal(t.size)))


def smooth_noise(rng):
    """Low-passed noise: a hand that moves the mass about."""
    t = _times(20)
    x = np.zeros(t.size)
    for _ in range(30):
        x += 0.02 * rng.standard_normal() * np.sin(2 * np.pi * rng.uniform(0.05, 3) * t + rng.uniform(0, 7))
    return t, counted(x)


def sine(rng):
    t = _times(20)
    omega, phase = rng.uniform(4, 9), rng.uniform(0, 2 * np.pi)
    x = rng.uniform(-0.1, 0.15) + rng.uniform(0.02, 0.06) * np.sin(omega * t + phase)
    return t, counted(x + 3e-6 * rng.standard_normal(t.size))


def decay(rng):
    """Let go of a mass on its spring: no belt, hardly any damping."""
    t = _times(20)
    omega, rate = rng.uniform(4, 9), rng.uniform(0.02, 0.3)
    return t, counted(rng.uniform(0.03, 0.08) * np.exp(-rate * t) * np.cos(omega * t))


def coulomb_decay(rng):
    """Let go of a mass on its spring, for dry friction to bring it to rest half a period at a time."""
    t = _times(20)
    omega, loss = rng.uniform(4, 9), rng.uniform(0.002, 0.006)
    x = np.empty(t.size)
    amplitude, centre, sign, start = 0.06, loss / 2, 1.0, 0.0
    for i, now in enumerate(t):
        while now - start > np.pi / omega and amplitude > loss:
            start += np.pi / omega
            amplitude -= loss
            sign = -sign
            centre = sign * loss / 2
        if amplitude <= loss:
            x[i:] = x[i - 1]
            break
        x[i] = centre + sign * amplitude * np.cos(omega * (now - start))
    return t, counted(x)


def positioning_drive(rng):
    """Go back and forth as a positioning drive does (EMPS): trapezoids of velocity with rests between."""
    t = _times(24)
    v = np.zeros(t.size)
    begin, sign = rng.uniform(0.3, 1.0), 1.0
    while begin < t[-1]:
        speed, rise, hold, rest = rng.uniform(0.05, 0.25), rng.uniform(0.1, 0.4), rng.uniform(0.3, 1.5), 0.3
        shape = np.interp(t - begin, [0, rise, rise + hold, 2 * rise + hold], [0, 1, 1, 0], left=0, right=0)
        v += sign * speed * shape
        begin += 2 * rise + hold + rest * rng.uniform(0, 2)
        sign = -sign
    x = np.cumsum(v) / RATE
    ring = 2e-5 * np.sin(2 * np.pi * 30 * t) * (np.abs(v) > 0)  # the controller's own ripple
    return t, counted(x + ring)


def positioning_sweep(rng):
    """Follow the sum of sines that identification of a drive commonly asks for, coming to rest by Coulomb friction."""
    t = _times(24)
    x = 0.12 * (1 - np.cos(2 * np.pi * t / 12)) + 0.02 * np.sin(2 * np.pi * rng.uniform(0.2, 0.6) * t)
    return t, counted(x + 0.005 * np.sin(2 * np.pi * rng.uniform(1, 3) * t))


def square(rng):
    """Jump between two positions."""
    t = _times(20)
    return t, counted(0.05 * np.sign(np.sin(2 * np.pi * rng.uniform(0.3, 1.5) * t)))


def sawtooth(rng):
    """Straight up, straight down: no law's slip has no curvature."""
    t = _times(20)
    period, part = rng.uniform(0.8, 2.0), rng.uniform(0.6, 0.8)
    phase = (t / period) % 1.0
    return t, counted(0.2 * np.where(phase < part, phase / part, (1 - phase) / (1 - part)))


def steps(rng):
    """Climb stairs: a conveyor that is indexed."""
    t = _times(20)
    period = rng.uniform(0.7, 1.5)
    k, phase = np.divmod(t, period)
    return t, counted(0.1 * (k + np.clip(phase / (0.4 * period), 0, 1)))


def two_sines(rng):
    t = _times(20)
    f = rng.uniform(0.7, 1.2)
    return t, counted(0.05 * np.sin(2 * np.pi * f * t) + 0.03 * np.sin(2 * np.pi * 2.3 * f * t + rng.uniform(0, 6)))


def shaken(rng):
    """Shake a mass on its spring at random: it swings, now more, now less, and nothing holds it at one speed."""
    t = _times(8)
    omega, damping = 2 * np.pi * rng.uniform(5, 15), rng.choice([0.02, 0.05, 0.1])
    steps = 4  # of the integration in a sample
    dt = 1 / (RATE * steps)
    push = 0.04 * omega * math.sqrt(damping * omega / dt) * rng.standard_normal((t.size, steps))
    fade = 0.005  # s: a push does not change at once
    x, position, velocity, force = np.empty(t.size), 0.0, 0.0, 0.0
    for i, row in enumerate(push.tolist()):
        x[i] = position
        for kick in row:
            force += dt / fade * (kick - force)
            velocity += dt * (force - 2 * damping * omega * velocity - omega**2 * position)
            position += dt * velocity
    return t, counted(x + 1e-4 * rng.standard_normal(t.size))


ALL = {
    make.__name__: make
    for make in (
        ramp,
        ramp_with_noise,
        constant,
        noise,
        random_walk,
        smooth_noise,
        sine,
        decay,
        coulomb_decay,
        positioning_drive,
        positioning_sweep,
        square,
        sawtooth,
        steps,
        two_sines,
        shaken,
    )
}
