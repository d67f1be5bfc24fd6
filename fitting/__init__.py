"""Which friction law was it: ``fitting.rank(kinematics, rig=...)`` fits six laws and ranks them."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fitting.law import Law as Law
    from fitting.selection.ranking import Ranking as Ranking
    from fitting.selection.ranking import rank as rank

    __version__: str

__all__ = ["Law", "Ranking", "__version__", "rank"]


def __getattr__(name: str) -> Any:
    """Import what is asked for when it is first asked for: ``import fitting`` alone loads nothing."""
    if name == "__version__":
        from daq.base.version import VERSION

        return VERSION
    if name == "Law":
        from fitting.law import Law

        return Law
    if name in __all__:
        from fitting.selection import ranking

        return getattr(ranking, name)
    raise AttributeError(f"module 'fitting' has no attribute {name!r}")
