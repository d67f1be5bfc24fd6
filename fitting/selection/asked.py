"""The checked request of a ranking."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from numbers import Real

from fitting.competitors import Competitors, Given
from fitting.law import Law
from processing.record.kinematics import Kinematics
from stickslip.errors import InputError
from stickslip.units import Measured

LEAST_ALPHA = 1e-9  # surer is no interval


def check_numbers(alpha: float, jobs: int = 1) -> None:
    if not (isinstance(alpha, Real) and LEAST_ALPHA <= alpha < 1):
        raise InputError(f"alpha is {alpha!r}", "--alpha", f"give a number from {LEAST_ALPHA:g} to 1, such as 0.05")
    if not (isinstance(jobs, int) and jobs >= 1):
        raise InputError(f"jobs is {jobs!r}", "--jobs", "give 1 or more")


@dataclass(frozen=True, eq=False)
class Asked:
    """The laws that compete, and how; arguments of `fitting.selection.ranking.rank`, checked by InputError."""

    competitors: Competitors
    belt_speed: Measured | float | str | None
    excluded: tuple[int, ...]
    alpha: float
    jobs: int
    progress: Callable[[float], None] | None
    scheduler: str | None

    def __post_init__(self) -> None:
        check_numbers(self.alpha, self.jobs)

    def given(self, law: Law) -> dict[str, Given]:
        """Return the conditions on a law's parameters; none for a rival that was not requested."""
        return self.competitors.of_law(law) if self.competitors.asks(law) else {}

    def fixed(self, law: Law) -> dict[str, float]:
        return {name: given.low for name, given in self.given(law).items() if given.fixed}

    def check_together(self, records: Sequence[Kinematics]) -> None:
        """Raise InputError for options that require a single run."""
        if not records:
            raise InputError("no run", "command line", "name at least one run file")
        if len(records) == 1:
            return
        if self.belt_speed is not None and self.belt_speed != "channel":
            raise InputError("one belt speed for several runs", "--belt-speed", "leave it out: each run finds its own")
        if self.excluded:
            raise InputError(
                "cycles to exclude from several runs", "--exclude-cycles", "fit that run alone, or leave it out"
            )
