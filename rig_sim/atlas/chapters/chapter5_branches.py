"""Chapter 5, figures 5.5 and 5.7 to 5.12: branches over the damping, multipliers and eigenvalues of the damped mass."""

import cmath
import math
from dataclasses import replace
from functools import cache

import numpy as np

from rig_sim.analyses.limit_cycles.branches import continuation
from rig_sim.analyses.limit_cycles.floquet import FloquetOrbit
from rig_sim.analyses.special_points import Branch, Continuation
from rig_sim.atlas.chapters.axes import DAMPING, V, X
from rig_sim.atlas.chapters.chapter5 import (
    SPEED,
    STRONGEST,
    find_fixed_point,
    find_special_damping,
    find_special_points,
    find_stick_slip,
    find_unstable_orbit,
    flow_at,
    play,
    trace_stable_orbit,
    trace_unstable_orbit,
)
from rig_sim.atlas.figure import Computed, Label, Panel, Style, Trace
from rig_sim.atlas.statements import read_entries

SPACE_FROM = 0.28  # least damping of figure 5.7
BESIDE = 1e-6  # distance from a special point at which the branches end and the fold's multiplier is evaluated
LARGEST = "largest displacement (Fs/k)"
MULTIPLIERS = {"a": "0.3827", "b": "0.3967", "c": "0.4837", "d": "0.5563"}
EIGENVALUES = {"a": "0.04", "b": "0.16", "c": "0.3827", "d": "0.45"}


@cache
def compute_branches() -> Continuation:
    """Return the branches over the damping, up to both special points."""
    beside = [value + side * BESIDE for value in find_special_points().values() for side in (-1.0, 1.0)]
    near = [find_special_damping("hopf") + step for step in (1e-4, 5e-4, 2e-3, 5e-3)]
    return continuation(flow_at, np.unique(np.concatenate([np.linspace(0.0, STRONGEST, 63), beside, near])))


def find_unstable_peak(orbit: FloquetOrbit, c: float) -> float:
    if orbit.x_min is None or orbit.period is None:
        return math.nan
    return float(play(c, orbit.x_min, 0.0, orbit.period)[1].max())


def trace_branches(ordinate: str) -> tuple[Trace, ...]:
    """Return the branches over the damping; the ordinate is the largest velocity 'v' or displacement 'x'."""
    traces = []
    for branch in compute_branches().branches:
        c = np.array([row.value for row in branch.rows])
        name = f"{'stable' if branch.stable else 'unstable'} {branch.kind}"
        style: Style = "thick" if branch.stable else "dashed"
        colour = 2 if branch.kind == "fixed point" else 0 if branch.stable else 1
        traces.append(Trace(c, np.array(list_ordinates(branch, ordinate)), name, style, colour))
    return tuple(traces)


def list_ordinates(branch: Branch, ordinate: str) -> list[float]:
    if branch.kind == "fixed point":
        return [0.0 if ordinate == "v" else getattr(row.state, "x", math.nan) for row in branch.rows]
    if ordinate == "x":
        return [getattr(row.state, "x_max", math.nan) for row in branch.rows]
    if branch.stable:
        return [float(find_stick_slip(row.value).v_max or math.nan) for row in branch.rows]
    return [find_unstable_peak(find_unstable_orbit(row.value), row.value) for row in branch.rows]


def draw_velocity_diagram() -> Computed:
    labels = Label(find_special_damping("hopf"), 0.0, "H"), Label(find_special_damping("fold"), SPEED, "F")
    panel = Panel(DAMPING, "largest velocity (Fs/sqrt(km))", trace_branches("v"), texts=labels, y_range=(-0.05, 0.75))
    return Computed((panel,), find_special_points())


def draw_phase_space() -> Computed:
    traces: list[Trace] = []
    for c in (0.3, 0.34, 0.38, 0.42, 0.46, 0.5, 0.54):
        for trace in (*trace_stable_orbit(c), *trace_unstable_orbit(c)):
            style: Style = "dashed" if trace.style == "dashed" else "line"
            traces.append(replace(trace, x=np.full(len(trace.x), c), y=trace.x, z=trace.y, style=style))
    for trace in trace_branches("x"):
        if "fixed point" in trace.label:
            drawn = trace.x >= SPACE_FROM
            traces.append(replace(trace, x=trace.x[drawn], y=trace.y[drawn], z=np.zeros(int(drawn.sum()))))
    return Computed((Panel(DAMPING, X, tuple(traces), z=V),), find_special_points())


def select_displacements(*names: str) -> tuple[Trace, ...]:
    """Return the branches with these words in their names, by their largest displacement."""
    return tuple(trace for trace in trace_branches("x") if any(name in trace.label for name in names))


