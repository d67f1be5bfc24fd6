"""Runs to write, and to compare."""

from dataclasses import fields, is_dataclass, replace
from typing import Any

import numpy as np

from daq.runfile.recording import Recording
from daq.runfile.rig import Rig
from daq.runfile.run_data import Raw, positions
from stickslip.units import Measured


def assert_same(one: object, other: object, name: str = "") -> None:
    """Compare two values of dataclasses, arrays inside; a column counts as an array."""
    if is_dataclass(one):
        for field in fields(one):
            assert_same(getattr(one, field.name), getattr(other, field.name), f"{name}.{field.name}")
    elif isinstance(one, np.ndarray):
        whole = np.asarray(other)
        assert one.dtype == whole.dtype, name
        assert np.array_equal(one, whole, equal_nan=one.dtype.kind == "f"), name
    else:
        assert one == other, name


RIG = Rig(
    name="bench 2",
    metres_per_count=Measured(7.67e-6, 1e-9),
    counts_per_revolution=16384,
    mass=Measured(0.3, 3e-4),
    stiffness=Measured(10.5552),
    datum=Measured(0.001, 5e-4),
    damping=Measured(0.02, 0.002),
    belt_speed=Measured(0.22, 0.002),
)


def run(n: int = 501, *, rig: Rig = RIG, **changes: Any) -> Recording:
    """Return a run of n samples whose counters roll over."""
    time = np.arange(n) / 1000
    count = np.round(40_000 * np.sin(3 * time)).astype(np.int64)
    raw = Raw(
        sample=np.arange(n, dtype=np.uint32),
        count_up=(np.maximum(count, 0) * 3 % 65536).astype(np.uint16),
        count_down=(np.maximum(-count, 0) * 3 % 65536).astype(np.uint16),
        device_time=(2**32 - 1000 + np.arange(n) * 1000 & 0xFFFFFFFF).astype(np.uint32),
        levels=(count & 3).astype(np.uint8),
        flags=np.zeros(n, np.uint16),
        illegal=np.arange(n, dtype=np.uint16) // 400,
    )
    made = Recording(
        title="a run",
        started="2024-05-01T12:00:00.250000+02:00",
        ended="2024-05-01T12:00:20.750000+02:00",
        rate_hz=1000.0,
        rig=rig,
        time=time,
        position=positions(count, rig),
        count=count,
        raw=raw,
        segment=np.zeros(n, np.uint16),
        config_toml=rig.to_toml(),
        clock_sample=np.array([0, 250], np.uint32),
        clock_offset=np.array([12.25, 12.25001]),
        event_sample=np.array([3, 400], np.uint32),
        event_kind=("marker", "illegal"),
        event_note=("touched", ""),
        provenance={"software": "stickslip", "git_dirty": 1},
    )
    return replace(made, **changes)


def imported_run(n: int = 400, **changes: object) -> Recording:
    """Return an imported run of ``n`` samples at 100 Hz."""
    times = [f"2024-05-01T12:00:0{second}+02:00" for second in (0, 4)]
    time = np.arange(n) / 100
    made = Recording("a track", *times, rate_hz=100.0, rig=Rig(name="bench"), time=time, position=np.sin(time))
    return replace(made, **changes)  # type: ignore[arg-type]
