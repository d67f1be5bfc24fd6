"""What the fits of laws with memory find in records whose truth is known.

``python benchmarks/memory_fits.py [--seeds N] [--first SEED] [--output FILE] [--verdicts] [--write]``: for each law of
`CONTACTS` and each noise of `NOISES`, N records (default 1; 7 make 63), whose contacts, counts, durations and belts are
drawn by chance.  They are played by `rig_sim` (whose kernel ``benchmarks/memory_laws.py`` compares with scipy), with
2 % scatter of the friction, and read by an encoder at times that jitter.  Each law with memory is fitted to each
record; the misfit of another law is infinite where it is given up.  ``--verdicts`` also ranks each record without
naming a law, and counts the sets: those with the true law, and those of a wrong one alone.  ``--write`` puts the counts
into docs/identification.md.
"""

import argparse
import json
import math
import time as clock
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pages
from competition import between

import fitting
import rig_sim
from daq.runfile.recording import Recording
from fitting.judge.law_fits import cut_run
from fitting.laws import MEMORY, SIX
from fitting.least_squares.normal_equations import SchurComplement
from fitting.record.motion import from_kinematics
from fitting.search.exchange import fit_laws
from fitting.search.fit import Fit
from fitting.search.memory import fit_memory
from processing.smoothing import smooth
from rig_sim.scenes.scene import validate_content

RESULTS = Path(__file__).resolve().parent / "results"
RATE, FINE = 500.0, 2000.0  # Hz: of the record, and of the motion that it is read from
JITTER, SCATTER = 30e-6, 0.02  # s; share of the friction
NOISES = (10e-6, 30e-6, 100e-6)  # m
LEAST_CYCLES = 10
NORMAL_95 = 1.96  # standard errors
KEYS = ("misfits", "errors")
Chance = np.random.Generator


def lugre(chance: Chance) -> dict[str, float]:
    """Draw bristles that bend by some 20 um to 0.6 mm before they slip."""
    level, s0 = chance.uniform(1.2, 1.5), between(chance, 2e3, 5e4)
    damping = between(chance, 0.1, 0.7)  # over the critical one of bristles
    fall = {"Fc": level * chance.uniform(0.35, 0.6), "Fs": level, "v_s": between(chance, 0.06, 0.15)}
    return {"s0": s0, "s1": 2 * damping * math.sqrt(0.3 * s0)} | fall


def rate_and_state(shortest: float, longest: float, chance: Chance) -> dict[str, float]:
    """Draw a contact that strengthens by 8 to 12 % of its friction an e-fold of age."""
    F0 = chance.uniform(1.0, 1.4)
    b = F0 * chance.uniform(0.08, 0.12)
    return {"F0": F0, "a": b * chance.uniform(0.2, 0.4), "b": b, "D": between(chance, shortest, longest), "v0": 0.1}


CONTACTS: dict[str, Callable[[Chance], dict[str, float]]] = {
    "lugre": lugre,
    "ageing": lambda chance: rate_and_state(5e-4, 3e-3, chance),
    "slip": lambda chance: rate_and_state(2e-3, 8e-3, chance),
}


