"""Counters and clocks that wrap or jump: the 32-bit microseconds, the 16-bit counts, the date, the host's clock."""

import json
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from daq.finalise.run import run_data
from daq.protocols import session
from daq.runfile import journal, journal_records
from daq.wire import frames

from ..journals import HEADER
from .result import Result, Size

PERIOD_US = 1000
GRAY = np.array([0, 1, 3, 2])
# What wraps, the width of its counter in bits, and by how much it rises from sample to sample.
WRAPS = {"time": (32, PERIOD_US), "up": (16, 3), "down": (16, 2), "belt": (16, 1)}
BLOCKS = (1, 8)
START = datetime(2026, 11, 22, 12, tzinfo=UTC)
NS = 1_000_000_000
# First samples of runs that cross midnight, the ends of months and years, and the hours at which clocks change.
DATES = [
    *("2026-11-22T23:59:59.900", "2026-12-31T23:59:59.900", "2028-02-28T23:59:59.900", "2028-02-29T23:59:59.900"),
    *("2026-03-29T00:59:59.900", "2026-10-25T00:59:59.900", "2038-01-19T03:14:07.900", "1970-01-02T00:00:00.000"),
]
ZONES_MINUTES = (240, 15)  # at the short and at the full size
JUMPS_S = (-86_400, -3600, -0.5, 0.5, 3600, 86_400)


def clocks(size: Size, folder: Path) -> list[Result]:
    """Try wraps at every one of ``size.amount`` samples, and every date, zone and jump."""
    wrapped, tried = _wrap_everywhere(size, folder)
    dated, dates = _dates(folder, ZONES_MINUTES[size.full])
    jumped, jumps = _jumps(folder)
    return [
        _row(
            "a counter that wraps, wherever in a frame or in the file, changes no time and no count",
            f"{', '.join(f'{name} ({bits} bit)' for name, (bits, _) in WRAPS.items())}: before each of {size.amount} "
            f"samples, in frames of {BLOCKS[0]} and {BLOCKS[1]}",
            f"{tried} wraps",
            wrapped,
        ),
        _row(
            "start and end of a run are right in every time zone, at the ends of days and years, and in leap years",
            f"{len(DATES)} moments in the zones from -12 to +14 hours, every {ZONES_MINUTES[size.full]} minutes",
            f"{dates} runs",
            dated,
        ),
        _row(
            "a host's clock that jumps changes no sample time and no count",
            f"stamps that jump by {', '.join(f'{jump:g}' for jump in JUMPS_S)} s in the middle of a run",
            f"{jumps} runs",
            jumped,
        ),
    ]


def _row(promise: str, tried: str, number: str, faults: list[str]) -> Result:
    return Result(promise, tried, f"{number}, {len(faults)} wrong", tuple(faults))


def _board(samples: int, block: int, starts: dict[str, int]) -> Iterator[bytes]:
    has = frames.Capability
    capabilities = has.BLOCKS | has.LEVELS | has.BELT
    yield frames.encode_ident(frames.Ident((1, 0, 0), "x4", capabilities, 16, 1000, block, 10_000, 10**7, "clocks"))
    for first in range(0, samples, block):
        k = np.arange(first, min(first + block, samples))
        at = {name: starts.get(name, 0) + rise * k & (1 << bits) - 1 for name, (bits, rise) in WRAPS.items()}
        levels = GRAY[at["up"] - at["down"] & 3]
        columns = [[0, *[PERIOD_US] * (len(k) - 1)], *(at[name].tolist() for name in ("up", "down"))]
        sent = frames.SampleBlock(first, int(at["time"][0]), 0, *columns, levels.tolist(), at["belt"].tolist())
        yield frames.encode_samples(sent)


def _journal(path: Path, sent: list[bytes], stamps: NDArray[np.int64], **header: object) -> journal.Journal:
    """Return the journal of a recording; each of what was sent came in a read of its own."""
    known = HEADER | {"protocol": "frames", "rate_hz": 1e6 / PERIOD_US, "wall_ns": int(START.timestamp()) * NS}
    config = "[encoder]\nbelt_metres_per_count = 1.0\n"
    records = [(journal.HEADER, 0, json.dumps(known | header).encode()), (journal.CONFIGURATION, 0, config.encode())]
    records += [(journal.RECEIVED, stamp, data) for stamp, data in zip(stamps.tolist(), sent, strict=True)]
    path.write_bytes(journal.MAGIC + b"".join(b"".join(journal_records.pack(*record)) for record in records))
    return journal.read(path)


