"""From counts to motion: ``processing.smooth(recording)`` rebuilds position, velocity and acceleration."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from processing.kinematics import Kinematics as Kinematics
    from processing.kinematics import smooth as smooth

__all__ = ["Kinematics", "smooth"]


def __getattr__(name: str) -> Any:
    """Import what is asked for when it is first asked for: ``import processing`` alone loads nothing."""
    if name in __all__:
        from processing import kinematics

        return getattr(kinematics, name)
    raise AttributeError(f"module 'processing' has no attribute {name!r}")
