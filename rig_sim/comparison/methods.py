"""How a scene is played, by name: the exact method, the thesis's, and a general solver for comparison."""

import math
from functools import partial

from rig_sim.integrate.phases import sample_phase
from rig_sim.motion.play import SamplePhase
from rig_sim.scenes.model import Scene
from stickslip.errors import InputError

METHODS = ("exact", "rk4-henon", "dop853")
RK4_STEP = 0.01  # of sqrt(m/k)
RK4_LONGEST = 1.0  # of sqrt(m/k): a sixth of a period; longer steps do not resolve it, and above 2.8 RK4 is unstable
DOP853_RTOL = 2.3e-14  # 100 ulp: the least that scipy accepts; a larger one misses touches of the edge in laws 1 and 2


def choose_phases(
    method: str, scene: Scene, *, step: float | None = None, rtol: float | None = None
) -> tuple[SamplePhase, str]:
    """Return the function that plays one phase, and the method's setting as text.

    ``step``, of rk4-henon, is in the scene's unit of time: default `RK4_STEP` x sqrt(m/k), at most `RK4_LONGEST` of it.
    ``rtol``, of dop853, is relative and absolute: default and least `DOP853_RTOL`.
    """
    if method not in METHODS:
        raise InputError(f"unknown method {method!r}", "--method", f"use one of {', '.join(METHODS)}")
    if step is not None and method != "rk4-henon":
        raise InputError(f"{method} has no step", "--step", "remove it, or use --method=rk4-henon")
    if rtol is not None and method != "dop853":
        raise InputError(f"{method} has no tolerance", "--rtol", "remove it, or use --method=dop853")
    if method == "exact":
        return sample_phase, ""
    from rig_sim.comparison.stepping import sample_phase as sample_by

    if method == "rk4-henon":
        from rig_sim.comparison.rk4_henon import make_rk4_solver

        h = RK4_STEP * math.sqrt(scene.mass.m / scene.spring.k) if step is None else step
        if not (math.isfinite(h) and h > 0.0):
            raise InputError(f"is {h:g}", "--step", "use a positive number")
        unit = math.sqrt(scene.mass.m / scene.spring.k)
        if h > RK4_LONGEST * unit:
            problem = f"is {h:g}, and the period of the mass is {2 * math.pi * unit:.4g}, so this step is too long"
            do = f"use {RK4_LONGEST * unit:.4g} (a sixth of the period) or less; the default is {RK4_STEP * unit:.4g}"
            raise InputError(problem, "--step", do)
        return partial(sample_by, make_rk4_solver(h)), f"h {h:g}"
    from rig_sim.comparison.solve_ivp import make_ivp_solver

    tolerance = DOP853_RTOL if rtol is None else rtol
    if not DOP853_RTOL <= tolerance < 1.0:
        raise InputError(f"is {tolerance:g}", "--rtol", f"use at least {DOP853_RTOL} and less than 1, such as 1e-9")
    return partial(sample_by, make_ivp_solver("dop853", tolerance, dense=True)), f"rtol {tolerance:g}"
