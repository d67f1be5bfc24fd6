"""The constants of a law's fit: starting values, bounds, and the calibrations as priors."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fitting.data.cycles import Cycle, CycleSegmentation
from fitting.data.frame import MeasuredMotion
from fitting.data.ripple import Ripple
from fitting.law import Law
from fitting.model import parameters, starts
from fitting.model.parameters import PER_RUN, Global
from fitting.model.windows import ShootingWindows, Thinning
from rig_sim.friction.law import Law as Kind
from stickslip.compute.arrays import Array
from stickslip.units import Measured

# Samples a slip of a thinned record, on which searches and scans run, as residuals are correlated over many samples: at
# half as many the shortest wavelengths blur, twice as many take twice the time.  A stick, where the mass moves as the
# belt does, has no more: of one 10 times as long as its slip they took nearly all the time.
COARSE_SAMPLES = 62.5
DEFAULT_DAMPING_SD = 0.01  # standard deviation of the damping over the critical one, when no ring-down was recorded
LEAST_LINEAR_FRICTION = 0.97  # fall of the linear curve at the fastest slip, over the level, at the most
RIPPLE_AMPLITUDE_SD = 0.2  # error over the amplitude: how well the sticks show it
RIPPLE_FREQUENCY_SD = 0.1  # turns in the time in which it was seen: further off lie other minima
LARGEST_LOG_DROP = 30.0  # log: so far below its first value friction is none, and its exponential still a number
LARGEST_STATIC = 5.0  # break-away level over Fs: dry contacts have 1 to 2
# Scatter of the levels' prior over their own, without a datum: the prior would otherwise pull at the datum, as the
# larger Fs is, the less the levels scatter relative to it.  On camera tracks under 1 mm of noise d of law 4 is 1 to 2
# standard errors too large; twice the limit halves that, but there, as at 25, some of a ramp's levels run off to
# another minimum.
LOOSE_LEVELS = 5.0
FIRST_RAMP = 1e-4  # width over the belt's speed where a ramp law starts from its jump law
NARROWEST_RAMP = 1e-6  # width over the belt's speed: no fit makes a ramp narrower


HELD_SD = 1e-6  # standard deviation of an unknown that is held, over its size


class GivenUnknown(NamedTuple):
    """The user's bounds, equal where it is fixed, and first value of a shared unknown."""

    slot: Global
    low: float
    high: float
    start: float | None


@dataclass(frozen=True, eq=False)
class Run:
    """One record in the fit's frame, its cycles (unflagged ones are fitted), its ripple, the user's values by law."""

    motion: MeasuredMotion
    cut: CycleSegmentation
    ripple: Ripple | None = None
    given: Mapping[str, tuple[GivenUnknown, ...]] = field(default_factory=dict)

    @cached_property
    def windows(self) -> ShootingWindows:
        """The windows of every sample: all laws have the same."""
        return ShootingWindows.from_cycles(self.motion, self.cut.used)


