"""Does the predicted end of stick-slip cover the truth: rig records of many seeds, fitted, saved and drawn from.

``python benchmarks/predicted_end.py [SEEDS]`` (default 20): for each seed the rig with a damper is recorded for 20 s,
without and with scatter of the friction level, fitted with law 5, and saved as a scene.  Draws from its section ``fit``
then say at which damping and at which belt speed stick-slip ends, as `rig-sim continue --draws` does.
"""

import json
import math
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import rig_sim
from rig_sim.results.arguments import parse_range
from rig_sim.results.branches import find_point_intervals
from rig_sim.results.scene_systems import SweptScene
from rig_sim.scenes.draws import draw_changes
from rig_sim.scenes.scene import scene

RESULTS = Path(__file__).resolve().parent / "results"
DAMPER = 0.3
CASES: dict[str, list[str]] = {"no scatter": ["--set", "scatter.Fs=0"], "3 % scatter": []}
RANGES = {"damper.c": "damper.c=0.3:3.3:7", "belt.speed": "belt.speed=0.2:2.6:9"}
DRAWS = 100


def called(*words: str) -> Any:
    """Return the JSON document of a command."""
    done = subprocess.run(
        [sys.executable, "-m", *words, "--json"], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, check=False
    )
    return json.loads(done.stdout)


def main(seeds: int) -> None:
    """Run all seeds, print a line for each, and write JSON."""
    rows: list[dict[str, Any]] = []
    rig = rig_sim.scene("rig", **{"damper.c": DAMPER})
    truth = {key: rig_sim.continue_(rig, over).points for key, over in RANGES.items()}
    covered: dict[tuple[str, str, str], list[bool]] = {}
    for case, changes in CASES.items():
        for seed in range(1, seeds + 1):
            begun = time.process_time()
            with tempfile.TemporaryDirectory() as folder:
                run, file = str(Path(folder) / "run.h5"), str(Path(folder) / "fitted.toml")
                asked = ["--duration", "20", "-o", run, "--set", f"seed={seed}", "--set", f"damper.c={DAMPER}"]
                called("daq.cli.app", "record", "--scene", "rig", *asked, *changes)
                called("fitting.cli", run, "--laws", "5", "--mass", "0.3", "--save-scene", file, "--no-report")
                drawn = draw_changes(scene(file), DRAWS, file)
                for key, points in truth.items():
                    swept = SweptScene(scene(file), key)
                    intervals, _ = find_point_intervals(swept, points, parse_range(RANGES[key]), drawn)
                    for point, one in zip(points, intervals, strict=True):
                        lo, hi = (-math.inf if one.lo is None else one.lo), (math.inf if one.hi is None else one.hi)
                        inside = lo <= point.value <= hi
                        covered.setdefault((case, key, point.kind), []).append(inside)
                        rows.append({"case": case, "seed": seed, "parameter": key, "kind": point.kind})
                        rows[-1] |= {"truth": point.value, "lo": one.lo, "hi": one.hi, "covered": inside}
            print(
                f"{case}, seed {seed}: {time.process_time() - begun:.1f} s of CPU for the draws", rows[-4:], flush=True
            )
    for (case, key, kind), inside in covered.items():
        print(f"{case:12} {kind} in {key}: truth covered in {sum(inside)} of {len(inside)}")
    RESULTS.mkdir(exist_ok=True)
    (RESULTS / "predicted_end.json").write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 20)
