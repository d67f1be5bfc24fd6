"""Friction with memory: error and CPU time of the stiff kernel against scipy's.

``python benchmarks/memory_laws.py [--write]``: contacts of the laboratory rig of `oracles.memory`, 2001 positions each.
The reference is scipy at rtol 1e-11, bristles 1e-13.  Times are the least of `REPEATS`; ``--write`` puts the table into
docs/accuracy.md.
"""

import json
import time
from pathlib import Path
from typing import Any

import numpy as np
import pages
from oracles.memory import SETTINGS, Setting, solve

from rig_sim.flow.memory import MemoryFlow
from rig_sim.integrate.memory import compile_phases, initial_mode, new_memory_work, sample_memory_phase
from rig_sim.integrate.phases import Samples, State

RESULTS = Path(__file__).resolve().parent / "results"
CASES = {
    "LuGre, presliding 40 um": ("lugre", 0),
    "LuGre, 1 um": ("lugre", 1),
    "LuGre, 1 um, bristles without damping": ("lugre", 2),
    "LuGre, 2 mm": ("lugre", 3),
    "Dahl, 40 um": ("dahl", 0),
    "ageing law, D = 2 mm": ("ageing", 0),
    "ageing law, D = 20 um": ("ageing", 2),
    "slip law, D = 2 mm": ("slip", 0),
    "slip law, D = 2 um": ("slip", 1),
}
POINTS = 2001
REPEATS = 3


def follow(flow: MemoryFlow, case: Setting, times: Any, *, compiled: bool) -> tuple[Any, float, float]:
    """Return the positions (n,), the steps, and the CPU seconds."""
    n = len(times)
    work: Any = new_memory_work(1e7)
    samples = Samples(times.tolist(), [0.0] * n, [0.0] * n, [0.0] * n, n)
    step: Any = sample_memory_phase
    if compiled:
        step, work, samples = compile_phases(work, samples)
    state, i = State(initial_mode(flow, 0.0), case.x, -flow.v_belt, 0.0), 0
    begun = time.process_time()
    while i < n:
        _, state, i = step(flow, state, float(times[-1]), samples, i, work)
    return np.array(samples.x), float(work.steps), time.process_time() - begun


def measure(name: str, law: str, number: int) -> dict[str, Any]:
    """Return a row: errors (m), CPU seconds, steps."""
    case = SETTINGS[law][number]
    times, flow = np.linspace(0.0, case.until, POINTS), case.scene().memory_flow()
    reference, _ = solve(case, times, 1e-11)
    follow(flow, case, times, compiled=True)
    runs = {kind: [follow(flow, case, times, compiled=kind == "compiled") for _ in range(REPEATS)] for kind in KINDS}
    peers = [solve(case, times, 1e-9) for _ in range(REPEATS)]
    x, steps, _ = runs["compiled"][0]
    row = {"contact": name, "steps": steps, "until": case.until, "peer_s": min(cpu for _, cpu in peers)}
    for method, positions in (("error", x), ("peer_error", peers[0][0])):
        row[method] = [
            float(np.sqrt(np.mean((positions - reference) ** 2))),
            float(np.abs(positions - reference).max()),
        ]
    return row | {f"{kind}_s": min(cpu for _, _, cpu in found) for kind, found in runs.items()}


KINDS = ("compiled", "interpreted")


def main(write: bool) -> None:
    """Print the table, write JSON, and with ``write`` the table of the page."""
    rows = []
    for name, (law, number) in CASES.items():
        rows.append(row := measure(name, law, number))
        print(name, json.dumps({key: value for key, value in row.items() if key != "contact"}), flush=True)
    cells = {
        row["contact"]: [
            *(f"{1e6 * row[key][0]:.4f}, {1e6 * row[key][1]:.4f}" for key in ("error", "peer_error")),
            *(pages.significant(row["peer_s"] / row[f"{kind}_s"]) for kind in KINDS),
        ]
        for row in rows
    }
    if write:
        pages.write("accuracy.md", "memory_laws", cells)
    RESULTS.mkdir(exist_ok=True)
    (RESULTS / "memory_laws.json").write_text(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main(pages.asked()[1])
