"""The data of a run: its columns and what is known of them, and what they may be."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.runfile.rig import Rig
from daq.runfile.spill import BLOCK, blocks

# What can happen to a run, with the code its event is stored under.
EVENTS = {
    "gap": 1,  # samples are missing before this one
    "crc": 2,  # a frame arrived damaged
    "illegal": 3,  # A and B changed together: the direction is unknown
    "phase": 4,  # the count disagrees with the levels sent beside it
    "overrun": 5,  # the board could not keep its own pace
    "marker": 6,  # set by a person
    "both-moved": 7,  # up and down both counted within one sample
    "invalid": 8,  # a gap too long to unwrap the counters across
    "reopened": 9,  # the port went away and came back: a new segment
    "notice": 10,  # the board reported something in words
    "retimed": 11,  # the time as sent was not true and has been interpolated
}
EVENT_NAMES = {code: name for name, code in EVENTS.items()}
# In the provenance, `start_time_from` of an import whose start nobody stated.
OF_FILE = "file's time of modification"
# What no run reaches, and numbers whose products stay in the range of a float64: 30 years, and a count that a float64
# holds exactly.
LONGEST_S, FASTEST_HZ, FARTHEST = 1e9, 1e9, 1e16
# No mass on a spring in a laboratory is as fast, or moves as far.  The thesis's rig reaches 0.6 m/s and 0.3 m, so that
# its track in cm (60 m/s, 30 m) and in mm is asked about.  Halved, a fast rig of 5 m/s would be asked; doubled, a slow
# one in cm (0.15 m/s, 0.2 m) is not.
FASTEST_M_PER_S, LONGEST_M = 10.0, 10.0
FEWEST_ROWS = 100  # samples; nothing is asked of a shorter table, which is too short to be fitted
SPANS = 200  # pieces that the record is cut into to measure its speed: noise between neighbours is none


@dataclass(frozen=True)
class Raw:
    """The samples as the board sent them; each array has shape (n,)."""

    sample: NDArray[np.uint32]  # sequence number, unwrapped; it skips over lost samples and restarts in each segment
    count_up: NDArray[np.uint16] | NDArray[np.uint32]  # the two counters, rolling over at their width
    count_down: NDArray[np.uint16] | NDArray[np.uint32]
    device_time: NDArray[np.uint32]  # device time in us as sent, rolling over at 2^32
    levels: NDArray[np.uint8]  # channel levels at the sample, A = 1, B = 2
    flags: NDArray[np.uint16]  # the status bits of the sample
    illegal: NDArray[np.uint16]  # illegal transitions counted so far, rolling over
    # the belt encoder's count, and us from the last edge to the sample, when the board sends them
    belt_count: NDArray[np.uint16] | None = None
    edge_time: NDArray[np.uint16] | None = None


@dataclass(frozen=True)
class SentAs:
    """The identifications that a run was sent under, where there were several; i stretches of segments."""

    segment: NDArray[np.uint32]  # (i,) first segment of each stretch
    counter_bits: NDArray[np.uint8]  # (i,) width of the counters there
    # (i,) counts of the run in one count of these counters: 4 of a decoder that counts one edge in four
    counts: NDArray[np.uint8]
    ident: tuple[str, ...]  # (i,) the identification, in words


@dataclass(frozen=True)
class Truth:
    """The exact motion of a simulated rig: time (s), x (m), v (m/s), friction force F (N), each of shape (m,)."""

    time: NDArray[np.float64]
    x: NDArray[np.float64]
    v: NDArray[np.float64]
    F: NDArray[np.float64]
    scene: str = ""


def _make_empty(dtype: type[np.generic]) -> Callable[[], NDArray[Any]]:
    return lambda: np.empty(0, dtype)


@dataclass(frozen=True)
class RunData:
    """The fields of a `daq.runfile.recording.Recording`, where they are described."""

    title: str
    started: str
    ended: str
    rate_hz: float
    rig: Rig
    time: NDArray[np.float64]
    position: NDArray[np.float64]
    count: NDArray[np.int64] | None = None
    raw: Raw | None = None
    segment: NDArray[np.uint16] | NDArray[np.uint32] = field(default_factory=_make_empty(np.uint16))
    config_toml: str = ""
    clock_sample: NDArray[np.uint32] = field(default_factory=_make_empty(np.uint32))
    clock_offset: NDArray[np.float64] = field(default_factory=_make_empty(np.float64))
    clock_ppm: float | None = None
    clock_ppm_error: float | None = None
    clock_offset_error: NDArray[np.float64] = field(default_factory=_make_empty(np.float64))
    event_sample: NDArray[np.uint32] = field(default_factory=_make_empty(np.uint32))
    event_kind: tuple[str, ...] = ()
    event_note: tuple[str, ...] = ()
    belt_velocity: NDArray[np.float64] | None = None
    belt_count: NDArray[np.int64] | None = None
    truth: Truth | None = None
    sent_as: SentAs | None = None
    operator: str = ""
    sample_name: str = ""
    note: str = ""
    tags: Mapping[str, str] = field(default_factory=dict)
    provenance: Mapping[str, str | int] = field(default_factory=dict)
    source: Path = Path()
    default: str = "data"
    digest: str = ""

    def __post_init__(self) -> None:
        if not self.segment.size:
            object.__setattr__(self, "segment", np.zeros(self.time.size, np.uint16))
        if not self.event_note:
            object.__setattr__(self, "event_note", ("",) * self.event_sample.size)

    @property
    def unit(self) -> str:
        """Of `position`: "m", or "count" for counts of a rig whose metres per count nobody measured."""
        return "count" if self.count is not None and self.rig.metres_per_count is None else "m"


def count_lost(sample: NDArray[np.uint32], segment: NDArray[np.unsignedinteger]) -> int:
    """Return how many samples the sequence numbers skip within segments; both arguments have shape (n,)."""
    within = np.diff(segment) == 0
    return int((np.diff(sample.astype(np.int64))[within] - 1).sum())


def find_disorder(time: NDArray[np.float64]) -> int | None:
    """Return the first sample whose time is not finite or not after the one before; None when there is none."""
    before = -np.inf
    for number, block in enumerate(blocks(time)):
        wrong = ~np.isfinite(block) | ~(np.diff(block, prepend=before) > 0)
        if wrong.any():
            return number * BLOCK + int(np.argmax(wrong))
        before = float(block[-1])
    return None


def explain_impossible(time: NDArray[np.float64], position: NDArray[np.float64]) -> str | None:
    """Return why times, s, and positions, m or counts, (n,), are not those of a run; None if they are."""
    if (sample := find_disorder(time)) is not None:
        return f"time does not increase at sample {sample}"
    if not (in_range := np.abs(position) <= FARTHEST).all():
        sample = int(np.argmin(in_range))
        what = f"{position[sample]:.3g}, too large" if np.isfinite(position[sample]) else "not finite"
        return f"position is {what} at sample {sample}"
    if max(-time[0], time[-1]) > LONGEST_S:
        return f"its times reach {max(time[0], time[-1], key=abs):.3g} s"
    if (time[-1] - time[0]) * FASTEST_HZ < time.size - 1:
        return f"{time.size} samples in {time[-1] - time[0]:.3g} s are too many"
    return None


def explain_implausible(time: NDArray[np.float64], position: NDArray[np.float64]) -> str | None:
    """Return how far and fast times, s, and positions, m, move, if too far or fast for a mass on a spring."""
    if time.size < FEWEST_ROWS:
        return None
    low, high = np.percentile(position, [1, 99])  # a single wild sample is a fault, not a unit
    lag = max(1, time.size // SPANS)
    speed = float(np.percentile(np.abs(position[lag:] - position[:-lag]) / (time[lag:] - time[:-lag]), 90))
    travel = float(high - low)
    if speed <= FASTEST_M_PER_S and travel <= LONGEST_M:
        return None
    return f"the mass would move {travel:.3g} m, at {speed:.3g} m/s"


def positions(count: NDArray[np.int64], rig: Rig) -> NDArray[np.float64]:
    """Return ``count * metres_per_count + datum``, m, exact to one rounding; counts without calibration."""
    if rig.metres_per_count is None:
        return count.astype(np.float64)
    return np.asarray(count * rig.metres_per_count.value + rig.offset, np.float64)
