"""Identification study on camera tracks, bare of calibration: verdict, belt speed and false alarms under noise.

``python benchmarks/camera.py [--seeds N] [--noise 0.2,1] [--laws 2,3,4,5,6] [--decimals 5,4,6] [--foreign FOLDER]
[--write]``: tracks of 30 s at 400 frames a second with 3 % scatter of the friction level are written as tables,
imported, smoothed and ranked.  They are made by the integrator of ``tests/rig.py``; with ``--foreign`` by ``make.py``
in FOLDER, which has the function ``make(case, file, seed, sensor)``.  With several ``--decimals`` each track is also
printed with so many, and the set must be the same as with the first.  Rows are written to
``benchmarks/results/camera.json``; with ``--write`` those of all laws also into docs/identification.md and
docs/explanation/how-sure.md, where the tracks are those of ``--foreign``.
"""

import argparse
import importlib.util
import json
import os
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
from daq.imports import table_to_run
from daq.imports.options import ImportOptions
from stickslip.errors import DataError

HERE = Path(__file__).resolve().parent
RESULTS = HERE / "results"
GENERATOR = HERE.parent / "tests" / "rig.py"
BELT = 0.22  # m/s, of both generators


def load(path: Path) -> Any:
    """Load a module by its path."""
    sys.path.insert(0, str(path.parent))
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if spec is None or spec.loader is None:
        raise FileNotFoundError(path)
    module = importlib.util.module_from_spec(spec)
    sys.modules[path.stem] = module
    spec.loader.exec_module(module)
    return module


def motion(law: int, noise_mm: float, seed: int, foreign: Path | None) -> tuple[np.ndarray, np.ndarray]:
    """Return times (s) and noisy positions (m) of one track."""
    if foreign is None:
        time, position = load(GENERATOR).camera(law, 1e-3 * noise_mm, seed)
        return time, position
    with tempfile.TemporaryDirectory() as folder:
        table = Path(folder) / "track.csv"
        load(foreign / "make.py").make(f"law{law}", str(table), seed, f"camera{noise_mm:g}")
        time, position = np.loadtxt(table, delimiter=",", skiprows=1, unpack=True)
    return time, position


def run(case: tuple[int, float, int, tuple[int, ...], Path | None]) -> dict[str, Any]:
    """Make, import, smooth and rank one track in each print."""
    law, noise_mm, seed, decimals, foreign = case
    time, position = motion(law, noise_mm, seed, foreign)
    row: dict[str, Any] = {"law": law, "noise_mm": noise_mm, "seed": seed, "sets": [], "cpu_s": []}
    for places in decimals:
        with tempfile.TemporaryDirectory() as folder:
            table = Path(folder) / "track.csv"
            rows = np.c_[time, np.round(position, places)]
            np.savetxt(table, rows, fmt=["%.6f", f"%.{places}f"], delimiter=",", header="t,x", comments="")
            kinematics = processing.smooth(table_to_run.read(table, ImportOptions()).run)
        begun = clock.process_time()
        try:
            ranking = fitting.rank(kinematics)
        except DataError as error:
            row["sets"].append([])
            row.setdefault("said", str(error))
            continue
        row["cpu_s"].append(clock.process_time() - begun)
        row["sets"].append(sorted(ranking.laws_in_set))
        if len(row["sets"]) > 1:
            continue
        row["none"] = not ranking.adequacy.adequate
        row["findings"] = [finding.code for finding in ranking.findings]
        mine = next((one for one in ranking.rows if one.law == law), None)
        if mine is not None:
            speed = mine.parameters["v_dr"]
            row["v_dr"] = speed.value
            row["covered"] = speed.lo <= BELT <= speed.hi
    return row


def share(values: list[bool]) -> str:
    """Return a share as text."""
    return f"{sum(values)}/{len(values)}" if values else "-"


def table(rows: list[dict[str, Any]], name: str) -> None:
    """Print one line of the study."""
    found = [row["sets"][0] for row in rows]
    alone = [own == [row["law"]] for row, own in zip(rows, found, strict=True) if len(own) == 1]
    print(
        f"| {name} | {share([row['law'] in own for row, own in zip(rows, found, strict=True)])} | {share(alone)} "
        f"| {share([row.get('covered', False) for row in rows])} | {share([row.get('none', True) for row in rows])} "
        f"| {share([all(own == row['sets'][0] for own in row['sets'][1:]) for row in rows if len(row['sets']) > 1])} |"
    )


def page_rows(rows: list[dict[str, Any]]) -> dict[tuple[str, str], dict[str, list[str]]]:
    """Return by page and table the rows of each noise."""
    found: dict[tuple[str, str], dict[str, list[str]]] = {
        ("identification.md", "camera"): {},
        ("explanation/how-sure.md", "identify"): {},
    }
    for noise in dict.fromkeys(row["noise_mm"] for row in rows):
        own = [row for row in rows if row["noise_mm"] == noise]
        truth = [row["law"] in row["sets"][0] for row in own]
        alone = [row["sets"][0] == [row["law"]] for row in own if len(row["sets"][0]) == 1]
        covered = [row.get("covered", False) for row in own]
        found["identification.md", "camera"][f"{noise:g} mm"] = [share(truth), share(alone), share(covered)]
        cells = [f"{sum(counted)} of {len(counted)}" for counted in (truth, alone)]
        found["explanation/how-sure.md", "identify"][f"camera, {noise:g} mm of noise, no calibration"] = cells
    return found


def main() -> None:
    """Run the study, print its table and write every row as JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--noise", default="0.2,1", help="mm, several separated by commas")
    parser.add_argument("--laws", default="2,3,4,5,6")
    parser.add_argument("--decimals", default="5", help="of a metre, several separated by commas")
    parser.add_argument("--foreign", type=Path, help="folder with make.py, another simulator")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--output", type=Path, default=RESULTS / "camera.json")
    parser.add_argument("--write", action="store_true", help="put the results into the tables of the pages")
    given = parser.parse_args()
    if given.write and (given.foreign is None or given.laws != parser.get_default("laws")):
        parser.error("--write takes --foreign FOLDER, and all laws: leave out --laws")
    decimals = tuple(int(places) for places in given.decimals.split(","))
    cases = [
        (int(law), float(noise), seed, decimals, given.foreign)
        for noise in given.noise.split(",")
        for seed in range(given.first, given.first + given.seeds)
        for law in given.laws.split(",")
    ]
    rows = []
    with ProcessPoolExecutor(given.jobs, mp_context=get_context("spawn")) as pool:
        for row in pool.map(run, cases):
            rows.append(row)
            if row["sets"][0] != [row["law"]]:
                print(f"law {row['law']}, {row['noise_mm']:g} mm, seed {row['seed']}: {row['sets']}", file=sys.stderr)
    print("| | truth in the set | a set of one law right | v_dr covered | no law fits | same set in every print |")
    print("|---|---|---|---|---|---|")
    for noise in dict.fromkeys(row["noise_mm"] for row in rows):
        own = [row for row in rows if row["noise_mm"] == noise]
        table(own, f"{noise:g} mm, all laws")
        for law in dict.fromkeys(row["law"] for row in own):
            table([row for row in own if row["law"] == law], f"{noise:g} mm, law {law}")
    for (page, name), cells in page_rows(rows).items() if given.write else ():
        pages.write(page, name, cells)
    given.output.parent.mkdir(exist_ok=True)
    given.output.write_text(json.dumps(rows, indent=1, default=float) + "\n")


if __name__ == "__main__":
    main()
