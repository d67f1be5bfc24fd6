"""Faults of the sensor and steps of the position that the smoothing finds, on records with the exact motion known.

``python benchmarks/faults.py [--seeds N] [--first SEED] [--minutes N] [--write]``: tables of docs/velocity.md.

    kinds   spikes, drop-outs, pairs, bursts and frozen readings in records of 30 s of the laws 1 to 6: counts of 50 um
            at 1 kHz, and cameras of 400 frames a second with 0.2 and 1 mm of noise, printed to 10 um
    datum   ten steps of the position in each of these camera tracks, in standard deviations of the noise
    kicks   the mass pushed when the belt's joint passes, records of 60 s
    clean   records of 60 s without any fault: laws, pitches, jitter, nominal times, a rippling belt, cameras
    cost    CPU time of a minute with 19 spikes a second over that of the same minute without

Found is the share of the spoilt samples that were left out, or of the steps that were marked.  Seeds are those of the
scene `rig`; N of each (default 1), from SEED on (default 400).
"""

import argparse
import json
import tempfile
import time as clock
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pages
from velocity import Bench

import processing
from daq.imports import table_to_run
from daq.imports.options import ImportOptions
from daq.runfile.recording import Recording
from processing.record.kinematics import Kinematics

RESULTS = Path(__file__).resolve().parent / "results"
COUNT, FINE = 50e-6, 7.67e-6  # m
JITTER = 30e-6  # s
FRAMES = 400.0  # of a camera, Hz
LAWS = range(1, 7)
SENSORS = {"counts of 50 um": None, "camera, 0.2 mm": 2e-4, "camera, 1 mm": 1e-3}
STEPS = (5, 8, 10, 12, 30)  # standard deviations of a position
KICKS = (0.005, 0.01, 0.02, 0.05, 0.1)  # m/s
NEAR = 5  # samples from a step to where it is marked
Spoilt = tuple[np.ndarray, np.ndarray]  # samples, and what is read there, m


def recorded(law: int, noise: float | None, seed: int, duration: float = 30.0) -> Recording:
    """Return a record of a motion as an encoder (``noise`` None) or a camera with so much noise (m) shows it."""
    if noise is None:
        return Bench(seed, COUNT, JITTER, duration, **{"friction.law": law}).run()
    bench = Bench(seed, COUNT, 0.0, duration, FRAMES, **{"friction.law": law})
    return imported(bench.grid, bench.x + noise * np.random.default_rng([seed, law]).standard_normal(bench.x.size))


def imported(time: np.ndarray, position: np.ndarray) -> Recording:
    """Return the record of a camera's table, printed to 10 um."""
    with tempfile.TemporaryDirectory() as folder:
        table = Path(folder) / "track.csv"
        np.savetxt(table, np.c_[time, position], fmt=["%.6f", "%.5f"], delimiter=",", header="t,x", comments="")
        return table_to_run.read(table, ImportOptions()).run


def changed(recording: Recording, samples: np.ndarray, values: np.ndarray) -> Recording:
    """Return a record that reads ``values`` (m) at some samples."""
    position = recording.position.copy()
    position[samples] = values
    if recording.count is None:
        return replace(recording, position=np.round(position, 5))
    count = np.floor(position / COUNT).astype(np.int64)
    return replace(recording, position=count * COUNT, count=count)


def spikes(x: np.ndarray, rate: float, rng: np.random.Generator) -> Spoilt:
    """Return 19 spikes a second of 2 to 30 mm, to either side."""
    at = np.sort(rng.choice(x.size, round(19 * x.size / rate), replace=False))
    return at, x[at] + rng.choice([-1, 1], at.size) * rng.uniform(0.002, 0.03, at.size)


def zeros(x: np.ndarray, rate: float, rng: np.random.Generator) -> Spoilt:
    """Return 60 readings of zero where the mass is more than a centimetre away."""
    at = np.sort(rng.choice(x.size, 60, replace=False))
    at = at[np.abs(x[at]) > 0.01]
    return at, np.zeros(at.size)


def pairs(x: np.ndarray, rate: float, rng: np.random.Generator) -> Spoilt:
    """Return pairs of spikes of 8 mm to opposite sides, two samples apart."""
    first = np.linspace(100, x.size - 200, 54).astype(int)
    return np.r_[first, first + 2], np.r_[x[first] + 8e-3, x[first + 2] - 8e-3]


def bursts(x: np.ndarray, rate: float, rng: np.random.Generator) -> Spoilt:
    """Return three spikes in a row of 8 mm, each to either side."""
    at = np.add.outer(np.linspace(100, x.size - 200, 54).astype(int), np.arange(3)).ravel()
    return at, x[at] + 8e-3 * rng.choice([-1, 1], at.size)


