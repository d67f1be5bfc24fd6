"""The motion behind a run: position, velocity and acceleration with errors, and where the mass stuck and slipped.

`processing.smoothing` makes a `Kinematics` of a recording, `processing.stage` keeps it in the run file.  How it was
made is a `SmoothingHeader`; a record too long for memory yields a `SmoothingSummary`, which has no arrays.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from processing.polynomial.even_grid import is_even
from processing.record.finding import Finding
from processing.record.motion import Corner, Fault, Phase, VelocityStep, mask_of
from processing.record.position_steps import PositionStep, step_offsets
from stickslip.compute.arrays import Array, Mask
from stickslip.output.lengths import format_length, shown_speed
from stickslip.text import printable

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from daq.runfile.recording import Recording
    from processing.record.plot import DrawnMotion

DERIVATIVES = {"position": "", "velocity": "_per_s", "acceleration": "_per_s2"}


@dataclass(frozen=True, eq=False, kw_only=True)
class SmoothingHeader:
    """How a motion was made and what was found in it.

    Attributes
    ----------
    method : str
        "segment", "rts", "sg" or "fd": what `auto` chose, never "auto" itself.
    window, order : int
        Samples in the smoothing window (2 for finite differences) and degree of its polynomial.  A smoother has no
        window: that of the equivalent Savitzky-Golay filter of order 4 is stated; "segment" blurs less.
    times : str
        "recorded" or "nominal".
    belt_speed : float
        m/s, signed; with a belt channel the belt's median speed while the mass is in motion, unless one was stated;
        NaN when the record shows no stick and none was stated.
    phases : tuple of Phase
        Sticks and slips in order of time; rest before the belt starts belongs to neither.
    losses : tuple of PositionStep
        Where the position steps: ten or more counts went missing, or the datum moved
        (`processing.defects.faults`).
    kicks : tuple of VelocityStep
        Where the velocity stepped (`processing.defects.faults`); marked, and smoothed over.
    corners : tuple of Corner
        Where the velocity has a corner, as the method fitted it: landings, break-aways, the mass overtaking the belt;
        empty where the method models none ("rts", "sg", "fd").
    faults : tuple of Fault
        Samples that are no positions (`processing.defects.faults`), left out of the smoothing: the motion there
        is estimated from the samples on either side, with its errors.
    dropped_frames : int
        Frames lost among even times (`processing.defects.frames`), as counted or estimated; the times are as recorded.
    repaired : bool
        Whether these steps were taken out of the position.
    noise : float
        Standard deviation of one position, m (or counts), from the record itself (`processing.record.noise`).
    findings : tuple of Finding
        Contradictions and faults that the record shows.
    cpu_s : float
        CPU time spent, s.
    plateau_speed : float
        m/s: common speed of the plateaus, whatever the belt's nominal speed; NaN without plateaus, or when the
        motion was read back from a file.
    model : mapping
        What was learned from the record and applied to it (`processing.blocks.MotionModel`), as numbers by name and
        such of its parts; empty when the motion was read back from a file that does not hold it.
    """

    method: str
    window: int
    order: int
    times: str
    belt_speed: float
    phases: tuple[Phase, ...]
    losses: tuple[PositionStep, ...]
    kicks: tuple[VelocityStep, ...] = ()
    corners: tuple[Corner, ...] = ()
    faults: tuple[Fault, ...] = ()
    dropped_frames: int = 0
    repaired: bool
    noise: float
    findings: tuple[Finding, ...] = ()
    cpu_s: float
    plateau_speed: float = math.nan
    model: Mapping[str, Any] = field(default_factory=dict)

    @property
    def sticks(self) -> tuple[Phase, ...]:
        """The sticks, in order of time."""
        return tuple(phase for phase in self.phases if phase.kind == "stick")

    @property
    def slips(self) -> tuple[Phase, ...]:
        """The slips, in order of time."""
        return tuple(phase for phase in self.phases if phase.kind == "slip")

    @property
    def spikes(self) -> int:
        """Samples left out because they are out of line with their neighbours."""
        return sum(fault.samples for fault in self.faults if fault.kind == "spike")

    @property
    def frozen(self) -> int:
        """Samples left out because the sensor held its value while the mass moved."""
        return sum(fault.samples for fault in self.faults if fault.kind == "frozen")

    @property
    def lost_counts(self) -> int:
        """How many times counts went missing."""
        return sum(step.counts != 0 for step in self.losses)


@dataclass(frozen=True, eq=False, kw_only=True)
class SmoothingSummary(SmoothingHeader):
    """A motion that was written block by block into its run file."""

    samples: int  # how many samples there are
    span: float  # from the first sample to the last, s
    unit: str  # unit of the position: "m", or "count"
    plateau_fraction: float  # share of the samples in sticks, 0 to 1
    belt_counted: bool = False  # whether the belt has an encoder of its own


@dataclass(frozen=True, eq=False, kw_only=True)
class Kinematics(SmoothingHeader):
    """The motion rebuilt from a recording, every array of shape (n,).

    Attributes
    ----------
    recording : Recording
        What it was made from.
    time : array
        s; the recorded times, or the even grid when `times` is "nominal".
    position, velocity, acceleration : array
        m, m/s, m/s^2; positive towards +x.  In counts instead of metres for a rig without a calibration.
    position_errors, velocity_errors, acceleration_errors : array
        One standard error each; infinite where a derivative cannot be known (a lone sample between two gaps).
    belt_velocity, belt_velocity_errors : array or None
        m/s, signed, and one standard error, only with a belt channel: the belt's counts through the same filter.
    """

    recording: "Recording"
    time: Array
    position: Array
    velocity: Array
    acceleration: Array
    position_errors: Array
    velocity_errors: Array
    acceleration_errors: Array
    belt_velocity: Array | None = None
    belt_velocity_errors: Array | None = None

    @cached_property
    def stick(self) -> Mask:
        """True in sticks, (n,)."""
        return mask_of(self.sticks, self.samples)

    @cached_property
    def missing(self) -> Mask:
        """True for the samples that were left out of the smoothing, (n,)."""
        return mask_of(self.faults, self.samples)

    @property
    def belt_counted(self) -> bool:
        """Whether the belt has an encoder of its own."""
        return self.belt_velocity is not None

    @property
    def samples(self) -> int:
        """How many samples there are."""
        return int(self.time.size)

    @property
    def even_times(self) -> bool:
        """Whether the times lie on an even grid: they then do not show where a frame is missing."""
        return is_even(self.time)

    @property
    def span(self) -> float:
        """From the first sample to the last, s."""
        return float(self.time[-1] - self.time[0])

    @property
    def unit(self) -> str:
        """Unit of the position: "m", or "count"."""
        return self.recording.unit

    @cached_property
    def offset(self) -> Array:
        """By how much steps of the position put each recorded position off, m, (n,)."""
        return step_offsets(self.recording.segment, self.losses)

    @property
    def steady_position(self) -> Array:
        """Smoothed position without the steps, whether they were taken out of it or not, m, (n,)."""
        return self.position if self.repaired else self.position - self.offset

    @property
    def measured(self) -> Array:
        """The recorded positions, m, (n,); without their steps where these were taken out.

        Where samples are `missing` it is the smoothed position.
        """
        recording = self.recording
        recorded = recording.position
        if self.repaired:
            recorded = recorded - self.offset
        return np.where(self.missing, self.position, recorded) if self.faults else recorded

    @property
    def plateau_fraction(self) -> float:
        """Share of the samples in sticks, 0 to 1."""
        return float(self.stick.mean()) if self.stick.size else 0.0

    @cached_property
    def cycles(self) -> tuple[slice, ...]:
        """Samples of each complete cycle, from one onset of slip after a stick to the next."""
        onsets = [
            after.first
            for before, after in pairwise(self.phases)
            if before.kind == "stick" and after.kind == "slip" and after.first == before.last + 1
        ]
        segment = self.recording.segment
        return tuple(slice(first, last) for first, last in pairwise(onsets) if segment[first] == segment[last])

    def to_dataframe(self) -> "pd.DataFrame":
        """Return the motion as a pandas table, one row a sample, units in the column names.

        Columns: ``time_s``; position, velocity and acceleration, then their standard errors; the belt's velocity and
        its error where it has an encoder; ``phase``, which is "stick", "slip" or "rest"; ``segment``.
        """
        import pandas as pd

        columns: dict[str, np.ndarray] = {"time_s": self.time}
        for name, per in DERIVATIVES.items():
            columns[f"{name}_{self.unit}{per}"] = getattr(self, name)
        for name, per in DERIVATIVES.items():
            columns[f"{name}_error_{self.unit}{per}"] = getattr(self, f"{name}_errors")
        if self.belt_velocity is not None and self.belt_velocity_errors is not None:
            columns[f"belt_velocity_{self.unit}_per_s"] = self.belt_velocity
            columns[f"belt_velocity_error_{self.unit}_per_s"] = self.belt_velocity_errors
        phase = np.full(self.samples, "rest", dtype="U5")
        for found in self.phases:
            phase[found.first : found.last + 1] = found.kind
        return pd.DataFrame(columns | {"phase": phase, "segment": self.recording.segment})

    def plot(self, ax: "Axes | None" = None) -> "Figure":
        """Draw position and velocity against time, over the first cycles, and the phase portrait of the whole record.

        Parameters
        ----------
        ax : matplotlib Axes, optional
            Where to draw the phase portrait alone; by default a new figure.

        Returns
        -------
        matplotlib Figure
            Three axes; sticks are shaded.  ``figure.savefig(path)`` writes it, a notebook shows it.
        """
        from processing.record.plot import figure_of

        return figure_of(self.drawing(), ax)

    def drawing(self) -> "DrawnMotion":
        """Return what `plot` shows."""
        from processing.record.plot import DrawnMotion

        window = "finite differences"
        if self.method != "fd":
            window = f"{self.method}, window {self.window}, order {self.order}"
        return DrawnMotion(
            printable(f"{self.recording.name}: {self.recording.title}   ({window}, {self.times} times)"),
            self.time,
            self.position,
            self.velocity,
            self.recording.segment,
            self.unit,
            self.sticks,
            len(self.cycles),
            self.belt_speed,
            self.recording.markers,
        )

    def facts(self) -> dict[str, str]:
        """Return what a person wants to see first, in words, by name."""
        belt = f"{self.belt_speed:.5g} {shown_speed(self.unit)}" if math.isfinite(self.belt_speed) else "unknown"
        window = "" if self.method == "fd" else f", window {self.window}, order {self.order}"
        found = {
            "samples": str(self.samples),
            "duration": f"{self.span:.4g} s",
            "method": f"{self.method}{window}, {self.times} times",
            "phases": f"{len(self.sticks)} sticks, {len(self.slips)} slips",
            "belt speed": belt + (", from its own encoder" if self.belt_counted else ""),
            "stuck for": f"{100 * self.plateau_fraction:.0f} % of the record",
            "error of one position": format_length(self.noise, self.unit),
            "counts lost": f"{self.lost_counts} times" if self.lost_counts else "",
            "velocity steps": str(len(self.kicks)) if self.kicks else "",
            "samples left out": str(int(self.missing.sum())) if self.faults else "",
            "findings": "; ".join(finding.text for finding in self.findings),
        }
        return {name: text for name, text in found.items() if text}

    def __repr__(self) -> str:
        facts = self.facts()
        findings = f"; {len(self.findings)} findings" if self.findings else ""
        length = f"{facts['samples']} samples, {facts['duration']}"
        return (
            f"<Kinematics of {self.recording.name}: {facts['method']}\n"
            f" {length}; {facts['phases']}, belt speed {facts['belt speed']}{findings}>"
        )

    def _repr_html_(self) -> str:
        from stickslip.output import notebook

        return notebook.table(f"Kinematics of {self.recording.name}", self.facts().items())
