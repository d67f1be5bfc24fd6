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
from rig_sim.atlas.figure import Drawing, Entry, Label, Panel, StatementCheck, Style, Trace, compare, state
from rig_sim.dynamics.analyses.special_points import Branch, Continuation
from rig_sim.dynamics.orbits.branches import continuation
from rig_sim.dynamics.orbits.floquet import FloquetOrbit

SPACE_FROM = 0.28  # the least damping of figure 5.7
BESIDE = 1e-6  # of a special point: how close to it the branches are drawn and the fold's multiplier is taken
MULTIPLIERS = {"a": "0.3827", "b": "0.3967", "c": "0.4837", "d": "0.5563"}
EIGENVALUES = {"a": "0.04", "b": "0.16", "c": "0.3827", "d": "0.45"}


@cache
def diagram() -> Continuation:
    """Return the branches over the damping, drawn up to both special points."""
    beside = [value + side * BESIDE for value in points().values() for side in (-1.0, 1.0)]
    near = [special("hopf") + step for step in (1e-4, 5e-4, 2e-3, 5e-3)]
    return continuation(flow_at, np.unique(np.concatenate([np.linspace(0.0, STRONGEST, 63), beside, near])))


def unstable_peak(found: FloquetOrbit, c: float) -> float:
    """Return the largest velocity on an unstable orbit."""
    if found.x_min is None or found.period is None:
        return math.nan
    return float(played(c, found.x_min, 0.0, found.period)[1].max())


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


def special_rows() -> tuple[StatementCheck, ...]:
    """Return the comparisons of both special points."""
    return (
        compare("damping at H, the Hopf point", "0.3827", special("hopf")),
        compare(
            "damping at F, the fold",
            "0.5563",
            special("fold"),
            "the unstable orbit touches the belt's velocity at 0.556168 already.  AUTO followed the smooth equations "
            "without stick: at 0.5563 their orbit exceeds the belt's velocity, and is none of the stick-slip system",
        ),
    )


def velocity_diagram() -> Drawing:
    """Figure 5.5."""
    H, F = special("hopf"), special("fold")
    return Drawing(
        "The largest velocity over the damping: stick-slip orbit, unstable orbit and fixed point.  Between H and F "
        "both the orbit and the fixed point are stable.",
        (
            Panel(
                DAMPING,
                "largest velocity (Fs/sqrt(km))",
                branch_traces("v"),
                texts=(Label(H, 0.0, "H"), Label(F, SPEED, "F")),
                y_range=(-0.05, 0.75),
            ),
        ),
        special_rows(),
    )


def phase_space() -> Drawing:
    """Figure 5.7."""
    traces: list[Trace] = []
    for c in (0.3, 0.34, 0.38, 0.42, 0.46, 0.5, 0.54):
        for found in (*stable_trace(c), *unstable_trace(c)):
            style: Style = "dashed" if found.style == "dashed" else "line"
            traces.append(replace(found, x=np.full(len(found.x), c), y=found.x, z=found.y, style=style))
    for found in branch_traces("x"):
        if "fixed point" in found.label:
            shown = found.x >= SPACE_FROM
            traces.append(replace(found, x=found.x[shown], y=found.y[shown], z=np.zeros(int(shown.sum()))))
    return Drawing(
        "The phase space over the damping: the unstable orbit grows out of the fixed point at H (0.3827) and meets the "
        "stick-slip orbit at F (0.5562).",
        (Panel(DAMPING, X, tuple(traces), z=V),),
        special_rows(),
        choices="the values of the damping at which orbits are drawn",
    )


def unstable_branch() -> Drawing:
    """Figure 5.8."""
    H, F = special("hopf"), special("fold")
    traces = tuple(trace for trace in branch_traces("x") if trace.label == "unstable orbit")
    return Drawing(
        "The unstable orbit over the damping, from its birth at H to the place where it meets the stick-slip orbit, F.",
        (
            Panel(
                DAMPING,
                "largest displacement (Fs/k)",
                traces,
                texts=(Label(H, float(traces[0].y[0]), "H"), Label(F, float(traces[0].y[-1]), "F")),
            ),
        ),
        special_rows(),
        choices="the ordinate, as the text does not name AUTO's",
    )


def circle(label: str) -> Trace:
    """Return the unit circle."""
    angle = np.linspace(0.0, 2.0 * math.pi, 361)
    return Trace(np.cos(angle), np.sin(angle), label, "thin", None)


def complex_plane(traces: tuple[Trace, ...], title: str, x_range: tuple[float, float]) -> Panel:
    """Return a part of the complex plane."""
    return Panel("real part (1)", "imaginary part (1)", traces, title, x_range, (-1.6, 1.6), equal=True)


