"""The tests' own rig: a mass on a belt, followed by scipy's DOP853 from event to event, and records of its motion.

Nothing of rig_sim is used: one right-hand side in newtons, a stick in closed form, and a root search for each event.
A `Contact` is one of the six laws or none, and a departure is one field of it; 0 means that it is absent.  Contacts of
any scale are followed alike: steps and tolerances are in units of the contact's own, 1/omega and Fs/k.  `follow` gives
the exact motion with the break-aways and landings, `simulate` the positions alone, `recorded` what a counting encoder
shows of them, `by_encoder` the same as a Recording.

A `Scene` is a contact that obeys one of the six laws by its number, with what wears, kicks and reads it: `recording`
gives it as daq would load it, `camera` and `imported` as the table of a camera.
"""

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from daq.imports import table_to_run
from daq.imports.options import ImportOptions
from daq.runfile import store
from daq.runfile.recording import Recording
from daq.runfile.rig import Rig
from stickslip.units import Measured

STEP = 0.012  # of 1/omega: longest time between two looks for an event; the rig's 2 ms
FIRST = 6e-6  # of 1/omega: the step by which a slip leaves the belt, so that it does not land where it begins
EDGE = 1e-7  # of a ramp: it is left so far beyond its edge, where a mass that merely grazes it is not
JITTER = 30e-6  # s: standard deviation of an encoder's sample times
TIGHT = 1e-10  # of Fs/k: absolute tolerance; the relative one is 1e-9


@dataclass(frozen=True)
class Contact:
    """The rig of the design in SI units; the friction curve by name with its numbers, and what departs from it."""

    curve: str = "hyperbolic"
    Fs: float = 1.379353536
    gamma: float = 9.618
    G_slip: float = 0.3
    ramp: float = 0.0  # half-width of the ramp through w = 0, m/s; 0 lets the mass stick
    Fc: float = 0.5  # Stribeck: level at high speed, N
    v_s: float = 0.08  # Stribeck: speed over which it falls, m/s
    power: float = 1.0  # Stribeck: 1 exponential, 2 Gaussian
    Fv: float = 0.1  # Stribeck: viscous term, N s/m
    log_fall: float = 0.2  # logarithmic: N
    log_speed: float = 0.01  # logarithmic: m/s
    m: float = 0.3
    k: float = 10.5552
    c: float = 0.0
    belt: float = 0.22
    belt_start: float = 0.5
    duration: float = 30.0
    static: float = 1.0
    scatter: float = 0.0  # of the friction level, drawn at each landing
    farthest: float = 3.0  # standard deviations: no level is drawn farther out
    k3: float = 0.0  # N/m^3
    drag: float = 0.0  # N s^2/m^2
    guide: float = 0.0  # N
    belt_drift: float = 0.0  # fraction over the record
    stiffness_drift: float = 0.0  # fraction over the record
    ripple: tuple = ()  # pairs of relative amplitude and frequency, Hz
    second_mass: tuple = ()  # kg, N/m, N s/m
    by_mass_position: tuple = ()  # relative amplitude, wavelength in m
    by_belt_position: tuple = ()  # relative amplitude, wavelength in m
    ageing: tuple = ()  # relative growth of the break-away level per e-fold of stick time, time constant in s
    lugre: tuple = ()  # bristle stiffness N/m and damping N s/m; the steady curve is Stribeck with power 2
    fluctuation: tuple = ()  # of friction at random in time: relative standard deviation, correlation time in s
    eccentricity: tuple = ()  # m, revolution in m: of the reading
    wear: float = 0.0  # fraction of the friction level that is lost over the record
    kick: float = 0.0  # m/s, of either sign, when the belt's joint passes
    belt_length: float = 1.6  # m
    sticks_at_start: bool = False  # the mass moves with the belt from its first moment on
    seed: int = 1

    @property
    def omega(self):
        """Natural frequency, rad/s."""
        return math.sqrt(self.k / self.m)

    @property
    def tight(self):
        """Tolerances of the integration."""
        return {"method": "DOP853", "rtol": 1e-9, "atol": TIGHT * self.Fs / self.k}


