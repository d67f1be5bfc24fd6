"""Laws given as formulas: how often their intervals contain the truth (the six as formulas: `competition`).

``python benchmarks/own_law.py [NUMBER]``: NUMBER contacts, by default 100, with a Stribeck curve, exponential and
Gaussian in turn, drawn at random and read by an encoder of 50 um counts.  Each is fitted with its formula and no
starting values.  Nothing of rig_sim makes the records.
"""

import importlib.util
import json
import math
import sys
import time
from pathlib import Path
from types import ModuleType

import numpy as np

from daq.runfile.recording import Recording
from daq.runfile.rig import Rig
from fitting import rank
from processing.smoothing import smooth
from stickslip.units import Measured

ROOT = Path(__file__).resolve().parent.parent
RESULTS = ROOT / "benchmarks" / "results"
COUNT, JITTER = 50e-6, 30e-6
PARAMETERS = {"Fs/m": "Fs", "Fc/m": "Fc", "v_s": "v_s", "Fv/m": "Fv", "k/m": "k"}
SEED = 2027


def _tests_rig() -> ModuleType:
    """Return the simulator of the tests."""
    path = ROOT / "tests" / "rig.py"
    spec = importlib.util.spec_from_file_location("tests_rig", path)
    if spec is None or spec.loader is None:
        raise RuntimeError(f"no {path}")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


belt_rig = _tests_rig()


def drawn(number: int) -> tuple[object, Recording, str]:
    """Return a Stribeck contact, its record, and the name of its law."""
    chance = np.random.default_rng([SEED, number])
    power = 1.0 + number % 2
    level = chance.uniform(1.0, 1.8)
    contact = belt_rig.Contact(
        curve="stribeck",
        Fs=level,
        Fc=level * chance.uniform(0.4, 0.75),
        v_s=10 ** chance.uniform(math.log10(0.03), math.log10(0.15)),
        Fv=chance.uniform(0.05, 0.4),
        power=power,
        belt=chance.uniform(0.15, 0.3),
        c=chance.uniform(0.005, 0.02),
        scatter=0.03,
        duration=20.0,
        seed=number,
    )
    time_s, position = belt_rig.recorded(contact, count=COUNT, jitter=JITTER)
    critical = 2 * math.sqrt(contact.k * contact.m)
    rig = Rig(  # each calibration is off by an error that it states
        name="encoder",
        metres_per_count=Measured(COUNT),
        mass=Measured(contact.m * (1 + 1e-3 * chance.standard_normal()), 1e-3 * contact.m),
        datum=Measured(5e-4 * chance.standard_normal(), 5e-4),
        damping=Measured(max(contact.c + 1e-3 * critical * chance.standard_normal(), 0.0), 1e-3 * critical),
    )
    recording = Recording(
        source=Path(f"stribeck-{number}.h5"),
        title=f"Stribeck contact {number}",
        started="2026-01-01T00:00:00+00:00",
        ended="2026-01-01T00:00:20+00:00",
        time=time_s,
        position=position,
        rate_hz=1000.0,
        rig=rig,
    )
    return contact, recording, "stribeck-viscous" if power == 1 else "stribeck-gaussian-viscous"


def coverage(number: int) -> list[dict[str, object]]:
    """Fit contacts with their own formula; return a row each."""
    rows = []
    for one in range(number):
        contact, recording, name = drawn(one)
        begun = time.process_time()
        ranking = rank(smooth(recording), laws=(5, name))
        row: dict[str, object] = {"contact": one, "law": name, "cpu_s": time.process_time() - begun}
        found = ranking.row(name)
        row |= {"in_set": found.in_set, "adequacy": ranking.adequacy.verdict, "law_cpu_s": found.cpu_s}
        row |= {"seconds": contact.duration, "verdict": ranking.verdict}
        for parameter, field in PARAMETERS.items():
            item = found.parameters[parameter]
            true = getattr(contact, field) / (contact.m if parameter.endswith("/m") else 1.0)
            covered = item.lo <= true <= item.hi
            row[parameter] = {"true": true, "value": item.value, "stderr": item.stderr, "covered": bool(covered)}
        rows.append(row)
        deviations = [(row[p]["value"] - row[p]["true"]) / (row[p]["stderr"] or math.inf) for p in PARAMETERS]
        print(
            f"{one:3} {name:26} {found.in_set!s:5} {row['adequacy']!s:9}",
            *(f"{own:+5.1f}" for own in deviations),
            flush=True,
        )
    return rows


def main() -> None:
    """Run the study, print, and write JSON."""
    number = int(sys.argv[1]) if len(sys.argv) > 1 else 100
    rows = coverage(number)
    covered = {name: sum(row[name]["covered"] for row in rows) for name in PARAMETERS}
    alone = sum(row["in_set"] and row["adequacy"] == "adequate" for row in rows)
    cost = sum(row["law_cpu_s"] for row in rows) / sum(row["seconds"] for row in rows)
    print(
        f"\nof {number}: in the set and adequate {alone}; covered",
        ", ".join(f"{name} {own}" for name, own in covered.items()),
    )
    print(f"a formula takes {1e3 * cost:.1f} ms of CPU time per second of record")
    RESULTS.mkdir(exist_ok=True)
    found = {
        "contacts": number,
        "adequate": alone,
        "covered": covered,
        "ms_per_s": 1e3 * cost,
        "rows": rows,
    }
    (RESULTS / "own_law.json").write_text(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
