"""Parameters drawn from what a fit knows of them: the section ``fit`` of a scene, as changes for `scene`."""

import numpy as np

from rig_sim.scenes.model import Scene
from rig_sim.scenes.sections import FitSection
from stickslip.compute.arrays import Array
from stickslip.errors import InputError

# Lower limits that are physical values themselves: a draw below is set to the limit.  The scene refuses a draw that
# breaks another limit.
LOWEST = {"damper.c": 0.0, "droop.fraction": 0.0, "friction.static": 1.0}
ROUNDING = 1e-6  # relative: asymmetry, or a variance below 0, that rounding may make
CURVE = "friction.curve."


def draw_changes(scene: Scene, number: int, where: str) -> list[dict[str, object]]:
    """Return ``number`` sets of changes, the same for the same seed of the scene; ``where`` names it in messages.

    A key whose value is no longer the fitted one was changed by hand, and is not drawn.

    The errors are normal over the root of a chi square of ``cycles - 1`` degrees of freedom, as those of Student's t:
    with few cycles the covariance itself is uncertain.
    """
    fit = scene.fit
    if fit is None:
        do = "write the scene with fit-friction --save-scene"
        python = "write the scene with fitting.rank(run).save_scene(path)"
        raise InputError("has no section fit, which --draws requires", where, do, python=python)
    names, centre, spread = fit.parameters, np.array(fit.values), check_covariance(fit, where)
    points = len(scene.friction.curve or ()) if scene.friction is not None else 0
    curve = {f"{CURVE}{i}" for i in range(points)}
    for name in names:
        if name.startswith(CURVE) and name not in curve:
            raise InputError(
                f"fit.parameters names {name}, which is not a parameter of the curve", where, "correct the name"
            )
    scale = np.sqrt(np.diag(spread))
    unit = np.where(scale > 0.0, scale, 1.0)
    size, axes = np.linalg.eigh(spread / unit[:, None] / unit)
    if size[0] < -ROUNDING * max(float(size[-1]), 1.0) * len(names):
        raise InputError("fit.covariance contains a variance below 0", where, "write the scene again")
    root = unit[:, None] * axes * np.sqrt(np.maximum(size, 0.0))
    rng = np.random.default_rng(scene.seed)
    normal = rng.standard_normal((number, len(names)))
    widening = np.sqrt((fit.cycles - 1) / rng.chisquare(fit.cycles - 1, number))
    drawn = centre + widening[:, None] * np.einsum("nk,pk->np", normal, root)
    fitted_keys = find_fitted_keys(scene, fit)
    return [
        {key: value for key, value in format_changes(scene, names, row.tolist()).items() if key in fitted_keys}
        for row in drawn
    ]


def find_fitted_keys(scene: Scene, fit: FitSection) -> set[str]:
    """Return the keys whose values in the scene are those of the fit."""
    keys = {name: apply_lower_limit(name, value) for name, value in zip(fit.parameters, fit.values, strict=True)}
    curve = {name: value for name, value in keys.items() if name.startswith(CURVE)}
    fitted = {name for name, value in keys.items() if name not in curve and read_value(scene, name) == value}
    points = (scene.friction.curve or ()) if scene.friction is not None else ()
    if curve and all(points[int(name[len(CURVE) :])][1] == value for name, value in curve.items()):
        fitted.add("friction.curve")
    return fitted


def read_value(scene: Scene, name: str) -> object:
    section, _, key = name.partition(".")
    return getattr(getattr(scene, section, None), key, None)


def apply_lower_limit(name: str, number: float) -> float:
    return max(number, LOWEST.get(name, -float("inf")))


def check_covariance(fit: FitSection, where: str) -> Array:
    """Return the covariance (n, n), checked against the names and values."""
    n = len(fit.parameters)
    rows = fit.covariance
    if len(fit.values) != n or len(rows) != n or any(len(row) != n for row in rows) or n == 0:
        problem = f"fit has {n} parameters, {len(fit.values)} values and {len(rows)} rows of covariance"
        raise InputError(problem, where, "use equal numbers of parameters and values, and a square covariance")
    matrix = np.array(rows)
    error = np.sqrt(np.abs(np.diag(matrix)))
    if np.any(np.diag(matrix) < 0) or np.any(np.abs(matrix - matrix.T) > ROUNDING * np.outer(error, error)):
        raise InputError("fit.covariance is not symmetric, or has a variance below 0", where, "write the scene again")
    return matrix


def format_changes(scene: Scene, names: list[str], numbers: list[float]) -> dict[str, object]:
    """Return one draw as changes: dotted keys, and the curve as a whole."""
    changes: dict[str, object] = {
        name: apply_lower_limit(name, number)
        for name, number in zip(names, numbers, strict=True)
        if not name.startswith(CURVE)
    }
    friction = scene.friction
    if friction is not None and friction.curve is not None:
        points = [list(point) for point in friction.curve]
        for name, number in zip(names, numbers, strict=True):
            if name.startswith(CURVE):
                points[int(name[len(CURVE) :])][1] = number
        changes["friction.curve"] = points
    return changes
