"""Identification study on the simulated rig: accuracy of verdict and parameters, coverage and CPU time.

``python benchmarks/identify.py [--seeds N] [--first SEED] [--scenes nominal,harsh,...] [--jobs N] [--write]``: every
law is recorded (30 s at 1 kHz, the scene `rig`), smoothed and ranked N times (default 20) in each scene:

    nominal     scatter 3-10 %, wear 3-15 % over the run, joint kicks to 20 mm/s, jitter to 100 us, counts of 7.67 or
                50 um, damping 0.1-1 % of critical; calibrations as the board sends them, datum to 0.5 mm (sd)
    harsh       scatter 12 %, wear 25 %, jitter 200 us, belt ripple 2 %; the rest as nominal
    clean       no disturbance except counts of 7.67 um
    droop       law 5 on a belt that loses 1 % of its speed under load, nominal noise: without belt counts
    tachometer  the same with belt counts
    speeds      three runs of 16 s at 0.1, 0.2 and 0.3 m/s, nominal noise, fitted together

``--scenes`` selects the scenes (default nominal).  ``--write`` puts the rows of these scenes, and of the nominal one
the errors of the parameters, into the tables of docs/identification.md and docs/explanation/how-sure.md; rows of others
stay.  Only the benchmark reads the true
values; the commands do not.  Errors are relative to them; the true Fs/m is its mean over the times of the cycles, with
wear but without scatter.  CPU time is user and system time of the ranking alone, without compilation.
"""

import argparse
import json
import math
import os
import resource
import sys
import tempfile
import time as clock
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import pages

import fitting
import processing
import rig_sim
from daq.protocols.request import RecordRequest
from daq.recorder import ports
from daq.recorder.record import record
from daq.runfile import store
from rig_sim.motion.play import ScenePlayer
from stickslip.errors import DataError

RESULTS = Path(__file__).resolve().parent / "results"
K, FS, GAMMA, G_SLIP, D, MASS = 35.184, 0.13068, 9.618, 0.6, 0.03, 0.3
COUNT = 0.12566 / 4096 / 4  # m
CRITICAL = 2 * MASS * math.sqrt(K)
DURATION, JOINT_DURATION = 30.0, 16.0
SPEEDS = (0.1, 0.2, 0.3)
LAWS_OF = {"droop": (5,), "tachometer": (5,)}
SCENES = ("nominal", "harsh", "clean", "droop", "tachometer", "speeds")
SAID = {  # how the pages call the scenes
    "nominal": "encoder, disturbances of a laboratory rig",
    "harsh": "encoder, harsh: 12 % scatter, 25 % wear, 2 % ripple",
}
LIMITS = {"k/m": 0.5, "v_dr": 0.15, "Fs/m": 3.0, "gamma": 5.5, "G_slip/m": 5.5, "d": 6.0}  # %, p90, nominal


def draw(scene: str, law: int, seed: int) -> dict[str, Any]:
    """Return the values set in the scene `rig` for one run."""
    rng = np.random.default_rng([SCENES.index(scene) if scene != "tachometer" else SCENES.index("droop"), law, seed])
    changes: dict[str, Any] = {"friction.law": law, "seed": 100 * seed + law}
    if scene == "clean":
        return changes | {"scatter.Fs": 0.0, "jitter.rms": 0.0}
    harsh = scene == "harsh"
    changes |= {
        "scatter.Fs": 0.12 if harsh else rng.uniform(0.03, 0.10),
        "wear.rate": (0.25 if harsh else rng.uniform(0.03, 0.15)) / DURATION,
        "joint.kick": rng.uniform(-0.02, 0.02),
        "jitter.rms": 200e-6 if harsh else rng.uniform(0, 100e-6),
        "encoder.lines_per_rev": int(rng.choice((4096, 628))),
        "damper.c": rng.uniform(0.001, 0.01) * CRITICAL,
    }
    if harsh:
        changes |= {"belt.ripple": 0.02 * 0.22, "belt.ripple_hz": rng.uniform(0.5, 5.0)}
    if scene in ("droop", "tachometer"):
        changes["droop.fraction"] = 0.01
    if scene == "tachometer":
        changes["belt.channel"] = True
    return changes