def make(law: str, noise: float, seed: int) -> tuple[Recording, dict[str, float]]:
    """Return a record of a contact that sticks and slips, and its parameters."""
    chance = np.random.default_rng([list(CONTACTS).index(law), NOISES.index(noise), seed, 4500])
    while True:
        m, K, speed = chance.uniform(0.25, 0.4), chance.uniform(30, 45), chance.uniform(0.1, 0.22)
        c, duration, own = 0.05 * m, chance.uniform(20, 60), CONTACTS[law](chance)
        content = {
            "name": "contact",
            "seed": seed,
            "mass": {"m": m},
            "spring": {"k": m * K},
            "damper": {"c": c},
            "belt": {"speed": speed},
            "friction": {"law": law, **own},
            "start": {"x": 0.05, "v": 0.0},
            "scatter": {"Fs": SCATTER},
        }
        motion = rig_sim.run(validate_content(content, "contact"), until=duration, rate=FINE)
        swings = np.sum(np.diff(np.sign(motion.x - np.mean(motion.x))) != 0) / 2
        late = motion.x[motion.x.size // 2 :]
        if swings > LEAST_CYCLES and np.ptp(late) > 0.5 * np.ptp(motion.x) and np.ptp(late) > 0.05:
            break
    time = np.arange(int(duration * RATE) - 1) / RATE
    read = np.clip(time + JITTER * chance.standard_normal(time.size), 0.0, motion.t[-1])
    position = np.interp(read, motion.t, motion.x) + noise * chance.standard_normal(time.size)
    count = chance.uniform(40e-6, 50e-6)
    rest, damping = 1e-4 * chance.standard_normal(), c * (1 + 0.1 * chance.standard_normal())
    true = {"k/m": K, "v_dr": speed} | {name: own[name] for name in own if name not in ("F0", "v0", "Fc", "Fs")}
    if law == "lugre":
        true["Fs/Fc"] = own["Fs"] / own["Fc"]
    stated: dict[str, Any] = {"mass": m, "x0": (rest, 1e-4), "damping": (damping, 0.1 * c)}
    return Recording.from_arrays(time, np.floor(position / count) * count, **stated), true


def errors(fit: Fit, true: dict[str, float], mass: float) -> dict[str, float]:
    """Return how far the parameters are from the truth, in standard errors."""
    covariance, first = SchurComplement(fit.solution.blocks).covariance, len(fit.places)
    sd, names = np.sqrt(np.diag(covariance)), list(fit.task.curve.free)
    found = {"k/m": (fit.q[0] - true["k/m"]) / sd[0], "v_dr": (fit.q[1] - true["v_dr"]) / sd[1]}
    for name, theta, own in zip(names, fit.theta, sd[first:], strict=True):
        if name in true:
            found[name] = (theta - math.log(true[name] if name in ("v_s", "D") else true[name] / mass)) / own
    if "Fs/Fc" in true:
        along = np.zeros(sd.size)
        along[first + names.index("Fs")], along[first + names.index("Fc")] = 1.0, -1.0
        ratio = along[first:] @ fit.theta
        found["Fs/Fc"] = (ratio - math.log(true["Fs/Fc"])) / math.sqrt(along @ covariance @ along)
    return {name: float(error) for name, error in found.items()}


def run(law: str, noise: float, seed: int, *, verdict: bool) -> dict[str, Any]:
    """Fit all laws with memory to a record, from the nearest of law 5; misfits are over the record's resolution."""
    recording, true = make(law, noise, seed)
    motion = from_kinematics(smooth(recording), recording.rig, None)
    own, mass = cut_run(motion, frozenset()), recording.rig.mass
    nearest = fit_laws([SIX[5]], [own], among=[SIX[5]])[0]
    row: dict[str, Any] = {"law": law, "noise": noise, "seed": seed, "true": true, "s": recording.time[-1]}
    begun = clock.process_time()
    fits = {law: fit_memory(MEMORY[law], [own], nearest)}
    row |= {"cpu_s": clock.process_time() - begun, "errors": {}}
    lost = np.array([motion.resolution])
    fits |= {other: fit_memory(MEMORY[other], [own], nearest, lost) for other in CONTACTS if other != law}
    level = motion.resolution
    row["misfits"] = {
        name: math.inf if isinstance(fit, str) else fit.geometric_mean_rms / level for name, fit in fits.items()
    }
    best = fits[law]
    if isinstance(best, Fit) and mass is not None:
        row["errors"] = errors(best, true, mass.value)
    if verdict:
        row["set"] = [str(member) for member in fitting.rank(recording).members]
    return row


def count(rows: list[dict[str, Any]]) -> dict[str, list[str]]:
    """Return the rows of the page's table."""
    found = {}
    for law, noise in dict.fromkeys((row["law"], row["noise"]) for row in rows):
        own = [row for row in rows if (row["law"], row["noise"]) == (law, noise)]
        first = [min(row["misfits"], key=row["misfits"].get) == law for row in own]
        near = [value for row in own for name, value in row["misfits"].items() if name != law]
        all_errors = [error for row in own for error in row["errors"].values()]
        covered = f"{sum(abs(error) < NORMAL_95 for error in all_errors)} of {len(all_errors)}"
        cpu = 1e3 * sum(row["cpu_s"] for row in own) / sum(row["s"] for row in own)
        kind = f"{law}, {1e6 * noise:.0f} um"
        found[kind] = [f"{sum(first)} of {len(own)}", f"{min(near):.2f}", covered, f"{cpu:.0f} ms"]
    return found


def main() -> None:
    """Fit the records, print what is found in each, and write every row as JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--output", type=Path, default=RESULTS / "memory_fits.json")
    parser.add_argument("--verdicts", action="store_true", help="also rank all laws for each record")
    parser.add_argument("--write", action="store_true", help="put the counts into the table of the page")
    given = parser.parse_args()
    rows: list[dict[str, Any]] = []
    given.output.parent.mkdir(exist_ok=True)
    for seed in range(given.first, given.first + given.seeds):
        for law in CONTACTS:
            for noise in NOISES:
                row = run(law, noise, seed, verdict=given.verdicts)
                rows.append(row)
                told = [", ".join(f"{name} {value:.2f}" for name, value in row[key].items()) for key in KEYS]
                told += [f"set {row['set']}"] if given.verdicts else []
                print(f"{law} {1e6 * noise:.0f} um {seed}, {row['cpu_s']:.2f} CPU s: {' | '.join(told)}", flush=True)
                given.output.write_text(json.dumps(rows, indent=1, default=str) + "\n")
    table = count(rows)
    for case, cells in table.items():
        print(f"| {' | '.join([case, *cells])} |")
    if given.verdicts:
        true = sum(row["law"] in row["set"] for row in rows)
        wrong = sum(len(row["set"]) == 1 and row["set"] != [row["law"]] for row in rows)
        print(f"the true law is in the set of {true} of {len(rows)} records; a wrong one is alone in {wrong}")
    if given.write:
        pages.write("identification.md", "memory_fits", table)


if __name__ == "__main__":
    main()
