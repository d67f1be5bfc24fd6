"""The live view at 1 kHz in a real browser: frames per second, CPU time of its server, weight of the page, losses.

``python benchmarks/live.py [SECONDS]`` (default 20).  Needs chromium, playwright and the extra `live`.  The recording
is `daq record --live` of the simulated rig in real time.  The server's share of a core is its CPU time, start excluded,
over the time of measurement; a second recording of the same length without a viewer gives the recorder's own CPU time
for comparison.  The page as it looks at the end is kept as `results/live.png`: the picture of the documentation.
"""

import json
import os
import resource
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


def recording(folder: Path, seconds: float, *flags: str) -> subprocess.Popen[str]:
    line = [sys.executable, "-m", "daq.cli.app", "record", "--duration", str(seconds), "--json", "--force", *flags]
    return subprocess.Popen(line, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def measure(seconds: float, chromium: str) -> dict[str, float]:
    from playwright.sync_api import sync_playwright

    weight = 0

    def weigh(response) -> None:
        nonlocal weight
        if not response.url.endswith("events"):
            weight += len(response.body())

    with tempfile.TemporaryDirectory() as name, sync_playwright() as start:
        folder = Path(name)
        run = recording(folder, seconds + SETTLES_S, "--live", "--no-browser")
        url = next(text.strip() for text in iter(run.stderr.readline, "") if text.startswith("http"))
        server = int(subprocess.check_output(["pgrep", "-f", "watch run.h5.part"], text=True).split()[0])
        browser = start.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": 1200, "height": 860})
        page.on("response", weigh)
        page.goto(url)
        page.wait_for_timeout(1000 * SETTLES_S)
        frames, cpu, began = int(page.evaluate("document.body.dataset.frames")), cpu_s(server), time.monotonic()
        page.wait_for_timeout(1000 * (seconds - 2 * SETTLES_S))
        span = time.monotonic() - began
        shown = int(page.evaluate("document.body.dataset.frames")) - frames
        busy = cpu_s(server) - cpu
        RESULTS.mkdir(exist_ok=True)
        page.screenshot(path=RESULTS / "live.png")
        browser.close()
        found = json.loads(run.communicate()[0])
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        alone = recording(folder, seconds, "--realtime")
        alone.communicate()
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
    own = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return {
        "frames_per_s": shown / span,
        "server_core_percent": 100 * busy / span,
        "page_bytes": weight,
        "samples": found["samples"],
        "lost": found["lost"],
        "recorder_alone_cpu_s": own,
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
