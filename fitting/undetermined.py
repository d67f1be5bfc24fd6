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
EQUAL_SIZES = 1e-4  # relative difference of a direction's parts that are equal


class Undetermined(NamedTuple):
    """Parameters, their combination in the formula, and how many of them may have any value."""

    names: tuple[str, ...]
    how: str
    free: int

    def __str__(self) -> str:
        *others, last = self.names
        return f"{', '.join(others)} and {last} {self.how}" if others else f"{last} {self.how}"


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
    groups_of_draws = []
    for _ in range(DRAWS):
        drawn = sizes * rng.uniform(*SIZES_DRAWN, sizes.size)
        values = dict(zip(law.free, drawn.tolist(), strict=True)) | dict(law.fix or {})
        try:
            slopes = law.curve.gradient(speeds, values, law.free)
        except InputError:
            continue
        groups_of_draws.append(_groups(slopes * drawn, drawn))
    if not groups_of_draws:
        return ()
    everywhere = set.intersection(*(set(groups) for groups in groups_of_draws))
    return tuple(
        Undetermined(
            tuple(law.free[i] for i in group),
            _how([groups[group] for groups in groups_of_draws]),
            min(groups[group][0].shape[0] for groups in groups_of_draws),
        )
        for group in sorted(everywhere)
    )


def _groups(columns: Array, values: Array) -> dict[tuple[int, ...], tuple[Array, Array]]:
    """Return groups of dependent columns (n, k), each with the directions (r, m) along which they cancel.

    Once in the logarithms of the parameters, once in the parameters.
    """
    size = np.linalg.norm(columns, axis=0)
    seen = size > DEPENDENT_BELOW * float(size.max(initial=0.0))
    alone = np.ones((1, 1))
    groups: dict[tuple[int, ...], tuple[Array, Array]] = {(i,): (alone, alone) for i in np.flatnonzero(~seen).tolist()}
    index = np.flatnonzero(seen)
    if not index.size:
        return groups
    _, singular, axes = np.linalg.svd(columns[:, index] / size[index], full_matrices=False)
    null = axes[singular < DEPENDENT_BELOW * float(singular.max())]
    beside = np.abs(np.einsum("ri,rj->ij", null, null)) > LEAST_PART**2
    left = [i for i in range(index.size) if beside[i, i]]
    while left:
        group: list[int] = []
        more = left[:1]
        while more:
            group += more
            more = [i for i in left if i not in group and np.any(beside[i, group])]
        left = [i for i in left if i not in group]
        group.sort()
        places = index[group]
        logs = _basis(null[:, group]) / size[places]
        groups[tuple(places.tolist())] = logs, logs * values[places]
    return groups


def _how(directions: list[tuple[Array, Array]]) -> str:
    """Return the combination of a group in words, from its directions at every set of values."""
    count = directions[0][0].shape[1]
    if count == 1:
        return "does not change friction"
    first, others = np.eye(count)[0], np.eye(count)[1:]
    for place, both in enumerate((("a product", "a quotient"), ("a sum", "a difference"))):
        bases = [_basis(direction[place]) for direction in directions]
        for sign, kind in zip((-1.0, 1.0), both, strict=True):
            steps = first + sign * others
            if (sign < 0 or count == 2) and all(_inside(steps, basis) for basis in bases):
                return f"enter only as {kind}"
    return "enter only together"


def _basis(directions: Array) -> Array:
    """Return an orthonormal basis of the space of some directions (r, m)."""
    _, singular, axes = np.linalg.svd(directions, full_matrices=False)
    return np.asarray(axes[singular > EQUAL_SIZES * float(singular.max())])


def _inside(steps: Array, basis: Array) -> bool:
    left = steps - np.einsum("nm,rm,rj->nj", steps, basis, basis)
    return bool(np.all(np.abs(left) < EQUAL_SIZES * np.abs(steps).max()))
