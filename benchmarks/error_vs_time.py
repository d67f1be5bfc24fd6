"""Error against run time of every method, for five scenes: tables, a picture and JSON.

``python benchmarks/error_vs_time.py [UNTIL]``: each scene runs for UNTIL time units (default 1000; the slower reference
of ramp and driven scenes caps theirs at 200).  Error is the largest of an event time against 40-digit arithmetic; CPU
leaves out compiling.  Every cycle is stepped.  heyoka, where it is installed, is an oracle from outside: it meets the
reference, or the reference is wrong.
"""

import json
import math
import sys
import time
from dataclasses import asdict, replace
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt

from rig_sim.compare import Comparison, Row, compare, difference
from rig_sim.integrate import reference
from rig_sim.scenes import Scene, scene

try:
    from oracles.heyoka_events import TOLERANCE, Rig
except ModuleNotFoundError as missing:
    if missing.name != "heyoka":
        raise
    Rig = None

RESULTS = Path(__file__).resolve().parent / "results"
DRIVE = {"drive.u0": 0.2, "drive.omega": 0.3}
SCENES = {
    "law 3": ({"friction.law": 3}, 1000.0),
    "law 4": ({"friction.law": 4}, 200.0),
    "law 5": ({}, 1000.0),
    "law 6": ({"friction.law": 6}, 200.0),
    "law 5, driven": (DRIVE, 200.0),
}
MARKS = {"exact": "*", "rk4-henon": "o", "dop853": "s", "radau": "^", "lsoda": "v", "heyoka": "D"}
REPEATS = 5


def ratios(found: Comparison) -> dict[str, float]:
    """Return CPU of DOP853 at its tightest over that of the exact method, and the errors' ratio."""
    rows = {(row.method, row.setting): row for row in found.rows}
    peer, machine = rows["dop853", "rtol 2.3e-14"], rows["exact", "compiled"]
    answer = {
        "compiled": peer.cpu_s / machine.cpu_s,
        "interpreted": peer.cpu_s / rows["exact", "interpreted"].cpu_s,
    }
    if peer.error and machine.error:
        answer["error"] = peer.error / machine.error
    return answer


def by_heyoka(found: Scene, until: float, cycles: int) -> Row:
    """Return heyoka's row: the least CPU of `REPEATS`, without its compiling."""
    flow = found.flow()
    rig = Rig(flow)
    least = math.inf
    for _i in range(REPEATS):
        begun = time.process_time()
        events = rig.events(float(found.start.x), float(found.start.v), until)
        least = min(least, time.process_time() - begun)
    expected = reference.events(flow, float(found.start.x), float(found.start.v), until)
    error, note = difference(events, [(t, kind) for t, kind, _ in expected], until)
    return Row("heyoka", f"tol {TOLERANCE:g}", error, least, 1e6 * least / cycles, note)


def main(until: float) -> None:
    """Print the tables, write the picture and the JSON."""
    if Rig is None:
        print("heyoka is left out: it is not installed (pip install heyoka)")
    told = {}
    figure, axes = plt.subplots(1, len(SCENES), figsize=(3.2 * len(SCENES), 3.4), sharey=True, layout="constrained")
    for axis, (name, (changes, longest)) in zip(axes, SCENES.items(), strict=True):
        played = scene("base", **changes)
        found = compare(played, min(until, longest))
        if Rig is not None:
            row = by_heyoka(played, min(until, longest), found.cycles)
            found = replace(found, rows=(*found.rows, row))
        told[name] = {"until": min(until, longest), "ratios": ratios(found), **asdict(found)}
        print(f"\n{name}, {min(until, longest):g} time units, {found.cycles} cycles; reference: {found.reference}")
        for row in found.rows:
            error = row.note if row.error is None else f"{row.error:.1e}"
            print(f"  {row.method:10} {row.setting:14} {error:>10} {row.us_per_cycle or 0:12.1f} us per cycle")
        print("  DOP853 at rtol 2.3e-14 over exact: " + ", ".join(f"{k} {v:.3g}" for k, v in ratios(found).items()))
        for method, mark in MARKS.items():
            mine = [row for row in found.rows if row.method == method and row.error]
            axis.loglog([row.us_per_cycle for row in mine], [row.error for row in mine], mark + ":", label=method)
        axis.set(title=f"{name}, {min(until, longest):g} time units", xlabel="CPU per cycle, us")
        axis.grid(alpha=0.3)
    axes[0].set_ylabel("largest error of an event time")
    axes[0].legend(fontsize=8)
    RESULTS.mkdir(exist_ok=True)
    figure.savefig(RESULTS / "error_vs_time.png", dpi=110)
    (RESULTS / "error_vs_time.json").write_text(json.dumps(told, indent=1) + "\n")


if __name__ == "__main__":
    main(float(sys.argv[1]) if len(sys.argv) > 1 else 1000.0)
