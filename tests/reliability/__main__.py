"""`make reliability`: run the campaigns, two at a time, and write their table into docs/reliability.md.

Example: python -m tests.reliability --only crash --size short
"""

import argparse
import json
import platform
import resource
import subprocess
import sys
import tempfile
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from datetime import date
from pathlib import Path

from . import campaign, page
from .campaign import CAMPAIGNS, Result

ROOT = Path(__file__).resolve().parents[2]
AT_A_TIME = 2


def main() -> int:
    """Run the campaigns asked for; return 1 if one found a fault."""
    parser = argparse.ArgumentParser(prog="python -m tests.reliability", description=__doc__)
    parser.add_argument("--only", nargs="+", choices=CAMPAIGNS, default=list(CAMPAIGNS), metavar="NAME")
    parser.add_argument("--size", choices=("short", "full"), default="full")
    parser.add_argument("--rows", type=Path, help="run the one campaign of --only in this process; write its rows here")
    asked = parser.parse_args()
    if asked.rows:
        return _run_here(asked.only[0], asked.size, asked.rows)
    began = time.monotonic()
    writing = threading.Lock()

    def run(name: str) -> page.Rows:
        found = _run_beside(name, asked.size)
        if asked.size == "full":
            with writing:
                page.replace_rows(ROOT / "docs/reliability.md", found)
        return found

    with ThreadPoolExecutor(AT_A_TIME) as pool:
        rows = list(pool.map(run, asked.only))
    minutes, cpu = (time.monotonic() - began) / 60, sum(found.cpu_minutes for found in rows)
    _say(f"all campaigns: {minutes:.1f} min, {cpu:.1f} min of CPU time")
    faults = [f"{found.name}: {fault}" for found in rows for result in found.results for fault in result.faults]
    for fault in faults:
        _say(f"FAULT {fault}")
    return 1 if faults else 0


def _run_here(name: str, size: str, rows: Path) -> int:
    with tempfile.TemporaryDirectory(prefix=f"reliability-{name}-", dir=CAMPAIGNS[name].folder) as folder:
        results = campaign.run(name, size, Path(folder))
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    cpu_s = sum(each.ru_utime + each.ru_stime for each in used)
    rows.write_text(json.dumps({"cpu_s": cpu_s, "results": [asdict(result) for result in results]}))
    return 0


def _run_beside(name: str, size: str) -> page.Rows:
    """Run a campaign in a process of its own; one that breaks off is a fault."""
    from daq.base.version import VERSION

    _say(f"{name}: begins")
    began = time.monotonic()
    again = f"python -m tests.reliability --only {name} --size {size}"
    with tempfile.NamedTemporaryFile(suffix=".json") as file:
        done = subprocess.run([sys.executable, *again.split()[1:], "--rows", file.name], cwd=ROOT, check=False)
        content = Path(file.name).read_text()
    cpu_s = float("nan")
    if done.returncode == 0 and content:
        found = json.loads(content)
        cpu_s = found["cpu_s"]
        results = tuple(Result(**row | {"faults": tuple(row["faults"])}) for row in found["results"])
    else:
        fault = f"the campaign itself ended with {done.returncode}: {again}"
        results = (Result("the campaign runs to its end", name, fault, campaign.test_of(name), (fault,)),)
    minutes = (time.monotonic() - began) / 60
    faults = sum(len(result.faults) for result in results)
    _say(f"{name}: {faults} faults, {minutes:.1f} min, {cpu_s / 60:.1f} min of CPU time")
    return page.Rows(name, results, f"{date.today()}", VERSION, _processor(), minutes, cpu_s / 60)


def _processor() -> str:
    """Return the processor's name, as the system gives it."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        lines = []
    named = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return f"{len(named)} x {named[0]}" if named else platform.processor() or platform.machine()


def _say(line: str) -> None:
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    sys.exit(main())
