"""Which friction law was it: ``fitting.rank(run)`` fits six laws, and laws of one's own, and ranks them."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fitting.entry import rank as rank
    from fitting.law import Law as Law
    from fitting.ranked import Ranking as Ranking

    __version__: str

__all__ = ["Law", "Ranking", "__version__", "rank"]

_HOME = {"Law": "fitting.law", "Ranking": "fitting.ranked", "rank": "fitting.entry"}


def __getattr__(name: str) -> Any:
    """Import what is asked for when it is first asked for: ``import fitting`` alone loads nothing."""
    if name == "__version__":
        from stickslip.version import VERSION

        return VERSION
    if name in _HOME:
        from importlib import import_module

        return getattr(import_module(_HOME[name]), name)
    raise AttributeError(f"module 'fitting' has no attribute {name!r}")
