"""The motion of a run: position, velocity and acceleration with errors, and where the mass stuck and slipped.

`processing.smoothing` makes a `Kinematics` of a recording, `processing.stage` keeps it in the run file.  How it was
made is a `SmoothingSummary`, which is all that a record too long for memory yields: it has no arrays.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from processing.polynomial.even import is_even
from processing.record.motion import Corner, Fault, Finding, Phase, VelocityStep, mask_ranges
from processing.record.series import PositionStep, step_offsets
from stickslip.compute.arrays import Array, Mask
from stickslip.output.lengths import format_length, shown_speed

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from daq.runfile.recording import Recording


DERIVATIVES = {"position": "", "velocity": "_per_s", "acceleration": "_per_s2"}


@dataclass(frozen=True, eq=False, kw_only=True)
class SmoothingSummary:
    """How a motion was computed, and its sticks, slips and faults.

    Attributes
    ----------
    method : str
        "segment", "rts", "sg" or "fd": what `auto` chose, never "auto" itself.
    window, order : int
        Samples in the smoothing window (2 for finite differences) and degree of its polynomial.  For a smoother, the
        window of the equivalent Savitzky-Golay filter of order 4; "segment" blurs less.
    times : str
        "recorded" or "nominal".
    belt_speed : float
        m/s, signed; with a belt channel the belt's median speed while the mass is in motion, unless a speed was
        stated; NaN if the record shows no stick and no speed was stated.
    phases : tuple of Phase
        Sticks and slips in order of time; rest before the belt starts belongs to neither.
    losses : tuple of PositionStep
        Steps of the position: ten or more counts went missing, or the datum moved (`processing.defects.faults`).
    kicks : tuple of VelocityStep
        Steps of the velocity (`processing.defects.faults`); marked, and smoothed over.
    corners : tuple of Corner
        Fitted corners of the velocity: landings and break-aways; empty for methods without corners ("rts", "sg", "fd").
    faults : tuple of Fault
        Samples left out of the smoothing as spikes or frozen values (`processing.defects.faults`): the motion there
        is estimated from the samples on either side, with its errors.
    dropped_frames : int
        Frames lost among even times (`processing.defects.frames`), as counted or estimated; the times are as recorded.
    repaired : bool
        Whether the steps of the position were removed from it.
    noise : float
        Standard deviation of one position, m (or counts), from the record itself (`processing.record.noise`).
    findings : tuple of Finding
        Contradictions and faults that the record shows.
    cpu_s : float
        CPU time spent, s.
    samples : int
        Number of samples.
    span : float
        Time from the first sample to the last, s.
    unit : str
        Unit of the position: "m" or "count".
    belt_counted : bool
        Whether the belt has an encoder.
    plateau_speed : float
        m/s: common speed of the plateaus, whatever the belt's nominal speed; NaN without plateaus, or when the
        motion was read back from a file.
    model : mapping
        Model learned from the record and applied to it (`processing.blocks.MotionModel`): numbers by name, and nested
        mappings for its parts; empty when the motion was read back from a file without a model.
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
    samples: int
    span: float
    unit: str
    belt_counted: bool = False
    plateau_speed: float = math.nan
    model: Mapping[str, Any] = field(default_factory=dict)

    @property
    def sticks(self) -> tuple[Phase, ...]:
        return tuple(phase for phase in self.phases if phase.kind == "stick")

    @property
    def slips(self) -> tuple[Phase, ...]:
        return tuple(phase for phase in self.phases if phase.kind == "slip")

    @property
    def plateau_fraction(self) -> float:
        """Share of the samples in sticks, 0 to 1."""
        return sum(stick.last - stick.first + 1 for stick in self.sticks) / self.samples

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
        """Number of times that counts went missing."""
        return sum(step.counts != 0 for step in self.losses)


@dataclass(frozen=True, eq=False, kw_only=True)
class Kinematics(SmoothingSummary):
    """The motion estimated from a recording; every array has shape (n,).

    Attributes
    ----------
    recording : Recording
        The recording that was smoothed.
    time : array
        s; the recorded times, or the even grid when `times` is "nominal".
    position, velocity, acceleration : array
        m, m/s, m/s^2; positive towards +x.  In counts instead of metres for a rig without a calibration.
    position_errors, velocity_errors, acceleration_errors : array
        One standard error each; infinite where the samples do not determine a derivative (a single sample between two
        gaps).
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
        return mask_ranges(self.sticks, self.samples)

    @cached_property
    def missing(self) -> Mask:
        """True for the samples that were left out of the smoothing, (n,)."""
        return mask_ranges(self.faults, self.samples)

    @property
    def even_times(self) -> bool:
        """Whether the times lie on an even grid, which hides missing frames."""
        return is_even(self.time)

    @cached_property
    def offset(self) -> Array:
        """Error of each recorded position due to steps of the position, m."""
        return step_offsets(self.recording.segment, self.losses)

    @property
    def steady_position(self) -> Array:
        """Smoothed position without the steps, whether `repaired` or not, m."""
        return self.position if self.repaired else self.position - self.offset

    @property
    def measured(self) -> Array:
        """The recorded positions, m, without steps if `repaired`; the smoothed position where samples are `missing`."""
        recording = self.recording
        recorded = recording.position
        if self.repaired:
            recorded = recorded - self.offset
        return np.where(self.missing, self.position, recorded) if self.faults else recorded

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
        for interval in self.phases:
            phase[interval.first : interval.last + 1] = interval.kind
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
        from processing.record.plot import draw_figure

        return draw_figure(self, ax)

    def facts(self) -> dict[str, str]:
        """Return the summary of `__repr__` as text by name."""
        belt = f"{self.belt_speed:.5g} {shown_speed(self.unit)}" if math.isfinite(self.belt_speed) else "unknown"
        window = "" if self.method == "fd" else f", window {self.window}, order {self.order}"
        texts = {
            "samples": str(self.samples),
            "duration": f"{self.span:.4g} s",
            "method": f"{self.method}{window}, {self.times} times",
            "phases": f"{len(self.sticks)} sticks, {len(self.slips)} slips",
            "belt speed": belt + (", from its own encoder" if self.belt_counted else ""),
            "stuck for": f"{100 * self.plateau_fraction:.0f} % of the record",
            "error of one position": format_length(self.noise, self.unit),
            "counts lost": f"{self.lost_counts} times" if self.lost_counts else "",
            "velocity steps": str(len(self.kicks)) if self.kicks else "",
            "samples omitted": str(int(self.missing.sum())) if self.faults else "",
            "findings": "; ".join(finding.text for finding in self.findings),
        }
        return {name: text for name, text in texts.items() if text}

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
