"""One of the six laws as it was fitted."""

from dataclasses import dataclass

from fitting.driver.curves import LawCurve
from fitting.driver.fit import TaskFit
from fitting.estimation.fitted_law import FittedLaw
from fitting.model.parameters import NUISANCE, PER_RUN


@dataclass(frozen=True, eq=False)
class Fit(FittedLaw):
    @classmethod
    def of(cls, at: TaskFit) -> "Fit":
        return cls(**cls.read(at))

    @property
    def law(self) -> int:
        curve = self.at.task.curve
        if not isinstance(curve, LawCurve):
            raise TypeError("not the fit of one of the six")
        return curve.law

    @property
    def law_parameters(self) -> int:
        """Number of the law's own free unknowns, without those of every law (datum, damping, fade, belt)."""
        held = self.problem.held
        return sum(place % PER_RUN not in NUISANCE and not held[place] for place in self.active)
