"""The tail of a journal gives, piece by piece, the samples that the finaliser puts into the run file."""

import random
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from daq.finalise.run import run_data
from daq.live.tail import JournalTail
from daq.runfile import journal, journal_records
from daq.runfile.recording import Recording

from ...journals import write_journal


def followed(part: Path, step: int) -> tuple[JournalTail, np.ndarray, np.ndarray, np.ndarray]:
    """Return the tail of a journal that grows by ``step`` bytes between two looks, and its samples joined."""
    content = part.read_bytes()
    growing = part.with_name("growing.h5.part")
    growing.write_bytes(content[:4096])
    tail = JournalTail(growing)
    new = tail.poll()
    for at in range(4096, len(content), step):
        with growing.open("ab") as file:
            file.write(content[at : at + step])
        new += tail.poll()
    columns = (np.concatenate([getattr(piece, name) for piece in new]) for name in ("time", "position", "fresh"))
    return tail, *columns


def finalised(part: Path) -> tuple[Recording, dict[str, int]]:
    run, found = run_data(journal.read(part))
    names = {"samples", "lost", "crc_errors", "illegal", "phase_errors", "segments"}
    return run, {name: value for name, value in found.as_json().items() if name in names}


def damaged(part: Path, share: float) -> None:
    """Flip one bit in this share of the bytes that the board sent; the journal's own records stay whole."""
    draw = random.Random(5)
    made = bytearray(journal.MAGIC)
    for place in journal_records.scan(journal.Content(part.read_bytes())):
        data = bytearray(place.record.data)
        if place.record.kind == journal.RECEIVED:
            for at in range(200 if len(data) > 400 else len(data), len(data)):
                if draw.random() < share:
                    data[at] ^= 1 << draw.randrange(8)
        for piece in journal_records.pack(place.record.kind, place.record.stamp_ns, bytes(data)):
            made += piece
    part.write_bytes(made)


@pytest.mark.parametrize("step", [97, 1 << 20])
@pytest.mark.parametrize(
    ("changes", "share"),
    [(("scatter.Fs=0.1",), 0.0), (("gaps.rate=2", "gaps.duration=0.05"), 0.002)],
    ids=["whole", "gaps and damage"],
)
def test_the_samples_and_totals_are_those_of_the_run_file(
    keep_journal: Callable[..., Path], changes: tuple[str, ...], step: int, share: float
) -> None:
    part = keep_journal(*changes)
    damaged(part, share)
    run, totals = finalised(part)
    assert (totals["crc_errors"] > 3) == (share > 0)
    assert totals["lost"] > 50 or len(changes) == 1
    tail, time, position, fresh = followed(part, step)
    # The board sends on until it is stopped: 16,003 samples on the page were 16,000 in the file.
    np.testing.assert_array_equal(position, run.position)
    np.testing.assert_allclose(time, run.time, rtol=0, atol=1e-9)
    assert np.flatnonzero(fresh).tolist() == [0]
    assert tail.ended == journal.COMPLETE
    assert vars(tail.counts) == totals


def text_journal(part: Path, *, reopen_at: int | None = None, n: int = 3000) -> None:
    """Write the journal of a sketch that prints time and count; its port is lost once, and its clock starts again."""
    records, began = [], 0
    for k in range(0, n, 20):
        if k == reopen_at:
            records.append((journal.LOST, k * 1_000_000, b"unplugged"))
            records.append((journal.REOPENED, k * 1_000_000 + 500_000_000, b"/dev/ttyACM0"))
            began = k
        late = 500_000_000 if began else 0
        lines = [b"%d,%d\n" % (1000 * (i - began) + 7, round(4000 * np.sin(i / 200))) for i in range(k, k + 20)]
        records.append((journal.RECEIVED, (k + 20) * 1_000_000 + late, b"".join(lines)))
    write_journal(part, [*records, (journal.END, n * 1_000_000, b'{"reason": "stopped"}')])


@pytest.mark.parametrize("reopen_at", [None, 1500])
def test_text_lines_are_followed_across_a_lost_port(tmp_path: Path, reopen_at: int | None) -> None:
    part = tmp_path / "text.h5.part"
    text_journal(part, reopen_at=reopen_at)
    run, totals = finalised(part)
    tail, time, position, fresh = followed(part, 300)
    np.testing.assert_array_equal(position, run.position)
    assert tail.counts.samples == totals["samples"]
    assert tail.counts.segments == totals["segments"] == int(fresh.sum())
    assert np.all(np.diff(time) > 0)
    np.testing.assert_allclose(time, run.time, rtol=0, atol=0.05)  # placed by the host's clock, late by one read


def test_a_stream_without_lines_is_not_kept(tmp_path: Path) -> None:
    part = tmp_path / "noise.h5.part"
    text_journal(part, n=20)
    tail = JournalTail(part)
    tail.poll()
    for k in range(30):
        with part.open("ab") as file:
            file.write(b"".join(journal_records.pack(journal.RECEIVED, k, b"\xff" * 5000)))
        assert tail.poll() == []
    assert sum(len(data) for _, data in tail._reads) <= 1 << 15
