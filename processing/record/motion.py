"""Values computed from a record: motion, switching times, phases, motion of the belt, velocity steps and findings."""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Literal, Protocol, Self

import numpy as np

from processing.record.series import Series
from stickslip.compute.arrays import Array, Mask


@dataclass(frozen=True)
class Finding:
    code: str  # name for programs, in words joined by hyphens: "belt-speed", "spikes"
    text: str  # a sentence for a person, with both numbers and their unit
    value: float = math.nan  # what the record shows, in SI units; NaN without a number
    expected: float = math.nan  # what was stated or would be sound
    sigmas: float = math.nan  # standard deviations between both; NaN without a scatter


DERIVATIVES = ("position", "velocity", "acceleration")
ROWS = (*DERIVATIVES, *(f"{name}_errors" for name in DERIVATIVES))


@dataclass(frozen=True)
class Corner:
    """A corner of the velocity."""

    time: float  # s
    sd: float  # standard deviation of the time, s
    # "land" (slip to stick), "leave" (stick to slip), "start" (from rest), "stop" (to rest) or "kick" (a step of the
    # velocity); files of earlier versions also have "overtake" (the mass runs ahead of the belt)
    what: str


@dataclass(frozen=True, eq=False)
class Motion:
    """Result of a method: x, v, a (m, m/s, m/s^2) with one standard error each, all of shape (n,)."""

    position: Array
    velocity: Array
    acceleration: Array
    position_errors: Array
    velocity_errors: Array
    acceleration_errors: Array
    window: int  # samples in the smoothing window, or in that of the equivalent Savitzky-Golay filter
    order: int  # polynomial degree
    method: str  # the method that was run, never "auto"
    corners: tuple[Corner, ...] = ()  # fitted ones, in order of time; empty for methods without corners

    @classmethod
    def from_rows(
        cls,
        series: Series,
        values: Array,
        errors: Array,
        *,
        window: int,
        order: int,
        method: str,
        corners: tuple[Corner, ...] = (),
    ) -> Self:
        """Return the motion with the rows x (from the origin of ``series``), v and a of ``values``, (3, n)."""
        return cls(
            position=series.origin + values[0],
            velocity=values[1],
            acceleration=values[2],
            position_errors=errors[0],
            velocity_errors=errors[1],
            acceleration_errors=errors[2],
            window=window,
            order=order,
            method=method,
            corners=corners,
        )

    def as_rows(self) -> Array:
        """Return a copy of x, v, a and their standard errors, (6, n)."""
        return np.array([getattr(self, name) for name in ROWS])

    def select(self, kept: Mask) -> Self:
        return self.with_rows(self.as_rows()[:, kept])

    def with_rows(self, rows: Array) -> Self:
        return replace(self, **dict(zip(ROWS, rows, strict=True)))


@dataclass(frozen=True)
class Phase:
    """One stick or slip."""

    kind: Literal["stick", "slip"]
    start: float  # times, s, on the recording's axis, between samples
    end: float
    first: int  # first and last sample inside (both included)
    last: int
    # standard deviations of the times, s; infinite where not fitted, or where a gap or an end of the record cuts the
    # phase off
    start_sd: float = math.inf
    end_sd: float = math.inf

    @property
    def duration(self) -> float:
        """End minus start, s."""
        return self.end - self.start


class SampleRange(Protocol):
    """Anything with a first and a last sample, both included."""

    @property
    def first(self) -> int:
        """The first sample."""

    @property
    def last(self) -> int:
        """The last one."""


@dataclass(frozen=True)
class Fault:
    """Samples that a sensor read wrong, left out of the smoothing."""

    first: int
    last: int  # included
    # "spike": out of line with the samples on either side; "frozen": one value held while the mass moved
    kind: Literal["spike", "frozen"]

    @property
    def samples(self) -> int:
        return self.last - self.first + 1


def mask_ranges(ranges: Iterable[SampleRange], n: int) -> Mask:
    """Return a mask of n samples, True inside the ranges."""
    mask = np.zeros(n, bool)
    for interval in ranges:
        mask[interval.first : interval.last + 1] = True
    return mask


@dataclass(frozen=True, eq=False)
class PhaseSegmentation:
    """The record divided into sticks and slips."""

    belt_speed: float  # m/s, signed; NaN when unknown
    phases: tuple[Phase, ...]  # in order of time
    plateau_speed: float  # common speed of the plateaus, m/s, whatever the belt's nominal speed; NaN without plateaus


@dataclass(frozen=True, eq=False)
class BeltMotion:
    """The motion of a belt with an encoder, arrays of shape (n,)."""

    velocity: Array  # of the belt, m/s, signed
    velocity_errors: Array
    series: Series  # of the mass relative to the belt: x less the belt's travel
    motion: Motion  # of the same

    def speed(self, moving: Mask) -> float:
        """Return the belt's median speed where ``moving`` is True, m/s, signed; NaN if it never is."""
        return float(np.median(self.velocity[moving])) if moving.any() else math.nan


@dataclass(frozen=True)
class VelocityStep:
    """A step of the velocity."""

    sample: int  # the first one after it
    step: float  # m/s
