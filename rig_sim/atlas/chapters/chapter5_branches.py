"""Chapter 5, figures 5.5 and 5.7 to 5.12: branches over the damping, multipliers and eigenvalues of the damped mass."""

import cmath
import math
from dataclasses import replace
from functools import cache

import numpy as np

from rig_sim.atlas.chapters.axes import DAMPING, V, X
from rig_sim.atlas.chapters.chapter5 import (
    SPEED,
    STRONGEST,
    flow_at,
    played,
    points,
    rest,
    special,
    stable_trace,
    stick_slip,
    unstable,
    unstable_trace,
)
from rig_sim.atlas.figure import Computed, Label, Panel, Style, Trace
from rig_sim.atlas.statements import entries
from rig_sim.dynamics.analyses.special_points import Branch, Continuation
from rig_sim.dynamics.limit_cycles.branches import continuation
from rig_sim.dynamics.limit_cycles.floquet import FloquetOrbit

SPACE_FROM = 0.28  # the least damping of figure 5.7
BESIDE = 1e-6  # of a special point: how close to it the branches are drawn and the fold's multiplier is taken
LARGEST = "largest displacement (Fs/k)"
MULTIPLIERS = {"a": "0.3827", "b": "0.3967", "c": "0.4837", "d": "0.5563"}
EIGENVALUES = {"a": "0.04", "b": "0.16", "c": "0.3827", "d": "0.45"}


@cache
def diagram() -> Continuation:
    """Return the branches over the damping, drawn up to both special points."""
    beside = [value + side * BESIDE for value in points().values() for side in (-1.0, 1.0)]
    near = [special("hopf") + step for step in (1e-4, 5e-4, 2e-3, 5e-3)]
    return continuation(flow_at, np.unique(np.concatenate([np.linspace(0.0, STRONGEST, 63), beside, near])))


def unstable_peak(orbit: FloquetOrbit, c: float) -> float:
    """Return the largest velocity on an unstable orbit."""
    if orbit.x_min is None or orbit.period is None:
        return math.nan
    return float(played(c, orbit.x_min, 0.0, orbit.period)[1].max())


def branch_traces(ordinate: str) -> tuple[Trace, ...]:
    """Return the branches over the damping; the ordinate is the largest velocity 'v' or displacement 'x'."""
    traces = []
    for branch in diagram().branches:
        c = np.array([row.value for row in branch.rows])
        name = f"{'stable' if branch.stable else 'unstable'} {branch.kind}"
        style: Style = "thick" if branch.stable else "dashed"
        colour = 2 if branch.kind == "fixed point" else 0 if branch.stable else 1
        traces.append(Trace(c, np.array(heights(branch, ordinate)), name, style, colour))
    return tuple(traces)


def heights(branch: Branch, ordinate: str) -> list[float]:
    """Return the ordinate of every row of a branch."""
    if branch.kind == "fixed point":
        return [0.0 if ordinate == "v" else getattr(row.state, "x", math.nan) for row in branch.rows]
    if ordinate == "x":
        return [getattr(row.state, "x_max", math.nan) for row in branch.rows]
    if branch.stable:
        return [float(stick_slip(row.value).v_max or math.nan) for row in branch.rows]
    return [unstable_peak(unstable(row.value), row.value) for row in branch.rows]


def velocity_diagram() -> Computed:
    """Return the largest velocity over the damping."""
    labels = Label(special("hopf"), 0.0, "H"), Label(special("fold"), SPEED, "F")
    panel = Panel(DAMPING, "largest velocity (Fs/sqrt(km))", branch_traces("v"), texts=labels, y_range=(-0.05, 0.75))
    return Computed((panel,), points())


def phase_space() -> Computed:
    """Return orbits and fixed points in the phase space over the damping."""
    traces: list[Trace] = []
    for c in (0.3, 0.34, 0.38, 0.42, 0.46, 0.5, 0.54):
        for found in (*stable_trace(c), *unstable_trace(c)):
            style: Style = "dashed" if found.style == "dashed" else "line"
            traces.append(replace(found, x=np.full(len(found.x), c), y=found.x, z=found.y, style=style))
    for found in branch_traces("x"):
        if "fixed point" in found.label:
            shown = found.x >= SPACE_FROM
            traces.append(replace(found, x=found.x[shown], y=found.y[shown], z=np.zeros(int(shown.sum()))))
    return Computed((Panel(DAMPING, X, tuple(traces), z=V),), points())


def displacements(*names: str) -> tuple[Trace, ...]:
    """Return the branches with these words in their names, by their largest displacement."""
    return tuple(trace for trace in branch_traces("x") if any(name in trace.label for name in names))