@dataclass(frozen=True)
class Motion:
    """What a contact did.

    Attributes
    ----------
    position, velocity : array (samples,)
        m, from the spring's rest, and m/s.
    break_aways, landings : array
        Times at which slips begin and end, s; of a ramp, those at which the mass leaves it and comes back to it.
    """

    position: np.ndarray
    velocity: np.ndarray
    break_aways: np.ndarray
    landings: np.ndarray


def curve(p, s):
    """Friction at slip speed s >= 0, N; of a ramp, s counts from its end."""
    if p.curve == "constant":
        return p.Fs
    if p.curve == "linear":
        return p.Fs - p.G_slip * s
    if p.curve == "hyperbolic":
        return p.Fs / (1 + p.gamma * s)
    if p.curve == "stribeck":
        return p.Fc + (p.Fs - p.Fc) * math.exp(-((s / p.v_s) ** p.power)) + p.Fv * s
    if p.curve == "logarithmic":
        return p.Fs - p.log_fall * math.log1p(s / p.log_speed)
    raise ValueError(p.curve)


def belt_motion(p, t):
    """Position, speed and acceleration of the belt after its start."""
    if t < p.belt_start:
        return 0.0, 0.0, 0.0
    x = (t - p.belt_start) + p.belt_drift * (t**2 - p.belt_start**2) / (2 * p.duration)
    v, a = 1 + p.belt_drift * t / p.duration, p.belt_drift / p.duration
    for size, hertz in p.ripple:
        w = 2 * math.pi * hertz
        x -= size / w * (math.cos(w * t) - math.cos(w * p.belt_start))
        v += size * math.sin(w * t)
        a += size * w * math.cos(w * t)
    return p.belt * x, p.belt * v, p.belt * a


def factor_of(p, t, x, belt):
    """Factor of friction at a time, at mass position x on the belt that has moved by ``belt``."""
    factor = 1.0 - p.wear * t / p.duration
    if p.fluctuation:
        size, scale = p.fluctuation
        rates, phases = _random_sines(p.seed)
        factor *= 1 + size * math.sqrt(2 / rates.size) * float(np.sum(np.cos(rates * t / scale + phases)))
    if p.by_mass_position:
        size, length = p.by_mass_position
        factor *= 1 + size * math.sin(2 * math.pi * x / length)
    if p.by_belt_position:
        size, length = p.by_belt_position
        factor *= 1 + size * math.sin(2 * math.pi * (belt - x) / length)
    return factor


@lru_cache(maxsize=4)
def _random_sines(seed):
    """Rates and phases of sines whose sum has a Gaussian correlation of unit time."""
    rng = np.random.default_rng([seed, 3])
    return rng.standard_normal(64), rng.uniform(0, 2 * math.pi, 64)


def other_forces(p, t, state, v, way):
    """All forces on the mass but the belt's friction; ``way`` is the direction in which the guide resists."""
    x = state[0]
    force = -p.k * (1 + p.stiffness_drift * t / p.duration) * x - p.k3 * x**3 - p.c * v - p.drag * v * abs(v)
    force -= p.guide * way
    if p.second_mass:
        _, stiffness, damping = p.second_mass
        force += stiffness * (state[2] - x) + damping * (state[3] - v)
    return force


def side_mass(p, state, v):
    """Velocity and acceleration of the second mass."""
    own, stiffness, damping = p.second_mass
    return state[3], (-stiffness * (state[2] - state[0]) - damping * (state[3] - v)) / own


def simulate(p, times):
    """Exact positions (m) at ``times`` (s, rising from 0), starting at the spring's rest on a belt at rest."""
    return follow(p, times).position


