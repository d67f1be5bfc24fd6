"""Which friction law was it: ``fitting.rank(run)`` fits six laws, published and custom ones, and ranks them."""

from typing import TYPE_CHECKING

from stickslip.lazy import lazy_names

if TYPE_CHECKING:
    from fitting.functions import RankedRuns as RankedRuns
    from fitting.functions import rank as rank
    from fitting.functions import rank_each as rank_each
    from fitting.laws import Law as Law
    from fitting.result import Ranking as Ranking

    __version__: str

__all__ = ["Law", "RankedRuns", "Ranking", "__version__", "rank", "rank_each"]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "Law": "fitting.laws",
        "RankedRuns": "fitting.functions",
        "Ranking": "fitting.result",
        "rank": "fitting.functions",
        "rank_each": "fitting.functions",
    },
)
