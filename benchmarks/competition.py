"""What the competition of laws says of records whose truth is known, and what of it is false.

``python benchmarks/competition.py [--cases NAME,...] [--seeds N] [--first SEED] [--keep FOLDER] [--write]``: of each
case in `CASES` N records (default 2) are made by the integrator of ``tests/rig.py``, which shares nothing with
`rig_sim`, and ranked.  `find_faults` lists what counts as false.  ``--keep`` writes the records with a fault as run
files, with all that was said of them.  Rows go to ``benchmarks/results/competition.json``; with ``--write`` the counts
also into docs/identification.md.
"""

import argparse
import json
import math
import sys
import tempfile
import time as clock
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pages
from scipy.integrate import solve_ivp

import fitting
from daq.runfile import store
from daq.runfile.recording import Recording
from fitting.laws import SIX
from fitting.search.passes import WHOLE
from stickslip.errors import DataError

ROOT = Path(__file__).resolve().parent.parent
RESULTS = ROOT / "benchmarks" / "results"
sys.path.insert(0, str(ROOT))

from tests import rig  # noqa: E402
from tests.fitting import scales  # noqa: E402

STRIBECK = ("stribeck", "stribeck-viscous", "stribeck-gaussian", "stribeck-gaussian-viscous")
CALIBRATIONS = ("x0", "datum", "damping", "belt-speed", "stiffness")
CAUSES = ("not-one-contact", "random-within-slips", "break-away")
COUNT = 7.67e-6  # m
CAMERA = 1e-4  # m: noise of a camera's positions
REST_SD = 1e-4  # m: error of a stated rest position
SAME_ERRORS, SAME_RMS = 0.02, 1e-6  # of a law and its formula: parameters in standard errors, relative rms
Chance = np.random.Generator


@dataclass(frozen=True)
class Sample:
    runs: list[Recording]
    laws: tuple[int | str, ...] = ()  # those that are true; none where no law that competes is
    true: dict[str, float] = field(default_factory=dict)
    given: dict[str, Any] = field(default_factory=dict)  # keywords of `fitting.rank`
    known: bool = False  # whether a true law must be in the set, else it may have more parameters and fit equally well
    described: bool = True  # whether a law must describe the record
    causes: tuple[str, ...] = ()  # departures and findings that are true


def between(chance: Chance, low: float, high: float) -> float:
    return float(math.exp(chance.uniform(math.log(low), math.log(high))))


def by_camera(contact: rig.Contact, noise: float = CAMERA, rate: float = 250.0) -> Recording:
    times = np.arange(0, contact.duration, 1 / rate)
    noisy = rig.simulate(contact, times) + np.random.default_rng([contact.seed, 5]).normal(0, noise, times.size)
    return Recording.from_arrays(times, np.round(noisy, 6))


def record(contact: rig.Contact, chance: Chance, laws: tuple[int | str, ...] = (), **more: Any) -> Sample:
    """Return a record of a contact by a camera or by an encoder, every other one with its rest position to 0.1 mm."""
    if chance.random() < 0.5:
        run = by_camera(contact)
    else:
        run = Recording.from_arrays(*rig.recorded(contact, count=COUNT, jitter=rig.JITTER))
    return Sample([run], laws, true_values(contact), state(contact, chance), **more)


def state(contact: rig.Contact, chance: Chance) -> dict[str, Any]:
    """Return what is stated of a contact, all of it right."""
    rest = {"x0": (REST_SD * chance.standard_normal(), REST_SD)}
    return {"mass": contact.m} | (rest if chance.random() < 0.5 else {})


def true_values(contact: rig.Contact, runs: int = 1, **more: float) -> dict[str, float]:
    own = {"v_dr": contact.belt, "x0": 0.0} if runs == 1 else {"v_dr (1)": contact.belt, "x0 (1)": 0.0}
    return {"k/m": contact.k / contact.m, **own, **more}


