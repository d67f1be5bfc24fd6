"""From counts to motion: ``processing.smooth(recording)`` rebuilds position, velocity and acceleration."""

from typing import TYPE_CHECKING

from stickslip.lazy import lazy_names

if TYPE_CHECKING:
    from processing.entry import smooth as smooth
    from processing.record.kinematics import Kinematics as Kinematics

    __version__: str

__all__ = ["Kinematics", "__version__", "smooth"]

__getattr__, __dir__ = lazy_names(
    __name__, {"Kinematics": "processing.record.kinematics", "smooth": "processing.entry"}
)
