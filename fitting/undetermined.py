"""Parameters that a formula has only together, as those of ``a*b*s`` or ``Fs - (a + b)*s``.

A direction in the parameters along which the curve does not change at any speed exists where the derivatives by them,
each over its size, are linearly dependent.  It must exist at several sets of values, of the sizes that the units of the
parameters allow: a fall of no height leaves its speed undetermined, but the formula does not.
"""

from typing import NamedTuple

import numpy as np

from fitting.law import DEPENDENT_BELOW, Law
from stickslip.compute.arrays import Array
from stickslip.errors import InputError

DRAWS = 4  # sets of values: at half of them a chance dependence would pass, at twice nothing changes
SIZES_DRAWN = (0.5, 2.0)  # least and largest size drawn, over the natural one
LEAST_PART = 0.1  # part of a direction over its largest: less is rounding


class Undetermined(NamedTuple):
    """Parameters that the formula has only together, and how many of them may have any value."""

    names: tuple[str, ...]
    free: int

    def __str__(self) -> str:
        *others, last = self.names
        return f"{', '.join(others)} and {last} enter only together" if others else f"{last} does not change friction"


def natural_size(law: Law, name: str, friction: float, speed: float) -> float:
    """Return the size of a parameter by its unit, for curves of that friction (m/s^2) and speed (m/s); else 1.

    Positive also for negative friction, as of a measured curve without a known level.
    """
    force, power = law.dimensions.get(name, (0, 0))
    return float(abs(friction) ** force * speed**power)


def undetermined(law: Law, friction: float, fastest: float) -> tuple[Undetermined, ...]:
    """Return the parameters that a formula has only together, for friction (m/s^2) and slip speeds like these."""
    rng = np.random.default_rng(len(law.formula))
    speeds = fastest * np.linspace(0.0, 1.0, 12 * len(law.free) + 1)
    sizes = np.array([natural_size(law, name, friction, fastest) for name in law.free])
    draws = []
    for _ in range(DRAWS):
        drawn = sizes * rng.uniform(*SIZES_DRAWN, sizes.size)
        values = dict(zip(law.free, drawn.tolist(), strict=True)) | dict(law.fix or {})
        try:
            draws.append(_groups(law.curve.gradient(speeds, values, law.free) * drawn))
        except InputError:
            continue
    everywhere = set.intersection(*(set(groups) for groups in draws)) if draws else set()
    return tuple(
        Undetermined(tuple(law.free[i] for i in group), min(groups[group] for groups in draws))
        for group in sorted(everywhere)
    )


def _groups(columns: Array) -> dict[tuple[int, ...], int]:
    """Return groups of dependent columns (n, k), each with the number of directions along which they cancel."""
    size = np.linalg.norm(columns, axis=0)
    seen = size > DEPENDENT_BELOW * float(size.max(initial=0.0))
    groups: dict[tuple[int, ...], int] = {(i,): 1 for i in np.flatnonzero(~seen).tolist()}
    index = np.flatnonzero(seen)
    if not index.size:
        return groups
    _, singular, axes = np.linalg.svd(columns[:, index] / size[index], full_matrices=False)
    null = axes[singular < DEPENDENT_BELOW * float(singular.max())]
    beside = np.einsum("ri,rj->ij", null, null)
    left = [i for i in range(index.size) if beside[i, i] > LEAST_PART**2]
    while left:
        group: list[int] = []
        more = left[:1]
        while more:
            group += more
            more = [i for i in left if i not in group and np.any(np.abs(beside[i, group]) > LEAST_PART**2)]
        left = [i for i in left if i not in group]
        groups[tuple(index[sorted(group)].tolist())] = round(float(np.trace(beside[np.ix_(group, group)])))
    return groups
