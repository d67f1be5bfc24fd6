"""A bound on the integrator steps that one analysis takes in all, however many motions it follows."""

from dataclasses import dataclass

from stickslip.errors import InputError


class StepLimitError(InputError):
    """An analysis has taken more integrator steps than it may."""


@dataclass
class StepBudget:
    """Integrator steps that an analysis may take in all, ``allowed``, and what is ``left``; its maps share it."""

    allowed: float

    def __post_init__(self) -> None:
        self.left = self.allowed

    def exceeded(self, where: str, do: str) -> StepLimitError:
        """Return the error that says so of an analysis, ``where``, with what to ``do``."""
        return StepLimitError(f"step limit: more than {self.allowed:.0e} integrator steps", where, do)
