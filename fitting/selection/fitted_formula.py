"""A law given as a formula as one of the fitted laws: its motion in every window, its friction, and its parameters.

Everything is read from the fit of `fitting.curve.formula_fit`; nothing is fitted here.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations

import numpy as np

from daq.base.compute.arrays import Array, Mask
from daq.base.compute.distributions import student_quantile
from daq.base.errors import InputError
from daq.base.measured import Measured
from fitting.curve.formula_fit import FormulaFit
from fitting.data.cycles import Cycle
from fitting.data.frame import MeasuredMotion
from fitting.estimation import derived, wear
from fitting.estimation.covariance import upper_bound
from fitting.estimation.derived import Known
from fitting.estimation.linearised import LinearisedFit
from fitting.estimation.result import Correlations, Parameter
from fitting.law import Law
from fitting.model import parameters
from fitting.model.parameters import PER_RUN, Global, Values
from fitting.model.problem import EstimationProblem
from fitting.model.windows import ShootingWindows
from fitting.sensitivity import flow
from fitting.sensitivity.path import Path, follow
from fitting.undetermined import Undetermined

LEVELS = ("Fs/m", "Fs/k", "Fs", "Fs0/m", "x0 + Fs/k", "(G_slip - c)/m", "static")  # of the six alone
# Of a level of friction: with a larger standard error it is not stated alone, but its difference to another one.
LEVEL_KNOWN = 0.5


@dataclass(frozen=True, eq=False)
class FittedFormula:
    """A formula fitted to the runs, or its part of one run.

    Attributes
    ----------
    at : FormulaFit
        Of all runs together.
    asked_for : Law
        The law as it was asked for; parameters that no record can determine apart are held in the fit.
    number : int or None
        That of one of the six, which was fitted as its formula.
    together : tuple of Undetermined
        Parameters that the formula has only together.
    u : (13 runs,) f8
        As `fitting.estimation.fit.Fit`; LOG_F is the log of the formula's friction at rest.
    local, residual, inlier_cycles, windows, cycles
        As `fitting.estimation.fit.Fit`.
    """

    at: FormulaFit
    asked_for: Law
    number: int | None
    together: tuple[Undetermined, ...]
    u: Array
    local: Array
    residual: Array
    inlier_cycles: Mask
    windows: ShootingWindows
    cycles: tuple[Cycle, ...]

    @classmethod
    def of(
        cls, at: FormulaFit, asked_for: Law, number: int | None = None, together: Sequence[Undetermined] = ()
    ) -> "FittedFormula":
        """Read a fit."""
        u = at.path.u.copy()
        u[Global.LOG_F :: PER_RUN] = math.log(float(at.friction.friction(at.theta, np.zeros(1))[0]))
        return cls(
            at=at,
            asked_for=asked_for,
            number=number,
            together=tuple(together),
            u=u,
            local=at.solution.local,
            residual=at.residual,
            inlier_cycles=at.inlier_cycles,
            windows=at.windows,
            cycles=at.cycles,
        )

    @property
    def law(self) -> int | str:
        """The law's number where it stands for one of the six, else its name."""
        return self.asked_for.name if self.number is None else self.number

    @property
    def formula(self) -> str:
        """The formula as it was written."""
        return self.asked_for.formula

    @property
    def problem(self) -> EstimationProblem:
        """The runs, and a law of the same contact."""
        return self.at.host.fit.problem

    @property
    def values(self) -> Values:
        """Shared unknowns by name; the first run's where there are several."""
        return parameters.values(self.u[:PER_RUN])

    @property
    def runs(self) -> int:
        """How many runs were fitted together, or 1 of a part."""
        return self.u.size // PER_RUN

    @property
    def rows(self) -> tuple[slice, ...]:
        """The residuals of each cycle."""
        return self.windows.rows

    @property
    def cycle_rms(self) -> Array:
        """Rms residual of each cycle, m."""
        return self.windows.rms(self.residual)

    @property
    def rms(self) -> float:
        """Root mean square of all residuals, m."""
        return float(np.sqrt(np.mean(self.residual**2)))

    @property
    def geometric_mean_rms(self) -> float:
        """Geometric mean of the cycles' errors, m."""
        return float(np.exp(np.mean(np.log(self.cycle_rms))))

    @property
    def misfit(self) -> float:
        """What noise (the largest of all runs) does not explain of the geometric mean of the cycles' errors, m."""
        noise = max(motion.resolution for motion in self.problem.motions)
        return math.sqrt(max(self.geometric_mean_rms**2 - noise**2, 0.0))

    @property
    def outcome(self) -> str:
        """How the minimisation ended."""
        return self.at.solution.outcome

    @property
    def cpu_s(self) -> float:
        """CPU time of the fit, s."""
        return self.at.cpu_s

    @property
    def law_parameters(self) -> int:
        """Number of the law's own free unknowns."""
        return self.at.law_parameters

    @property
    def calibration_deviations(self) -> Array:
        """How far the unknowns are from their calibrations, in standard deviations; 0 where there is none."""
        return self.at.calibration_deviations

    def path(self) -> Path | None:
        """Return the motion along the windows, for tangents."""
        return self.at.path

    def linearised(self) -> LinearisedFit:
        """Return the fit made linear at its solution."""
        return self.at.linearised()

    def friction(self, s: Array) -> Array:
        """Return friction per unit mass (m/s^2) at slip speeds s (n,), m/s; beyond where it is friction, at the end."""
        inside = np.minimum(s, self.at.friction.fastest)
        for speeds in (s, inside):
            try:
                return self.at.friction.friction(self.at.theta, speeds)
            except InputError:
                continue
        raise RuntimeError("the formula of a fit is a friction")

    def force(self, w: Array, mass: float = 1.0) -> Array:
        """Return friction on a mass (kg), N, positive along the belt, at relative velocities w (n,), m/s."""
        w = np.asarray(w, float)
        if not self.problem.ramp:
            return np.asarray(-mass * np.sign(w) * self.friction(np.abs(w)))
        d, level = self.values.d, self.values.F
        beyond = self.friction(np.maximum(np.abs(w) - d, 0.0))
        return np.asarray(mass * np.where(np.abs(w) <= d, -level * w / d, -np.sign(w) * beyond))

    def residual_in(self, windows: ShootingWindows, local: Array) -> Array | None:
        """Return what the law would leave of other windows of this run (N,), m; None where it cannot be followed."""
        found = follow(windows, self.at.path.curve, self.u, local, longest_step=flow.LONGEST_STEP)
        return None if found is None else found.residual

    def level_trend(self, run: int = 0) -> wear.Wear | None:
        """Return the line through the friction levels of one run's inlier cycles (`fitting.estimation.wear`)."""
        return wear.of_cycles(self.windows, self.inlier_cycles, self.local, run)

    def for_run(self, run: int) -> "FittedFormula":
        """Return what the fit says of one run; the covariance stays that of all."""
        if self.runs == 1:
            return self
        own = np.flatnonzero(self.windows.run == run)
        return replace(
            self,
            u=self.u[PER_RUN * run : PER_RUN * (run + 1)],
            local=self.local[own],
            residual=np.concatenate([self.residual[self.rows[k]] for k in own]),
            inlier_cycles=self.inlier_cycles[own],
            windows=self.windows.parts[run],
            cycles=tuple(self.cycles[k] for k in own),
        )

    def without_prior(self, slot: Global, run: int = 0) -> Measured | None:
        """Return what the record alone shows of an unknown; None where its value was given, and where nothing is."""
        place, places, task = PER_RUN * run + slot, self.at.places, self.at.task
        index = places.index(place if place in places else int(slot))
        if task.lower[index] == task.upper[index]:
            return None
        if task.precision[index] == 0:
            return Measured(float(self.at.solution.u[index]), math.sqrt(float(self.at.variances[index])))
        return self.at.without_prior(slot, run)

    @cached_property
    def spreads(self) -> Array:
        """Covariances (2, p + k, p + k) of the shared unknowns and the formula's, by scatter and by noise."""
        return self.at.covariances

    def parameters(
        self, motion: MeasuredMotion, alpha: float, run: int = 0, *, sustained: bool = True
    ) -> dict[str, Parameter]:
        """Return the law's parameters with their intervals, those of rig and contact first.

        A parameter with friction in its unit is given per unit mass, as ``NAME/m``, and as ``NAME``: in newtons with a
        mass or a stiffness, else the same again.  What bears the name of a formula's parameter is that.

        Parameters as of `fitting.estimation.derived.derived_parameters`.
        """
        quantile = student_quantile(1 - alpha / 2, max(len(self.at.rows) - 1, 1))
        found = self._of_rig(motion, quantile, run)
        if sustained:
            level = Parameter(1.0, 0.0, 1.0, 1.0, "")
            trend = derived.wear_of(self.level_trend(run if self.runs > 1 else 0), level, alpha)
            found |= {name: item for name, item in trend.items() if name == "wear"}
        own: dict[str, Parameter] = {}
        for name in self.asked_for.curve.parameters:
            own |= self._own(name, motion, quantile)
        own |= self._differences(own, quantile)
        return {name: item for name, item in found.items() if name not in own} | own

    def correlations(self, motion: MeasuredMotion) -> Correlations:
        """Return how the errors of the parameters go together: those of rig and contact, and the formula's."""
        known = self._known(motion, 0)
        hidden = derived.hidden(known)
        places = {
            row.name: (known.active.index(slot), derived.sign_of(row, motion))
            for row, _ in derived.given_rows("", motion, known)
            for slot in (_SLOTS.get(row.name),)
            if slot is not None and slot in known.active and row.name not in hidden
        }
        index = self._slots(0)
        names, columns, signs = [], [], []
        for name, (place, sign) in places.items():
            names.append(name)
            columns.append(index[place])
            signs.append(sign)
        unknown = {name for one in self.together for name in one.names}
        for k, name in enumerate(self.at.formula.free):
            if name not in unknown:
                names.append(name)
                columns.append(len(self.at.places) + k)
                signs.append(1.0)
        spread = upper_bound(*(own[np.ix_(columns, columns)] for own in self.spreads))
        shown = np.diag(spread) > 0
        error = np.sqrt(np.diag(spread)[shown])
        turn = np.array(signs)[shown]
        matrix = np.clip(spread[np.ix_(shown, shown)] / np.outer(error, error), -1.0, 1.0) * np.outer(turn, turn)
        return Correlations(tuple(name for name, own in zip(names, shown, strict=True) if own), matrix)

    def level_error(self, run: int = 0) -> float:
        """Return the standard error of a run's break-away level by what all cycles share: rest, curve and k/m."""
        p = self.values
        slots = [int(slot) for slot in parameters.columns(self.at.places, self._together_runs)[run]]
        slope = np.zeros(self.at.solution.u.size)
        stretch = p.F / p.K
        for place, slot in enumerate(slots):
            slope[place] = {int(Global.K): stretch / p.F, int(Global.DATUM): -p.K / p.F}.get(slot, 0.0)
        slope[len(slots) :] = -self.at.friction.slopes(self.at.theta, np.zeros(1))[0] / p.F
        return math.sqrt(max(float(np.einsum("i,sij,j->s", slope, self.spreads, slope).max()), 0.0))

    @property
    def _together_runs(self) -> int:
        return self.at.host.fit.runs

    def _slots(self, run: int) -> list[int]:
        """Return where among the unknowns of the fit those of one run stand."""
        slots = parameters.columns(self.at.places, self._together_runs)[run]
        return [place for place, slot in enumerate(slots) if slot >= 0]

    def _known(self, motion: MeasuredMotion, run: int) -> Known:
        """Return what the fit knows of one run beside the formula's own parameters."""
        places, task = self._slots(run), self.at.task
        active = [Global(self.at.places[place] % PER_RUN) for place in places]
        spread = self.spreads[:, places][:, :, places]
        default = {
            Global.DATUM: motion.datum_prior is None,
            Global.DAMPING: motion.damping_prior is None or motion.per_mass,
        }
        variance = np.einsum("sii->si", spread).max(axis=0)
        share = variance * task.precision[places]
        held = task.lower[places] == task.upper[places]
        undetermined = {
            slot
            for slot, own, fixed in zip(active, share, held, strict=True)
            if default.get(slot) and own > derived.UNDETERMINED and not (fixed and slot != Global.DATUM)
        }
        first = PER_RUN * run if self.runs > 1 else 0
        return Known(self.u[first : first + PER_RUN], active, spread, undetermined)

    def _of_rig(self, motion: MeasuredMotion, quantile: float, run: int) -> dict[str, Parameter]:
        known = self._known(motion, run)
        found = {}
        for row, scale in derived.given_rows("", motion, known):
            if row.name in LEVELS:
                continue
            value, variance = derived.propagated(row, known, motion)
            if scale is not None:
                variance = variance * scale.value**2 + (value * scale.sd) ** 2
                value *= scale.value
            error = math.sqrt(max(variance, 0.0))
            signed = row.name in derived.SIGNED
            found[row.name] = derived.as_parameter(value, error, quantile, row.unit, signed=signed)
        return {name: item for name, item in found.items() if name not in derived.hidden(known)}

    def _own(self, name: str, motion: MeasuredMotion, quantile: float) -> dict[str, Parameter]:
        """Return a parameter of the formula, per unit mass and, where friction is in its unit, as a force too."""
        law = self.asked_for
        value, error, by_log = self.at.values[name], 0.0, False
        if name in self.at.formula.free:
            k = self.at.formula.free.index(name)
            by_log = bool(self.at.friction.by_log[k])
            error = math.sqrt(float(self.at.variances[len(self.at.places) + k]))
        force, speed = law.dimensions.get(name, (0, 0))
        # that of the metres per count
        error = math.hypot(error * (value if by_log else 1.0), (force + speed) * value * motion.length_error)
        trusted = not any(name in one.names for one in self.together)
        fixed = name in (law.fix or {})
        item = _interval(value, 0.0 if fixed else error, quantile, law.limits(name), by_log=by_log)
        item = replace(item, unit=law.unit(name), trusted=trusted, fixed=fixed)
        if not force:
            return {name: item}
        known = motion.mass or motion.stiffness
        if known is None:
            return {f"{name}/m": item, name: item}
        K = self.values.K
        mass = known.value if motion.mass else known.value / K
        factor = mass**force
        spread = math.hypot(item.stderr * factor, force * value * factor * known.sd / known.value)
        limits = tuple(factor * end for end in law.limits(name))
        newtons = _interval(value * factor, spread, quantile, (limits[0], limits[1]), by_log=by_log)
        unit = law.unit(name, newtons=True)
        return {f"{name}/m": item, name: replace(newtons, unit=unit, trusted=trusted)}

    def _differences(self, own: dict[str, Parameter], quantile: float) -> dict[str, Parameter]:
        """Return the differences of levels that are known where the levels are not, per unit mass."""
        free = self.at.formula.free
        levels = [name for name in free if self.asked_for.dimensions.get(name) == (1, 0)]
        found = {}
        for pair in combinations(levels, 2):
            if any(_level_known(own[f"{name}/m"]) for name in pair):
                continue
            high, low = sorted(pair, key=lambda name: -self.at.values[name])
            slope = np.zeros(self.at.solution.u.size)
            for name, sign in ((high, 1.0), (low, -1.0)):
                k = free.index(name)
                size = self.at.values[name] if self.at.friction.by_log[k] else 1.0
                slope[len(self.at.places) + k] = sign * size
            error = math.sqrt(max(float(np.einsum("i,sij,j->s", slope, self.spreads, slope).max()), 0.0))
            value = self.at.values[high] - self.at.values[low]
            item = Parameter(value, error, value - quantile * error, value + quantile * error, "m s^-2")
            if _level_known(item):
                found[f"({high} - {low})/m"] = item
        return found


_SLOTS = {"k/m": Global.K, "v_dr": Global.V_DR, "d": Global.D, "x0": Global.DATUM, "c/m": Global.DAMPING}


def _level_known(item: Parameter) -> bool:
    return item.stderr < LEVEL_KNOWN * abs(item.value)


def _interval(value: float, error: float, quantile: float, limits: tuple[float, float], *, by_log: bool) -> Parameter:
    """Return a value with its interval within the limits; of one that was fitted by its logarithm by a factor."""
    if by_log and value > 0:
        factor = math.exp(min(quantile * error / value, 700.0))
        lo, hi = value / factor, value * factor
    else:
        lo, hi = value - quantile * error, value + quantile * error
    return Parameter(value, error, max(lo, limits[0]), min(hi, limits[1]), "")
