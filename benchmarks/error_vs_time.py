"""Error against run time of every method, for the six laws and a driven one: tables, a figure and JSON.

``python benchmarks/error_vs_time.py [UNTIL]``: each scene runs for UNTIL time units (default 1000).  The error is
the largest error of an event time, compared with 40-digit arithmetic; CPU times exclude compilation.  Every cycle is
integrated.  heyoka, if installed, checks the reference independently: the two must agree.  PathSim, if installed, is
what a block diagram of the rig costs.
"""

import json
import math
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt

from rig_sim.comparison import reference
from rig_sim.comparison.error_vs_time import Comparison, MethodResult, compare, difference
from rig_sim.flow.flow import Flow
from rig_sim.integrate.events import EventList
from rig_sim.scenes.model import Scene
from rig_sim.scenes.scene import scene

Peer = Callable[[Flow], Callable[[float, float, float], EventList]]


def peers() -> dict[tuple[str, str], Peer]:
    """Return the other programs that are installed, by name and setting: each makes of a flow its list of events."""
    found: dict[tuple[str, str], Peer] = {}
    try:
        from oracles import heyoka_events

        found["heyoka", f"tol {heyoka_events.TOLERANCE:g}"] = lambda flow: heyoka_events.Rig(flow).events
    except ModuleNotFoundError as missing:
        print(f"{missing.name} is not installed and is omitted (make bench installs it)")
    try:
        from oracles import pathsim_events

        for tolerance in (1e-6, 1e-12):
            found["pathsim", f"tol {tolerance:g}"] = partial(_diagram, pathsim_events.Rig, tolerance)
    except ModuleNotFoundError as missing:
        print(f"{missing.name} is not installed and is omitted (make bench installs it)")
    return found


def _diagram(rig: type, tolerance: float, flow: Flow) -> Callable[[float, float, float], EventList]:
    return rig(flow, tolerance).events


RESULTS = Path(__file__).resolve().parent / "results"
DRIVE = {"drive.u0": 0.2, "drive.omega": 0.3}
SCENES = {**{f"law {law}": {"friction.law": law} for law in range(1, 7)}, "law 5, driven": DRIVE}
MARKS = {"exact": "*", "rk4-henon": "o", "dop853": "s", "radau": "^", "lsoda": "v", "heyoka": "D", "pathsim": "P"}
REPEATS, SLOW_S = 5, 1.0  # a peer that takes longer is timed once


def ratios(found: Comparison) -> dict[str, float]:
    """Return the ratios of CPU time and of error between DOP853 at its smallest tolerance and the exact method."""
    rows = {(row.method, row.setting): row for row in found.rows}
    peer, machine = rows["dop853", "rtol 2.3e-14"], rows["exact", "compiled"]
    answer = {
        "compiled": peer.cpu_s / machine.cpu_s,
        "interpreted": peer.cpu_s / rows["exact", "interpreted"].cpu_s,
    }
    if peer.error and machine.error:
        answer["error"] = peer.error / machine.error
    return answer


def by_peer(name: str, setting: str, peer: Peer, found: Scene, until: float, cycles: int) -> MethodResult:
    """Return the row of another program: the smallest CPU time of `REPEATS`, without its compilation."""
    flow = found.flow()
    events_of = peer(flow)
    least = math.inf
    for _i in range(REPEATS):
        begun = time.process_time()
        events = events_of(float(found.start.x), float(found.start.v), until)
        least = min(least, time.process_time() - begun)
        if least > SLOW_S:
            break
    expected = reference.events(flow, float(found.start.x), float(found.start.v), until)
    error, note = difference(events, [(t, kind) for t, kind, _ in expected], until)
    return MethodResult(name, setting, error, least, 1e6 * least / cycles, note)


def main(until: float) -> None:
    """Print the tables, write the figure and the JSON."""
    others = peers()
    collected = {}
    figure, axes = plt.subplots(2, 4, figsize=(12.0, 6.0), sharex=True, sharey=True, layout="constrained")
    for axis, (name, changes) in zip(axes.flat, SCENES.items(), strict=False):
        played = scene("base", **changes)
        found = compare(played, until)
        rows = [by_peer(*key, peer, played, until, found.cycles) for key, peer in others.items()]
        found = replace(found, rows=(*found.rows, *rows))
        collected[name] = {"until": until, "ratios": ratios(found), **asdict(found)}
        print(f"\n{name}, {until:g} time units, {found.cycles} cycles; reference: {found.reference}")
        for row in found.rows:
            error = row.note if row.error is None else f"{row.error:.1e}"
            print(f"  {row.method:10} {row.setting:14} {error:>10} {row.us_per_cycle or 0:12.1f} us per cycle")
        print("  DOP853 at rtol 2.3e-14 over exact: " + ", ".join(f"{k} {v:.3g}" for k, v in ratios(found).items()))
        for method, mark in MARKS.items():
            mine = [row for row in found.rows if row.method == method and row.error]
            axis.loglog([row.us_per_cycle for row in mine], [row.error for row in mine], mark + ":", label=method)
        axis.set_title(name)
        axis.grid(alpha=0.3)
    axes[-1, -1].axis("off")
    axes[-1, -1].legend(*axes[0, 2].get_legend_handles_labels(), loc="center")
    figure.supxlabel("CPU per cycle, us")
    figure.supylabel("largest error of an event time")
    RESULTS.mkdir(exist_ok=True)
    figure.savefig(RESULTS / "error_vs_time.png", dpi=110)
    (RESULTS / "error_vs_time.json").write_text(json.dumps(collected, indent=1) + "\n")


if __name__ == "__main__":
    main(float(sys.argv[1]) if len(sys.argv) > 1 else 1000.0)
