"""Make the sample runs again from their scenes and seeds, with the project's own commands.

``python data_samples/regenerate.py [FOLDER]`` writes the six runs, the camera table and ``manifest.json`` into FOLDER
(default: beside this file).  A test makes them afresh and compares them with the files kept here.
"""

import csv
import hashlib
import json
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
DURATION_S = 12
RATE_HZ = 500
CAMERA_HZ = 400
CAMERA_SEED = 17
RUNS = {f"law{law}.h5": {"friction.law": law, "seed": 100 + law} for law in range(1, 7)}


def command(folder: Path, *arguments: object) -> None:
    """Run one of our commands in a folder, as a module of this interpreter."""
    subprocess.run([sys.executable, "-m", *map(str, arguments)], check=True, cwd=folder, stdout=subprocess.DEVNULL)


def record(folder: Path, name: str, changes: dict[str, int]) -> dict[str, object]:
    """Record one run of the built-in rig and return its line of the manifest."""
    flags = [part for key, value in changes.items() for part in ("--set", f"{key}={value}")]
    what = ["--rate", RATE_HZ, "--duration", DURATION_S, "-o", name, "--force", *flags]
    command(folder, "daq.cli.app", "record", *what)
    return {"scene": "rig", "changes": changes, "rate_hz": RATE_HZ, "duration_s": DURATION_S}


def camera(folder: Path, name: str) -> dict[str, object]:
    """Film the rig with law 5: t in s, x in cm to a tenth of a millimetre, semicolons and decimal commas."""
    changes = {"friction.law": 5, "seed": CAMERA_SEED}
    exact = folder / "exact.csv"
    flags = [part for key, value in changes.items() for part in ("--set", f"{key}={value}")]
    command(
        folder, "rig_sim.cli.app", "run", "rig", "--until", DURATION_S, "--rate", CAMERA_HZ, "-o", exact.name, *flags
    )
    with exact.open(newline="") as source, (folder / name).open("w", newline="") as target:
        rows = csv.DictReader(source)
        target.write("time (s);position (cm)\r\n")
        for row in rows:
            target.write(f"{float(row['t']):.4f};{100 * float(row['x']):.2f}\r\n".replace(".", ","))
    exact.unlink()
    return {"scene": "rig", "changes": changes, "rate_hz": CAMERA_HZ, "duration_s": DURATION_S}


def main(folder: Path) -> None:
    """Write every sample and the manifest."""
    folder.mkdir(parents=True, exist_ok=True)
    manifest = {name: record(folder, name, changes) for name, changes in RUNS.items()}
    manifest["camera.csv"] = camera(folder, "camera.csv")
    for name, line in manifest.items():
        line["sha256"] = hashlib.sha256((folder / name).read_bytes()).hexdigest()
    (folder / "manifest.json").write_text(json.dumps(manifest, indent=1) + "\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else HERE)
