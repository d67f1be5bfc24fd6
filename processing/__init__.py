"""From counts to motion: ``processing.smooth(recording)`` rebuilds position, velocity and acceleration."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from processing.entry import smooth as smooth
    from processing.record.kinematics import Kinematics as Kinematics

    __version__: str

__all__ = ["Kinematics", "__version__", "smooth"]

_HOME = {"Kinematics": "processing.record.kinematics", "smooth": "processing.entry"}


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used, so that ``import processing`` alone loads nothing."""
    if name == "__version__":
        from daq.base.version import VERSION

        return VERSION
    if name in _HOME:
        from importlib import import_module

        return getattr(import_module(_HOME[name]), name)
    raise AttributeError(f"module 'processing' has no attribute {name!r}")
