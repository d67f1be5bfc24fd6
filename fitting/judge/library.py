"""The departures that are tried: v is the velocity of the mass over ground, z the stretch, b the travel of the belt.

- ``spring-nonlinear``: the spring's force is -k z - k3 z^3, positive k3 for a hard spring. Source: A. H. Nayfeh,
  D. T. Mook, Nonlinear Oscillations, 1979, ch. 4.
- ``drag-quadratic``: -q v |v|. At one belt speed a free friction curve absorbs it: only runs at several speeds, or
  a law whose curve has another form, distinguish it. Source: L. D. Landau, E. M. Lifshitz, Fluid Mechanics, 1987,
  par. 45.
- ``guide-friction``: -Fg sign(v), Coulomb friction in the guide of the mass. At one belt speed only the jump where the
  mass turns distinguishes it from friction of the belt. Not modelled: a guide that holds the mass at rest. Source:
  B. Armstrong-Helouvry, P. Dupont, C. Canudas de Wit, Automatica 30 (1994) 1083.
- ``eccentricity``: an error e sin(2 pi x/L + phase) of the reading, L the revolution of the encoder wheel, calibrated
  or scanned. For a camera or a laser the cause is the lens or the scale.
- ``belt-drift``: v_b (1 + a (t - t_mid)), the same a in each run of a joint fit; so is that of ``stiffness-drift``.
- ``belt-ripple``: v_b + r sin(2 pi f t + phase), a second ripple, or one too weak to be fitted with the laws
  (`fitting.record.ripple`). f is searched in the residual of the sticks, where the mass moves as the belt does.
- ``stiffness-drift``: k (1 + a (t - t_mid)), as by the spring's temperature.
- ``second-mode``: a second mass on the first: m2 (x + z)'' = -k2 z - c2 z'. m2/m is given, sqrt(k2/m2) scanned. It
  rings from one cycle into the next, so the record's own acceleration drives it through the whole record. The two
  columns are stretch and velocity. Source: J. P. Den Hartog, Mechanical Vibrations, 1956, ch. 3.
- ``friction-by-belt-position``: F (1 + a sin(2 pi (b - x)/L + phase)), L the length of the belt.
- ``friction-by-mass-position``: F (1 + a sin(2 pi x/L + phase)). Wavelengths beyond the travel look like another
  spring. Source: E. Rabinowicz, Friction and Wear of Materials, 1995, ch. 4 (worn tracks).
"""

import cmath
import math
from functools import lru_cache

import numpy as np

from fitting import noise_levels
from fitting.model import forces
from fitting.model.forces import Departure, FittedMotion, Forcing, by_velocity, harmonic, spaced, speed_of_wave
from fitting.record.motion import MeasuredMotion
from fitting.record.ripple import SLOWEST_OF_FEW, strongest_frequencies
from stickslip.compute.arrays import Array
from stickslip.compute.compile import compiled

SMALLEST_REVOLUTION = 0.04  # revolution over the travel: a smaller wheel would turn 25 times in a slip
MOST_PEAKS = 8  # gaps between the sticks cause false peaks near the true one, two or three of them strong
MODE_DAMPING = 0.01  # damping of a second mass over the critical one
SLOWEST_MODE, FASTEST_MODE = 1.5, 15.0  # over the main mode's: slower is a second spring, faster moves with the mass
FREQUENCY_STEP = 0.012  # relative step between frequencies: about half the width of the resonance
HELD_SLIPS = 8e-3  # time for which the acceleration is held, in slips; at the fastest mode a tenth of its period
SHORTEST_BELT = 0.7  # length over the travel between mass and belt in a cycle: a shorter one turns more than once in it
LONGEST_BELT = 0.7  # length over the travel in the whole record: a longer one does not repeat, and acts as wear
SHORTEST_WAVELENGTH = 0.08  # wavelength over the travel: a shorter one averages out in a slip


def cube_of_stretch(trajectory: FittedMotion, _: float) -> Forcing:
    return Forcing(acceleration=-(trajectory.stretch[:, np.newaxis] ** 3))


def quadratic_drag(velocity: Array, _: float) -> Array:
    return -velocity * np.abs(velocity)


