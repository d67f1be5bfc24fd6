"""Contacts drawn at any scale, with the tables that sensors write of them and what `fit-friction` can know of them.

`draw` gives the same contact for the same number.  Mass, frequency, length, sampling, record and noise are drawn over
decades; the friction, the belt and the damping in units of the contact's own: its natural frequency omega, the stretch
Fs/k of its spring, and their product, a speed.  `python -m tests.fitting.scales NUMBER TABLE.csv` writes the table of
one contact and prints the commands that read it.
"""

import math
import shlex
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..rig import Contact, Motion, follow

LAWS = {"law1": 1, "law2": 2, "law3": 3, "law4": 4, "law5": 5, "law6": 6}
FOREIGN = ("stribeck", "stribeck-gaussian", "logarithmic", "hard-spring")  # none of the six
KINDS = (*LAWS, *FOREIGN)
MASS = (0.02, 10.0)  # kg
OMEGA = (1.0, 300.0)  # rad/s
STRETCH = (3e-4, 0.3)  # Fs/k, m
SAMPLES = (4.0, 300.0)  # of a slip
CYCLES = (5.0, 80.0)
NOISE = (10**-4.5, 10**-2.3)  # of Fs/k: standard deviation of a camera's readings, or an encoder's count
BELT = (0.05, 0.45)  # of omega Fs/k
SCATTER = 0.03  # of the friction level, from landing to landing
SLIP = 0.7  # of the natural period: about how long a slip lasts
DROP = 1.2  # of Fs/k: about how long a slip is
REST = 1.0  # natural periods before the belt starts
# What a calibration leaves open: the rest position in Fs/k, the damping in units of critical damping.
DATUM_SD, DAMPING_SD = 1e-3, 1e-3


@dataclass(frozen=True)
class Drawn:
    """A contact, and how it was recorded."""

    number: int  # what it was drawn from
    kind: str  # one of `KINDS`
    contact: Contact
    rate_hz: float
    noise_m: float  # standard deviation of a camera's readings, or an encoder's count
    counts: bool  # an encoder counts, else a camera reads
    mirrored: bool  # +x points against the belt
    x0_m: float  # what the table reads at the spring's rest
    begin_s: float  # time of its first row
    flags: tuple[str, ...]  # the calibration, as flags of `fit-friction`

    @property
    def law(self) -> int | None:
        """The law of the six that it follows, if any."""
        return LAWS.get(self.kind)


@dataclass(frozen=True)
class Truth:
    """What a record of a contact holds."""

    sticks: int  # between two slips, as long as two samples or longer
    # Of the median slip between two sticks, however short; of a mass that never sticks again, of a natural period: it
    # slips from one approach to the belt's speed to the next.
    samples_per_slip: float
    cycles: float  # sticks; of constant friction, under which no stick is sustained, natural periods


def draw(number: int) -> Drawn:
    """Return the contact of a number."""
    chance = np.random.default_rng([7129, number])
    kind = KINDS[number % len(KINDS)]

    def between(ends: tuple[float, float]) -> float:
        return float(math.exp(chance.uniform(math.log(ends[0]), math.log(ends[1]))))

    mass, omega, stretch = between(MASS), between(OMEGA), between(STRETCH)
    stiffness, speed, period = mass * omega**2, omega * stretch, 2 * math.pi / omega
    level, belt = stiffness * stretch, speed * between(BELT)
    samples, cycles = between(SAMPLES), between(CYCLES)
    critical = 2 * math.sqrt(stiffness * mass)
    damping = critical * between((1e-3, 1e-2))
    start = REST * period
    contact = Contact(
        **_friction(kind, chance, level, speed, stiffness, stretch, belt),
        Fs=level,
        m=mass,
        k=stiffness,
        c=damping,
        belt=belt,
        belt_start=start,
        duration=start + stretch / belt + cycles * (SLIP * period + DROP * stretch / belt),
        scatter=float(chance.choice([0.0, SCATTER])),
        seed=number,
    )
    x0 = stretch * chance.uniform(-20, 20) if chance.random() < 0.5 else 0.0
    flags: list[str] = []
    weighed, calibrated = chance.random() < 0.75, chance.random() < 0.5
    if weighed:
        flags += ["--mass", f"{mass:.9g}"]
    if calibrated:
        datum, sd = -x0 + DATUM_SD * stretch * chance.standard_normal(), DATUM_SD * stretch
        flags += [f"--datum={datum:.9g}", "--datum-sd", f"{sd:.9g}"]
    if calibrated and weighed:  # a damping in N s/m says nothing without a mass
        said = abs(damping + DAMPING_SD * critical * chance.standard_normal())
        flags += ["--damping", f"{said:.9g}", "--damping-sd", f"{DAMPING_SD * critical:.9g}"]
    return Drawn(
        number=number,
        kind=kind,
        contact=contact,
        rate_hz=samples / (SLIP * period),
        noise_m=stretch * between(NOISE),
        counts=bool(chance.random() < 0.5),
        mirrored=bool(chance.random() < 0.5),
        x0_m=x0,
        begin_s=period * between((1.0, 1e3)) if chance.random() < 0.5 else 0.0,
        flags=tuple(flags),
    )


