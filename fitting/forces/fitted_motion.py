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
    """A fitted motion; M stage points, N samples."""

    time: Array  # (M,) s, m, m/s
    position: Array
    velocity: Array
    # (M,) of the belt by the unknowns of the fit, without what a departure adds, m/s and m; the position's origin is
    # arbitrary
    belt_speed: Array
    belt_position: Array
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
        return max(record.travel for record in self.records)

    @property
    def slip_s(self) -> float:
        """Approximate duration of a slip of the slowest run, s."""
        return max(record.slip_s for record in self.records)

    @property
    def samples_per_slip(self) -> float:
        """Largest of the runs."""
        return max(record.time.size / record.span * record.slip_s for record in self.records)

    @cached_property
    def rows_of_runs(self) -> tuple[Mask, ...]:
        """The stage points of each run."""
        return tuple(self.run == number for number in range(len(self.records)))

    @property
    def belt_way(self) -> float:
        """Travel of the belt in the longest run, m."""
        return max(float(np.ptp(self.belt_position[run])) for run in self.rows_of_runs)