def _stamps(sent: list[bytes], block: int) -> NDArray[np.int64]:
    return np.arange(len(sent), dtype=np.int64) * block * PERIOD_US * 1000


def _wrong(recorded: journal.Journal, samples: int) -> str:
    """Return what is wrong in a run whose sample k has moved by k counts, and the belt too; "" if nothing."""
    run, found = run_data(recorded)
    k = np.arange(samples)
    if (found.samples, found.lost, found.segments, found.phase_errors) != (samples, 0, 1, 0):
        return f"{found.samples} of {samples} samples, {found.lost} lost, {found.segments} segments"
    if not np.array_equal(run.count - run.count[0], k):
        return "wrong counts"
    if run.belt_count is None or not np.array_equal(run.belt_count - run.belt_count[0], k):
        return "wrong counts of the belt"
    return "" if np.allclose(run.time, k * PERIOD_US / 1e6, rtol=0, atol=1e-9) else "wrong times"


def _wrap_everywhere(size: Size, folder: Path) -> tuple[list[str], int]:
    faults, tried, whole = [], 0, session.PIECE_BYTES
    for block in BLOCKS:
        for name, (bits, rise) in WRAPS.items():
            for at in range(1, size.amount):
                start = (1 << bits) - rise * at
                sent = list(_board(size.amount, block, {name: start}))
                recorded = _journal(folder / "wrap.part", sent, _stamps(sent, block))
                try:
                    for session.PIECE_BYTES in (whole, 100):
                        tried += 1
                        if wrong := _wrong(recorded, size.amount):
                            faults.append(f"{wrong} when {name} wraps before sample {at}, in frames of {block}")
                finally:
                    session.PIECE_BYTES = whole
    return faults, tried


def _dates(folder: Path, minutes_apart: int) -> tuple[list[str], int]:
    faults, tried, samples = [], 0, 304
    sent = list(_board(samples, 8, {}))
    for date in DATES:
        for minutes in range(-12 * 60, 14 * 60 + 1, minutes_apart):
            zone = timezone(timedelta(minutes=minutes))
            local = datetime.fromisoformat(date).replace(tzinfo=zone)
            wall_ns = int((local - datetime(1970, 1, 1, tzinfo=UTC)) / timedelta(microseconds=1)) * 1000
            if wall_ns < 0:
                continue
            recorded = _journal(
                folder / "date.part", sent, 5 * NS + _stamps(sent, 8), wall_ns=wall_ns, monotonic_ns=5 * NS,
                utc_offset_s=60 * minutes,
            )  # fmt: skip
            run, _ = run_data(recorded)
            begun, ended = datetime.fromisoformat(run.started), datetime.fromisoformat(run.ended)
            # The first frame comes after the identification, one frame's time after the start.
            begin = local + timedelta(milliseconds=8)
            tried += 1
            if abs(begun - begin) > timedelta(microseconds=2) or begun.utcoffset() != zone.utcoffset(None):
                faults.append(f"a run of {begin.isoformat()} starts at {run.started}")
            if abs((ended - begun) - timedelta(milliseconds=samples - 1)) > timedelta(microseconds=2):
                faults.append(f"a run from {run.started} ends at {run.ended}")
    return faults, tried


def _jumps(folder: Path) -> tuple[list[str], int]:
    faults, samples = [], 8000
    sent = list(_board(samples, 8, {}))
    for jump in JUMPS_S:
        stamps = 100_000 * NS + _stamps(sent, 8)
        stamps[len(stamps) // 2 :] += round(jump * NS)
        if wrong := _wrong(_journal(folder / "jump.part", sent, stamps), samples):
            faults.append(f"{wrong} after a jump of {jump:g} s")
    return faults, len(JUMPS_S)
