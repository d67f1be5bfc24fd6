"""Which friction law was it: ``fitting.rank(run)`` fits six laws, and laws of one's own, and ranks them."""

from typing import TYPE_CHECKING

from stickslip.lazy import lazy_names

if TYPE_CHECKING:
    from fitting.entry import RankedRuns as RankedRuns
    from fitting.entry import rank as rank
    from fitting.entry import rank_each as rank_each
    from fitting.law import Law as Law
    from fitting.selection.result import Ranking as Ranking

    __version__: str

__all__ = ["Law", "RankedRuns", "Ranking", "__version__", "rank", "rank_each"]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "Law": "fitting.law",
        "RankedRuns": "fitting.entry",
        "Ranking": "fitting.selection.result",
        "rank": "fitting.entry",
        "rank_each": "fitting.entry",
    },
)