def dry_friction(velocity: Array, turn: float) -> Array:
    return np.asarray(-np.tanh(velocity / turn))


def error_of_wheel(trajectory: FittedMotion, revolution: float) -> Forcing:
    angle = speed_of_wave(revolution) * trajectory.position[trajectory.samples]
    return Forcing(reading=harmonic(angle))


def revolutions(trajectory: FittedMotion) -> Array:
    """Return the calibrated length of one revolution, m, or those up to the travel."""
    if trajectory.revolution is not None:
        return np.array([trajectory.revolution])
    return spaced(SMALLEST_REVOLUTION * trajectory.travel, trajectory.travel, trajectory.travel)


def drift_of_belt(trajectory: FittedMotion, _: float) -> Forcing:
    change = trajectory.belt_speed * trajectory.elapsed
    return Forcing(belt_speed=change[:, np.newaxis])


def ripple_of_belt(trajectory: FittedMotion, hertz: float) -> Forcing:
    return Forcing(belt_speed=harmonic(2 * math.pi * hertz * trajectory.time))


def ripple_frequencies(trajectory: FittedMotion) -> Array:
    """Return the strongest frequencies of the residuals in stick, Hz, each with its neighbours as bounds."""
    window, time = trajectory.window[trajectory.samples], trajectory.time[trajectory.samples]
    times, residuals = [], []
    for stick in np.flatnonzero(trajectory.sticks):
        rows = window == stick
        times.append(time[rows])
        residuals.append(trajectory.residual[rows] - trajectory.residual[rows].mean())
    if len(times) < noise_levels.FEWEST:
        return np.empty(0)
    slip_s = trajectory.slip_s
    peaks, resolution = strongest_frequencies(
        np.concatenate(times), np.concatenate(residuals), slip_s, SLOWEST_OF_FEW / slip_s, MOST_PEAKS
    )
    neighbours = np.unique(np.add.outer(peaks, resolution * np.arange(-1, 2)).ravel())
    return np.asarray(neighbours[neighbours > 0])


def drift_of_stiffness(trajectory: FittedMotion, _: float) -> Forcing:
    change = -trajectory.K * trajectory.stretch * trajectory.elapsed
    return Forcing(acceleration=change[:, np.newaxis])


def pull_of_second_mass(trajectory: FittedMotion, omega: float) -> Forcing:
    """Return the pull of an equal mass, in phase and a quarter turn later, m/s^2."""
    out = np.empty((trajectory.time.size, 2))
    for run, record in zip(trajectory.rows_of_runs, trajectory.records, strict=True):
        time, drive = step_acceleration(record)
        pull = follow_second_mass(drive, time[1] - time[0], omega)
        step_number = (trajectory.time[run] - time[0]) / (time[1] - time[0])
        before = np.minimum(step_number.astype(np.int64), time.size - 2)
        share = (step_number - before)[:, np.newaxis]
        out[run] = (1 - share) * pull[before] + share * pull[before + 1]
    return Forcing(acceleration=out)


@lru_cache(maxsize=8)  # one a run: every frequency uses the same drive
def step_acceleration(record: MeasuredMotion) -> tuple[Array, Array]:
    """Return times and mean accelerations, m/s^2, of steps of about `HELD_SLIPS` slips."""
    interval = float(np.median(np.diff(record.time)))
    samples_per_step = max(1, int(HELD_SLIPS * record.slip_s / interval))
    count = int((record.time[-1] - record.time[0]) / (samples_per_step * interval))
    fine = record.time[0] + interval * np.arange(count * samples_per_step)
    mean = np.interp(fine, record.time, record.acceleration).reshape(count, samples_per_step).mean(axis=1)
    return record.time[0] + samples_per_step * interval * np.arange(count), mean


def follow_second_mass(acceleration: Array, step: float, omega: float) -> Array:
    """Return stretch omega^2 and velocity omega (n, 2), m/s^2, of an oscillator on a base moved stepwise."""
    rate = omega * complex(-MODE_DAMPING, math.sqrt(1 - MODE_DAMPING**2))
    turn = cmath.exp(rate * step)
    state = np.empty(acceleration.size, np.complex128)
    compiled(forces.follow_pole, (forces.__name__,))(-acceleration, turn, (turn - 1) / rate, state)
    return np.asarray(omega * np.c_[state.imag, state.real])


