"""Steep ramps: CPU time for slopes from -5 to -5e8, and the error of the position at break-away, for law 6.

``python benchmarks/stiff.py [UNTIL] [--write]`` (default 40 time units).  The exact method is compared with scipy's
Radau and LSODA at rtol 1e-9 and DOP853 at rtol 1e-12, phase by phase; a method that needs more than `EVALUATIONS`
evaluations of the right-hand side is stopped and has no error.  The reference is 40-digit arithmetic.  ``--write`` puts
the results into two tables of docs/accuracy.md.
"""

import json
import time
from functools import partial
from pathlib import Path
from typing import Any

import matplotlib as mpl
import pages

mpl.use("Agg")
import matplotlib.pyplot as plt

from rig_sim.comparison import reference
from rig_sim.comparison.solve_ivp import make_ivp_solver
from rig_sim.comparison.stepping import sample_phase
from rig_sim.integrate.events import EventList, list_events
from rig_sim.motion.play import play_events
from rig_sim.scenes.scene import scene

RESULTS = Path(__file__).resolve().parent / "results"
SLOPES = (-5.0, -5e2, -5e4, -5e6, -5e8)
EVALUATIONS = 300_000
LONG = 1000.0  # time units over which the CPU time of the exact method is measured
REPEATS = 7
PEERS = (("radau", 1e-9), ("lsoda", 1e-9), ("dop853", 1e-12))


def errors(found: EventList, expected: list[reference.Event]) -> tuple[float | None, float | None]:
    """Return the largest errors of x at break-away and of any event time; None if the events differ."""
    if found.outcome != "completed" or list(found.kinds) != [kind for _, kind, _ in expected]:
        return None, None
    pairs = list(zip(found.t, found.x, expected, strict=True))
    slips = [abs(float(x - x_ref)) for _, x, (_, kind, x_ref) in pairs if kind.startswith("S>")]
    return max(slips), max(abs(float(t - t_ref)) for t, _, (t_ref, _, _) in pairs)


def cost(compiled: bool, slope: float) -> tuple[float, float]:
    """Return (smallest CPU s per cycle, steps per cycle) of the exact method with every cycle integrated."""
    flow = scene("base", **{"friction.law": 6, "friction.G_stick": slope}).flow()
    least = float("inf")
    for _i in range(REPEATS):
        begun = time.process_time()
        found = list_events(flow, 0.0, 0.0, LONG, every_cycle=True, compiled=compiled)
        least = min(least, time.process_time() - begun)
    cycles = sum(kind.startswith("S>") for kind in found.kinds)
    return least / cycles, found.steps / cycles


def slope_name(row: dict[str, Any]) -> str:
    """Return the slope of a row: -5, -5e2, ..."""
    return f"{row['G_stick']:.0e}".replace("e+0", "e").removesuffix("e0")


def exact_rows(rows: list[dict[str, Any]]) -> dict[str, list[str]]:
    """Return the rows of the exact method: steps and CPU time over those of the mildest ramp, and errors."""
    mildest, found = rows[0], {}
    for row in rows:
        ratios = [row[name] / mildest[name] for name in ("steps_per_cycle", "compiled_s", "interpreted_s")]
        found[slope_name(row)] = [f"{ratios[0]:.3f}", f"{ratios[1]:.2f}", f"{ratios[2]:.2f}"]
        found[slope_name(row)] += [f"{row['exact_error']:.1e}", f"{row['exact_t_error']:.1e}"]
    return found


def peer_rows(rows: list[dict[str, Any]]) -> dict[str, list[str]]:
    """Return the rows of scipy's methods: CPU time over that of the compiled exact method, and error."""
    found = {}
    for row in rows:
        cells = []
        for method, _ in PEERS:
            ratio = pages.significant(row[f"{method}_s"] / row["compiled_s"])
            error = row[f"{method}_t_error"]
            cells.append(f"stopped after {ratio}" if error is None else f"{ratio}, {error:.1e}")
        found[slope_name(row)] = cells
    return found