def follow(p, times, chance=None, level=1.0):
    """Exact motion at ``times`` (s, rising from 0), starting at the spring's rest on a belt at rest.

    LuGre's model has no break-aways and landings.  A ramp knows no ageing, no guide, and no start on the belt.
    ``chance`` draws the levels and the signs of kicks, by default a generator of the contact's own seed; ``level`` is
    that of friction until the first landing.
    """
    if p.ramp and (p.ageing or p.guide or p.sticks_at_start):
        raise ValueError("a ramp with ageing, guide or sticks_at_start")
    times = np.asarray(times, float)
    rng = np.random.default_rng(p.seed + 991) if chance is None else chance
    found = np.full((2, times.size), np.nan)
    found[:, times < p.belt_start] = 0.0
    state = np.zeros(4 if p.second_mass else 3 if p.lugre else 2)
    t, end = p.belt_start, float(times[-1]) + 1e-9
    if p.lugre:
        found[:, times >= p.belt_start] = _memory(p, t, end, state, times)
        return Motion(*found, np.array([]), np.array([]))
    slipping, side = not p.sticks_at_start, -1.0
    broke, landings = [t] if slipping else [], []
    began = 0.0 if p.sticks_at_start else t
    turn = p.belt_length / p.belt if p.kick else np.inf
    joint = (math.floor(t / turn) + 1) * turn if p.kick else np.inf

    def store(first, last, motion):
        own = slice(*np.searchsorted(times, (first, last)))
        if own.stop > own.start:
            found[:, own] = motion(times[own])

    while t < end:
        until = min(end, joint)
        landed = False
        if slipping:
            t, state, landed = _slip(p, t, until, state, side, level, store)
            if landed:
                level = 1 + p.scatter * float(np.clip(rng.standard_normal(), -p.farthest, p.farthest))
                landings.append(t)
        else:
            t, state = (_creep if p.ramp else _stick)(p, t, until, state, level, began, store)
        if t >= end:
            break
        belt, v, a = belt_motion(p, t)
        if t >= joint:
            state[1] += p.kick * rng.choice((-1.0, 1.0))
            joint += turn
            held, side = slipping, math.copysign(1.0, state[1] - v)
            slipping = not p.ramp or abs(state[1] - v) >= p.ramp
        elif p.ramp:
            held, slipping, side = slipping, not slipping, math.copysign(1.0, state[1] - v)
        else:
            state[1] = v
            need = p.m * a - other_forces(p, t, state, v, 1.0)
            held = False
            slipping = not landed or abs(need) > level * p.Fs * p.static * factor_of(p, t, state[0], belt)
            side = -math.copysign(1.0, need) if slipping else side
        if slipping and not held:
            broke.append(t)
        elif not slipping:
            began = t
    return Motion(*found, np.array(broke), np.array(landings))


