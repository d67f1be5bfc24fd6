"""What the competition of laws says of records whose truth is known, and what of it is false.

``python benchmarks/competition.py [--cases NAME,...] [--seeds N] [--first SEED] [--keep FOLDER] [--write]``: of each
case N records (default 2) are made by the integrator of ``tests/rig.py``, which shares nothing with `rig_sim`, and
ranked.  `CASES` lists what there is: Stribeck contacts under a camera with and without the spring's rest position;
friction with memory, that fluctuates, lost counts and two contacts fitted as one; contacts of any scale; the six laws
typed as formulas.  `find_faults` lists what is counted as false.  ``--keep`` writes the records with a fault as run
files, with what is true of them.

Rows are written to ``benchmarks/results/competition.json``; with ``--write`` the counts also into
docs/identification.md.
"""

import argparse
import json
import math
import sys
import time as clock
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

import fitting
from daq.runfile import store
from daq.runfile.recording import Recording
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
TOLD = 1e-4  # m: error of a stated rest position
Chance = np.random.Generator


@dataclass(frozen=True)
class Sample:
    """Runs with the truth about them.

    Attributes
    ----------
    runs : list of Recording
    laws : tuple
        The laws, numbers or names, that are true; none where no law that competes is.
    true : dict
        True values of parameters.
    given : dict
        Keywords of `fitting.rank`.
    known : bool
        Whether a true law must be in the set, else it may be equally good and have more parameters.
    described : bool
        Whether a law must describe the record; False where it has a fault.
    causes : tuple of str
        Departures and findings that are true.
    """

    runs: list[Recording]
    laws: tuple[int | str, ...] = ()
    true: dict[str, float] = field(default_factory=dict)
    given: dict[str, Any] = field(default_factory=dict)
    known: bool = False
    described: bool = True
    causes: tuple[str, ...] = ()


def between(chance: Chance, low: float, high: float) -> float:
    """Return a number that is even in its logarithm."""
    return float(math.exp(chance.uniform(math.log(low), math.log(high))))


def by_camera(contact: rig.Contact, noise: float = CAMERA, rate: float = 250.0) -> Recording:
    """Return a camera's track of a contact, bare of calibration."""
    times = np.arange(0, contact.duration, 1 / rate)
    noisy = rig.simulate(contact, times) + np.random.default_rng([contact.seed, 5]).normal(0, noise, times.size)
    return Recording.from_arrays(times, np.round(noisy, 6))


def parameters(contact: rig.Contact, runs: int = 1, **more: float) -> dict[str, float]:
    """Return the true parameters that all laws share."""
    own = {"v_dr": contact.belt, "x0": 0.0} if runs == 1 else {"x0 (1)": 0.0}
    return {"k/m": contact.k / contact.m, **own, **more}