def levels(changes: dict[str, Any], duration: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the times of the break-aways (s) and the friction at these times divided by Fs."""
    motion = ScenePlayer(rig_sim.scene("rig", **changes))
    motion.events = []
    path = motion.follow(np.arange(0.0, duration, 1e-3))
    begin = np.array([path.nodes.t[node] for node, _ in path.flows])
    factor = np.array([flow.factor for _, flow in path.flows])
    t = np.array([event.t for event in motion.events if event.kind.startswith("S>")])
    return t, factor[np.searchsorted(begin, t, side="left") - 1]


def ranked(changes: dict[str, Any], duration: float, folder: str) -> Any:
    """Record and smooth one run."""
    path = Path(folder) / f"{changes['seed']}-{changes.get('belt.speed', 0)}.h5"
    listed = [f"{key}={json.dumps(value)}" for key, value in changes.items()]
    record(RecordRequest(ports.rig_url("rig", listed, False), path, 1000, duration))
    kinematics = processing.smooth(store.load(path))
    path.unlink()
    return kinematics


def run(case: tuple[str, int, int]) -> dict[str, Any]:
    """Record, smooth and rank one case; return the results together with the true values."""
    scene, law, seed = case
    changes = draw(scene, law, seed)
    with tempfile.TemporaryDirectory() as folder:
        if scene == "speeds":
            each = [changes | {"belt.speed": speed, "seed": 10 * changes["seed"] + n} for n, speed in enumerate(SPEEDS)]
            kinematics: Any = [ranked(one, JOINT_DURATION, folder) for one in each]
        else:
            kinematics = ranked(changes, DURATION, folder)
    row: dict[str, Any] = {"scene": scene, "law": law, "seed": seed, "changes": changes}
    before, begun = clock.process_time(), resource.getrusage(resource.RUSAGE_SELF)
    try:
        ranking = fitting.rank(kinematics)
    except DataError as error:
        return row | {"set": [], "said": str(error), "cpu_s": clock.process_time() - before}
    after = resource.getrusage(resource.RUSAGE_SELF)
    row |= {
        "set": list(ranking.laws_in_set),
        "said": ranking.verdict,
        "warnings": list(ranking.warnings),
        "cpu_s": after.ru_utime + after.ru_stime - begun.ru_utime - begun.ru_stime,
        "outcomes": {str(one.law): one.fit.outcome for one in ranking.rows},
        "weights": {str(one.law): one.weight for one in ranking.rows},
    }
    mine = next((one for one in ranking.rows if one.law == law), None)
    if mine is None or scene == "speeds":
        return row
    row["rms_m"] = mine.rms_m
    onsets = np.array([event.t for event in ranking.events])
    middle = float(np.mean([event.t for event in ranking.events if math.isfinite(event.kinetic_scale)]))
    rate = changes.get("wear.rate", 0.0)
    t, factor = levels(changes, DURATION)
    # With constant friction there is hardly any landing, so its friction level is the one drawn; else the mean is 1.
    worn = 1 - rate * middle if law > 2 else float(np.mean(factor[1:] if factor.size > 1 else factor))
    truth = {
        "k/m": K, "Fs/m": K * FS * worn, "Fs/k": FS * worn, "v_dr": 0.22, "gamma": GAMMA, "G_slip/m": G_SLIP / MASS,
        "d": D, "c/m": changes.get("damper.c", 0.0) / MASS, "wear": rate, "k": K * MASS, "Fs": K * FS * MASS * worn,
        "G_slip": G_SLIP, "c": changes.get("damper.c", 0.0), "Fs0/m": K * FS,
    }  # fmt: skip
    if changes.get("scatter.Fs") and mine.law in (3, 4):
        # scatter and wear act on the whole curve, its slope included
        truth["G_slip/m"] *= worn
        truth["G_slip"] *= worn
    row["parameters"] = {
        name: {"value": one.value, "lo": one.lo, "hi": one.hi, "stderr": one.stderr, "truth": truth[name]}
        for name, one in mine.parameters.items()
        if name in truth
    }
    if ranking.best.law == law:
        load = math.nan * onsets
        for i, event in enumerate(ranking.events):
            nearest = int(np.argmin(np.abs(t - event.t)))
            if abs(t[nearest] - event.t) < 0.2 and event.flag == "" and math.isfinite(event.break_away_level):
                seen = event.break_away_level * mine.parameters["Fs/m"].value / (K * FS)
                load[i] = seen / factor[nearest] - 1
        found = load[np.isfinite(load)]
        if not found.size:
            return row
        middle = float(np.median(found))
        row["static"] = {"bias": middle, "mad": float(np.median(np.abs(found - middle))), "events": int(found.size)}
    return row


def share(values: list[bool]) -> str:
    """Return a share as text."""
    return f"{100 * sum(values) / len(values):5.1f} % ({sum(values)}/{len(values)})" if values else "-"


def table(rows: list[dict[str, Any]], scene: str) -> None:
    """Print the results of one scene."""
    mine = [row for row in rows if row["scene"] == scene]
    print(f"\n{scene}: {len(mine)} rankings, median {np.median([row['cpu_s'] for row in mine]):.2f} CPU s")
    alone = [row for row in mine if len(row["set"]) == 1]
    print("  truth in the set ", share([row["law"] in row["set"] for row in mine]))
    print("  a set of one law right ", share([row["set"] == [row["law"]] for row in alone]))
    print("  first place right ", share([row["set"][:1] == [row["law"]] for row in mine]))
    for law in sorted({row["law"] for row in mine}):
        own = [row for row in mine if row["law"] == law]
        line = share([row["set"][:1] == [law] for row in own])
        only = share([row["set"] == [law] for row in own])
        constant = share([bool(row["set"]) and set(row["set"]) <= {1, 2} for row in own])
        print(f"    law {law}: first {line}, alone {only}" + (f", constant {constant}" if law < 3 else ""))
    names = [name for name in LIMITS if any(name in row.get("parameters", {}) for row in mine)]
    for name in [*names, "wear", "c/m", "Fs0/m"]:
        for law in range(1, 7):
            own = [row["parameters"][name] for row in mine if row["law"] == law and name in row.get("parameters", {})]
            if not own:
                continue
            error = np.array([one["value"] - one["truth"] for one in own])
            ratio = np.array([abs(one["truth"]) or 1.0 for one in own])
            covered = [one["lo"] <= one["truth"] <= one["hi"] for one in own]
            z = error / np.array([max(one["stderr"], 1e-300) for one in own])
            print(
                f"    {name:>9} law {law}: p90 {100 * np.quantile(np.abs(error / ratio), 0.9):7.3f} %, "
                f"bias {100 * np.mean(error / ratio):+7.3f} %, z rms {np.sqrt(np.mean(z**2)):5.2f}, "
                f"covers {share(covered)}"
            )
    pooled = [
        one["lo"] <= one["truth"] <= one["hi"]
        for row in mine
        for name, one in row.get("parameters", {}).items()
        if name in LIMITS
    ]
    print("  intervals cover, pooled ", share(pooled))
    static = [row["static"] for row in mine if "static" in row]
    if static:
        print(
            f"  static level: bias {100 * np.mean([one['bias'] for one in static]):+.2f} % "
            f"(worst run {100 * max((one['bias'] for one in static), key=abs):+.2f} %), "
            f"MAD {100 * np.mean([one['mad'] for one in static]):.2f} %"
        )
    if scene == "clean":
        rms = [row["rms_m"] for row in mine if "rms_m" in row]
        quantised = COUNT / math.sqrt(12)
        print(f"  rms over quantisation/sqrt(12): largest {max(rms) / quantised:.3f} of {len(rms)}")


def page_rows(rows: list[dict[str, Any]]) -> dict[tuple[str, str], dict[str, list[str]]]:
    """Return the rows of the tables by page and name: counts of each scene, and those of each law alone and right."""
    scenes, by_law, summary = {}, {}, {}
    for scene in dict.fromkeys(row["scene"] for row in rows):
        own = [row for row in rows if row["scene"] == scene]
        alone = [row for row in own if len(row["set"]) == 1]
        right = sum(row["set"] == [row["law"]] for row in alone)
        truth = sum(row["law"] in row["set"] for row in own)
        first = sum(row["set"][:1] == [row["law"]] for row in own)
        scenes[scene] = [*(f"{n}/{len(own)}" for n in (truth, first, right)), f"{right}/{len(alone)}"]
        if scene in SAID:
            summary[SAID[scene]] = [f"{truth} of {len(own)}", f"{right} of {len(alone)}"]
            sets = {law: [row["set"] for row in own if row["law"] == law] for law in range(1, 7)}
            by_law[scene] = [f"{of_law.count([law])}/{len(of_law)}" for law, of_law in sets.items()]
    return {
        ("identification.md", "identify"): scenes,
        ("identification.md", "identify laws"): by_law,
        ("explanation/how-sure.md", "identify"): summary,
    }


def parameter_rows(rows: list[dict[str, Any]]) -> dict[str, list[str]]:
    """Return by parameter, for each law of the nominal runs, the 90th percentile of the error, % (intervals right)."""
    found: dict[str, list[str]] = {}
    for name in (*LIMITS, "c/m"):
        cells = []
        for law in range(1, 7):
            own = [
                row["parameters"][name]
                for row in rows
                if row["scene"] == "nominal" and row["law"] == law and name in row.get("parameters", {})
            ]
            errors = [abs((one["value"] - one["truth"]) / (one["truth"] or 1.0)) for one in own]
            covered = sum(one["lo"] <= one["truth"] <= one["hi"] for one in own)
            percentile = pages.significant(100 * float(np.quantile(errors, 0.9))) if own else ""
            cells.append(f"{percentile} ({covered}/{len(own)})" if own else "")
        if any(cells):
            found[name] = cells
    return found


def main() -> None:
    """Run the study, print its tables and write every row as JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--scenes", default="nominal")
    parser.add_argument("--laws", default="1,2,3,4,5,6")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--output", type=Path, default=RESULTS / "identify.json")
    parser.add_argument("--write", action="store_true", help="put the results into the tables of the pages")
    given = parser.parse_args()
    if given.write and given.laws != parser.get_default("laws"):
        parser.error("--write takes all laws: leave out --laws")
    laws = [int(law) for law in given.laws.split(",")]
    cases = [
        (scene, law, seed)
        for scene in given.scenes.split(",")
        for seed in range(given.first, given.first + given.seeds)
        for law in LAWS_OF.get(scene, (3, 4, 5, 6) if scene == "speeds" else laws)
    ]
    run(cases[0])  # compile once, before several processes would compile at the same time
    with ProcessPoolExecutor(given.jobs, mp_context=get_context("spawn")) as pool:
        rows = []
        for row in pool.map(run, cases):
            rows.append(row)
            wrong = row["set"][:1] != [row["law"]]
            if wrong or len(row["set"]) > 1:
                print(
                    f"{row['scene']} law {row['law']} seed {row['seed']}: {row['set']} {row['said']}", file=sys.stderr
                )
    for scene in given.scenes.split(","):
        table(rows, scene)
    for (page, name), cells in page_rows(rows).items() if given.write else ():
        pages.write(page, name, cells)
    if given.write:
        pages.write("identification.md", "identify parameters", parameter_rows(rows))
    given.output.parent.mkdir(exist_ok=True)
    given.output.write_text(json.dumps(rows, indent=1, default=float) + "\n")


if __name__ == "__main__":
    main()