@dataclass(frozen=True, eq=False)
class EstimationProblem:
    """Constants of a law's passes; arrays over the unknowns of all runs unless said otherwise."""

    law: Law
    runs: tuple[Run, ...]
    active: tuple[int, ...]
    start: Array
    lower: Array
    upper: Array
    prior: Array
    precision: Array

    @classmethod
    def build(cls, law: Law, runs: Sequence[Run]) -> "EstimationProblem":
        """Regress the start and turn the calibrations into priors.

        Several runs start from the median regression of the contact.
        """
        kind = law.kind
        motions = tuple(run.motion for run in runs)
        first, _ = _regressed(kind, runs)
        K, first_shape = first[0].K, first[0].shape
        omega = math.sqrt(K)
        damping = damping_calibration(motions[0], K)
        speed = min(motion.belt_speed for motion in motions)
        steepest = np.inf
        if kind.curve == "linear":  # beyond Fs/G_slip the curve would push: that far it is no friction
            steepest = LEAST_LINEAR_FRICTION / max(float(np.max(m.belt_speed - m.velocity)) for m in motions)
        start, lower, upper, prior, precision = np.zeros((5, len(runs), PER_RUN))
        lower[:], upper[:] = -np.inf, np.inf
        upper[:, Global.SHAPE] = steepest
        for r, (run, own) in enumerate(zip(runs, first, strict=True)):
            motion, ripple, v = run.motion, run.ripple, run.motion.belt_speed
            datum, belt, compliance = datum_calibration(motion), motion.belt_prior, motion.compliance
            # Constant friction determines only datum + Fs/k: the scatter of levels must not separate the two.
            datum_sd = 0.0 if kind.curve == "constant" else datum.sd
            known = {
                Global.DATUM: (datum.value, _precision(datum_sd, 1e-6 * motion.travel)),
                Global.DAMPING: (damping.value, _precision(damping.sd, 1e-6 * omega)),
            }
            begin = own._replace(shape=min(first_shape, steepest), damping=damping.value)
            if belt is not None and belt.sd > 0:
                known[Global.V_DR] = belt.value, _precision(belt.sd, 0.0)
            if kind.curve == "constant" and not run.cut.shows_belt:  # slips do not depend on them
                known[Global.D] = 0.0, v**-2
                known.setdefault(Global.V_DR, (v, v**-2))
            if compliance is not None:
                begin = begin._replace(compliance=compliance.value)
                known[Global.COMPLIANCE] = compliance.value, _precision(compliance.sd, 0.0)
            if ripple is not None:
                begin = begin._replace(cosine=ripple.cosine, sine=ripple.sine, omega=ripple.omega)
                spread = (RIPPLE_AMPLITUDE_SD * ripple.amplitude) ** -2
                known[Global.COSINE], known[Global.SINE] = (ripple.cosine, spread), (ripple.sine, spread)
                known[Global.OMEGA] = ripple.omega, (RIPPLE_FREQUENCY_SD * 2 * math.pi / ripple.seen_s) ** -2
            for slot, (value, weight) in known.items():
                prior[r, slot], precision[r, slot] = value, weight
            start[r] = parameters.to_array(begin)
            lowest = start[r, Global.LOG_F] - LARGEST_LOG_DROP
            lower[r, : Global.DATUM] = 1e-6 * K, lowest, 0.05 * v, 0, NARROWEST_RAMP * speed
            lower[r, [Global.DAMPING, Global.OMEGA]] = 0.0
            lower[r, Global.STATIC], upper[r, Global.STATIC] = 1.0, LARGEST_STATIC
            lower[r, Global.COMPLIANCE] = NARROWEST_RAMP * v / motion.travel
        return cls(
            law=law,
            runs=tuple(runs),
            active=parameters.active_places(
                kind, [motion.compliance is not None for motion in motions], [run.ripple is not None for run in runs]
            ),
            start=start.ravel(),
            lower=lower.ravel(),
            upper=upper.ravel(),
            prior=prior.ravel(),
            precision=precision.ravel(),
        ).with_given()

    def with_given(self) -> "EstimationProblem":
        """Return the problem with the user's values of its law's shared unknowns."""
        if not any(run.given.get(self.law.name) for run in self.runs):
            return self
        start, lower, upper, prior, precision = (
            own.copy() for own in (self.start, self.lower, self.upper, self.prior, self.precision)
        )
        for run, own in enumerate(self.runs):
            sizes = _sizes(own.motion, float(self.start[PER_RUN * run + Global.K]))
            for given in own.given.get(self.law.name, ()):
                at = PER_RUN * run + given.slot
                lower[at], upper[at] = max(lower[at], given.low), min(upper[at], given.high)
                first = start[at] if given.start is None else given.start
                if given.low == given.high:
                    lower[at] = upper[at] = first = prior[at] = given.low
                    precision[at] = (HELD_SD * sizes[given.slot]) ** -2.0
                start[at] = min(max(first, lower[at]), upper[at])
        return replace(self, start=start, lower=lower, upper=upper, prior=prior, precision=precision)

    @property
    def held(self) -> NDArray[np.bool_]:
        """The fixed unknowns of all runs."""
        return np.asarray(self.lower == self.upper)

    def with_overtaking(self, overtaking: NDArray[np.bool_]) -> "EstimationProblem":
        """Return the problem with these cycles (cycles,) as ones that overtake the belt after landing."""
        flags = iter(overtaking)
        runs = []
        for run in self.runs:
            cycles = [
                cycle if cycle.flag else replace(cycle, overtakes=bool(next(flags)) or cycle.overtakes)
                for cycle in run.cut.cycles
            ]
            runs.append(replace(run, cut=replace(run.cut, cycles=tuple(cycles))))
        return replace(self, runs=tuple(runs))

    def start_with_drag(self, drag: Callable[[Array], Array]) -> tuple[Array, float]:
        """Return other starting values (13 runs,), regressed together with a drag, and its size."""
        first, size = _regressed(self.law.kind, self.runs, drag)
        start = self.start.copy()
        for own, p in zip(start.reshape(-1, PER_RUN), first, strict=True):
            own[: Global.DATUM + 1] = parameters.to_array(p)[: Global.DATUM + 1]
        return np.clip(start, self.lower, self.upper), size

    def start_near(self, other: Law, u: Array) -> Array:
        """Return the unknowns (13 runs,) of this law nearest the fit u of another.

        A new ramp is almost closed; another curve has the same friction at two slip speeds.
        """
        start, own, near = u.copy(), self.law.kind, other.kind
        if own.ramp and not near.ramp:
            start[Global.D :: PER_RUN] = FIRST_RAMP * min(motion.belt_speed for motion in self.motions)
            start[Global.STATIC :: PER_RUN] = 1.0
        elif near.ramp and not own.ramp:
            start[Global.D :: PER_RUN], start[Global.STATIC :: PER_RUN] = self.start[Global.D :: PER_RUN], 1.0
        if own.curve_code != near.curve_code:
            fastest = max(float(np.max(motion.belt_speed - motion.velocity)) for motion in self.motions)
            p = parameters.values(u[:PER_RUN])
            F, shape = starts.matched_curve(own.curve_code, near.curve_code, p.F, p.shape, fastest)
            start[Global.LOG_F :: PER_RUN], start[Global.SHAPE :: PER_RUN] = math.log(F), shape
        return np.where(self.held, self.start, start)

    def windows(self, *, thinned: bool) -> ShootingWindows:
        """Return the windows of all runs, of every sample or thinned (`thinned_to`)."""
        if not thinned:
            return ShootingWindows.join([run.windows for run in self.runs])
        return ShootingWindows.join(
            [ShootingWindows.from_cycles(run.motion, run.cut.used, thinned_to(run)) for run in self.runs]
        )

    @property
    def ramp(self) -> bool:
        return self.law.ramp

    @property
    def level_prior(self) -> float:
        """Standard deviation of the prior of the friction levels, in standard deviations of their scatter.

        Constant friction fixes the datum, so that no level pulls at it.
        """
        guessed = any(motion.datum_prior is None for motion in self.motions)
        return LOOSE_LEVELS if guessed and self.law.kind.curve != "constant" else 1.0

    @property
    def motions(self) -> tuple[MeasuredMotion, ...]:
        return tuple(run.motion for run in self.runs)

    @property
    def cycles(self) -> tuple[Cycle, ...]:
        return tuple(cycle for run in self.runs for cycle in run.cut.used)