def mode_frequencies(trajectory: FittedMotion) -> Array:
    interval = max(float(np.median(np.diff(record.time))) for record in trajectory.records)
    main = math.sqrt(trajectory.K)
    fastest = min(FASTEST_MODE * main, 0.5 * math.pi / interval)
    return np.asarray(np.exp(np.arange(math.log(SLOWEST_MODE * main), math.log(fastest), FREQUENCY_STEP)))


def friction_along_belt(trajectory: FittedMotion, length: float) -> Forcing:
    phase = speed_of_wave(length) * (trajectory.belt_position - trajectory.position)
    return Forcing(acceleration=harmonic(phase, trajectory.friction))


def belt_lengths(trajectory: FittedMotion) -> Array:
    travel = trajectory.belt_way
    return spaced(SHORTEST_BELT * travel / trajectory.cycles, LONGEST_BELT * travel, travel)


def friction_along_travel(trajectory: FittedMotion, wavelength: float) -> Forcing:
    phase = speed_of_wave(wavelength) * trajectory.position
    return Forcing(acceleration=harmonic(phase, trajectory.friction))


def wavelengths(trajectory: FittedMotion) -> Array:
    return spaced(SHORTEST_WAVELENGTH * trajectory.travel, trajectory.travel, trajectory.travel)


DEPARTURES = (
    Departure(
        name="spring-nonlinear",
        text="a nonlinear spring (its stiffness depends on its extension)",
        parameter="k3/m",
        unit="m^-2 s^-2",
        with_mass=("k3", "N/m^3"),
        forcing=cube_of_stretch,
    ),
    Departure(
        name="drag-quadratic",
        text="quadratic drag (proportional to the square of the velocity)",
        parameter="q/m",
        unit="m^-1",
        with_mass=("q", "N s^2/m^2"),
        forcing=by_velocity(quadratic_drag),
        drag=quadratic_drag,
    ),
    Departure(
        name="guide-friction",
        text="dry friction in the guide of the mass",
        parameter="Fg/m",
        unit="m s^-2",
        with_mass=("Fg", "N"),
        forcing=by_velocity(dry_friction),
        drag=dry_friction,
    ),
    Departure(
        name="eccentricity",
        text="an eccentric encoder wheel",
        text_of_positions="lens distortion or an uneven scale",
        parameter="e",
        unit="m",
        columns=2,
        scale="revolution",
        scale_unit="m",
        scales=revolutions,
        forcing=error_of_wheel,
    ),
    Departure(
        name="belt-drift",
        text="a drifting belt speed",
        parameter="(dv_dr/dt)/v_dr",
        unit="s^-1",
        forcing=drift_of_belt,
    ),
    Departure(
        name="belt-ripple",
        text="a ripple of the belt speed at another frequency",
        parameter="r",
        unit="m/s",
        columns=2,
        scale="frequency",
        scale_unit="Hz",
        scales=ripple_frequencies,
        forcing=ripple_of_belt,
    ),
    Departure(
        name="stiffness-drift",
        text="a drifting spring stiffness",
        parameter="(dk/dt)/k",
        unit="s^-1",
        forcing=drift_of_stiffness,
    ),
    Departure(
        name="second-mode",
        text="a second mode of vibration (a second mass on a second spring)",
        parameter="m2/m",
        unit="",
        columns=2,
        scale="angular frequency",
        scale_unit="rad/s",
        scales=mode_frequencies,
        forcing=pull_of_second_mass,
    ),
    Departure(
        name="friction-by-belt-position",
        text="friction that varies along the belt",
        parameter="a",
        unit="",
        columns=2,
        scale="belt length",
        scale_unit="m",
        scales=belt_lengths,
        forcing=friction_along_belt,
    ),
    Departure(
        name="friction-by-mass-position",
        text="friction that varies along the path of the mass",
        parameter="a",
        unit="",
        columns=2,
        scale="wavelength",
        scale_unit="m",
        scales=wavelengths,
        forcing=friction_along_travel,
    ),
)
