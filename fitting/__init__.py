"""Identification of friction laws: ``fitting.rank(run)`` fits and ranks six laws, published laws and custom laws."""

from typing import TYPE_CHECKING

from stickslip.lazy import lazy_names

if TYPE_CHECKING:
    from fitting.functions import RankedRuns as RankedRuns
    from fitting.functions import rank as rank
    from fitting.functions import rank_each as rank_each
    from fitting.judge.parameters import Parameter as Parameter
    from fitting.laws import Law as Law
    from fitting.result import Ranking as Ranking

    __version__: str

__all__ = ["Law", "Parameter", "RankedRuns", "Ranking", "__version__", "rank", "rank_each"]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "Law": "fitting.laws",
        "Parameter": "fitting.judge.parameters",
        "RankedRuns": "fitting.functions",
        "Ranking": "fitting.result",
        "rank": "fitting.functions",
        "rank_each": "fitting.functions",
    },
)
