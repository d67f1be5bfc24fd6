"""A second mass on the first, on a spring of its own: m2 (x + z)'' = -k2 z - c2 z', with z its way on the first mass.

m2/m is given; the angular frequency sqrt(k2/m2) is scanned.  The oscillator is driven by the record's own acceleration
and rings from one cycle into the next, so it is followed through the whole record, not window by window.  Its damping
is taken as 1 % of the critical one; the two columns, stretch and velocity of its spring, take up what another damping
shifts in phase.  Source: J. P. Den Hartog, Mechanical Vibrations, 1956, ch. 3 (vibration absorber).
"""

import cmath
import math
from functools import lru_cache

import numpy as np

from fitting.data.frame import MeasuredMotion
from fitting.forces import oscillator
from fitting.forces.departure import Departure, Forcing
from fitting.forces.fitted_motion import FittedMotion
from stickslip.compute.arrays import Array
from stickslip.compute.compile import compiled

MODE_DAMPING = 0.01  # damping over the critical one
# Frequency over the main spring's: slower is a second spring, faster moves with the mass.
SLOWEST_MODE, FASTEST_MODE = 1.5, 15.0
FREQUENCY_STEP = 0.012  # relative step between frequencies: about half the width of the resonance
HELD_SLIPS = 8e-3  # time for which the acceleration is held, in slips; at the fastest mode a tenth of its period


def forcing(trajectory: FittedMotion, omega: float) -> Forcing:
    """Return the pull of a mass of 1 (times the first), in phase and a quarter turn later, m/s^2."""
    out = np.empty((trajectory.time.size, 2))
    for run, record in zip(trajectory.rows_of_runs, trajectory.records, strict=True):
        time, drive = held_acceleration(record)
        pull = _pull(drive, time[1] - time[0], omega)
        place = (trajectory.time[run] - time[0]) / (time[1] - time[0])
        before = np.minimum(place.astype(np.int64), time.size - 2)
        share = (place - before)[:, np.newaxis]
        out[run] = (1 - share) * pull[before] + share * pull[before + 1]
    return Forcing(acceleration=out)


def frequencies(trajectory: FittedMotion) -> Array:
    """Return angular frequencies that the samples resolve, rad/s."""
    interval = max(float(np.median(np.diff(record.time))) for record in trajectory.records)
    main = math.sqrt(trajectory.K)
    fastest = min(FASTEST_MODE * main, 0.5 * math.pi / interval)
    return np.asarray(np.exp(np.arange(math.log(SLOWEST_MODE * main), math.log(fastest), FREQUENCY_STEP)))


@lru_cache(maxsize=8)  # one a run: every frequency uses the same drive
def held_acceleration(record: MeasuredMotion) -> tuple[Array, Array]:
    """Return times and mean accelerations, m/s^2, of steps of about `HELD_SLIPS` slips; shapes (n,)."""
    interval = float(np.median(np.diff(record.time)))
    held = max(1, int(HELD_SLIPS * record.slip_s / interval))
    count = int((record.time[-1] - record.time[0]) / (held * interval))
    fine = record.time[0] + interval * np.arange(count * held)
    mean = np.interp(fine, record.time, record.acceleration).reshape(count, held).mean(axis=1)
    return record.time[0] + held * interval * np.arange(count), mean


def _pull(acceleration: Array, step: float, omega: float) -> Array:
    """Return stretch omega^2 and velocity omega (n, 2) of an oscillator on a moving base, m/s^2.

    ``acceleration`` (n,) of the base is constant for ``step`` s; in the complex plane the oscillator is one pole.
    """
    rate = omega * complex(-MODE_DAMPING, math.sqrt(1 - MODE_DAMPING**2))
    turn = cmath.exp(rate * step)
    state = np.empty(acceleration.size, np.complex128)
    compiled(oscillator.follow_pole, (oscillator.__name__,))(-acceleration, turn, (turn - 1) / rate, state)
    return np.asarray(omega * np.c_[state.imag, state.real])


DEPARTURE = Departure(
    name="second-mode",
    text="a second mass on a spring of its own",
    parameter="m2/m",
    unit="",
    columns=2,
    scale="angular frequency",
    scale_unit="rad/s",
    scales=frequencies,
    forcing=forcing,
)
