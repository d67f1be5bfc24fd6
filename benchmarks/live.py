"""The live view at 1 kHz in a real browser: frames per second, CPU time of all that takes part, weight of the page.

``python benchmarks/live.py [SECONDS]`` (default 20).  Needs chromium, playwright, the extra `live` and Linux.  The
recording is `daq record --live` of the simulated rig in real time.  Shares of a core are CPU time, start excluded, over
the time of measurement: of the recorder with its simulated rig, of the server, and of all processes of the browser,
which draws without a graphics card.  The page as it looks at the end is kept as `results/live.png`: the picture of the
documentation.  With another checkout first in PYTHONPATH, its live view is measured.
"""

import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

RESULTS = Path(__file__).resolve().parent / "results"
SETTLES_S = 4.0  # until the page has loaded and the first slips have been


def cpu_s(pid: int) -> float:
    """Return the CPU time of a process so far, s (Linux)."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def family(pid: int) -> list[int]:
    """Return a process and all that descend from it (Linux)."""
    found = [pid]
    for task in Path(f"/proc/{pid}/task").iterdir():
        for child in (task / "children").read_text().split():
            found += family(int(child))
    return found


def recording(folder: Path, seconds: float, *flags: str) -> subprocess.Popen[str]:
    line = [sys.executable, "-m", "daq.cli.app", "record", "--duration", str(seconds), "--json", "--force", *flags]
    return subprocess.Popen(line, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def measure(seconds: float, chromium: str) -> dict[str, float]:
    from playwright.sync_api import sync_playwright

    weight = 0

    def weigh(response) -> None:
        nonlocal weight
        weight += int(response.headers.get("content-length", 0))  # the stream of events has none

    with tempfile.TemporaryDirectory() as name, sync_playwright() as start:
        folder = Path(name)
        run = recording(folder, seconds + SETTLES_S, "--live", "--no-browser")
        url = next(text.strip() for text in iter(run.stderr.readline, "") if text.startswith("http"))
        (server,) = (pid for pid in family(run.pid) if pid != run.pid)
        before = set(family(os.getpid()))
        browser = start.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": 1200, "height": 860})
        page.on("response", weigh)
        page.goto(url)
        page.wait_for_timeout(1000 * SETTLES_S)
        parts = {"recorder": [run.pid], "server": [server]}
        parts["browser"] = [pid for pid in family(os.getpid()) if pid not in before]
        frames, began = int(page.evaluate("document.body.dataset.frames")), time.monotonic()
        cpu = {name: sum(map(cpu_s, pids)) for name, pids in parts.items()}
        page.wait_for_timeout(1000 * (seconds - 2 * SETTLES_S))
        span = time.monotonic() - began
        shown = int(page.evaluate("document.body.dataset.frames")) - frames
        busy = {name: sum(map(cpu_s, pids)) - cpu[name] for name, pids in parts.items()}
        RESULTS.mkdir(exist_ok=True)
        page.screenshot(path=RESULTS / "live.png")
        browser.close()
        found = json.loads(run.communicate()[0])
    return {
        "frames_per_s": shown / span,
        **{f"{name}_core_percent": 100 * value / span for name, value in busy.items()},
        "page_bytes": weight,
        "samples": found["samples"],
        "lost": found["lost"],
    }


def main() -> None:
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 20.0
    chromium = shutil.which("chromium")
    if chromium is None:
        print("not measured: chromium is not installed")
        return
    found = measure(seconds, chromium)
    for name, value in found.items():
        print(f"{name:22} {value:10.4g}")
    (RESULTS / "live.json").write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