def _slip(p, t, end, state, side, level, store):
    """Follow a slip until the mass moves as the belt does; the guide's friction turns round with the velocity."""
    way = math.copysign(1.0, state[1]) if state[1] else side

    def rates(time, y):
        belt, speed, _ = belt_motion(p, time)
        s = max(side * (y[1] - speed) - p.ramp, 0.0)
        friction = -side * level * curve(p, s) * factor_of(p, time, y[0], belt)
        a = (other_forces(p, time, y, y[1], way) + friction) / p.m
        return (y[1], a, *side_mass(p, y, y[1])) if p.second_mass else (y[1], a)

    def lands(time, y):
        return side * (y[1] - belt_motion(p, time)[1]) - p.ramp

    def turns(time, y):
        return y[1]

    def nears(time, y):
        return side * (rates(time, y)[1] - belt_motion(p, time)[2])

    lands.terminal, lands.direction = True, -1
    turns.terminal, turns.direction = p.guide != 0 or p.drag != 0, -way  # both forces have a corner there
    nears.terminal, nears.direction = True, 1  # a landing that grazes begins and ends within one step
    # Leave the belt's speed by one small step, so that the event is not found where the slip begins.
    h, begin = min(FIRST / p.omega, end - t), state
    store(t, t + h, lambda when: np.tile(begin[:2, None], when.size))
    t, state = t + h, begin + h * np.array(rates(t, begin))
    while t < end:
        looks = {"events": [lands, turns, nears], "dense_output": True, "max_step": 5 * STEP / p.omega}
        run = solve_ivp(rates, (t, end), state, **looks, **p.tight)
        before, last, state = float(run.t[-2]), float(run.t[-1]), run.y[:, -1].copy()
        landed = run.status == 1 and run.t_events[0].size > 0
        if run.status == 1 and not landed and lands(last, state) < 0 < lands(before, run.sol(before)):
            last = brentq(lambda when, run=run: lands(when, run.sol(when)), before, last, xtol=1e-13)
            landed, state = True, run.sol(last)
        store(t, last if run.status == 1 else end, lambda when, run=run: run.sol(when)[:2])
        t = last
        if run.status != 1 or landed:
            return (t if landed else end), state, landed
        if run.t_events[1].size:
            way = -way
            turns.direction = -way
        else:
            nears.direction = -nears.direction
    return end, state, False


def _creep(p, t, end, state, level, began, store):
    """Creep within the ramp, where friction is linear and stiff, until the mass leaves it."""

    def rates(time, y):
        belt, speed, _ = belt_motion(p, time)
        friction = -level * p.static * p.Fs * (y[1] - speed) / p.ramp * factor_of(p, time, y[0], belt)
        a = (other_forces(p, time, y, y[1], 0.0) + friction) / p.m
        return (y[1], a, *side_mass(p, y, y[1])) if p.second_mass else (y[1], a)

    def leaves(time, y):
        return (1 + EDGE) * p.ramp - abs(y[1] - belt_motion(p, time)[1])

    leaves.terminal, leaves.direction = True, -1
    stiff = p.tight | {"method": "LSODA"}
    run = solve_ivp(rates, (t, end), state, events=leaves, dense_output=True, **stiff)
    store(t, run.t[-1] if run.status == 1 else end, lambda when: run.sol(when)[:2])
    return (float(run.t[-1]) if run.status == 1 else end), run.y[:, -1].copy()


def _stick(p, t, end, state, level, began, store):
    """Ride on the belt until the load exceeds the break-away level."""
    x0, origin = state[0], belt_motion(p, t)[0]
    ring = None
    if p.second_mass:
        ring = solve_ivp(
            lambda time, y: side_mass(p, (x0 + belt_motion(p, time)[0] - origin, 0, *y), belt_motion(p, time)[1]),
            (t, min(t + 3.0, end)),
            state[2:],
            dense_output=True,
            **p.tight,
        )

    def at(time):
        x = x0 + belt_motion(p, time)[0] - origin
        return np.array([x, belt_motion(p, time)[1], *(ring.sol(time) if ring is not None else ())])

    def spare(time):
        here = at(time)
        belt, v, a = belt_motion(p, time)
        cap = level * p.Fs * p.static * factor_of(p, time, here[0], belt)
        if p.ageing:
            growth, scale = p.ageing
            cap *= 1 + growth * math.log1p((time - began) / scale)
        return cap - abs(p.m * a - other_forces(p, time, here, v, 1.0))

    last = t
    while last < end:
        ahead = min(last + STEP / p.omega, end)
        if spare(ahead) < 0:
            ahead = brentq(spare, last, ahead, xtol=1e-13) if spare(last) > 0 else last
            break
        last = ahead
    else:
        ahead = end
    store(t, ahead, lambda when: np.add([[x0 - origin], [0.0]], np.array([belt_motion(p, one)[:2] for one in when]).T))
    return ahead, at(ahead)


