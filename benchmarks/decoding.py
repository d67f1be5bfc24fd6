"""Decoding of sampled logic levels A, B: edges and samples per second of every decoder, compared with sigrok.

``python benchmarks/decoding.py [SAMPLES]`` (default 2^24): streams with an edge every other sample (dense) and every
ten (ordinary), in the pieces in which a capture is read; regular back-and-forth motion, and a random walk.  "totals"
only counts, as `daq decode` does; "steps" also locates each edge, as `daq replay` requires.  CPU time of one core, best
of `REPEATS`.  sigrok-cli decodes one capture of the same dense motion, shortened so that it takes some seconds; the
CPU time of its start-up, measured on an empty capture, is subtracted.
"""

import json
import resource
import shutil
import subprocess
import sys
import tempfile
import time
import zipfile
from pathlib import Path

import numpy as np

from daq.imports.sigrok import PIECE
from daq.wire.quadrature import DECODERS, Decoder, levels_of

RESULTS = Path(__file__).resolve().parent / "results"
REPEATS = 5
SIGROK_SAMPLES = 1 << 20


def stream(samples: int, every: int, walk: bool) -> np.ndarray:
    """Return levels with an edge every so many samples: back and forth by 5000 edges, or a random walk."""
    edges = samples // every
    if walk:
        steps = np.random.default_rng(1).choice([-1, 1], edges)
    else:
        steps = np.where(np.arange(edges) // 5000 % 2 == 0, 1, -1)
    return np.repeat(levels_of(np.cumsum(steps)), every)


def seconds(kind: str, levels: np.ndarray, what: str) -> tuple[float, Decoder]:
    """Return the smallest CPU time of decoding ``levels``, and the decoder afterwards."""
    least = float("inf")
    for _ in range(REPEATS):
        decoder = Decoder(kind)
        take = decoder.count if what == "totals" else decoder.feed
        begun = time.process_time()
        for first in range(0, len(levels), PIECE):
            take(levels[first : first + PIECE])
        least = min(least, time.process_time() - begun)
    return least, decoder


def capture(path: Path, levels: np.ndarray) -> None:
    """Write a .sr capture with A and B as its first two probes."""
    lines = ["[global]", "sigrok version=0.5.2", "[device 1]", "capturefile=logic-1", "total probes=2"]
    lines += ["samplerate=1 MHz", "unitsize=1", "probe1=A", "probe2=B"]
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("version", "2")
        archive.writestr("metadata", "\n".join(lines) + "\n")
        archive.writestr("logic-1-1", levels.tobytes())


def sigrok() -> dict[str, float] | None:
    """Return the CPU time of sigrok's Gray code decoder for dense motion, or None if sigrok-cli is not installed."""
    tool = shutil.which("sigrok-cli")
    if tool is None:
        return None
    with tempfile.TemporaryDirectory() as folder:

        def cpu(levels: np.ndarray) -> tuple[float, str]:
            path = Path(folder) / "capture.sr"
            capture(path, levels)
            before = resource.getrusage(resource.RUSAGE_CHILDREN)
            line = [tool, "-i", str(path), "-P", "graycode:d0=A:d1=B", "-A", "graycode=count"]
            # Debian 12's sigrok-cli decodes to the end and then aborts in Python's clean-up, so its output is used.
            done = subprocess.run(line, capture_output=True, text=True, check=False)
            after = resource.getrusage(resource.RUSAGE_CHILDREN)
            return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, done.stdout

        start, _ = cpu(np.zeros(8, dtype=np.uint8))
        levels = stream(SIGROK_SAMPLES, 2, walk=False)
        taken, printed = cpu(levels)
    decoder = Decoder("x4")
    decoder.count(levels)
    found = len(printed.splitlines())
    if found != decoder.edges:
        raise SystemExit(f"sigrok found {found} edges, we {decoder.edges}: the two did not do the same work")
    return {
        "edges_per_s": decoder.edges / (taken - start), "edges": decoder.edges, "cpu_s": taken, "start_s": start,
    }  # fmt: skip


def main(samples: int) -> None:
    """Print the table and write it as JSON."""
    rows = []
    print(f"{'stream':22} {'decoder':11} {'for':7} {'Medges/s':>9} {'Msamples/s':>11}")
    for every, density in ((2, "dense"), (10, "ordinary")):
        for walk in (False, True):
            levels = stream(samples, every, walk)
            for kind in DECODERS:
                for what in ("totals", "steps"):
                    cpu_s, decoder = seconds(kind, levels, what)
                    row = {
                        "stream": density, "motion": "random walk" if walk else "swings", "decoder": kind, "for": what,
                        "edges_per_s": decoder.edges / cpu_s, "samples_per_s": len(levels) / cpu_s,
                    }  # fmt: skip
                    rows.append(row)
                    name = f"{density}, {row['motion']}"
                    rates = f"{row['edges_per_s'] / 1e6:9.1f} {row['samples_per_s'] / 1e6:11.0f}"
                    print(f"{name:22} {kind:11} {what:7} {rates}")
    peer = sigrok()
    least = min(row["edges_per_s"] for row in rows if row["stream"] == "dense")
    ordinary = min(row["samples_per_s"] for row in rows if row["stream"] == "ordinary")
    print(f"slowest: {least / 1e6:.0f} M edges/s dense, {ordinary / 1e6:.0f} M samples/s ordinary")
    if peer is None:
        print("sigrok-cli is not installed: no comparison")
    else:
        like = next(row for row in rows if row["decoder"] == "x4" and row["for"] == "totals")
        peer["ratio"] = like["edges_per_s"] / peer["edges_per_s"]
        peer["ratio_of_the_slowest"] = least / peer["edges_per_s"]
        print(
            f"sigrok: {peer['edges_per_s'] / 1e3:.0f} k edges/s, dense swings; ours, x4, {peer['ratio']:.0f} times "
            f"as fast (the slowest of ours {peer['ratio_of_the_slowest']:.0f} times)"
        )
    RESULTS.mkdir(exist_ok=True)
    results = {"samples": samples, "rows": rows, "sigrok": peer}
    (RESULTS / "decoding.json").write_text(json.dumps(results, indent=1) + "\n")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 1 << 24)
