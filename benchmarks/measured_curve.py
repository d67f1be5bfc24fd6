"""CPU time of a measured curve (law 0) against law 5, every cycle integrated, compiled and interpreted.

``python benchmarks/measured_curve.py``: curves through the hyperbola of the base scene and a Stribeck curve, with 14
points, denser at low speed as a fit gives them, and with 31 evenly spaced ones.  The least of five runs, alternating.
"""

import json
import math
import time
from pathlib import Path

import numpy as np

from rig_sim.flow.flow import Flow
from rig_sim.integrate.events import list_events
from rig_sim.scenes.scene import scene

RESULTS = Path(__file__).resolve().parent / "results"
FASTEST = 2.1
REPEATS = 5
UNTIL = {True: 20_000.0, False: 1_000.0}


def hyperbola(s: float) -> float:
    """Return friction of law 5, base scene."""
    return 1.0 / (1.0 + 3.0 * s)


def stribeck(s: float) -> float:
    """Return friction that falls to a minimum and rises again."""
    return 0.7 + 0.3 * math.exp(-((s / 0.2) ** 2)) + 0.05 * s


def flows() -> dict[str, Flow]:
    """Return law 5 and the curves."""
    found = {"law 5": scene("base").flow()}
    for points in (14, 31):
        speeds = FASTEST * np.linspace(0.0, 1.0, points) ** (1.6 if points == 14 else 1.0)
        for curve in (hyperbola, stribeck):
            knots = [[s, curve(s)] for s in speeds.tolist()]
            changed = scene("base", **{"friction.law": 0, "friction.curve": knots})
            found[f"{curve.__name__}, {points} points"] = changed.flow()
    return found


def main() -> None:
    """Measure, print, and write JSON."""
    rows = []
    for compiled, until in UNTIL.items():
        cases = flows()
        least = dict.fromkeys(cases, math.inf)
        for flow in cases.values():
            list_events(flow, 0.0, 0.0, 10.0, every_cycle=True, compiled=compiled)
        for _ in range(REPEATS):
            for name, flow in cases.items():
                begun = time.process_time()
                found = list_events(flow, 0.0, 0.0, until, every_cycle=True, compiled=compiled)
                # of one cycle: curves make more or fewer cycles in a time
                least[name] = min(least[name], (time.process_time() - begun) / found.kinds.count("S>N"))
        for name, spent in least.items():
            row = {"curve": name, "compiled": compiled, "us_per_cycle": 1e6 * spent, "ratio": spent / least["law 5"]}
            rows.append(row)
            print(f"{name:24} {'compiled' if compiled else 'plain':9} {1e6 * spent:9.2f} us/cycle {row['ratio']:6.2f}")
    RESULTS.mkdir(exist_ok=True)
    (RESULTS / "measured_curve.json").write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