def unstable_branch() -> Computed:
    """Return the unstable orbit over the damping."""
    (trace,) = displacements("unstable orbit")
    first, last = float(trace.y[0]), float(trace.y[-1])
    labels = Label(special("hopf"), first, "H"), Label(special("fold"), last, "F")
    return Computed((Panel(DAMPING, LARGEST, (trace,), texts=labels),), points())


def circle(label: str) -> Trace:
    """Return the unit circle."""
    angle = np.linspace(0.0, 2.0 * math.pi, 361)
    return Trace(np.cos(angle), np.sin(angle), label, "thin", None)


def complex_plane(traces: tuple[Trace, ...], title: str, x_range: tuple[float, float]) -> Panel:
    """Return a part of the complex plane."""
    return Panel("real part (1)", "imaginary part (1)", traces, title, x_range, (-1.6, 1.6), equal=True)


def multipliers() -> Computed:
    """Return the Floquet multipliers of the unstable orbit at four dampings."""
    fold = special("fold")
    panels, across = [], {}
    for letter, printed in MULTIPLIERS.items():
        c = min(float(printed), fold - BESIDE)
        across[letter] = unstable(c).multipliers[1]
        where = f"c = {printed}" if c == float(printed) else f"c = {fold:.6f}, at the fold"
        marks = Trace(np.array([1.0, across[letter]]), np.zeros(2), "multipliers", "cross", 1)
        panels.append(complex_plane((circle("unit circle"), marks), f"({letter}) {where}", (-1.6, 7.6)))
    numbers = {
        **across,
        "on_the_circle": across["a"] - 1.0 < 1e-3,
        "crossed": 1.0 < across["b"] < 2.0,
        "further": across["c"] > 2.0,
        "fold": fold,
        "exists": unstable(float(MULTIPLIERS["d"])).period is not None,
        "infinite": math.isinf(across["d"]),
    }
    return Computed(tuple(panels), numbers)


def fixed_branch() -> Computed:
    """Return the fixed point over the damping."""
    label = Label(special("hopf"), rest(0.45).x or math.nan, "H")
    panel = Panel(DAMPING, X, displacements("fixed point"), texts=(label,), y_range=(0.0, 0.75))
    above, below = (rest(special("hopf") + side * BESIDE).stable for side in (1.0, -1.0))
    return Computed((panel,), {**points(), "beside": BESIDE, "changes": (above, below) == (True, False)})


def eigenvalues() -> Computed:
    """Return the eigenvalues of the fixed point at four dampings, and what AUTO plots of them."""
    panels: list[Panel] = []
    numbers: dict[str, object] = {}
    for letter, printed in EIGENVALUES.items():
        roots = rest(float(printed)).eigenvalues
        images = [cmath.exp(root) for root in roots]
        plain = Trace(np.array([r.real for r in roots]), np.array([r.imag for r in roots]), "lambda", "cross", 1)
        mapped = Trace(np.array([r.real for r in images]), np.array([r.imag for r in images]), "exp(lambda)", "open", 0)
        panels.append(complex_plane((circle("unit circle"), plain, mapped), f"({letter}) c = {printed}", (-1.6, 1.6)))
        numbers |= {f"size_{letter}": abs(roots[0]), f"exp_size_{letter}": abs(images[0])}
        numbers |= {f"outside_{letter}": abs(roots[0]) > 1.0 + 1e-9}
    strong, hopf = rest(STRONGEST).eigenvalues[0], special("hopf")
    size = abs(cmath.exp(rest(hopf).eigenvalues[0]))
    numbers |= {
        "strongest": STRONGEST,
        "real_part": strong.real,
        "imaginary_part": abs(strong.imag),
        "real": strong.imag == 0.0,
        "real_from": hopf + 2.0,
        "hopf": hopf,
        "exp_size": size,
        "on_the_circle": abs(size - 1.0) < 1e-9,
    }
    return Computed(tuple(panels), numbers, columns=2)


def both_branches() -> Computed:
    """Return fixed point and unstable orbit over the damping."""
    fold = special("fold")
    at_h, at_f = rest(0.45).x or math.nan, unstable(fold - BESIDE).x_max or math.nan
    labels = Label(special("hopf"), at_h, "H"), Label(fold, at_f, "F")
    return Computed((Panel(DAMPING, LARGEST, displacements("fixed point", "unstable"), texts=labels),), points())


FIGURES = entries(
    "chapter5.toml",
    {
        "5.5": velocity_diagram,
        "5.7": phase_space,
        "5.8": unstable_branch,
        "5.9": multipliers,
        "5.10": fixed_branch,
        "5.11": eigenvalues,
        "5.12": both_branches,
    },
)