def stribeck(chance: Chance, seed: int, *, joint: bool = False, rest: bool = False) -> Sample:
    """Make a Stribeck contact under a camera, some 90 samples a slip; every other one with 3 % scatter."""
    mass, omega = between(chance, 0.2, 1.0), chance.uniform(11, 14)
    level = mass * omega**2 * between(chance, 0.01, 0.025)
    contact = rig.Contact(
        curve="stribeck", Fs=level, Fc=level * chance.uniform(0.5, 0.7), v_s=between(chance, 0.02, 0.05), Fv=0.0,
        m=mass, k=mass * omega**2, belt_start=1.0, duration=25.0, scatter=0.03 * (seed % 2), seed=seed,
    )  # fmt: skip
    speeds = [between(chance, 0.03, 0.12)] if not joint else sorted(chance.uniform(0.03, 0.12, 2 + seed // 2 % 2))
    contacts = [replace(contact, belt=float(speed), seed=10 * seed + n) for n, speed in enumerate(speeds)]
    given = {"mass": mass} | ({"x0": (REST_SD * chance.standard_normal(), REST_SD)} if rest else {})
    true = true_values(contacts[0], len(contacts), v_s=contact.v_s)
    return Sample([by_camera(one) for one in contacts], STRIBECK, true, given, known=rest)


def hyperbolic(chance: Chance, seed: int, **more: Any) -> rig.Contact:
    drawn = {"Fs": chance.uniform(1.0, 1.8), "gamma": chance.uniform(5, 12), "belt": chance.uniform(0.12, 0.25)}
    return rig.Contact(**(drawn | {"c": 0.02, "scatter": 0.03, "duration": 25.0, "seed": seed} | more))


def lugre(chance: Chance, seed: int) -> Sample:
    """Make a contact of bristles that bend by some 0.03 to 0.3 mm before they slip."""
    level, bristles = chance.uniform(0.9, 1.4), (between(chance, 2e3, 2e4), chance.uniform(1, 5))
    contact = rig.Contact(
        Fs=level, Fc=level * chance.uniform(0.4, 0.7), v_s=between(chance, 0.03, 0.1), Fv=chance.uniform(0, 0.05),
        lugre=bristles, belt=between(chance, 0.05, 0.2), duration=20.0, seed=seed,
    )  # fmt: skip
    return record(contact, chance, ("lugre",), described=False)


def ageing(chance: Chance, seed: int) -> Sample:
    """Make a contact of rate and state (Dieterich, Ruina), regularised, followed in x, slip speed and psi."""
    contact = rig.Contact(belt=between(chance, 0.04, 0.15), duration=25.0, seed=seed)
    load, f0, v0, length = 3.0, 0.35, 0.01, between(chance, 3e-4, 3e-3)
    a, K = chance.uniform(0.018, 0.025), contact.k / contact.m
    b = a + chance.uniform(0.02, 0.05)

    def rates(_: float, y: np.ndarray) -> list[float]:
        friction = load * a * np.arcsinh(y[1] * np.exp((f0 + b * y[2]) / a) / (2 * v0)) / contact.m
        return [contact.belt - y[1], K * y[0] - friction, v0 / length * np.exp(-y[2]) - abs(y[1]) / length]

    def slopes(_: float, y: np.ndarray) -> list[list[float]]:
        grown = np.exp((f0 + b * y[2]) / a) / (2 * v0)
        root = load * grown / math.sqrt(1 + (y[1] * grown) ** 2) / contact.m
        fall = -v0 / length * np.exp(-y[2])
        return [[0, -1, 0], [K, -a * root, -b * y[1] * root], [0, -math.copysign(1 / length, y[1]), fall]]

    times, begin = np.arange(0, contact.duration, 1e-3), [0.0, contact.belt, math.log(v0 / length)]
    tight = {"rtol": 1e-7, "atol": [1e-10, 1e-14, 1e-8], "max_step": 0.05}
    run = solve_ivp(rates, (0, times[-1]), begin, method="Radau", jac=slopes, t_eval=times, **tight)
    if chance.random() < 0.5:
        made = Recording.from_arrays(times, np.floor(run.y[0] / COUNT) * COUNT)
    else:
        made = Recording.from_arrays(times[::4], np.round(run.y[0] + chance.normal(0, CAMERA, times.size), 6)[::4])
    return Sample([made], ("ageing", "slip"), true_values(contact), state(contact, chance), described=False)


def fluctuating(chance: Chance, seed: int) -> Sample:
    """Make a hyperbola whose level fluctuates within slips."""
    fluctuation = chance.uniform(0.04, 0.12), between(chance, 0.03, 0.2)
    contact = hyperbolic(chance, seed, fluctuation=fluctuation, scatter=0.0)
    return record(contact, chance, described=False, causes=("random-within-slips",))


def lost(chance: Chance, seed: int) -> Sample:
    """Make a record that loses 0.2 % of its counts in the fast part of slips."""
    contact = hyperbolic(chance, seed)
    time, position = rig.recorded(contact, count=COUNT, jitter=rig.JITTER)
    steps = np.diff(position, prepend=position[0])
    steps[np.abs(steps) > 0.5 * np.max(np.abs(steps))] *= 1 - 0.002
    run = Recording.from_arrays(time, np.floor((position[0] + np.cumsum(steps)) / COUNT) * COUNT)
    return Sample([run], (5,), {}, {"mass": contact.m}, described=False)


def two_contacts(chance: Chance, seed: int) -> Sample:
    """Make runs of two contacts on one rig."""
    first = hyperbolic(chance, seed, belt=chance.uniform(0.08, 0.14))
    other = {"Fs": first.Fs * chance.uniform(1.2, 1.5), "gamma": first.gamma * chance.uniform(0.4, 0.7)}
    runs = [by_camera(one, 2e-4, 240.0) for one in (first, hyperbolic(chance, seed + 1000, **other))]
    return Sample(runs, (), {}, state(first, chance), causes=("not-one-contact",))


def any_scale(chance: Chance, seed: int, *, foreign: bool) -> Sample | None:
    """Make a contact of ``tests/fitting/scales.py``; None where a record of it is too short to tell."""
    drawn = scales.draw(10 * seed + (6 + seed % 4 if foreign else seed % 6))
    with tempfile.TemporaryDirectory() as folder:
        held = scales.write_table(drawn, table := Path(folder) / "table.csv")
        time, position = np.loadtxt(table, delimiter=",", skiprows=1, unpack=True)
    if held.samples_per_slip < 20 or held.cycles < 10:
        return None
    words = " ".join(drawn.flags).replace("=", " ").split()
    flags = {flag: float(value) for flag, value in zip(words[::2], words[1::2], strict=True)}
    given: dict[str, Any] = {"mass": flags["--mass"]} if "--mass" in flags else {}
    if "--datum" in flags:
        given["x0"] = (-flags["--datum"], flags["--datum-sd"])
    if "--damping" in flags:
        given["damping"] = (flags["--damping"], flags["--damping-sd"])
    kinds: dict[str, tuple[int | str, ...]] = {"logarithmic": ("logarithmic",), "hard-spring": ()}
    laws = (drawn.law,) if drawn.law else kinds.get(drawn.kind, STRIBECK)
    sign = -1 if drawn.mirrored else 1
    true = true_values(drawn.contact) | {"v_dr": sign * drawn.contact.belt, "x0": drawn.x0_m}
    run, causes = Recording.from_arrays(time - time[0], position), () if laws else ("spring-nonlinear",)
    return Sample([run], laws, true, given, known=not foreign, described=bool(laws), causes=causes)


def typed(chance: Chance, seed: int) -> Sample:
    """Make a record of one of laws 3 to 6, to be fitted with that law and its formula."""
    law = 3 + seed % 4
    shape = {"curve": "linear" if law < 5 else "hyperbolic", "ramp": 0.0 if law % 2 else 0.03}
    contact = hyperbolic(chance, seed, duration=12.0, **shape)
    sample = record(contact, chance, (law,), known=True)
    return replace(sample, given=sample.given | {"laws": (law, replace(SIX[law], name=f"typed{law}"))})


CASES: dict[str, tuple[Callable[..., Sample | None], str]] = {
    "stribeck": (stribeck, "Stribeck under a camera, no rest position"),
    "stribeck-joint": (partial(stribeck, joint=True), "the same, 2 or 3 belt speeds together"),
    "stribeck-x0": (partial(stribeck, rest=True), "the same with the rest position"),
    "lugre": (lugre, "LuGre"),
    "ageing": (ageing, "rate and state"),
    "fluctuating": (fluctuating, "a level that fluctuates within slips"),
    "lost": (lost, "0.2 % of the counts lost in fast slips"),
    "two": (two_contacts, "two contacts fitted as one"),
    "six": (partial(any_scale, foreign=False), "laws 1 to 6 at any scale"),
    "foreign": (partial(any_scale, foreign=True), "none of the six at any scale"),
    "typed": (typed, "laws 3 to 6 typed as formulas"),
}


def find_faults(sample: Sample, said: dict[str, Any]) -> list[str]:
    """Return what is false in the document of a ranking."""
    members, adequacy = [*said["set"], *said.get("rivals", [])], said["adequacy"]
    adequate, rows = adequacy["verdict"] in ("adequate", None), [row for row in said["ranking"] if row["fitted"]]
    right = [law for law in sample.laws if law in (members if sample.known else [*members, *said["not_excluded"]])]
    faults = []
    if sample.described and sample.laws and not adequate:
        faults.append("no law describes the record")
    elif sample.described and sample.laws and not right:
        faults.append("another law alone" if len(members) == 1 and said["set"] else "the truth is excluded")
    elif right and not any((law if isinstance(law, str) else f"law {law}") in said["verdict"] for law in right):
        faults.append("the truth is not named")
    if not sample.laws and members:
        faults.append("a law is said to describe the record")
    constant = next((row["rms_m"] for row in rows if row["law"] == 1), math.inf)
    above = (1 + WHOLE.gain) * constant  # what a search leaves
    faults += [f"law {row['law']} errs more than constant friction" for row in rows if row["rms_m"] > above]
    sizes = [size for row in rows for size in row["parameters"].values() if not size.get("fixed")]
    claims = [row[key] for row in rows for key in ("weight", "score")] + [size["lo"] for size in sizes]
    if not adequate and (members or any(claim is not None for claim in claims)):
        faults.append("a set, weight or interval though no law describes the record")
    codes = [finding["code"] for finding in said["findings"]]
    faults += [f"{code} is accused" for code in codes if code in CALIBRATIONS]
    named = [code for code in codes if code in CAUSES] + [departure["name"] for departure in adequacy["departures"]]
    faults += [f"false cause {name}" for name in named if name not in sample.causes]
    faults += [f"{one['name']} was not fitted" for one in adequacy["departures"] if not one["refitted"]]
    if "laws" in sample.given:
        law, formula = sorted(rows[:2], key=lambda row: str(row["law"]))
        apart = [
            abs(size["value"] - formula["parameters"][name]["value"]) / size["stderr"]
            for name, size in law["parameters"].items()
            if size["stderr"] and name in formula["parameters"]
        ]
        if max(apart, default=math.inf) > SAME_ERRORS or abs(formula["rms_m"] / law["rms_m"] - 1) > SAME_RMS:
            faults.append("the formula is fitted differently")
    return faults


def compare_first_row(sample: Sample, said: dict[str, Any]) -> dict[str, tuple[bool, float]]:
    """Return by parameter whether the first row's interval contains the truth, and its error in standard errors."""
    shown = said["ranking"][0]["parameters"] if said["ranking"] else {}
    known = {name: shown[name] for name in sample.true if name in shown and shown[name]["stderr"]}
    return {
        name: (one["lo"] <= sample.true[name] <= one["hi"], (one["value"] - sample.true[name]) / one["stderr"])
        for name, one in known.items()
    }


def run(name: str, seed: int, keep: Path | None) -> dict[str, Any] | None:
    """Make and rank one record; None where the case has none of this seed."""
    sample = CASES[name][0](np.random.default_rng([list(CASES).index(name) + 4400, seed]), seed)
    if sample is None:
        return None
    begun = clock.process_time()
    row: dict[str, Any] = {"case": name, "seed": seed, "laws": sample.laws, "true": sample.true}
    try:
        said = fitting.rank(sample.runs, **sample.given).as_json()
    except DataError as error:
        said, faults = {"verdict": str(error), "ranking": []}, ["refused"]
    else:
        faults = find_faults(sample, said)
    row |= {"faults": faults, "compared": compare_first_row(sample, said), "cpu_s": clock.process_time() - begun}
    row |= {key: said.get(key) for key in ("verdict", "set", "rivals", "not_excluded", "findings", "ranking")}
    if keep is not None and faults:
        for number, recording in enumerate(sample.runs, start=1):
            store.write(keep / f"{name}-{seed}-{number}.h5", recording)
        text = json.dumps(row | {"given": sample.given}, indent=1, default=str)
        (keep / f"{name}-{seed}.json").write_text(text + "\n")
    return row


def count_faults(rows: list[dict[str, Any]]) -> dict[str, list[str]]:
    """Return the rows of the page's table: of each case how many records are without fault, and intervals right."""
    found = {}
    for case in dict.fromkeys(row["case"] for row in rows):
        own = [row for row in rows if row["case"] == case]
        right = [covered for row in own for covered, _ in row["compared"].values()]
        intervals = f"{sum(right)} of {len(right)}" if right else ""
        faults = "; ".join(dict.fromkeys(fault for row in own for fault in row["faults"]))
        found[CASES[case][1]] = [f"{sum(not row['faults'] for row in own)} of {len(own)}", intervals, faults]
    return found


def main() -> None:
    """Run the cases, print what is false in each, and write every row as JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", default=",".join(CASES))
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--keep", type=Path, help="folder for the records with a fault")
    parser.add_argument("--output", type=Path, default=RESULTS / "competition.json")
    parser.add_argument("--write", action="store_true", help="put the counts into the table of the page")
    given = parser.parse_args()
    rows: list[dict[str, Any]] = []
    given.output.parent.mkdir(exist_ok=True)
    for seed in range(given.first, given.first + given.seeds):
        for name in given.cases.split(","):
            row = run(name, seed, given.keep)
            if row is None:
                continue
            rows.append(row)
            errors = ", ".join(f"{key} {error:+.1f}" for key, (_, error) in row["compared"].items())
            print(f"{name} {seed}: {'; '.join(row['faults']) or 'no fault'} | {errors} | {row['cpu_s']:.1f} CPU s")
            print(f"    {row['verdict']}", flush=True)
            given.output.write_text(json.dumps(rows, indent=1, default=str) + "\n")
    for case, cells in count_faults(rows).items():
        print(f"| {' | '.join([case, *cells])} |")
    if given.write:
        pages.write("identification.md", "competition", count_faults(rows))


if __name__ == "__main__":
    main()
