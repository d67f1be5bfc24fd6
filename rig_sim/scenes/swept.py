"""A scene whose one key is varied, in a form that a process is handed."""

from dataclasses import dataclass

from rig_sim.flow.two_mass import TwoMassFlow
from rig_sim.scenes.model import Scene
from rig_sim.scenes.scene import scene


@dataclass(frozen=True)
class SweptScene:
    """A scene with one key left open, whole, as a process is handed it: a worker elsewhere may not have its file.

    Attributes
    ----------
    scene : Scene
    key : str
        Its key that is left open, ``section.key``.
    """

    scene: Scene
    key: str

    def __call__(self, value: float) -> TwoMassFlow:
        """Return the masses of the scene whose key has this value."""
        return scene(self.scene, **{self.key: value}).two_mass_flow()
