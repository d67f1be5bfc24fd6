"""CPU time of reading: decoding of frames and lines per sample, and a recording at 5 kHz in real time.

``python benchmarks/throughput.py [SECONDS]`` (default 10).  Decoding: CPU time per sample, best of `REPEATS`, of the
work during a recording (the tally of received samples) and of the work at its end (the arrays of the run file).
Recording: a board in another process sends at 5 kHz through a pseudo-terminal, in real time; CPU time of this process
as a share of one core during the recording, and CPU time of the run file afterwards.  Last, the complete command `daq
record --realtime`, whose process also contains the simulated rig.
"""

import json
import os
import resource
import subprocess
import sys
import tempfile
import threading
import time
import tty
from pathlib import Path

from daq import protocols
from daq.finalise import run
from daq.protocols.request import RecordRequest
from daq.protocols.session import Plan, decode_whole
from daq.recorder.record import record
from daq.wire import frames as wire

RESULTS = Path(__file__).resolve().parent / "results"
REPEATS = 5
SAMPLES = 200_000
READ = 512  # bytes at a time
FEEDER = """
import os, sys, time
line = open(sys.argv[1], "rb").read()
per_s, ident = float(sys.argv[2]), bytes.fromhex(sys.argv[3])
at, running, began, command = 0, False, 0.0, b""
os.set_blocking(0, False)
while True:
    try:
        command += os.read(0, 4096)
    except BlockingIOError:
        pass
    *done, command = command.split(b"\\n")
    for word in done:
        if word == b"I":
            os.write(1, ident)
        elif word in (b"S", b"X"):
            running, began, at = word == b"S", time.monotonic(), 0
    if running:
        due = min(len(line), int((time.monotonic() - began) * per_s))
        if due > at:
            at += os.write(1, line[at:due])
    time.sleep(0.001)
"""


def frames(samples: int, block: int, rate_hz: int) -> bytes:
    """Return a number of samples as frames."""
    period = 1_000_000 // rate_hz
    dt = (0, *[period] * (block - 1))
    parts = []
    for first in range(0, samples, block):
        k = range(first, first + block)
        up, down = [3 * i & 0xFFFF for i in k], [2 * i & 0xFFFF for i in k]
        head = first & 0xFFFF, period * first & 0xFFFFFFFF, 0
        parts.append(wire.encode_samples(wire.SampleBlock(*head, dt, up, down, [(0, 1, 3, 2)[i & 3] for i in k])))
    return b"".join(parts)


def lines(protocol: str, samples: int) -> bytes:
    """Return a number of samples as records of a QSB or as text lines."""
    if protocol == "qsb":
        return b"".join(b"s0E%08X%08X!\n" % (3 * k, k) for k in range(samples))
    return b"".join(b"%d,%d,%d\r\n" % (1000 * k, 3 * k, 2 * k) for k in range(samples))


def decoding() -> list[dict[str, object]]:
    """Return the CPU time per sample of the tally and of the decoding, for each protocol."""
    rows = []
    for protocol, block, data, header in (
        ("frames", 1, frames(SAMPLES, 1, 1000), {}),
        ("frames", 8, frames(SAMPLES, 8, 1000), {}),
        ("qsb", 1, lines("qsb", SAMPLES), {"rate_hz": 512.0}),
        ("text", 1, lines("text", SAMPLES), {"rate_hz": 1000.0, "columns": "t_us,up,down"}),
    ):
        backend = protocols.load(protocol)
        reads = [(at, data[at : at + READ]) for at in range(0, len(data), READ)]
        session = backend.session(None, "", RecordRequest(columns=header.get("columns")))
        if protocol == "text":
            session.prepare(Plan(1000.0, 1, 0.0))
        least = {"tally": float("inf"), "decode": float("inf")}
        for _ in range(REPEATS):
            tally = session.tally()
            begun = time.process_time()
            for _, part in reads:
                tally.feed(part)
            least["tally"] = min(least["tally"], time.process_time() - begun)
            begun = time.process_time()
            stream = decode_whole(backend, reads, header)
            least["decode"] = min(least["decode"], time.process_time() - begun)
        rows.append(
            {"protocol": protocol, "block": block, "bytes": len(data) / SAMPLES, "samples": int(stream.n.sum())}
        )
        rows[-1] |= {f"{name}_us": 1e6 * cpu / SAMPLES for name, cpu in least.items()}
    return rows