def _memory(p, t, end, state, times):
    """Follow the LuGre model: bristles of stiffness and damping under a Stribeck curve; there is no event."""
    stiffness, damping = p.lugre

    def rates(time, y):
        w = y[1] - belt_motion(p, time)[1]
        steady = p.Fc + (p.Fs - p.Fc) * math.exp(-((w / p.v_s) ** 2))
        bend = w - stiffness * abs(w) / steady * y[2]
        friction = -(stiffness * y[2] + damping * bend + p.Fv * w)
        return y[1], (other_forces(p, time, y, y[1], 1.0) + friction) / p.m, bend

    run = solve_ivp(rates, (t, end), state, t_eval=times[times >= t], method="LSODA", rtol=1e-9, atol=1e-12)
    return run.y[:2]


def recorded(p, *, rate=1000.0, count=7.67e-6, jitter=0.0):
    """Return times (s) and positions (m) as an encoder with ``count`` m per count and jittering samples shows them."""
    nominal = np.arange(round(p.duration * rate)) / rate
    rng = np.random.default_rng([p.seed, 7])
    times = np.maximum.accumulate(np.maximum(nominal + jitter * rng.standard_normal(nominal.size), 0.0))
    x = simulate(p, times)
    if p.eccentricity:
        size, turn = p.eccentricity
        x = x + size * np.sin(2 * np.pi * x / turn + 0.7)
    return nominal, np.floor(x / count) * count if count else x


def as_recording(time, position, rate, rig, title):
    """Return a Recording of positions (m) at times (s), as daq would load it."""
    at = {"started": "2026-01-01T00:00:00+00:00", "ended": "2026-01-01T00:00:20+00:00"}
    return Recording(source=Path("rig.h5"), title=title, rate_hz=rate, rig=rig, time=time, position=position, **at)


def by_encoder(contact, *, rate=1000.0, count=50e-6, damping_sd=None):
    """Return the Recording of a contact by an encoder, at times that jitter; uncalibrated without ``damping_sd``."""
    time, position = recorded(contact, rate=rate, count=count, jitter=JITTER)
    rig = Rig(name="encoder", metres_per_count=Measured(count))
    if damping_sd is not None:
        mass, damping = Measured(contact.m, 1e-3 * contact.m), Measured(contact.c, damping_sd)
        rig = replace(rig, mass=mass, datum=Measured(0.0, 5e-4), damping=damping)
    return as_recording(time, position, rate, rig, contact.curve)