def stribeck(chance: Chance, seed: int, *, joint: bool = False, rest: bool = False) -> Sample:
    """A Stribeck contact with some 90 samples a slip; every other one with 3 % scatter."""
    mass, omega = between(chance, 0.2, 1.0), chance.uniform(11, 14)
    level = mass * omega**2 * between(chance, 0.01, 0.025)
    contact = rig.Contact(
        curve="stribeck", Fs=level, Fc=level * chance.uniform(0.5, 0.7), v_s=between(chance, 0.02, 0.05), Fv=0.0,
        m=mass, k=mass * omega**2, belt_start=1.0, duration=25.0, scatter=0.03 * (seed % 2), seed=seed,
    )  # fmt: skip
    speeds = [between(chance, 0.03, 0.12)] if not joint else sorted(chance.uniform(0.03, 0.12, 2 + seed // 2 % 2))
    contacts = [rig.replace(contact, belt=float(speed), seed=10 * seed + n) for n, speed in enumerate(speeds)]
    given = {"mass": mass} | ({"x0": (TOLD * chance.standard_normal(), TOLD)} if rest else {})
    true = parameters(contacts[0], len(contacts), v_s=contact.v_s)
    return Sample([by_camera(one) for one in contacts], STRIBECK, true, given, known=rest)


def read(contact: rig.Contact, chance: Chance, rate: float = 1000.0) -> Recording:
    """Return a contact's record by a camera or by an encoder, with its mass and the rest position to 0.1 mm."""
    if chance.random() < 0.5:
        return by_camera(contact, rate=250.0)
    time, position = rig.recorded(contact, rate=rate, count=COUNT, jitter=rig.JITTER)
    return Recording.from_arrays(time, position)


def told(contact: rig.Contact, chance: Chance) -> dict[str, Any]:
    """Return a calibration that is right, of every other record."""
    x0 = {"x0": (TOLD * chance.standard_normal(), TOLD)}
    return {"mass": contact.m} | (x0 if chance.random() < 0.5 else {})


def hyperbolic(chance: Chance, seed: int, **more: Any) -> rig.Contact:
    """A contact of law 5 about the rig's."""
    drawn = {"Fs": chance.uniform(1.0, 1.8), "gamma": chance.uniform(5, 12), "belt": chance.uniform(0.12, 0.25)}
    return rig.Contact(**(drawn | {"c": 0.02, "scatter": 0.03, "duration": 25.0, "seed": seed} | more))


def lugre(chance: Chance, seed: int) -> Sample:
    """Bristles that bend by some 0.03 to 0.3 mm before they slip."""
    level = chance.uniform(0.9, 1.4)
    contact = rig.Contact(
        Fs=level, Fc=level * chance.uniform(0.4, 0.7), v_s=between(chance, 0.03, 0.1), Fv=chance.uniform(0, 0.05),
        lugre=(between(chance, 2e3, 2e4), chance.uniform(1, 5)), belt=between(chance, 0.05, 0.2), duration=20.0, seed=seed,
    )  # fmt: skip
    return Sample([read(contact, chance)], ("lugre",), parameters(contact), told(contact, chance), described=False)


def ageing(chance: Chance, seed: int) -> Sample:
    """Friction of rate and state: the law of Dieterich and Ruina, regularised, followed in x, slip speed and psi."""
    contact = rig.Contact(belt=between(chance, 0.02, 0.15), duration=20.0, seed=seed)
    load, f0, v0, length = 3.0, 0.35, 0.01, between(chance, 3e-4, 3e-3)
    a = chance.uniform(0.018, 0.025)
    b = a + chance.uniform(0.02, 0.05)

    def rates(_: float, state: np.ndarray) -> list[float]:
        x, slip, psi = state
        friction = load * a * np.arcsinh(slip * np.exp((f0 + b * psi) / a) / (2 * v0))
        steady = v0 / length * np.exp(-psi) - abs(slip) / length
        return [contact.belt - slip, (contact.k * x - friction) / contact.m, steady]

    def slopes(_: float, state: np.ndarray) -> list[list[float]]:
        _, slip, psi = state
        grown = np.exp((f0 + b * psi) / a) / (2 * v0)
        root = load * grown / math.sqrt(1 + (slip * grown) ** 2) / contact.m
        fall = -v0 / length * np.exp(-psi)
        return [
            [0, -1, 0],
            [contact.k / contact.m, -a * root, -b * slip * root],
            [0, -math.copysign(1 / length, slip), fall],
        ]

    times = np.arange(0, contact.duration, 1e-3)
    begin, tight = (
        [0.0, contact.belt, math.log(v0 / length)],
        {"rtol": 1e-7, "atol": [1e-10, 1e-14, 1e-8], "max_step": 0.05},
    )
    run = solve_ivp(rates, (0, times[-1]), begin, method="Radau", jac=slopes, t_eval=times, **tight)
    counts = np.floor(run.y[0] / COUNT) * COUNT
    noisy = np.round(run.y[0] + chance.normal(0, CAMERA, times.size), 6)
    record = (
        Recording.from_arrays(times, counts) if chance.random() < 0.5 else Recording.from_arrays(times[::4], noisy[::4])
    )
    return Sample([record], ("ageing", "slip"), parameters(contact), told(contact, chance), described=False)


def fluctuating(chance: Chance, seed: int) -> Sample:
    """A hyperbola whose level fluctuates within slips."""
    contact = hyperbolic(
        chance, seed, fluctuation=(chance.uniform(0.04, 0.12), between(chance, 0.03, 0.2)), scatter=0.0
    )
    causes = ("random-within-slips",)
    return Sample(
        [read(contact, chance)], (), parameters(contact), told(contact, chance), described=False, causes=causes
    )


def lost(chance: Chance, seed: int) -> Sample:
    """An encoder that loses 0.2 % of its counts in the fast part of slips."""
    contact = hyperbolic(chance, seed)
    time, position = rig.recorded(contact, count=COUNT, jitter=rig.JITTER)
    steps = np.diff(position, prepend=position[0])
    steps[np.abs(steps) > 0.5 * np.max(np.abs(steps))] *= 1 - 0.002
    run = Recording.from_arrays(time, np.floor((position[0] + np.cumsum(steps)) / COUNT) * COUNT)
    return Sample([run], (5,), {}, {"mass": contact.m}, described=False)


def two_contacts(chance: Chance, seed: int) -> Sample:
    """Two contacts on one rig, fitted as one."""
    first = hyperbolic(chance, seed, belt=chance.uniform(0.08, 0.14))
    second = hyperbolic(
        chance, seed + 1000, Fs=first.Fs * chance.uniform(1.2, 1.5), gamma=first.gamma * chance.uniform(0.4, 0.7)
    )
    runs = [by_camera(one, 2e-4, 240.0) for one in (first, second)]
    return Sample(runs, (), {}, told(first, chance), causes=("not-one-contact",))


def any_scale(chance: Chance, seed: int, *, foreign: bool) -> Sample | None:
    """A contact of ``tests/fitting/scales.py``; None where it is too short to tell."""
    numbers = [number for number in range(10) if (number < 6) != foreign]
    drawn = scales.draw(10 * seed + numbers[seed % len(numbers)])
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        table = Path(folder) / "table.csv"
        held = scales.write_table(drawn, table)
        time, position = np.loadtxt(table, delimiter=",", skiprows=1, unpack=True)
    if held.samples_per_slip < 20 or held.cycles < 10:
        return None
    contact, flags = drawn.contact, dict(zip(*[iter(" ".join(drawn.flags).replace("=", " ").split())] * 2, strict=True))
    given: dict[str, Any] = {"mass": float(flags["--mass"])} if "--mass" in flags else {}
    if "--datum" in flags:
        given["x0"] = (-float(flags["--datum"]), float(flags["--datum-sd"]))
    if "--damping" in flags:
        given["damping"] = (float(flags["--damping"]), float(flags["--damping-sd"]))
    laws: tuple[int | str, ...] = (
        (drawn.law,) if drawn.law else {"logarithmic": ("logarithmic",)}.get(drawn.kind, STRIBECK)
    )
    causes: tuple[str, ...] = ()
    if drawn.kind == "hard-spring":
        laws, causes = (), ("spring-nonlinear",)
    true = {"k/m": contact.k / contact.m, "v_dr": (-1 if drawn.mirrored else 1) * contact.belt, "x0": drawn.x0_m}
    run = Recording.from_arrays(time - time[0], position)
    return Sample([run], laws, true, given, known=not foreign, described=drawn.kind != "hard-spring", causes=causes)


def typed(chance: Chance, seed: int) -> Sample:
    """A record of law 5, fitted with law 5 and its formula."""
    contact = hyperbolic(chance, seed, duration=12.0)
    given = {"mass": contact.m, "laws": (5, fitting.Law("mine", "Fs/(1 + gamma*s)"))}
    return Sample([read(contact, chance)], (5,), parameters(contact), given)


CASES: dict[str, tuple[Callable[..., Sample | None], str]] = {
    "stribeck": (stribeck, "Stribeck under a camera, no rest position"),
    "stribeck-joint": (partial(stribeck, joint=True), "the same, 2 or 3 belt speeds together"),
    "stribeck-x0": (partial(stribeck, rest=True), "the same with the rest position"),
    "lugre": (lugre, "LuGre"),
    "ageing": (ageing, "rate and state"),
    "fluctuating": (fluctuating, "level that fluctuates within slips"),
    "lost": (lost, "0.2 % of the counts lost in fast slips"),
    "two": (two_contacts, "two contacts fitted as one"),
    "six": (partial(any_scale, foreign=False), "laws 1 to 6 at any scale"),
    "foreign": (partial(any_scale, foreign=True), "none of the six at any scale"),
    "typed": (typed, "law 5 typed as a formula"),
}


def find_faults(sample: Sample, said: dict[str, Any]) -> list[str]:
    """Return what is false in the document of a ranking."""
    members = [*said["set"], *said.get("rivals", [])]
    rows = {row["law"]: row for row in said["ranking"]}
    adequate = said["adequacy"]["verdict"] in ("adequate", None)
    faults = []
    right = [law for law in sample.laws if law in (members if sample.known else [*members, *said["not_excluded"]])]
    if sample.described and sample.laws and not right:
        faults.append("truth is not in the set" if sample.known else "truth is excluded")
        if adequate and len(members) == 1 and said["set"]:
            faults.append("another law alone")
    elif right and not any(words(law) in said["verdict"] for law in right):
        faults.append("truth is not named")
    if sample.described and sample.laws and not adequate:
        faults.append("no law describes the record")
    if not sample.laws and members:
        faults.append("a law is said to describe the record")
    constant = (rows.get(1) or {}).get("rms_m")
    fitted = [row for row in said["ranking"] if row["fitted"]]
    if constant is not None:
        faults += [
            f"law {row['law']} errs more than constant friction"
            for row in fitted
            if row["rms_m"] > constant * (1 + 1e-9)
        ]
    sizes = [one for row in fitted for one in row["parameters"].values()]
    if not adequate and (
        members or any(row["weight"] is not None or row["score"] is not None or row["in_set"] for row in fitted)
    ):
        faults.append("a set or weight though no law describes the record")
    if not adequate and any(
        one["lo"] is not None or one["stderr"] is not None for one in sizes if not one.get("fixed")
    ):
        faults.append("an interval though no law describes the record")
    codes = [one["code"] for one in said["findings"]]
    faults += [f"accuses {code}" for code in codes if code in CALIBRATIONS]
    named = [code for code in codes if code in CAUSES] + [one["name"] for one in said["adequacy"]["departures"]]
    faults += [f"false cause {name}" for name in named if name not in sample.causes]
    faults += [f"{one['name']} was not refitted" for one in said["adequacy"]["departures"] if not one["refitted"]]
    return faults


def words(law: int | str) -> str:
    """Return how a verdict names a law."""
    return f"law {law}" if isinstance(law, int) else law


def coverage(sample: Sample, said: dict[str, Any]) -> dict[str, tuple[bool, float]]:
    """Return by parameter whether the first row's interval contains the truth, and the error in standard errors."""
    first = said["ranking"][0] if said["ranking"] else {"parameters": {}}
    found = {}
    for name, true in sample.true.items():
        one = first["parameters"].get(name)
        if one and one["lo"] is not None and one["stderr"]:
            found[name] = one["lo"] <= true <= one["hi"], (one["value"] - true) / one["stderr"]
    return found


def run(name: str, seed: int, keep: Path | None) -> dict[str, Any] | None:
    """Make and rank one record; None where the case has none of this seed."""
    sample = CASES[name][0](np.random.default_rng([list(CASES).index(name) + 4400, seed]), seed)
    if sample is None:
        return None
    begun = clock.process_time()
    row: dict[str, Any] = {
        "case": name,
        "seed": seed,
        "laws": sample.laws,
        "true": sample.true,
        "given": str(sample.given),
    }
    try:
        said = fitting.rank(sample.runs, **sample.given).as_json()
    except DataError as error:
        return row | {
            "faults": ["refused"],
            "verdict": str(error),
            "covered": {},
            "cpu_s": clock.process_time() - begun,
        }
    row |= {
        "faults": find_faults(sample, said),
        "covered": coverage(sample, said),
        "cpu_s": clock.process_time() - begun,
    }
    row |= {key: said.get(key) for key in ("verdict", "set", "rivals", "not_excluded", "findings")}
    row |= {"adequacy": said["adequacy"]["verdict"], "departures": said["adequacy"]["departures"]}
    row["rows"] = [
        {key: one[key] for key in ("law", "rms_m", "misfit", "weight", "fitted", "parameters")}
        | {"reason": one["reason"]}
        for one in said["ranking"]
    ]
    if keep is not None and row["faults"]:
        for number, recording in enumerate(sample.runs, start=1):
            store.write(keep / f"{name}-{seed}-{number}.h5", recording)
        (keep / f"{name}-{seed}.json").write_text(json.dumps(row, indent=1, default=str) + "\n")
    return row


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
            z = ", ".join(f"{key} {error:+.1f}" for key, (_, error) in row["covered"].items())
            print(
                f"{name} {seed}: {'; '.join(row['faults']) or 'ok'} | {row['verdict'][:230]} | {z} | {row['cpu_s']:.1f} CPU s",
                flush=True,
            )
            given.output.write_text(json.dumps(rows, indent=1, default=str) + "\n")


if __name__ == "__main__":
    main()