def multipliers() -> Drawing:
    """Figure 5.9."""
    panels, rows = [], []
    fold = special("fold")
    at_fold = unstable(fold - BESIDE)
    for letter, printed in MULTIPLIERS.items():
        c = float(printed) if float(printed) < fold else fold - BESIDE
        across = unstable(c).multipliers[1]
        where = f"c = {printed}" if c == float(printed) else f"c = {fold:.6f}, at the fold"
        marks = Trace(np.array([1.0, across]), np.zeros(2), "multipliers", "cross", 1)
        panels.append(complex_plane((circle("unit circle"), marks), f"({letter}) {where}", (-1.6, 7.6)))
        if letter in "abc":
            says = {"a": "on the unit circle", "b": "one crossed it through +1", "c": "further away"}[letter]
            holds = {"a": across - 1.0 < 1e-3, "b": 1.0 < across < 2.0, "c": across > 2.0}[letter]
            rows.append(state(f"multipliers at c = {printed}", says, f"1 and {across:.9f}", holds))
    rows.append(
        state(
            "orbit at c = 0.5563",
            "one multiplier outside the circle",
            f"no orbit: the fold is at {fold:.12g}",
            unstable(0.5563).period is not None,
            "AUTO followed the smooth equations past the belt's velocity, where stick would begin",
        )
    )
    rows.append(
        state(
            "second multiplier at the fold",
            "jumps from 0 to infinity",
            f"jumps from 0 to {at_fold.multipliers[1]:.6g}",
            math.isinf(at_fold.multipliers[1]),
            "the unstable orbit touches the belt's velocity in one point and follows the smooth equations, whose "
            "multiplier is finite there; it is 0 on the orbit that sticks",
        )
    )
    return Drawing(
        "The Floquet multipliers of the unstable orbit in the complex plane: 1 along the orbit, and one across it that "
        "leaves the unit circle through +1 and stays finite up to the fold.",
        tuple(panels),
        tuple(rows),
    )


def fixed_branch() -> Drawing:
    """Figure 5.10."""
    traces = tuple(trace for trace in branch_traces("x") if "fixed point" in trace.label)
    x = rest(0.45).x or math.nan
    return Drawing(
        "The fixed point over the damping: its place stays, its stability changes at H.",
        (Panel(DAMPING, X, traces, texts=(Label(special("hopf"), x, "H"),), y_range=(0.0, 0.75)),),
        (
            special_rows()[0],
            state(
                "the fixed point is stable",
                "for c above H",
                f"stable at H + {BESIDE:g}, not at H - {BESIDE:g}",
                (rest(special("hopf") + BESIDE).stable, rest(special("hopf") - BESIDE).stable) == (True, False),
            ),
        ),
        choices="the ordinate, as the text does not name AUTO's",
    )


def eigenvalues() -> Drawing:
    """Figure 5.11."""
    panels, rows = [], []
    for letter, printed in EIGENVALUES.items():
        roots = rest(float(printed)).eigenvalues
        images = [cmath.exp(root) for root in roots]
        plain = Trace(np.array([r.real for r in roots]), np.array([r.imag for r in roots]), "lambda", "cross", 1)
        mapped = Trace(np.array([r.real for r in images]), np.array([r.imag for r in images]), "exp(lambda)", "open", 0)
        panels.append(complex_plane((circle("unit circle"), plain, mapped), f"({letter}) c = {printed}", (-1.6, 1.6)))
        if letter in "ab":
            rows.append(
                state(
                    f"eigenvalues at c = {printed}",
                    "outside the unit circle",
                    f"abs(lambda) = {abs(roots[0]):.6g}, abs(exp(lambda)) = {abs(images[0]):.6g}",
                    abs(roots[0]) > 1.0 + 1e-9,
                    "the eigenvalues of a fixed point are judged by their real part, here above 0; their size is "
                    "sqrt(k/m) = 1 at every damping.  What AUTO plots around the circle is exp(lambda)",
                )
            )
    strong = rest(STRONGEST).eigenvalues
    real_from = special("hopf") + 2.0
    rows.append(
        state(
            "eigenvalues for damping above H (5.13)",
            "real and negative",
            f"{strong[0].real:.4g} +- {abs(strong[0].imag):.4g} i at c = {STRONGEST}; real from c = {real_from:.6g}",
            strong[0].imag == 0.0,
            "stability needs a negative real part alone; the pair stays complex until c - gamma_lin = 2 sqrt(km)",
        )
    )
    size = abs(cmath.exp(rest(special("hopf")).eigenvalues[0]))
    rows.append(
        state(
            "both lie on the circle at the Hopf point",
            "c = 0.3827",
            f"abs(exp(lambda)) = {size:.12g} at c = {special('hopf'):.9g}",
            abs(size - 1.0) < 1e-9,
        )
    )
    return Drawing(
        "The eigenvalues lambda of the fixed point (crosses) and exp(lambda) (circles): stable where the real part of "
        "lambda is negative, and exp(lambda) within the unit circle.",
        tuple(panels),
        tuple(rows),
        columns=2,
        choices="the damping of (d)",
    )


def both_branches() -> Drawing:
    """Figure 5.12."""
    traces = tuple(trace for trace in branch_traces("x") if trace.label != "stable orbit")
    H, F = special("hopf"), special("fold")
    return Drawing(
        "Fixed point and unstable orbit over the damping: a subcritical Hopf bifurcation at H.",
        (
            Panel(
                DAMPING,
                "largest displacement (Fs/k)",
                traces,
                texts=(Label(H, rest(0.45).x or math.nan, "H"), Label(F, unstable(F - BESIDE).x_max or math.nan, "F")),
            ),
        ),
        special_rows(),
        choices="the ordinate, as the text does not name AUTO's",
    )


FIGURES = (
    Entry("5.5", "bifurcation diagram over the damping", velocity_diagram),
    Entry("5.7", "phase space over the damping", phase_space),
    Entry("5.8", "path of the unstable orbit", unstable_branch),
    Entry("5.9", "Floquet multipliers around the unit circle", multipliers),
    Entry("5.10", "path of the fixed point", fixed_branch),
    Entry("5.11", "eigenvalues around the unit circle", eigenvalues),
    Entry("5.12", "paths of the fixed point and the unstable orbit", both_branches),
)
