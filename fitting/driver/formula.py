"""A law given as a formula as the curve of a fit: followed through a spline, started by `fitting.driver.start_search`.

The spline's knots are refined until its error is below `SPLINE_ERROR` of the friction; the derivatives by the
parameters are the formula's.  A parameter that bends the curve and is never negative is fitted by its logarithm.  A
trial whose formula is not finite, is negative at a speed of the motion or is not above 0 at rest is rejected as one
that cannot be followed.
"""

from collections.abc import Sequence

import numpy as np

from fitting.driver.curves import FrictionCurve
from fitting.driver.start_search import StartSearch, Target
from fitting.law import Law
from fitting.sensitivity.columns import friction_effect, shared_tangents
from fitting.sensitivity.path import Curve, Path, spline_curve
from fitting.sensitivity.spline import FrictionSpline
from fitting.sensitivity.tangents import tangents
from fitting.undetermined import natural_size, undetermined
from stickslip.compute.arrays import Array
from stickslip.errors import InputError

SPLINE_ERROR = 1e-6  # distance of the spline from the formula, over the largest friction
FIRST_PIECES, KNOT_POWER = 24, 1.8  # knots s_max u^1.8, before they are set closer where the curve bends most
MOST_PIECES = 300  # a power with an infinite slope at rest takes 150; more are a curve with a corner
PER_PIECE = 6  # speeds of each piece at which the spline is put through the formula, and compared with it
SPLINE_REACH = 1.1  # last knot over the measured curve's: slips of the fit may be a little faster


class FormulaCurve(FrictionCurve):
    """A law's formula as the friction of a path; theta (k,) are its free parameters or their logarithms (``by_log``).

    It is followed up to slip speed ``fastest``, m/s; ``starts`` are minima on the target ``near``, nearest first.  Of
    parameters that the formula has only ``together`` some are held at their starts or natural sizes.
    Raises InputError where no trial of the parameters is a friction, with the reason of the first.
    """

    law: Law

    def __init__(self, law: Law, fastest: float, near: Target) -> None:
        self.law, self.fastest, self.ramp = law, fastest, law.ramp
        self.together = undetermined(law, near.size, float(near.speeds[-1]))
        first = law.start or {}
        held = [name for group in self.together for name in group.names[len(group.names) - group.free :]]
        sizes = {name: natural_size(law, name, near.size, float(near.speeds[-1])) for name in held}
        fitted = law.given(fix={name: first.get(name, size) for name, size in sizes.items()})
        self.fixed, self.free, self.size = fitted.fix or {}, fitted.free, len(fitted.free)
        search = StartSearch(fitted, near, fastest)
        self.by_log = np.array([search.bends[name] and law.limits(name)[0] >= 0.0 for name in self.free], np.bool_)
        self.prior = self.precision = np.zeros(self.size)
        self.lower, self.upper = self.bounds
        self._first = FrictionSpline.over(fastest * np.linspace(0.0, 1.0, FIRST_PIECES + 1) ** KNOT_POWER)
        self._near = self._first
        # A logarithm of speed over next to nothing is near on the target, and too abrupt to be followed.
        self.starts = sorted(search.minima(), key=lambda start: self.spline(self.theta_at(start.values)) is None)
        self.start = self.theta_at(self.starts[0].values)

    def on_path(self, theta: Array, beside: Array) -> Curve | None:
        spline = self.spline(theta)
        return None if spline is None else spline_curve(spline, self.ramp)

    def columns(self, path: Path, theta: Array, places: Sequence[int]) -> Array:
        """As in `FrictionCurve`, with the formula's own derivatives by the parameters."""
        in_slip, in_stick, edge = friction_effect(path)
        at_rest = self.slopes(theta, np.zeros(1))[0]
        forces = in_stick[:, None] * at_rest
        speed = np.clip(path.slip_speed[path.slips], 0.0, self.fastest)
        forces[path.slips] = in_slip[path.slips, None] * self.slopes(theta, speed)
        own = tangents(path, forces, edge=edge[:, None] * at_rest)
        return np.hstack([shared_tangents(path, places), own])

    def friction(self, u: Array, theta: Array, beside: Array, s: Array) -> Array:
        """As in `FrictionCurve`; constant beyond `fastest`, where the formula may not be a friction."""
        try:
            return self.at_speeds(theta, s)
        except InputError:
            return self.at_speeds(theta, np.minimum(s, self.fastest))

    def values(self, theta: Array, u: Array | None = None) -> dict[str, float]:
        free = np.where(self.by_log, np.exp(np.clip(theta, -700.0, 700.0)), theta)
        return dict(self.fixed) | dict(zip(self.free, free.tolist(), strict=True))

    def theta_at(self, values: dict[str, float]) -> Array:
        free = np.array([values[name] for name in self.free])
        return np.where(self.by_log, np.log(np.where(self.by_log, free, 1.0)), free)

    @property
    def bounds(self) -> tuple[Array, Array]:
        lower, upper = np.array([self.law.limits(name) for name in self.free]).reshape(-1, 2).T
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(self.by_log, np.log(lower), lower), np.where(self.by_log, np.log(upper), upper)

    def at_speeds(self, theta: Array, s: Array) -> Array:
        """Return friction per unit mass (m/s^2) at slip speeds s (k,), m/s; InputError if not finite or negative."""
        found = self.law.curve.value(s, self.values(theta))
        if found.min() < 0:
            at = self.law.curve.place(float(s[np.argmin(found)]), self.values(theta))
            what = f"law {self.law.name}: friction is negative, {found.min():.4g} m/s^2, {at}"
            raise InputError(what, "formula", "give bounds, or a form that stays above 0")
        return found

    def slopes(self, theta: Array, s: Array) -> Array:
        """Return the derivatives (k, unknowns) of friction at slip speeds s (k,)."""
        values = self.values(theta)
        found = self.law.curve.gradient(s, values, self.free)
        return np.asarray(found * np.where(self.by_log, [values[name] for name in self.free], 1.0))

    def spline(self, theta: Array) -> FrictionSpline | None:
        """Return a spline through the formula; None where it is not a friction, or too abrupt.

        It begins with the knots of the trial before, or anew where those of other trials do not fit or are so many that
        a path along them has too many steps.
        """
        crowded = self._near.knots.size > MOST_PIECES // 2
        for begin in dict.fromkeys((self._first, self._near) if crowded else (self._near, self._first)):
            found = self._through(theta, begin)
            if found is not None:
                self._near = found
                return found
        return None

    def _through(self, theta: Array, spline: FrictionSpline) -> FrictionSpline | None:
        """Return a spline through the formula, with refined knots where its error is large."""
        while True:
            knots = spline.knots
            at = np.append(np.linspace(knots[:-1], knots[1:], PER_PIECE, endpoint=False, axis=1), knots[-1])
            try:
                target = self.at_speeds(theta, at)
            except InputError:
                return None
            if not target[0] > 0:
                return None
            spline = spline.nearest(at, target)
            away = np.abs(spline(at) - target) > SPLINE_ERROR * target.max()
            if not away.any():
                return spline
            bad = np.unique(np.clip(np.searchsorted(knots, at[away], side="right") - 1, 0, knots.size - 2))
            if knots.size + bad.size > MOST_PIECES:
                return None
            spline = FrictionSpline.over(np.sort(np.concatenate((knots, 0.5 * (knots[bad] + knots[bad + 1])))))