@dataclass(frozen=True)
class Scene:
    """A contact that obeys a law on the rig of the design, in SI units, with what disturbs it, and how it is read."""

    law: int = 5
    m: float = 0.3
    K: float = 35.184  # k/m, 1/s^2
    Fs_over_k: float = 0.13068
    gamma: float = 9.618
    G_slip: float = 0.6
    d: float = 0.03
    belt: float = 0.22
    belt_start: float = 0.5
    static: float = 1.0
    scatter: float = 0.03
    wear: float = 0.0  # fraction of Fs lost over the run
    kick: float = 0.0  # m/s
    belt_length: float = 1.6
    damping: float = 0.0  # c/m, 1/s
    duration: float = 20.0
    rate: float = 1000.0
    jitter: float = 30e-6
    delta: float = 7.67e-6
    datum_error: float = 0.0
    seed: int = 1

    @property
    def contact(self):
        """The contact of this scene."""
        return Contact(
            curve=("constant", "linear", "hyperbolic")[(self.law - 1) // 2],
            Fs=self.m * self.K * self.Fs_over_k,
            gamma=self.gamma,
            G_slip=self.G_slip,
            ramp=0.0 if self.law % 2 else self.d,
            m=self.m,
            k=self.m * self.K,
            c=self.m * self.damping,
            belt=self.belt,
            belt_start=self.belt_start,
            duration=self.duration,
            static=self.static,
            scatter=self.scatter,
            farthest=math.inf,
            wear=self.wear,
            kick=self.kick,
            belt_length=self.belt_length,
        )


@lru_cache(maxsize=64)
def sampled(scene):
    """Sample and count the motion: recorded times (s), what it was at these, counted position (m)."""
    rng = np.random.default_rng(scene.seed + 10_000)
    n = int(scene.duration * scene.rate)
    when = np.maximum(np.arange(n) / scene.rate + scene.jitter * rng.standard_normal(n), 0.0)
    order = np.argsort(when, kind="stable")
    motion = follow(scene.contact, when[order], np.random.default_rng(scene.seed))
    x = np.empty(n)
    x[order] = motion.position
    recorded = np.round(when, 6) if scene.jitter else when
    counted = (np.floor(x / scene.delta) + 0.5) * scene.delta if scene.delta else x
    return recorded, motion, counted + scene.datum_error


def recording(scene=None, **changes):
    """Return a Recording of the scene as daq would load it, calibrated as the rig's own board calibrates it."""
    scene = replace(scene or Scene(), **changes)
    backwards = scene.belt < 0
    if backwards:
        scene = replace(scene, belt=-scene.belt)
    time, _, position = sampled(scene)
    if backwards:
        position = -position
    rng = np.random.default_rng(scene.seed + 20_000)
    belt = scene.belt * (1 + 0.01 * rng.standard_normal()) * (-1 if backwards else 1)
    critical = 2 * scene.m * math.sqrt(scene.K)
    rig = Rig(
        name="the tests' rig",
        metres_per_count=Measured(scene.delta),
        mass=Measured(scene.m * (1 + 1e-3 * rng.standard_normal()), 1e-3 * scene.m),
        datum=Measured(0.0, 5e-4),
        damping=Measured(max(0.0, scene.damping * scene.m + 1e-3 * critical * rng.standard_normal()), 1e-3 * critical),
        belt_speed=Measured(belt, 0.01 * scene.belt),
    )
    return as_recording(time - time[0], position, scene.rate, rig, f"law {scene.law}")


def written(path, recording):
    """Write a recording as a run file and return its path."""
    data = Recording(
        title="the tests' rig",
        started=recording.started,
        ended=recording.ended,
        rate_hz=recording.rate_hz,
        rig=recording.rig,
        time=recording.time,
        position=recording.position,
    )
    store.write(path, data)
    return path


def nominal(law, seed, **changes):
    """Return a scene with the nominal disturbances drawn for this seed."""
    rng = np.random.default_rng(1000 * law + seed)
    critical = 2 * math.sqrt(Scene.K)
    return replace(
        Scene(law=law, seed=seed),
        scatter=rng.uniform(0.03, 0.10),
        wear=rng.uniform(0.03, 0.15),
        kick=rng.uniform(0.0, 0.02),
        jitter=rng.uniform(0, 100e-6),
        delta=float(rng.choice((7.67e-6, 50e-6))),
        damping=rng.uniform(0.001, 0.01) * critical,
        datum_error=5e-4 * rng.standard_normal(),
        **changes,
    )


def camera(law, noise, seed=1, duration=30.0, **changes):
    """Return times (s) and positions (m) of a camera track: 400 frames a second, ``noise`` (m) on each position."""
    scene = replace(
        Scene(law=law, seed=seed, duration=duration, rate=400.0, jitter=0.0, delta=0.0, G_slip=0.3), **changes
    )
    time, _, position = sampled(scene)
    return time - time[0], position + np.random.default_rng([seed, 400]).normal(0, noise, time.size)


def imported(path, time, position, decimals=5, **options):
    """Write a table of times and positions, and return the recording that is imported from it, bare of calibration."""
    rows = np.c_[time, np.round(position, decimals)]
    np.savetxt(path, rows, fmt=["%.6f", f"%.{max(decimals, 1)}f"], delimiter=",", header="t,x", comments="")
    return table_to_run.read(path, ImportOptions(**options)).run