def main(until: float, write: bool) -> None:
    """Print the table, write the figure and the JSON, and with ``write`` the tables of the page."""
    rows = []
    for slope in SLOPES:
        played = scene("base", **{"friction.law": 6, "friction.G_stick": slope})
        flow = played.flow()
        expected = reference.events(flow, 0.0, 0.0, until)
        compiled_s, steps = cost(True, slope)
        exact = list_events(flow, 0.0, 0.0, until, every_cycle=True)
        row = {"G_stick": slope, "steps_per_cycle": steps, "compiled_s": compiled_s}
        row["interpreted_s"] = cost(False, slope)[0]
        row["exact_error"], row["exact_t_error"] = errors(exact, expected)
        cycles = sum(kind.startswith("S>") for _, kind, _ in expected)
        for method, rtol in PEERS:
            begun = time.process_time()
            phases = partial(sample_phase, make_ivp_solver(method, rtol, dense=False))
            found = play_events(played, until, phases, max_steps=EVALUATIONS)
            row[f"{method}_s"] = (time.process_time() - begun) / cycles
            row[f"{method}_error"], row[f"{method}_t_error"] = errors(found, expected)
            row[f"{method}_outcome"] = found.outcome
        rows.append(row)
    if write:
        pages.write("accuracy.md", "stiff exact", exact_rows(rows))
        pages.write("accuracy.md", "stiff scipy", peer_rows(rows))
    mildest = rows[0]
    print(f"{'G_stick':>8} {'method':8} {'steps':>6} {'compiled':>8} {'interpr.':>8} {'x error':>8} {'t error':>8}")
    for row in rows:
        ratios = [row[name] / mildest[name] for name in ("steps_per_cycle", "compiled_s", "interpreted_s")]
        columns = f"{ratios[0]:6.3f} {ratios[1]:8.3f} {ratios[2]:8.3f}"
        print(f"{row['G_stick']:8.0e} exact    {columns} {row['exact_error']:8.1e} {row['exact_t_error']:8.1e}")
        for method, _ in PEERS:
            x_error, t_error = row[f"{method}_error"], row[f"{method}_t_error"]
            columns = f"{row[f'{method}_outcome']:>8}" if x_error is None else f"{x_error:8.1e} {t_error:8.1e}"
            print(f"{'':8} {method:8} {'':6} {row[f'{method}_s'] / row['compiled_s']:8.0f} {'':8} {columns}")
    print("exact: CPU time per cycle relative to G_stick = -5; others: relative to the compiled exact method")
    figure, (above, below) = plt.subplots(2, 1, figsize=(6, 6.5), sharex=True, layout="constrained")
    steepness = [-row["G_stick"] for row in rows]
    for name in ("compiled", "interpreted", *(method for method, _ in PEERS)):
        done = [row.get(f"{name}_outcome", "completed") == "completed" for row in rows]
        (curve,) = above.loglog(steepness, [1e6 * row[f"{name}_s"] for row in rows], "o-", label=name)
        stopped = [(g, 1e6 * row[f"{name}_s"]) for g, row, ok in zip(steepness, rows, done, strict=True) if not ok]
        if stopped:
            above.plot(*zip(*stopped, strict=True), "x", color=curve.get_color(), ms=11, label=f"{name}, stopped there")
        if name == "interpreted":
            continue
        key = "exact_t_error" if name == "compiled" else f"{name}_t_error"
        known = [(g, row[key]) for g, row in zip(steepness, rows, strict=True) if row[key]]
        if known:
            below.loglog(*zip(*known, strict=True), "o-", color=curve.get_color())
    above.set_ylabel("CPU per cycle, us")
    above.legend(fontsize=8, ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    below.set(xlabel="slope of the ramp, |G_stick|", ylabel="largest error of an event time")
    RESULTS.mkdir(exist_ok=True)
    figure.savefig(RESULTS / "stiff.png", dpi=110)
    (RESULTS / "stiff.json").write_text(json.dumps({"until": until, "rows": rows}, indent=1) + "\n")


if __name__ == "__main__":
    words, written = pages.asked()
    main(float(words[0]) if words else 40.0, written)
