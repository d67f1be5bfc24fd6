"""Names of the axes, with their units, that figures of several chapters share; motions sampled for them."""

from functools import cache

import numpy as np

from rig_sim.motion.play import ScenePlayer
from rig_sim.scenes.scene import scene
from stickslip.compute.arrays import Array

T, X, V, F = "time t (sqrt(m/k))", "displacement x (Fs/k)", "velocity v (Fs/sqrt(km))", "friction force F (Fs)"
DAMPING = "damping c (sqrt(km))"


@cache
def play_motion(name: str, until: float, rate: float, changes: tuple[tuple[str, float], ...] = ()) -> tuple[Array, ...]:
    """Return t, x, v, F of a scene of one mass from t = 0, sampled ``rate`` times per unit of time."""
    times = np.arange(0.0, until + 0.5 / rate, 1.0 / rate)
    return ScenePlayer(scene(name, **dict(changes))).columns(times)
