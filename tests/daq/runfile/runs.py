"""Runs to write."""

from dataclasses import replace

import numpy as np

from daq.runfile.recording import Recording
from daq.runfile.rig import Rig


def imported_run(n: int = 400, **changes: object) -> Recording:
    """Return an imported run of ``n`` samples at 100 Hz."""
    times = [f"2024-05-01T12:00:0{second}+02:00" for second in (0, 4)]
    time = np.arange(n) / 100
    made = Recording("a track", *times, rate_hz=100.0, rig=Rig(name="bench"), time=time, position=np.sin(time))
    return replace(made, **changes)  # type: ignore[arg-type]