def frozen(seconds: float) -> Callable[[np.ndarray, float, np.random.Generator], Spoilt]:
    """Return what makes five readings stay for so long."""

    def held(x: np.ndarray, rate: float, rng: np.random.Generator) -> Spoilt:
        length = round(seconds * rate)
        first = np.linspace(0.1 * x.size, 0.8 * x.size, 5).astype(int) + rng.integers(0, round(0.1 * x.size), 5)
        at = np.add.outer(first, np.arange(1, length)).ravel()
        return at, np.repeat(x[first], length - 1)

    return held


KINDS = {
    "spikes of 2 to 30 mm, 19 a second": spikes,
    "drop-outs to zero": zeros,
    "opposite pairs, 8 mm": pairs,
    "bursts of three, 8 mm": bursts,
    "readings frozen for 400 ms": frozen(0.4),
    "readings frozen for 50 ms": frozen(0.05),
}


def kinds(seeds: range) -> dict[str, dict[str, list[int]]]:
    """Return by fault and sensor: spoilt samples that were found, all of them, and sound ones left out."""
    found: dict[str, dict[str, list[int]]] = {kind: {sensor: [0, 0, 0] for sensor in SENSORS} for kind in KINDS}
    for sensor, noise in SENSORS.items():
        for law in LAWS:
            for seed in seeds:
                clean = recorded(law, noise, seed)
                for number, (kind, fault) in enumerate(KINDS.items()):
                    rng = np.random.default_rng([seed, law, number])
                    at, values = fault(clean.position, clean.rate_hz, rng)
                    out = processing.smooth(changed(clean, at, values)).missing
                    counts = found[kind][sensor]
                    counts[0] += int(out[at].sum())
                    counts[1] += at.size
                    counts[2] += int(out.sum() - out[at].sum())
    return found


def datum(seeds: range) -> dict[int, list[int]]:
    """Return by the size of a step of a camera's datum how many were found, how many there were, and false ones."""
    found = {size: [0, 0, 0] for size in STEPS}
    for noise in (2e-4, 1e-3):
        for law in LAWS:
            for seed in seeds:
                clean = recorded(law, noise, seed)
                for size, counts in found.items():
                    rng = np.random.default_rng([seed, law, size])
                    at = np.linspace(0.05, 0.93, 10) + rng.uniform(0, 0.04, 10)
                    at = (at * clean.position.size).astype(int)
                    signs = rng.choice([-1, 1], at.size)
                    moved = clean.position.copy()
                    for place, sign in zip(at, signs, strict=True):
                        moved[place:] += sign * size * noise
                    seen = processing.smooth(replace(clean, position=np.round(moved, 5))).losses
                    first = np.array([step.first for step in seen])
                    hits = sum(first.size > 0 and np.abs(first - place).min() <= NEAR for place in at)
                    counts[0] += int(hits)
                    counts[1] += at.size
                    counts[2] += max(0, len(seen) - int(hits))
    return found


def kicked(seeds: range) -> dict[float, list[int]]:
    """Return by the size of a kick how many were found, how many there were, and false ones."""
    found = {kick: [0, 0, 0] for kick in KICKS}
    for kick, counts in found.items():
        for seed in seeds:
            bench = Bench(seed, FINE, JITTER, 60.0, **{"joint.kick": kick})
            seen = np.array([bench.time[own.sample] for own in processing.smooth(bench.run()).kicks])
            hits = sum(seen.size > 0 and np.abs(seen - at).min() < 4e-3 for at in bench.kicks)
            counts[0] += int(hits)
            counts[1] += bench.kicks.size
            counts[2] += max(0, seen.size - int(hits))
    return found


def sound(minutes: int, first: int) -> Iterator[tuple[str, Kinematics]]:
    """Yield minutes without faults, and what kind each is."""
    makers: list[tuple[str, Callable[[int], Kinematics]]] = []
    for law in LAWS:
        for pitch, jitter in ((1e-6, 0.0), (FINE, JITTER), (FINE, 1e-4), (COUNT, JITTER)):
            name = f"law {law}, {1e6 * pitch:g} um, jitter {1e6 * jitter:g} us"
            made = {"friction.law": law}
            makers.append((name, lambda s, p=pitch, j=jitter, m=made: processing.smooth(Bench(s, p, j, **m).run())))
        for noise in (2e-5, 2e-4, 1e-3):
            name = f"law {law}, camera of {1e3 * noise:g} mm"
            makers.append((name, lambda s, la=law, n=noise: processing.smooth(recorded(la, n, s, 60.0))))
    changes: dict[str, dict[str, object]] = {
        "nominal times": {},
        "Coulomb, break-away at 1.3 Fs": {"friction.law": 1, "friction.static": 1.3},
        "ripple of 2 mm/s": {"belt.ripple": 2e-3, "belt.ripple_hz": 3.0},
        "ripple of 10 mm/s": {"belt.ripple": 1e-2, "belt.ripple_hz": 3.0},
    }
    for name, own in changes.items():
        times = "nominal" if name == "nominal times" else "recorded"
        makers.append((name, lambda s, o=own, t=times: processing.smooth(Bench(s, FINE, JITTER, **o).run(), times=t)))
    for k in range(minutes):
        name, make = makers[k % len(makers)]
        yield name, make(first + k)


