"""The fitted motion as departures read it: at the stage points of every window, in the fit's frame."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fitting.data.frame import MeasuredMotion
from fitting.data.ripple import Ripple
from fitting.model import parameters
from fitting.model.parameters import PER_RUN
from fitting.sensitivity.path import Path
from stickslip.compute.arrays import Array, Integers, Mask


@dataclass(frozen=True, eq=False)
class FittedMotion:
    """A fitted motion; M stage points, N samples.

    Attributes
    ----------
    time, position, velocity : (M,) f8
        s, m, m/s.
    belt_speed, belt_position : (M,) f8
        Of the belt by the unknowns of the fit, without what a departure adds, m/s and m; the position's origin is
        arbitrary.
    friction : (M,) f8
        Force of the belt on the mass per unit mass, positive where it pulls towards +x, m/s^2.
    stretch : (M,) f8
        Of the spring, m.
    elapsed : (M,) f8
        Since the middle of the run, s.
    window, run : (M,) i8
    sticks : (windows,) bool
        Whether a window is one of stick.
    samples : (N,) i8
        Stage point of each sample.
    residual : (N,) f8
        Model minus measurement, m.
    K : float
        k/m, 1/s^2.
    cycles : int
    records : tuple of MeasuredMotion
        Of each run.
    revolution : float or None
        Travel per revolution of the encoder, m, where the calibration has it.
    """

    time: Array
    position: Array
    velocity: Array
    belt_speed: Array
    belt_position: Array
    friction: Array
    stretch: Array
    elapsed: Array
    window: Integers
    sticks: Mask
    run: Integers
    samples: Integers
    residual: Array
    K: float
    cycles: int
    records: tuple[MeasuredMotion, ...]
    revolution: float | None = None

    @classmethod
    def from_path(
        cls, path: Path, records: Sequence[MeasuredMotion], residual: Array, revolution: float | None = None
    ) -> "FittedMotion":
        """Read a path along the windows of ``records``, with ``residual`` (N,) at its samples."""
        runs = [parameters.values(of_run) for of_run in path.u.reshape(-1, PER_RUN)]
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
        """Largest travel of the runs, m."""
        return max(record.travel for record in self.records)

    @property
    def slip_s(self) -> float:
        """About how long a slip of the slowest run lasts, s."""
        return max(record.slip_s for record in self.records)

    @property
    def samples_per_slip(self) -> float:
        """Largest of the runs."""
        return max(record.time.size / record.span * record.slip_s for record in self.records)

    @cached_property
    def rows_of_runs(self) -> tuple[Mask, ...]:
        """Which stage points are of each run."""
        return tuple(self.run == number for number in range(len(self.records)))

    @property
    def belt_way(self) -> float:
        """Way of the belt in the longest run, m."""
        return max(float(np.ptp(self.belt_position[run])) for run in self.rows_of_runs)
