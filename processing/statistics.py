"""Statistics of stick-slip without a friction law: durations, drops, and break-away levels.

A stick has a duration between two slips, a slip between two sticks, unless an end of the record or a gap cuts it off,
or the belt rests during it; a stick that ends in a slip has a break-away in any case.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from processing.record.kinematics import Kinematics, SmoothingSummary
from stickslip.compute.arrays import Array
from stickslip.output.lengths import shown_length

FEWEST_SLIPS = 3  # with fewer the scatter is not meaningful
BELT_RUNS = 0.5  # travel of a stick relative to that of the belt; with less the belt rested: the stick has no duration
QUANTITIES = {"stick_s": "s", "slip_s": "s", "drop_m": "m", "break_away_m": "m"}
TITLES = {"stick_s": "stick", "slip_s": "slip", "drop_m": "drop", "break_away_m": "break-away"}


@dataclass(frozen=True)
class SlipEvent:
    """One break-away and the slip after it; NaN for what the record contains only in part."""

    t: float  # time of the break-away, s
    stick_s: float  # duration of the stick before, s
    slip_s: float  # duration of the slip, s
    # how far the mass slips back, m (or counts): range of the position from the middle of the stick before to that of
    # the stick after
    drop_m: float
    break_away_m: float  # extension of the spring at break-away, m (or counts), positive in the belt's direction


@dataclass(frozen=True, eq=False)
class StickSlipStatistics:
    """The statistics of one record, or of several together."""

    sticks: int  # including those that are cut off
    slips: int
    spikes: int  # samples left out as spikes
    frozen: int  # samples left out while the sensor held its value
    dropped_frames: int
    events: tuple[SlipEvent, ...]  # in order of time, record by record
    records: int = 1

    def summary(self, name: str) -> dict[str, float | None] | None:
        """Return mean, sd, min, max and trend of a quantity of `SlipEvent`; None with fewer than `FEWEST_SLIPS` slips.

        The trend is the slope of the least-squares line through the quantity against the time of the break-away, in
        units of the quantity per second: None over several records.
        """
        time, values = self.column("t"), self.column(name)
        finite = np.isfinite(values)
        time, values = time[finite], values[finite]
        if self.slips < FEWEST_SLIPS or values.size < FEWEST_SLIPS:
            return None
        centred = time - time.mean()
        trend = float(np.sum(centred * values) / np.sum(centred**2)) if self.records == 1 else None
        return {
            "mean": float(values.mean()),
            "sd": float(values.std(ddof=1)),
            "min": float(values.min()),
            "max": float(values.max()),
            "trend_per_s": trend,
        }

    def column(self, name: str) -> Array:
        """Return one quantity of all events, NaN where unknown."""
        return np.array([getattr(event, name) for event in self.events], np.float64)

    def as_json(self) -> dict[str, Any]:
        """Return what the commands print under ``statistics``; the keys are fixed."""
        document: dict[str, Any] = {
            name: getattr(self, name) for name in ("sticks", "slips", "spikes", "frozen", "dropped_frames")
        }
        document |= {name: self.summary(name) for name in QUANTITIES}
        document["break_aways"] = [
            {name: value if math.isfinite(value) else None for name, value in vars(event).items()}
            for event in self.events
        ]
        return document

    def rows(self, unit: str) -> list[tuple[str, str, str, str, str, str, str]]:
        """Return the table of the quantities as text: name, mean, sd, min, max, trend ("" over several records), unit.

        Lengths are in mm, or in counts where ``unit`` is "count".
        """
        rows = []
        for name, quantity_unit in QUANTITIES.items():
            summary = self.summary(name)
            if summary is None:
                continue
            size, unit_text = (1.0, quantity_unit) if quantity_unit == "s" else shown_length(unit)
            values = [size * (summary[key] or 0.0) for key in ("mean", "sd", "min", "max")]
            digits = 1 - math.floor(math.log10(values[1])) if values[1] > 0 else 6  # two of the standard deviation
            mean, sd, low, high = (f"{round(value, digits):.{min(max(digits, 0), 12)}f}" for value in values)
            trend = summary["trend_per_s"]
            drift = "" if trend is None else f"{size * trend:+.2g} {unit_text}/s"
            rows.append((TITLES[name], mean, sd, low, high, drift, unit_text))
        return rows

    def sentences(self, unit: str) -> list[str]:
        """Return a compact table as lines; lengths in mm, or in counts where ``unit`` is "count"."""
        if not self.sticks:
            return []
        if self.slips < FEWEST_SLIPS:
            return [f"statistics: {self.slips} slips are too few (at least {FEWEST_SLIPS} are needed)"]
        return [
            f"{name:10} {mean} ± {sd} {shown} ({low} to {high}{f', trend {drift}' if drift else ''})"
            for name, mean, sd, low, high, drift, shown in self.rows(unit)
        ]


def statistics(motion: SmoothingSummary, position: Array, time: Array) -> StickSlipStatistics:
    """Return the statistics of a smoothed record; ``position`` is without steps, m from the spring's rest position."""
    sign = math.copysign(1.0, motion.belt_speed) if math.isfinite(motion.belt_speed) else 1.0
    phases = motion.phases
    interval = float(np.median(np.diff(time[:10_000]))) if time.size > 1 else 0.0
    events = []
    for index, slip in enumerate(phases):
        before = phases[index - 1] if index else None
        after = phases[index + 1] if index + 1 < len(phases) else None
        if slip.kind != "slip" or before is None or before.kind != "stick" or slip.start - before.end > 2 * interval:
            continue
        stretch = float(np.interp(slip.start, time, position))
        last = phases[index - 2] if index > 1 else None
        complete = last is not None and last.kind == "slip" and before.start - last.end <= 2 * interval
        advance = float(np.ptp(position[before.first : before.last + 1]))
        if advance < BELT_RUNS * abs(motion.belt_speed) * before.duration:  # False where the speed is unknown
            complete = False
        landed = after is not None and after.kind == "stick" and after.start - slip.end <= 2 * interval
        drop = math.nan
        if landed and after is not None:
            begin, end = (before.first + before.last) // 2, (after.first + after.last) // 2 + 1
            drop = float(np.ptp(position[begin:end]))
        events.append(
            SlipEvent(
                slip.start,
                before.duration if complete else math.nan,
                slip.duration if landed else math.nan,
                drop,
                sign * stretch,
            )
        )
    return StickSlipStatistics(
        len(motion.sticks), len(motion.slips), motion.spikes, motion.frozen, motion.dropped_frames, tuple(events)
    )


def from_kinematics(motion: Kinematics) -> StickSlipStatistics:
    """Return the statistics of a motion in memory."""
    return statistics(motion, motion.steady_position, motion.time)


def pooled(records: Sequence[StickSlipStatistics]) -> StickSlipStatistics:
    """Return the statistics of several records together, without a trend."""
    if len(records) == 1:
        return records[0]
    return StickSlipStatistics(
        sum(record.sticks for record in records),
        sum(record.slips for record in records),
        sum(record.spikes for record in records),
        sum(record.frozen for record in records),
        sum(record.dropped_frames for record in records),
        tuple(event for record in records for event in record.events),
        len(records),
    )
