"""What the assessment of a record says: does a law describe it, and how far can that be trusted."""

from dataclasses import dataclass
from typing import Any

from fitting.adequacy.goodness import GoodnessOfFit

ADEQUATE = "adequate"
NONE_OF_SIX = "none of the six"
NONE_FITTED = "none of the laws fitted"


@dataclass(frozen=True)
class Adequacy:
    """Whether the best law describes a record.

    Attributes
    ----------
    verdict : str
        `ADEQUATE`, `NONE_OF_SIX`, or `NONE_FITTED` where not all six laws were fitted.
    goodness : GoodnessOfFit or None
        Of the law that was judged; None where no law could be fitted at all.
    noise_m : float
        Standard deviation of one position, m.
    """

    verdict: str
    noise_m: float
    goodness: GoodnessOfFit | None = None

    @property
    def adequate(self) -> bool:
        """Whether a law describes the record."""
        return self.verdict == ADEQUATE

    def as_json(self) -> dict[str, Any]:
        """Return the document's form."""
        found = self.goodness
        return {
            "verdict": self.verdict,
            "noise_m": self.noise_m,
            "misfit": found and found.misfit,
            "lag1": found and found.lag1,
            "repeat": found and found.repeat,
            "p_value": found and found.p_value,
        }
