"""Error against run time of every method, for the six laws and a driven one: tables, a figure and JSON.

``python benchmarks/error_vs_time.py [UNTIL] [--write]``: each scene runs for UNTIL time units (default 1000).  The
error is the largest error of an event time, compared with 40-digit arithmetic; CPU times exclude compilation.  Every
cycle is integrated.  heyoka, if installed, checks the reference independently: the two must agree.  PathSim, if
installed, is what a block diagram of the rig costs; it is timed up to 200 time units only.  ``--write`` puts the
results into the tables of docs/accuracy.md: with UNTIL up to 200 that of PathSim, with more the others.
"""

import json
import math
import time
from collections.abc import Callable
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path

import matplotlib as mpl
import pages

mpl.use("Agg")
import matplotlib.pyplot as plt

from rig_sim.comparison import reference
from rig_sim.comparison.error_vs_time import Comparison, MethodResult, compare, difference
from rig_sim.flow.flow import Flow
from rig_sim.integrate.events import EventList
from rig_sim.scenes.model import Scene
from rig_sim.scenes.scene import scene

Peer = Callable[[Flow], Callable[[float, float, float], EventList]]


def peers(until: float) -> dict[tuple[str, str], Peer]:
    """Return the other programs that are installed, by name and setting: each makes of a flow its list of events.

    PathSim is left out of runs longer than `SHORT`.
    """
    found: dict[tuple[str, str], Peer] = {}
    try:
        from oracles import heyoka_events

        found["heyoka", f"tol {heyoka_events.TOLERANCE:g}"] = lambda flow: heyoka_events.Rig(flow).events
    except ModuleNotFoundError as missing:
        print(f"{missing.name} is not installed and is omitted (make bench installs it)")
    if until > SHORT:
        return found
    try:
        from oracles import pathsim_events

        for tolerance in PATHSIM:
            found["pathsim", f"tol {tolerance:g}"] = partial(_diagram, pathsim_events.Rig, tolerance)
    except ModuleNotFoundError as missing:
        print(f"{missing.name} is not installed and is omitted (make bench installs it)")
    return found


def _diagram(rig: type, tolerance: float, flow: Flow) -> Callable[[float, float, float], EventList]:
    return rig(flow, tolerance).events


RESULTS = Path(__file__).resolve().parent / "results"
DRIVE = {"drive.u0": 0.2, "drive.omega": 0.3}
SCENES = {**{f"law {law}": {"friction.law": law} for law in range(1, 7)}, "law 5, u0 = 0.2, omega = 0.3": DRIVE}
MARKS = {"exact": "*", "rk4-henon": "o", "dop853": "s", "radau": "^", "lsoda": "v", "heyoka": "D", "pathsim": "P"}
PATHSIM = (1e-6, 1e-12)  # tolerances
TIGHTEST = "dop853", "rtol 2.3e-14"
SHORT = 200.0  # time units up to which PathSim is timed
ROWS = {  # of the other methods on law 5, by method and setting: how the page calls them
    ("exact", "compiled"): "exact, compiled",
    ("exact", "interpreted"): "exact, interpreted",
    ("rk4-henon", "h 0.1"): "rk4-henon, h = 0.1",
    ("rk4-henon", "h 0.01"): "rk4-henon, h = 0.01",
    ("rk4-henon", "h 0.003"): "rk4-henon, h = 0.003",
    ("dop853", "rtol 1e-06"): "DOP853, rtol 1e-6",
    ("dop853", "rtol 1e-09"): "DOP853, rtol 1e-9",
    ("dop853", "rtol 1e-12"): "DOP853, rtol 1e-12",
    ("radau", "rtol 1e-09"): "Radau, rtol 1e-9",
    ("lsoda", "rtol 1e-09"): "LSODA, rtol 1e-9",
}
REPEATS, SLOW_S = 5, 1.0  # a peer that takes longer is timed once


def ratios(found: Comparison) -> dict[str, float]:
    """Return the ratios of CPU time and of error between DOP853 at its smallest tolerance and the exact method."""
    rows = {(row.method, row.setting): row for row in found.results}
    peer, machine = rows[TIGHTEST], rows["exact", "compiled"]
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