def _regressed(
    kind: Kind, runs: Sequence[Run], drag: Callable[[Array], Array] | None = None
) -> tuple[list[parameters.Values], float]:
    """Return each run's regression, with the medians of the contact, and the median size of a drag."""
    found = [
        starts.regress_start(run.motion, run.cut, kind.curve_code, bool(kind.ramp), datum_calibration(run.motion), drag)
        for run in runs
    ]
    contact = {name: float(np.median([getattr(own, name) for own, _ in found])) for name in ("K", "F", "shape", "d")}
    return [own._replace(**contact) for own, _ in found], float(np.median([size for _, size in found]))


def thinned_to(run: Run) -> Thinning:
    """Return the thinning of a run: `COARSE_SAMPLES` a slip, also in a stick unless its belt ripples."""
    motion = run.motion
    stride = max(1, round(motion.time.size / motion.span * motion.slip_s / COARSE_SAMPLES))
    return Thinning(stride, COARSE_SAMPLES if run.ripple is None else math.inf)


def datum_calibration(motion: MeasuredMotion) -> Measured:
    """Return the spring's rest position: the calibration, or the middle of the motion +- half its range.

    Without a datum laws 1 and 3 determine only datum + Fs/k; the wide prior keeps the fit finite and its interval wide.
    """
    if motion.datum_prior is not None:
        return motion.datum_prior
    middle = 0.5 * float(motion.position.max() + motion.position.min())
    return Measured(middle, 0.5 * motion.travel)


def damping_calibration(motion: MeasuredMotion, K: float) -> Measured:
    """Return c/m, 1/s: from the ring-down, or 0 +- a hundredth of the critical damping."""
    known = motion.damping_prior
    mass = motion.mass.value if motion.mass else motion.stiffness.value / K if motion.stiffness else None
    if known is None or mass is None:
        return Measured(0.0, DEFAULT_DAMPING_SD * 2 * math.sqrt(K))
    return Measured(known.value / mass, known.sd / mass)


def _sizes(motion: MeasuredMotion, K: float) -> dict[Global, float]:
    """Return the natural sizes of the unknowns."""
    v, omega = motion.belt_speed, math.sqrt(K)
    sizes = {Global.K: K, Global.LOG_F: 1.0, Global.V_DR: v, Global.SHAPE: 1 / v, Global.D: v, Global.STATIC: 1.0}
    return sizes | {Global.DATUM: motion.travel, Global.DAMPING: omega}


def _precision(sd: float, exact: float) -> float:
    """Return 1/sd^2; a calibration without an error has the error ``exact``."""
    return 1 / max(sd, exact) ** 2 if max(sd, exact) > 0 else 0.0
