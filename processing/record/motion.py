"""Values made from a record: its motion, switching times, phases, the belt's motion, and steps of the velocity."""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Literal, Protocol, Self

import numpy as np

from processing.record.series import Series
from stickslip.compute.arrays import Array, Mask

DERIVATIVES = ("position", "velocity", "acceleration")
ROWS = (*DERIVATIVES, *(f"{name}_errors" for name in DERIVATIVES))


@dataclass(frozen=True)
class Corner:
    """A corner of the velocity: its estimated time and standard deviation, s, and what happens there.

    ``what`` is "land" (slip to stick), "leave" (stick to slip), "start" (from rest), "stop" (to rest), "overtake" (the
    mass comes up to the belt and runs ahead of it) or "kick" (a step of the velocity).
    """

    time: float
    sd: float
    what: str


@dataclass(frozen=True, eq=False)
class Motion:
    """What a method returns: x, v, a (m, m/s, m/s^2) with one standard error each, all of shape (n,)."""

    position: Array
    velocity: Array
    acceleration: Array
    position_errors: Array
    velocity_errors: Array
    acceleration_errors: Array
    # samples in the smoothing window, or in that of the equivalent Savitzky-Golay filter, and polynomial degree
    window: int
    order: int
    method: str  # the method that was run, never "auto"
    # those that the method fitted, in order of time; empty for methods that model no corners
    corners: tuple[Corner, ...] = ()

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
        """Return the motion whose x (without the origin of ``series``), v and a are the rows of ``values``.

        ``values`` and ``errors``, the standard errors of the same three, are of shape (3, n).
        """
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

    def rows(self) -> Array:
        """Return x, v, a and their standard errors, a copy of shape (6, n)."""
        return np.array([getattr(self, name) for name in ROWS])

    def taken(self, kept: Mask) -> Self:
        """Return the samples ``kept``, (n,)."""
        return self.with_rows(self.rows()[:, kept])

    def with_rows(self, rows: Array) -> Self:
        """Return the motion with other `rows`."""
        return replace(self, **dict(zip(ROWS, rows, strict=True)))


@dataclass(frozen=True)
class Phase:
    """One stick or slip."""

    kind: Literal["stick", "slip"]
    start: float  # Times, s, on the recording's axis; they lie between samples
    end: float
    first: int  # first and last sample inside (both included)
    last: int
    # standard deviations of the times, s; infinite where they were not fitted, or where a gap or an end of the record
    # cuts the phase off
    start_sd: float = math.inf
    end_sd: float = math.inf

    @property
    def duration(self) -> float:
        """Length of the phase, s."""
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
    """Samples ``first`` to ``last`` (both included) that a sensor got wrong, left out of the smoothing.

    ``kind`` is "spike" (out of line with the samples on either side) or "frozen" (one value held while the mass moved).
    """

    first: int
    last: int
    kind: Literal["spike", "frozen"]

    @property
    def samples(self) -> int:
        """How many samples there are."""
        return self.last - self.first + 1


def mask_of(ranges: Iterable[SampleRange], n: int) -> Mask:
    """Return a mask of n samples, True inside the ranges (phases, faults)."""
    mask = np.zeros(n, bool)
    for own in ranges:
        mask[own.first : own.last + 1] = True
    return mask


@dataclass(frozen=True, eq=False)
class PhaseSegmentation:
    """The record divided into sticks and slips."""

    belt_speed: float  # m/s, signed; NaN when unknown
    phases: tuple[Phase, ...]  # in order of time
    # common speed of the plateaus, m/s, whatever the belt's nominal speed is; NaN without plateaus
    plateau_speed: float


@dataclass(frozen=True, eq=False)
class BeltMotion:
    """The motion of a belt with an encoder, arrays of shape (n,)."""

    velocity: Array  # of the belt, m/s, signed, and one standard error
    velocity_errors: Array
    series: Series  # the mass relative to the belt: x less the belt's travel, and its motion
    motion: Motion

    def speed(self, moving: Mask) -> float:
        """Return the belt's median speed where ``moving`` (n,) is True, m/s, signed; NaN when it never is."""
        return float(np.median(self.velocity[moving])) if moving.any() else math.nan


@dataclass(frozen=True)
class VelocityStep:
    """The velocity stepped by ``step`` (m/s) just before sample ``sample``."""

    sample: int
    step: float
