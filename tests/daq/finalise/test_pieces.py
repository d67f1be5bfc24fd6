"""A run file is made piece by piece: what the pieces are makes no difference, and memory does not grow with the run."""

import resource
import subprocess
import sys
from pathlib import Path

import pytest

from daq.finalise.run import run_data
from daq.protocols import session
from daq.runfile import journal, spill, store

from ..runfile.runs import assert_same

FIXTURE = Path(__file__).parents[1] / "runfile/fixtures/damaged.h5.part"
# Peak of a process that makes the run file of a journal, MB.
MEASURE = """
import resource, sys
from pathlib import Path
from daq.finalise.run import finalise
resource.setrlimit(resource.RLIMIT_AS, (int(sys.argv[3]),) * 2)
found = finalise(Path(sys.argv[1]), Path(sys.argv[2]), finished_by="test")
print(found.samples, found.lost, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024)
"""


def measured(part, limit):
    """Return samples, lost samples and the peak of a process that makes the run file of a journal."""
    command = [sys.executable, "-c", MEASURE, str(part), str(part.with_suffix("")), str(limit)]
    return [int(word) for word in subprocess.run(command, capture_output=True, check=True).stdout.split()]


def test_the_pieces_of_a_journal_make_no_difference(tmp_path, monkeypatch):
    markers = journal.read_markers(journal.markers_path(FIXTURE))
    whole, found = run_data(journal.read(FIXTURE), markers)
    monkeypatch.setattr(session, "PIECE_BYTES", 2000)
    monkeypatch.setattr(spill, "MEMORY_BYTES", 5000)
    monkeypatch.setattr(spill, "BLOCK", 300)
    run, again = run_data(journal.read(FIXTURE), markers, output=tmp_path / "run.h5")
    assert isinstance(run.time, spill.Column)
    assert_same(whole, run)
    assert again == found
    store.write(tmp_path / "run.h5", run)
    store.write(tmp_path / "whole.h5", whole)
    assert [path.name for path in sorted(tmp_path.iterdir())] == ["run.h5", "whole.h5"]
    assert_same(store.load(tmp_path / "whole.h5").raw, store.load(tmp_path / "run.h5").raw)


@pytest.mark.slow
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the limit of a process's memory is Linux's")
def test_memory_does_not_grow_with_the_run(tmp_path):
    # It took 150 bytes a sample: 2755 MB for an hour at 5 kHz, and MemoryError under 2 GB.
    read = journal.read(FIXTURE)
    board = [record for record in read.records if record.kind == journal.RECEIVED]
    peaks = []
    for hundreds in (1, 5):
        part = tmp_path / f"{hundreds}.h5.part"
        writer = journal.Writer(part, read.header | {"samples": None})
        for k in range(100 * hundreds):
            for record in board:
                stamp = record.stamp_ns + k * 60_000_000_000
                writer.append(record.kind, stamp, record.data)
            writer.append(journal.LOST, stamp + 1, b"gone")
            writer.append(journal.REOPENED, stamp + 2, b"back")
        writer.close()
        peaks.append(measured(part, 400 << 20 if hundreds == 5 else resource.getrlimit(resource.RLIMIT_AS)[1]))
    (few, _, small), (many, _, large) = peaks
    assert many > 4 * few
    assert large - small < 60


@pytest.mark.slow
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the peak of a process's memory is in kB on Linux")
@pytest.mark.parametrize("protocol", ["text", "qsb"])
def test_memory_does_not_grow_with_the_lines(protocol, tmp_path):
    # They were decoded at once, 380 bytes a line: 1386 MB for an hour of text at 1 kHz.
    header = journal.read(FIXTURE).header | {"samples": None, "protocol": protocol, "rate_hz": 512.0}
    header["columns"] = None if protocol == "qsb" else "t_us,count"
    line = b"s0E%08X%08X!\n" if protocol == "qsb" else b"%d,%d\n"
    tick = 1 if protocol == "qsb" else 1e6 / 512
    peaks = []
    for seconds in (200, 800):
        part = tmp_path / f"{seconds}.h5.part"
        writer = journal.Writer(part, header)
        for second in range(seconds):
            rows = [(k // 9, int(tick * k)) for k in range(512 * second, 512 * second + 512)]
            sent = b"".join(line % (row if protocol == "qsb" else row[::-1]) for row in rows)
            writer.append(journal.RECEIVED, 1_000_000_000 * (second + 2), b"x" * (second % 7 == 0) + sent)
        writer.close()
        peaks.append(measured(part, 2 << 30))
    (few, _, small), (many, _, large) = peaks
    assert few > 0.99 * 512 * 200
    assert many > 3.9 * few
    assert large - small < 60
