"""A friction curve made of cubics, as the kernels read it: the spline through measured points, or through a formula.

The spline through points (slip speed, friction) is not-a-knot, the usual one through points alone: twice continuously
differentiable, with its third derivative continuous at the second and at the last point but one too.  Two points give a
line, three a parabola.
Beyond the last point its slope stays as it is there.  A spline with breaks at given speeds is such a curve when one
more point is named inside its first and its last piece each.  The cubics of a formula: `formula_curve`.

The kernels read one flat table of ``pieces`` cubics, the last of them the line beyond the last point:

    table[i]                         slip speed where piece i begins (m/s); the first begins at 0
    table[pieces + 4 i ... + 3]      powers 0 to 3 of the distance to that speed, over the friction at rest
    table[5 pieces]                  slip speed at which friction first is 0, beyond which it is unphysical; or infinite
    table[5 pieces + 1]              slip speed (m/s) beyond which the curve is not known; infinite for measured points
"""

import math
from collections.abc import Sequence
from functools import lru_cache
from itertools import pairwise
from typing import Any

NO_TABLE = (0.0,)  # of the other curves: never read
Table = Any  # tuple of floats (interpreted) or one-dimensional float64 array (compiled)


def piece_of(begins: Table, pieces: int, s: float) -> int:
    """Return the piece in which s lies, of ``pieces`` that begin at increasing speeds; the first or last beyond."""
    low, high = 0, pieces
    while high - low > 1:
        middle = (low + high) // 2
        if s < begins[middle]:
            high = middle
        else:
            low = middle
    return low


def about(table: Table, pieces: int, i: int, s: float) -> tuple[float, float, float, float]:
    """Return the powers 0 to 3 of piece i about the slip speed s (m/s), over the friction at rest."""
    z = s - table[i]
    start = pieces + 4 * i
    c1, c2, c3 = table[start + 1], table[start + 2], table[start + 3]
    return (
        table[start] + z * (c1 + z * (c2 + z * c3)),
        c1 + z * (2.0 * c2 + z * 3.0 * c3),
        c2 + 3.0 * z * c3,
        c3,
    )


def steepest_fall_between(table: Table, pieces: int, low: float, high: float) -> float:
    """Return the largest fall of the curve per speed (s/m, over the friction at rest) from slip speed low to high."""
    first, last = piece_of(table, pieces, low), piece_of(table, pieces, high)
    # cached: an orbit calls this thousands of times, and a formula has hundreds of pieces
    between = _steepest_falls(table, pieces)[first + 1 : last]
    return max(*(_steepest_fall(table, pieces, i, low, high) for i in (first, last)), *between)


@lru_cache(maxsize=16)
def _steepest_falls(table: Table, pieces: int) -> tuple[float, ...]:
    """Return the largest fall per speed of each piece but the last, over all of it."""
    return tuple(_steepest_fall(table, pieces, i, table[i], table[i + 1]) for i in range(pieces - 1))


def _steepest_fall(table: Table, pieces: int, i: int, low: float, high: float) -> float:
    """Return the largest fall per speed of piece i from slip speed low to high, as far as they lie in it."""
    end = table[i + 1] if i + 1 < pieces else high
    places = [max(low, table[i]), min(high, end)]
    c2, c3 = table[pieces + 4 * i + 2], table[pieces + 4 * i + 3]
    if c3 != 0.0:
        turn = table[i] - c2 / (3.0 * c3)
        if places[0] < turn < places[1]:
            places.append(turn)
    return max(-about(table, pieces, i, s)[1] for s in places)


@lru_cache(maxsize=64)
def spline_table(points: tuple[tuple[float, float], ...]) -> tuple[int, tuple[float, ...]]:
    """Return (pieces, table) of the spline through points (slip speed m/s, friction N), as the module describes it.

    Raises ValueError for fewer than two points; a first speed other than 0; speeds that do not increase; a friction
    that is not above 0, or a number that is not finite.
    """
    problem = find_problem(points)
    if problem:
        raise ValueError(problem)
    from scipy.interpolate import PPoly, make_interp_spline

    speeds = [s for s, _ in points]
    rest = points[0][1]
    degree = min(3, len(points) - 1)
    spline = make_interp_spline(speeds, [F / rest for _, F in points], k=degree)
    polynomials = PPoly.from_spline((spline.t, spline.c, spline.k))
    rows = []
    for begin, end, powers in zip(polynomials.x[:-1], polynomials.x[1:], polynomials.c[::-1].T, strict=True):
        if end > begin:
            rows.append((float(begin), *powers.tolist(), *[0.0] * (3 - degree)))
    rows[0] = (0.0, 1.0, *rows[0][2:])
    return make_table(rows, speeds[-1], ends=False)


def make_table(rows: Sequence[tuple[float, ...]], last: float, *, ends: bool) -> tuple[int, tuple[float, ...]]:
    """Return (pieces, table) of cubics, as the module describes it.

    ``rows`` are the start of each cubic (m/s), from 0 on, and its powers over the friction at rest.  Beyond ``last``,
    the end of the last one (m/s), the curve has constant slope; or, with ``ends``, it is unknown, is not negative
    before, and its zeros are not searched.
    """
    begin, c0, c1, c2, c3 = rows[-1]
    z = last - begin
    value, slope = c0 + z * (c1 + z * (c2 + z * c3)), c1 + z * (2.0 * c2 + z * 3.0 * c3)
    rows = [*rows, (last, value, slope, 0.0, 0.0)]
    table = [row[0] for row in rows] + [power for row in rows for power in row[1:]]
    return len(rows), (*table, *((math.inf, last) if ends else (find_first_zero(rows), math.inf)))


def find_problem(points: Sequence[Sequence[float]]) -> str:
    """Return the fault of the points of a curve; empty without one."""
    if len(points) < 2:
        return f"the curve has {len(points)} point{'s' * (len(points) != 1)}, but two or more are required"
    for s, F in points:
        if not (math.isfinite(s) and math.isfinite(F)):
            return f"the point [{s}, {F}] is not finite"
        if s < 0.0:
            return f"the point [{s:g}, {F:g}] has a slip speed below 0; state the curve for positive speeds"
        if not F > 0.0:
            return f"the point [{s:g}, {F:g}] has a friction that is not above 0"
    if points[0][0] != 0.0:
        return f"the curve begins at s = {points[0][0]:g}; the first point must be at s = 0"
    for (s, _), (following, _) in pairwise(points):
        if not following - s > CLOSEST * points[-1][0]:
            return (
                f"s = {following!r} follows s = {s!r}, but speeds must increase by more than {CLOSEST:g} of "
                "the last speed"
            )
    return ""


CLOSEST = 1e-9  # of the last slip speed: between points closer together the slope has no digits


def find_first_zero(rows: Sequence[tuple[float, ...]]) -> float:
    """Return the lowest slip speed at which the pieces reach 0, or infinity."""
    import numpy as np

    ends = [row[0] for row in rows[1:]] + [math.inf]
    for (begin, *powers), end in zip(rows, ends, strict=True):
        zeros = np.roots(np.trim_zeros(powers[::-1], "f")) if any(powers) else np.empty(0)
        real = [begin + zero.real for zero in zeros if abs(zero.imag) <= 1e-12 * abs(zero) and zero.real > 0.0]
        inside = [s for s in real if s <= end]
        if inside:
            return float(min(inside))
    return math.inf
