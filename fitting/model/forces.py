"""Departures: assumptions of the fit that may be violated, and their forces.

A departure maps a fitted motion, at the stage points of every window, to its effect, to first order in its parameters.
As a `Force` of a fit its coefficients, and its scale if it has one, are unknowns.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fitting.model import unknowns
from fitting.model.flow import Drag
from fitting.model.path import NO_DRAG, Path
from fitting.model.unknowns import PER_RUN
from fitting.record.motion import MeasuredMotion
from fitting.record.ripple import Ripple
from stickslip.compute.arrays import Array, Integers, Mask


def follow_pole(drive: Array, turn: complex, gain: complex, state: NDArray[np.complex128]) -> None:
    """Fill ``state`` (n,) from 0: each is ``turn`` times the one before plus ``gain`` times the drive (n,) then."""
    value = 0j
    for k in range(drive.size):
        state[k] = value
        value = turn * value + gain * drive[k]


@dataclass(frozen=True, eq=False)
class FittedMotion:
    """A fitted motion; M stage points, N samples."""

    time: Array  # (M,) s, m, m/s
    position: Array
    velocity: Array
    belt_speed: Array  # (M,) m/s, without the effect of a departure
    belt_position: Array  # (M,) m, from any origin
    friction: Array  # (M,) force of the belt on the mass per unit mass, positive where it pulls towards +x, m/s^2
    stretch: Array  # (M,) of the spring, m
    elapsed: Array  # (M,) since the middle of the run, s
    window: Integers  # (M,)
    sticks: Mask  # (windows,) whether a window is one of stick
    run: Integers
    samples: Integers  # (N,) stage point of each sample
    residual: Array  # (N,) model minus measurement, m
    K: float  # k/m, 1/s^2
    cycles: int
    records: tuple[MeasuredMotion, ...]  # of each run
    revolution: float | None = None  # travel per revolution of the encoder, m, where the calibration has it

    @classmethod
    def from_path(
        cls, path: Path, records: Sequence[MeasuredMotion], residual: Array, revolution: float | None = None
    ) -> "FittedMotion":
        runs = [unknowns.values(of_run) for of_run in path.u.reshape(-1, PER_RUN)]
        belt, speed, middle = np.empty((3, path.time.size))
        for number, (p, record) in enumerate(zip(runs, records, strict=True)):
            of_run = path.run == number
            time = path.time[of_run]
            position, velocity, _ = Ripple(p.cosine, p.sine, p.omega).belt_motion(time)
            belt[of_run], speed[of_run] = p.v_dr * time + position, p.v_dr + velocity
            middle[of_run] = 0.5 * (record.time[0] + record.time[-1])
        return cls(
            time=path.time,
            position=path.position,
            velocity=path.velocity,
            belt_speed=speed,
            belt_position=belt,
            friction=path.friction,
            stretch=path.position - np.array([p.datum for p in runs])[path.run],
            elapsed=path.time - middle,
            window=path.window,
            sticks=path.windows.table[:, 1] == 1,
            run=path.run,
            samples=path.reached,
            residual=residual,
            K=runs[0].K,
            cycles=len(path.windows.rows),
            records=tuple(records),
            revolution=revolution,
        )

    @property
    def travel(self) -> float:
        return max(record.travel for record in self.records)

    @property
    def slip_s(self) -> float:
        return max(record.slip_s for record in self.records)

    @property
    def samples_per_slip(self) -> float:
        return max(record.time.size / record.span * record.slip_s for record in self.records)

    @cached_property
    def rows_of_runs(self) -> tuple[Mask, ...]:
        return tuple(self.run == number for number in range(len(self.records)))

    @property
    def belt_way(self) -> float:
        return max(float(np.ptp(self.belt_position[run])) for run in self.rows_of_runs)


# Velocity, over the largest, within which a drag may jump at rest: a sample's change of velocity is 1 %.
TURN_IN_COLUMN = 0.005
TURN_IN_MOTION = 0.0005  # the same where the motion is followed with the drag, in steps as short as the turn
# A drag's table: its reach over the largest velocity, how much closer its rows are about rest, and their number.
TABLE_REACH, TABLE_CONTRAST, TABLE_ROWS = 1.5, 8.0, 801


class Forcing(NamedTuple):
    """The effect of a departure with parameters of 1; k columns, one a parameter, or None."""

    acceleration: Array | None = None  # (M, k) force per unit mass at the stage points, m/s^2
    belt_speed: Array | None = None  # (M, k) change of the belt's speed there, m/s
    reading: Array | None = None  # (N, k) change of the position read at the samples, m


@dataclass(frozen=True)
class Departure:
    """One assumption and how it may be violated."""

    name: str
    text: str  # the difference in the rig, used in a sentence after the law's name
    # symbol and unit of its size: of the coefficient of one column, or the amplitude of two, a sine and a cosine
    parameter: str
    unit: str
    # ``forcing(trajectory, scale)``; ``scale`` is NaN for a departure that has none
    forcing: Callable[[FittedMotion, float], Forcing]
    columns: int = 1  # 1 or 2
    scale: str = ""  # name of the parameter that is scanned, such as a frequency
    scale_unit: str = ""
    scales: Callable[[FittedMotion], Array] | None = None  # values to scan, at most half a resolution apart
    with_mass: tuple[str, str] | None = None  # symbol and unit of the size times the mass
    text_of_positions: str = ""  # ``text`` for a record without an encoder, if different
    # ``drag(velocity, turn)``: a force that depends only on the mass's velocity, m/s^2 per unit of the parameter, and
    # may jump at rest within ``turn``, m/s.  It acts on the motion itself, any other force along the earlier path.
    drag: Callable[[Array, float], Array] | None = None

    def says(self, *, counted: bool) -> str:
        return self.text if counted or not self.text_of_positions else self.text_of_positions

    def drag_table(self, fastest: float) -> Drag:
        """Return the drag of a unit by velocity, up to about ``fastest``, m/s; empty without one."""
        if self.drag is None:
            return NO_DRAG
        velocity = (
            fastest
            * TABLE_REACH
            * np.sinh(TABLE_CONTRAST * np.linspace(-1.0, 1.0, TABLE_ROWS))
            / math.sinh(TABLE_CONTRAST)
        )
        turn = TURN_IN_MOTION * fastest
        return Drag(velocity, self.drag(velocity, turn), turn)


def by_velocity(drag: Callable[[Array, float], Array]) -> Callable[[FittedMotion, float], Forcing]:
    def forcing(trajectory: FittedMotion, _: float) -> Forcing:
        turn = TURN_IN_COLUMN * float(np.max(np.abs(trajectory.velocity)))
        return Forcing(acceleration=drag(trajectory.velocity, turn)[:, np.newaxis])

    return forcing


def harmonic(phase: Array, factor: Array | float = 1.0) -> Array:
    return np.asarray(np.c_[factor * np.sin(phase), factor * np.cos(phase)])


def spaced(smallest: float, largest: float, length: float) -> Array:
    """Return wavelengths (or periods), descending, a quarter of the resolution of ``length`` apart."""
    if not 0 < smallest < largest or length <= 0:
        return np.empty(0)
    turns = np.arange(1 / largest, 1 / smallest, 0.25 / length)
    return np.asarray(1 / turns[turns > 0])


def speed_of_wave(length: float) -> float:
    return 2 * math.pi / length


SCALE_STEP = 1e-4  # relative step of the derivative by a scale
SCALE_RANGE = 0.15  # largest relative change of a scale from its scanned value


@dataclass(frozen=True, eq=False)
class Force:
    departure: Departure
    scale: float = math.nan  # its first scale (a frequency, a wavelength); NaN for a departure without one

    def __post_init__(self) -> None:
        if self.departure.scales is not None and not self.scanned:
            raise ValueError(f"{self.departure.name} depends on {self.departure.scale}: scan it first")

    @property
    def scanned(self) -> bool:
        return math.isfinite(self.scale)

    @property
    def width(self) -> int:
        """Number of unknowns: coefficients, then the relative change of the scale."""
        return self.departure.columns + self.scanned

    @property
    def lower(self) -> Array:
        """Lower bounds (width,): a drag dissipates energy; another force may have either sign."""
        lowest = 0.0 if self.departure.drag is not None else -np.inf
        return np.array([lowest] * self.departure.columns + [-SCALE_RANGE] * self.scanned)

    @property
    def upper(self) -> Array:
        return np.array([np.inf] * self.departure.columns + [SCALE_RANGE] * self.scanned)

    def coefficients(self, size: Array) -> Array:
        return size[: self.departure.columns]

    def scale_of(self, size: Array) -> float:
        return self.scale * (1 + float(size[-1])) if self.scanned else self.scale

    def forcing(self, motion: FittedMotion, size: Array) -> Forcing:
        return self.departure.forcing(motion, self.scale_of(size))

    def derivatives(self, motion: FittedMotion, size: Array) -> list[Forcing]:
        """Return the effect of a unit of each unknown: coefficients, then the scale's relative change."""
        scale = self.scale_of(size)
        forcing = self.departure.forcing(motion, scale)
        if not self.scanned:
            return [forcing]
        stepped = self.departure.forcing(motion, scale * (1 + SCALE_STEP))
        along = self.coefficients(size) / (self.scale / scale * SCALE_STEP)
        parts = [
            None if before is None or after is None else np.einsum("nk,k->n", after - before, along)[:, np.newaxis]
            for before, after in zip(forcing, stepped, strict=True)
        ]
        return [forcing, Forcing(*parts)]