def draw_unstable_branch() -> Computed:
    (trace,) = select_displacements("unstable orbit")
    first, last = float(trace.y[0]), float(trace.y[-1])
    labels = Label(find_special_damping("hopf"), first, "H"), Label(find_special_damping("fold"), last, "F")
    return Computed((Panel(DAMPING, LARGEST, (trace,), texts=labels),), find_special_points())


def trace_circle(label: str) -> Trace:
    angle = np.linspace(0.0, 2.0 * math.pi, 361)
    return Trace(np.cos(angle), np.sin(angle), label, "thin", None)


def make_complex_plane(traces: tuple[Trace, ...], title: str, x_range: tuple[float, float]) -> Panel:
    return Panel("real part (1)", "imaginary part (1)", traces, title, x_range, (-1.6, 1.6), equal=True)


def draw_multipliers() -> Computed:
    fold = find_special_damping("fold")
    panels, second_multipliers = [], {}
    for letter, printed in MULTIPLIERS.items():
        c = min(float(printed), fold - BESIDE)
        second_multipliers[letter] = find_unstable_orbit(c).multipliers[1]
        title = f"c = {printed}" if c == float(printed) else f"c = {fold:.6f}, at the fold"
        marks = Trace(np.array([1.0, second_multipliers[letter]]), np.zeros(2), "multipliers", "cross", 1)
        panels.append(make_complex_plane((trace_circle("unit circle"), marks), f"({letter}) {title}", (-1.6, 7.6)))
    numbers = {
        **second_multipliers,
        "on_the_circle": second_multipliers["a"] - 1.0 < 1e-3,
        "crossed": 1.0 < second_multipliers["b"] < 2.0,
        "further": second_multipliers["c"] > 2.0,
        "fold": fold,
        "exists": find_unstable_orbit(float(MULTIPLIERS["d"])).period is not None,
        "infinite": math.isinf(second_multipliers["d"]),
    }
    return Computed(tuple(panels), numbers)


def draw_fixed_branch() -> Computed:
    label = Label(find_special_damping("hopf"), find_fixed_point(0.45).x or math.nan, "H")
    panel = Panel(DAMPING, X, select_displacements("fixed point"), texts=(label,), y_range=(0.0, 0.75))
    above, below = (find_fixed_point(find_special_damping("hopf") + side * BESIDE).stable for side in (1.0, -1.0))
    return Computed((panel,), {**find_special_points(), "beside": BESIDE, "changes": (above, below) == (True, False)})


def draw_eigenvalues() -> Computed:
    """Return the eigenvalues of the fixed point at four dampings, and their images as AUTO plots them."""
    panels: list[Panel] = []
    numbers: dict[str, object] = {}
    for letter, printed in EIGENVALUES.items():
        roots = find_fixed_point(float(printed)).eigenvalues
        images = [cmath.exp(root) for root in roots]
        plain = Trace(np.array([r.real for r in roots]), np.array([r.imag for r in roots]), "lambda", "cross", 1)
        mapped = Trace(np.array([r.real for r in images]), np.array([r.imag for r in images]), "exp(lambda)", "open", 0)
        panels.append(
            make_complex_plane((trace_circle("unit circle"), plain, mapped), f"({letter}) c = {printed}", (-1.6, 1.6))
        )
        numbers |= {f"size_{letter}": abs(roots[0]), f"exp_size_{letter}": abs(images[0])}
        numbers |= {f"outside_{letter}": abs(roots[0]) > 1.0 + 1e-9}
    strong, hopf = find_fixed_point(STRONGEST).eigenvalues[0], find_special_damping("hopf")
    size = abs(cmath.exp(find_fixed_point(hopf).eigenvalues[0]))
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


def draw_both_branches() -> Computed:
    fold = find_special_damping("fold")
    at_h, at_f = find_fixed_point(0.45).x or math.nan, find_unstable_orbit(fold - BESIDE).x_max or math.nan
    labels = Label(find_special_damping("hopf"), at_h, "H"), Label(fold, at_f, "F")
    return Computed(
        (Panel(DAMPING, LARGEST, select_displacements("fixed point", "unstable"), texts=labels),), find_special_points()
    )


FIGURES = read_entries(
    "chapter5.toml",
    {
        "5.5": draw_velocity_diagram,
        "5.7": draw_phase_space,
        "5.8": draw_unstable_branch,
        "5.9": draw_multipliers,
        "5.10": draw_fixed_branch,
        "5.11": draw_eigenvalues,
        "5.12": draw_both_branches,
    },
)
