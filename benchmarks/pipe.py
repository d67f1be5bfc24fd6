"""All commands on the simulated rig: verdict, error of the fitted parameters and CPU time of each stage.

``python benchmarks/pipe.py [SEEDS]``: each of the six laws is recorded (20 s at 1 kHz), smoothed and fitted
SEEDS times (default 3).  CPU is user + system time of the whole process, start-up included, in units of
``python -c "import numpy"`` measured in the same run.  Only the benchmark reads the values of
the scene; the commands do not.
"""

import json
import resource
import subprocess
import sys
import tempfile
from pathlib import Path
from statistics import median

RESULTS = Path(__file__).resolve().parent / "results"
TRUE = {"k/m": 35.184, "v_dr": 0.22, "gamma": 9.618, "G_slip/m": 0.6 / 0.3, "Fs/m": 0.13068 * 35.184, "d": 0.03}


def cpu(line: list[str], folder: str) -> tuple[float, str]:
    """Run a command line and return its CPU seconds and its stdout."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(line, capture_output=True, text=True, cwd=folder, check=False)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode not in (0, 5):
        raise SystemExit(f"{' '.join(line)} ended with {done.returncode}: {done.stdout}{done.stderr}")
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, done.stdout


def run(law: int, seed: int, folder: str) -> dict[str, object]:
    """Record, smooth and fit one run; return the CPU time and the output of each stage."""
    changes = ["--set", f"friction.law={law}", "--set", f"seed={seed}"]
    recorder = [sys.executable, "-m", "daq.cli.app", "record", "--rate", "1000", "-o", "run.h5", "--force", *changes]
    record_s, _ = cpu(recorder, folder)
    smooth_s, smoothed = cpu([sys.executable, "-m", "processing.cli", "smooth", "run.h5", "--json"], folder)
    fit_s, fitted = cpu([sys.executable, "-m", "fitting.cli", "run.h5", "--json"], folder)
    answer = json.loads(fitted)
    row = next((row for row in answer["ranking"] if row["law"] == law), None)
    errors = {}
    for name, parameter in (row["parameters"] if row else {}).items():
        if name in TRUE:
            errors[name] = parameter["value"] / TRUE[name] - 1
    return {
        "law": law, "seed": seed, "set": answer["set"], "first": bool(answer["set"]) and answer["set"][0] == law,
        "in_set": law in answer["set"], "window": json.loads(smoothed)["window"], "errors": errors,
        "record_s": record_s, "smooth_s": smooth_s, "fit_s": fit_s,
    }  # fmt: skip


def main(seeds: int) -> None:
    """Print the table and write it as JSON."""
    with tempfile.TemporaryDirectory() as folder:
        unit = min(cpu([sys.executable, "-c", "import numpy"], folder)[0] for _ in range(5))
        rows = [run(law, seed, folder) for law in range(1, 7) for seed in range(seeds)]
    print(f"import numpy: {unit:.3f} CPU s; the stages below in units of it, medians over {seeds} seeds")
    print(f"{'law':>3} {'first':>6} {'in set':>6} {'record':>7} {'smooth':>7} {'fit':>7}  largest |error|")
    for law in range(1, 7):
        mine = [row for row in rows if row["law"] == law]
        stages = [median(row[stage] for row in mine) / unit for stage in ("record_s", "smooth_s", "fit_s")]
        worst = {
            name: max(abs(row["errors"].get(name, 0.0)) for row in mine)
            for name in TRUE
            if any(name in row["errors"] for row in mine)
        }
        worst_errors = ", ".join(f"{name} {100 * error:.2f} %" for name, error in worst.items())
        first, inside = (sum(row[key] for row in mine) for key in ("first", "in_set"))
        print(
            f"{law:>3} {first:>3}/{len(mine)} {inside:>4}/{len(mine)} " + " ".join(f"{x:7.1f}" for x in stages),
            worst_errors,
        )
    RESULTS.mkdir(exist_ok=True)
    (RESULTS / "pipe.json").write_text(json.dumps({"import_numpy_s": unit, "rows": rows}, indent=1) + "\n")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 3)