def recording(seconds: float, rate_hz: int) -> dict[str, float]:
    """Return the recorder's CPU share at a rate, from a board in another process."""
    master, slave = os.openpty()
    tty.setraw(slave)
    capabilities = wire.Capability.BLOCKS | wire.Capability.LEVELS
    ident = wire.encode_ident(wire.Ident((1, 0, 0), "x4", capabilities, 16, 1000, 8, 10_000, 10**7, "bench"))
    with tempfile.TemporaryDirectory() as folder:
        line = Path(folder) / "line"
        line.write_bytes(frames(round((seconds + 1) * rate_hz) // 8 * 8, 8, rate_hz))
        per_s = 71 * rate_hz / 8
        command = [sys.executable, "-c", FEEDER, str(line), str(per_s), ident.hex()]
        board = subprocess.Popen(command, stdin=master, stdout=master)
        began: list[float] = []
        marks: list[float] = []

        def note(done: float) -> None:
            if not began:
                began.extend((time.process_time(), time.monotonic()))
            marks[:] = [time.process_time(), time.monotonic()]

        build = run.finalise
        spent: list[float] = []

        def timed(*arguments: object, **more: object) -> object:
            begun = time.process_time()
            try:
                return build(*arguments, **more)
            finally:
                spent.append(time.process_time() - begun)

        run.finalise = timed
        try:
            request = RecordRequest(os.ttyname(slave), Path(folder) / "run.h5", rate_hz, seconds, baud=1_000_000)
            found = record(request, progress=note, stop=threading.Event())
        finally:
            run.finalise = build
            board.kill()
            board.wait()
            os.close(master)
            os.close(slave)
    wall = marks[1] - began[1]
    return {
        "rate_hz": rate_hz, "samples": found.samples, "lost": found.lost, "wall_s": wall,
        "share": (marks[0] - began[0]) / wall, "finalise_s": spent[0], "clock_ppm": found.clock_ppm or 0.0,
    }  # fmt: skip


def whole_command(seconds: float) -> float:
    """Return the CPU share of `daq record --realtime --rate 5000`, simulation, start and run file included."""
    with tempfile.TemporaryDirectory() as folder:
        line = [
            sys.executable,
            "-m",
            "daq.cli.app",
            "record",
            "--realtime",
            "--rate",
            "5000",
            "--duration",
            str(seconds),
        ]
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run(line, cwd=folder, check=True, capture_output=True)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return (after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime) / seconds


def main(seconds: float) -> None:
    """Print the tables and write them as JSON."""
    rows = decoding()
    print(
        f"{'protocol':9} {'per frame':>9} {'bytes':>6} {'while recording':>16} {'at the end':>11}   us CPU per sample"
    )
    for row in rows:
        figures = f"{row['bytes']:6.1f} {row['tally_us']:16.2f} {row['decode_us']:11.2f}"
        print(f"{row['protocol']:9} {row['block']:9} {figures}")
    found = [recording(seconds, rate_hz) for rate_hz in (1000, 5000)]
    for row in found:
        print(
            f"recording at {row['rate_hz']} Hz: {100 * row['share']:.2f} % of one core, {row['lost']:g} samples lost; "
            f"the run file {row['finalise_s']:.2f} s"
        )
    share = whole_command(seconds)
    print(
        f"all of 'daq record --realtime --rate 5000 --duration {seconds:g}': {100 * share:.1f} %, with the simulation"
    )
    RESULTS.mkdir(exist_ok=True)
    results = {"decoding": rows, "recording": found, "whole_command_share": share}
    (RESULTS / "throughput.json").write_text(json.dumps(results, indent=1) + "\n")


if __name__ == "__main__":
    main(float(sys.argv[1]) if len(sys.argv) > 1 else 10.0)
