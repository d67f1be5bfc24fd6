"""A bound on the integrator steps that one analysis takes in all, however many motions it follows."""

from dataclasses import dataclass

from stickslip.errors import InputError


class StepLimitError(InputError):
    """An analysis has taken more integrator steps than allowed."""


@dataclass
class StepBudget:
    """Integrator steps ``allowed`` in a whole analysis, and those ``left``; its maps share it."""

    allowed: float

    def __post_init__(self) -> None:
        self.left = self.allowed

    def limit_error(self, where: str, do: str) -> StepLimitError:
        """Return the error of a spent budget, with the analysis (``where``) and the remedy (``do``)."""
        return StepLimitError(f"step limit: more than {self.allowed:.0e} integrator steps", where, do)