def _friction(
    kind: str, chance: np.random.Generator, level: float, speed: float, stiffness: float, stretch: float, belt: float
) -> dict[str, object]:
    """Return the fields of `Contact` that make its friction."""
    linear = {"curve": "linear", "G_slip": level * chance.uniform(0.12, 0.31) / speed}
    hyperbolic = {"curve": "hyperbolic", "gamma": chance.uniform(1, 8) / speed}
    ramp = {"ramp": belt * chance.uniform(0.05, 0.3)}
    if kind in LAWS:
        curve = ({"curve": "constant"}, linear, hyperbolic)[(LAWS[kind] - 1) // 2]
        return curve | (ramp if LAWS[kind] % 2 == 0 else {})
    if kind == "hard-spring":
        return (linear if chance.random() < 0.5 else hyperbolic) | {
            "k3": chance.uniform(0.04, 0.15) * stiffness / stretch**2
        }
    if kind == "logarithmic":
        fall, scale = level * chance.uniform(0.06, 0.15), speed * 10 ** chance.uniform(-2, -1)
        return {"curve": kind, "log_fall": fall, "log_speed": scale}
    return {
        "curve": "stribeck",
        "power": 2.0 if kind == "stribeck-gaussian" else 1.0,
        "Fc": level * chance.uniform(0.4, 0.75),
        "v_s": speed * 10 ** chance.uniform(-1.4, -0.4),
        "Fv": level * chance.uniform(0, 0.12) / speed,
    }


def write_table(drawn: Drawn, path: Path) -> Truth:
    """Write the table of times (s) and positions (m) that the sensor gives; return what it holds."""
    times = np.arange(0, drawn.contact.duration, 1 / drawn.rate_hz)
    motion = follow(drawn.contact, times)
    readings = drawn.x0_m + (-1 if drawn.mirrored else 1) * motion.position
    if drawn.counts:
        readings = np.floor(readings / drawn.noise_m) * drawn.noise_m
    else:
        noise = np.random.default_rng([7129, drawn.number, 1])
        readings = readings + noise.normal(0, drawn.noise_m, readings.size)
    rows = np.column_stack([drawn.begin_s + times, readings])
    np.savetxt(path, rows, fmt="%.10f,%.12f", header="t [s],x [m]", comments="")
    return _truth(drawn, motion)


def commands(drawn: Drawn, table: str, run: str) -> tuple[list[str], list[str]]:
    """Return the command lines that make a run file of a table and fit the laws to it."""
    fit = ["fit-friction", run, *drawn.flags, "--json", "--no-report"]
    return ["daq", "import", table, "-o", run, "--json"], fit


def _truth(drawn: Drawn, motion: Motion) -> Truth:
    broke, landed = motion.break_aways, motion.landings
    # The first slip begins with the belt; every landing but the last of a record is followed by a break-away.
    sticks = broke[1:] - landed[: broke.size - 1]
    lasting = sticks * drawn.rate_hz >= 2
    slips = landed[1:] - broke[1 : landed.size]
    slip = float(np.median(slips)) if slips.size else 2 * math.pi / drawn.contact.omega
    count = int(lasting.sum())
    periods = (drawn.contact.duration - drawn.contact.belt_start) * drawn.contact.omega / (2 * math.pi)
    return Truth(count, slip * drawn.rate_hz, periods if drawn.law in (1, 2) else count)


def main() -> None:
    """Write the table of a contact and print its commands."""
    number, table = int(sys.argv[1]), Path(sys.argv[2])
    drawn = draw(number)
    truth = write_table(drawn, table)
    for line in commands(drawn, str(table), str(table.with_suffix(".h5"))):
        sys.stdout.write(shlex.join(line) + "\n")
    sys.stdout.write(f"{drawn}\n{truth}\n")


if __name__ == "__main__":
    main()
