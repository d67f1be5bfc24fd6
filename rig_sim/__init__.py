"""The rig in software: a function for every command of ``rig-sim``, and systems of one's own.

Each function takes a scene (a built-in name, the path of a TOML file, or what `scene` returns) and the flags of its
command as keywords of the same names, and returns a frozen dataclass with ``to_dataframe()`` and ``plot(ax=None)``.
Nothing loads until it is asked for.

>>> import rig_sim
>>> rig_sim.cycle("base").outcome
'cycle'
"""

from typing import TYPE_CHECKING

from stickslip.lazy import lazy_names

if TYPE_CHECKING:
    from rig_sim.results.branches import continue_ as continue_
    from rig_sim.results.compare import compare as compare
    from rig_sim.results.lock import lock as lock
    from rig_sim.results.maps import basins as basins
    from rig_sim.results.maps import lyapunov as lyapunov
    from rig_sim.results.maps import map as map
    from rig_sim.results.motion import events as events
    from rig_sim.results.motion import run as run
    from rig_sim.results.one_mass import cycle as cycle
    from rig_sim.results.one_mass import fixed_point as fixed_point
    from rig_sim.results.one_mass import floquet as floquet
    from rig_sim.results.quench import quench as quench
    from rig_sim.results.shaker import shaker as shaker
    from rig_sim.results.sweeps import sweep as sweep
    from rig_sim.scenes.scene import scene as scene
    from rig_sim.systems.formula import FormulaMap as FormulaMap

    __version__: str

_NAMES = {
    "rig_sim.systems.formula": ("FormulaMap",),
    "rig_sim.results.branches": ("continue_",),
    "rig_sim.results.compare": ("compare",),
    "rig_sim.results.lock": ("lock",),
    "rig_sim.results.maps": ("basins", "lyapunov", "map"),
    "rig_sim.results.motion": ("events", "run"),
    "rig_sim.results.one_mass": ("cycle", "fixed_point", "floquet"),
    "rig_sim.results.quench": ("quench",),
    "rig_sim.results.shaker": ("shaker",),
    "rig_sim.results.sweeps": ("sweep",),
    "rig_sim.scenes.scene": ("scene",),
}
HOMES = {name: module for module, names in _NAMES.items() for name in names}
__all__ = sorted(["__version__", *HOMES])
__getattr__, __dir__ = lazy_names(__name__, HOMES)
