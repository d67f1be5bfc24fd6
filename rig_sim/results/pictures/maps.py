"""Pictures of maps and attractors; matplotlib is imported in modules of pictures alone."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from rig_sim.analyses.basins import Attractor
from rig_sim.analyses.periodic_points import find_periodic_orbits
from rig_sim.analyses.sweep import AttractorAt
from rig_sim.systems.interface import OnInterval
from stickslip.compute.arrays import Array, Integers

if TYPE_CHECKING:
    from matplotlib.axes import Axes


COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")  # Okabe and Ito's
PLACES = 4000  # points of the curve of a map
VISIBLE, HALVINGS = 0.005, 30  # least visible jump of a map, of its interval; halvings that tell it from a steep rise
SHARP = 480.0  # number of values times size of a point: many values are drawn as fine points
MOST_DRAWN = 5000  # points drawn as shapes; more become an image


def draw_map(axes: "Axes", f: OnInterval, times: int = 1) -> None:
    """Draw the ``times``-th iterate of a map, with the points where it meets the diagonal."""
    x = np.linspace(f.lo, f.hi, PLACES)
    y = f.images(x, times)
    cuts = find_jumps(f, times, x, y) + 1
    axes.plot([f.lo, f.hi], [f.lo, f.hi], color="0.6", lw=0.8)
    axes.plot(np.insert(x, cuts, np.nan), np.insert(y, cuts, np.nan), lw=1.2)
    for period in range(1, times + 1):
        if times % period:
            continue
        for orbit in find_periodic_orbits(f, period):
            kind = "stable" if orbit.stable else "unstable"
            face = "black" if orbit.stable else "white"
            label = f"{kind}, period {period}"
            axes.plot(orbit.points, orbit.points, "o", ms=6, mfc=face, mec="black", label=label)
    handles = dict(zip(*reversed(axes.get_legend_handles_labels()), strict=True))
    if handles:
        axes.legend(handles.values(), handles.keys(), loc="best")
    name = "f" if times == 1 else f"f^{times}"
    axes.set(
        xlabel="d = x2 - x1 in global stick (the scene's unit)",
        ylabel=f"{name}(d) (the scene's unit)",
        title=f"Map {name} from stick to stick",
    )
    axes.set_aspect("equal")


def find_jumps(f: OnInterval, times: int, x: Array, y: Array) -> Integers:
    """Return after which of the places ``x``, ascending, with the values ``y``, the ``times``-th iterate jumps.

    Between two places whose values differ visibly the greater half of the difference is followed: where the iterate is
    continuous, however steep, it becomes small.
    """
    after = np.flatnonzero(np.abs(np.diff(y)) > VISIBLE * (f.hi - f.lo))
    lower, upper, low, high = x[after], x[after + 1], y[after], y[after + 1]
    initial_difference = np.abs(high - low)
    for _ in range(HALVINGS if after.size else 0):
        middle = 0.5 * (lower + upper)
        value = f.images(middle, times)
        first = np.abs(value - low) >= np.abs(high - value)
        lower, low = np.where(first, lower, middle), np.where(first, low, value)
        upper, high = np.where(first, middle, upper), np.where(first, value, high)
    return after[np.abs(high - low) > 0.5 * initial_difference]


def draw_sweep(axes: "Axes", rows: Sequence[AttractorAt], parameter: str, ordinate: str) -> None:
    """Draw a bifurcation diagram: the points of every attractor; ``ordinate`` is their quantity."""
    size = min(max(SHARP / max(len({row.value for row in rows}), 1), 2.4), 5.0)
    for number in sorted({row.attractor for row in rows if row.points}):
        of_attractor = [row for row in rows if row.attractor == number]
        x = np.concatenate([np.full(len(row.points), row.value) for row in of_attractor])
        y = np.concatenate([row.points for row in of_attractor])
        colour = COLOURS[(number - 1) % len(COLOURS)]
        label = f"attractor {number}"
        axes.plot(x, y, ".", ms=size, mew=0, color=colour, rasterized=len(x) > MOST_DRAWN, label=label)
    if axes.lines:
        axes.legend(markerscale=14.4 / size, framealpha=0.85, edgecolor="none", frameon=True)
    axes.set(xlabel=f"{parameter} (the scene's unit)", ylabel=f"{ordinate} (the scene's unit)")
    axes.set_title(f"Attractors over {parameter}")


def draw_basins(axes: "Axes", attractors: Sequence[Attractor], centres: Array, fate: Integers) -> None:
    """Draw which attractor each start d, a cell with ``centres`` and index ``fate``, leads to; above, the points."""
    half = 0.5 * (centres[1] - centres[0])
    for index, attractor in enumerate(attractors):
        colour = COLOURS[index % len(COLOURS)]
        label = f"attractor {index + 1}: {100.0 * attractor.share:.1f} %"
        axes.fill_between(centres, 0.0, 1.0, where=fate == index, color=colour, step="mid", lw=0, label=label)
        axes.plot(attractor.points, np.full(len(attractor.points), 1.15), "o", ms=4, mew=0, color=colour)
    axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    axes.set(xlim=(centres[0] - half, centres[-1] + half), ylim=(0.0, 1.3), yticks=[])
    axes.set(xlabel="d = x2 - x1 at the start (the scene's unit)", title="Basins; above, the attractors")
