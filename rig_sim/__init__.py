"""The rig in software: ``scene(name)``, ``events(scene, until)``, ``cycle(scene)``; nothing loads until asked."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rig_sim.dynamics.orbits.limit_cycle import cycle as cycle
    from rig_sim.motion.play import events as events
    from rig_sim.scenes.scene import scene as scene

    __version__: str

__all__ = ["__version__", "cycle", "events", "scene"]

_HOME = {
    "scene": "rig_sim.scenes.scene",
    "events": "rig_sim.motion.play",
    "cycle": "rig_sim.dynamics.orbits.limit_cycle",
}


def __getattr__(name: str) -> Any:
    """Import what is asked for when it is first asked for: ``import rig_sim`` alone loads nothing."""
    if name == "__version__":
        from daq.base.version import VERSION

        return VERSION
    if name in _HOME:
        from importlib import import_module

        return getattr(import_module(_HOME[name]), name)
    raise AttributeError(f"module 'rig_sim' has no attribute {name!r}")