def error_text(row: MethodResult) -> str:
    """Return the error of a row, or what prevents one."""
    return row.note.partition(" from ")[0] if row.error is None else f"{row.error:.1e}"


def over(row: MethodResult, exact: MethodResult) -> str:
    """Return the CPU time of a row over that of another."""
    return pages.significant(row.cpu_s / exact.cpu_s)


def tables(compared: dict[str, Comparison]) -> dict[str, dict[str, list[str]]]:
    """Return the rows of the tables of the page, by table and first cell; of a peer that was not timed none."""
    found: dict[str, dict[str, list[str]]] = {}
    for name, comparison in compared.items():
        rows = {(row.method, row.setting): row for row in comparison.results}
        compiled, plain, tight = rows["exact", "compiled"], rows["exact", "interpreted"], rows[TIGHTEST]
        if ("pathsim", f"tol {PATHSIM[-1]:g}") in rows:
            peer = rows["pathsim", f"tol {PATHSIM[-1]:g}"]
            found.setdefault("error_vs_time pathsim", {})[name] = [error_text(peer), over(peer, compiled)]
            continue
        cells = [error_text(compiled), error_text(tight), over(tight, compiled), over(tight, plain)]
        found.setdefault("error_vs_time scenes", {})[name] = cells
        for key, row in rows.items():
            if key[0] == "heyoka":
                found.setdefault("error_vs_time heyoka", {})[name] = [error_text(row), over(row, compiled)]
    if "error_vs_time scenes" in found:
        rows = {(row.method, row.setting): row for row in compared["law 5"].results}
        found["error_vs_time methods"] = {
            named: [error_text(rows[key]), over(rows[key], rows["exact", "compiled"])] for key, named in ROWS.items()
        }
    return found


def main(until: float, write: bool) -> None:
    """Print the tables, write the figure and the JSON, and with ``write`` the tables of the page."""
    others = peers(until)
    collected = {}
    compared = {}
    figure, axes = plt.subplots(2, 4, figsize=(12.0, 6.0), sharex=True, sharey=True, layout="constrained")
    for axis, (name, changes) in zip(axes.flat, SCENES.items(), strict=False):
        played = scene("base", **changes)
        found = compare(played, until)
        rows = [by_peer(*key, peer, played, until, found.cycles) for key, peer in others.items()]
        found = compared[name] = replace(found, results=(*found.results, *rows))
        collected[name] = {"until": until, "ratios": ratios(found), **asdict(found)}
        print(f"\n{name}, {until:g} time units, {found.cycles} cycles; reference: {found.reference}")
        for row in found.results:
            error = row.note if row.error is None else f"{row.error:.1e}"
            print(f"  {row.method:10} {row.setting:14} {error:>10} {row.us_per_cycle or 0:12.1f} us per cycle")
        print("  DOP853 at rtol 2.3e-14 over exact: " + ", ".join(f"{k} {v:.3g}" for k, v in ratios(found).items()))
        for method, mark in MARKS.items():
            mine = [row for row in found.results if row.method == method and row.error]
            axis.loglog([row.us_per_cycle for row in mine], [row.error for row in mine], mark + ":", label=method)
        axis.set_title(name)
        axis.grid(alpha=0.3)
    axes[-1, -1].axis("off")
    axes[-1, -1].legend(*axes[0, 2].get_legend_handles_labels(), loc="center")
    figure.supxlabel("CPU per cycle, us")
    figure.supylabel("largest error of an event time")
    for table, cells in tables(compared).items() if write else ():
        pages.write("accuracy.md", table, cells)
    RESULTS.mkdir(exist_ok=True)
    figure.savefig(RESULTS / "error_vs_time.png", dpi=110)
    (RESULTS / "error_vs_time.json").write_text(json.dumps(collected, indent=1) + "\n")


if __name__ == "__main__":
    words, written = pages.asked()
    main(float(words[0]) if words else 1000.0, written)