def clean(minutes: int, first: int) -> dict[str, Any]:
    """Return how many minutes there were, with counts and without, and what was found in them, which is false."""
    total: dict[str, Any] = {"minutes": 0, "minutes with counts": 0, "readings": 0, "steps": 0, "kicks": 0, "where": []}
    for name, made in sound(minutes, first):
        total["minutes"] += 1
        total["minutes with counts"] += made.recording.count is not None
        wrong = {"readings": int(made.missing.sum()), "steps": len(made.losses), "kicks": len(made.kicks)}
        for key, number in wrong.items():
            total[key] += number
        if any(wrong.values()):
            total["where"].append([name, first + total["minutes"] - 1, wrong])
    return total


def cost(seeds: range, repeats: int = 7) -> dict[str, list[float]]:
    """Return by law the CPU time of a minute with 19 spikes a second over that of the minute without, a seed each."""
    found: dict[str, list[float]] = {}
    for law in LAWS:
        for seed in seeds:
            sane = recorded(law, None, seed, 60.0)
            rng = np.random.default_rng([seed, law])
            pair = sane, changed(sane, *spikes(sane.position, sane.rate_hz, rng))
            spent: list[list[float]] = [[], []]
            for turn in range(repeats + 1):
                for which, record in enumerate(pair):
                    begun = clock.process_time()
                    processing.smooth(record)
                    if turn:
                        spent[which].append(clock.process_time() - begun)
            found.setdefault(f"law {law}", []).append(min(spent[1]) / min(spent[0]))
    return found


def share(found: int, of: int) -> str:
    """Return a share to three digits, and of how many."""
    return f"{found / of:.3f} of {of}" if of else "-"


def page_tables(results: dict[str, Any]) -> dict[str, dict[str, list[str]]]:
    """Return the rows of the tables of the page, by table and first cell."""
    quiet = results["clean"]
    steps = {f"camera's datum, {size} standard deviations": counts for size, counts in results["datum"].items()}
    steps |= {f"velocity, {1e3 * float(kick):g} mm/s": counts for kick, counts in results["kicks"].items()}
    return {
        "faults kinds": {
            kind: [*(share(*of[sensor][:2]) for sensor in SENSORS), str(sum(one[2] for one in of.values()))]
            for kind, of in results["kinds"].items()
        },
        "faults steps": {name: [share(*counts[:2]), str(counts[2])] for name, counts in steps.items()},
        "faults clean": {
            "readings left out": [str(quiet["minutes"]), str(quiet["readings"])],
            "steps of the position": [str(quiet["minutes"]), str(quiet["steps"])],
            "velocity steps": [str(quiet["minutes with counts"]), str(quiet["kicks"])],
        },
    }


def main() -> None:
    """Run the studies, print them, write JSON, and with ``--write`` the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--first", type=int, default=400)
    parser.add_argument("--minutes", type=int, default=150)
    parser.add_argument("--write", action="store_true", help="put the results into the tables of docs/velocity.md")
    given = parser.parse_args()
    seeds = range(given.first, given.first + given.seeds)
    results: dict[str, Any] = {"kinds": kinds(seeds), "datum": datum(seeds), "kicks": kicked(seeds)}
    results |= {"clean": clean(given.minutes, given.first), "cost": cost(seeds)}
    made = page_tables(results)
    for name, table in made.items():
        print(f"\n{name}")
        for first, cells in table.items():
            print(f"  {first:44} {'   '.join(cells)}")
    print("\nCPU time with spikes over that without: mean, largest")
    for law, ratios in results["cost"].items():
        print(f"  {law:44} {np.mean(ratios):.2f}   {max(ratios):.2f}")
    for wrong in results["clean"]["where"]:
        print("  false:", *wrong)
    for name, table in made.items() if given.write else ():
        pages.write("velocity.md", name, table)
    RESULTS.mkdir(exist_ok=True)
    (RESULTS / "faults.json").write_text(json.dumps(results, indent=1, default=str) + "\n")


if __name__ == "__main__":
    main()
