"""The first root of a polynomial on [0, xi_end], found for certain: events of a motion known by its Taylor series.

Leading zero coefficients (a phase begins on its edge, often with a derivative of 0) are divided out, so that the start
is never found again.  Most steps stray too little from their first term to reach the level.  Otherwise the step is
searched with a bound on the second derivative: a piece is passed only when the bound excludes a root, and a root is
polished only on a piece where the bound proves the polynomial monotone; pieces are halved until one of the two holds.
"""

from rig_sim.integrate.newton import EPS, polish_step
from rig_sim.integrate.work import Series

SHORTEST_PIECE = 1e-9  # share of a step: over it a parabola stays within rounding
PIECES = 300  # three times the halvings down to the shortest piece on both sides of a tangency


def value(c: Series, degree: int, xi: float) -> float:
    """Return the polynomial of this degree, whose coefficients begin at ``c[0]``, at ``xi``."""
    total = c[degree]
    for j in range(degree - 1, -1, -1):
        total = total * xi + c[j]
    return float(total)


def deflate(c: Series, degree: int, zeros: int, level: float, xi: float) -> tuple[float, float]:
    """Return value and slope of (polynomial - level) / xi^zeros, whose ``zeros`` lowest coefficients vanish."""
    total = c[degree]
    slope = 0.0
    for j in range(degree - 1, zeros - 1, -1):
        slope = slope * xi + total
        total = total * xi + c[j]
    if zeros == 0:
        total -= level
    return total, slope


def bound_spread(c: Series, degree: int, xi: float) -> float:
    """Return a bound on the distance of a polynomial from its first term over [0, xi]."""
    even = odd = 0.0
    square = xi * xi
    last = degree
    if degree % 2 == 1:
        odd = abs(c[last])
        last -= 1
    for j in range(last, 0, -2):
        even = even * square + abs(c[j])
        odd = odd * square + abs(c[j - 1])
    return float((even * xi + odd) * xi)


def bound_rise(c: Series, degree: int, zeros: int, side: int, xi: float) -> float:
    """Return a bound on the rise of ``side`` times the deflated polynomial above its first term over [0, xi]."""
    even = odd = 0.0  # twice the terms above 0; powers apart: two chains of sums that do not wait for each other
    square = xi * xi
    last = degree
    if (degree - zeros) % 2 == 1:
        odd = side * c[last] + abs(c[last])
        last -= 1
    for j in range(last, zeros, -2):
        even = even * square + (side * c[j] + abs(c[j]))
        odd = odd * square + (side * c[j - 1] + abs(c[j - 1]))
    return float(0.5 * (even * xi + odd) * xi)


def survey(c: Series, degree: int, zeros: int, level: float, xi: float) -> tuple[float, float, float]:
    """Return value and slope as `deflate`, and a bound on the second derivative over [0, xi]."""
    total = c[degree]
    slope = 0.0
    n = degree - zeros
    bound = n * (n - 1.0) * abs(total)
    for j in range(degree - 1, zeros + 1, -1):
        n = j - zeros
        slope = slope * xi + total
        total = total * xi + c[j]
        bound = bound * xi + n * (n - 1.0) * abs(c[j])
    for j in range(zeros + 1, zeros - 1, -1):
        slope = slope * xi + total
        total = total * xi + c[j]
    if zeros == 0:
        total -= level
    return total, slope, bound


def first_root(c: Series, degree: int, level: float, side: int, xi_end: float) -> float:
    """Return the first xi in [0, xi_end] where the polynomial leaves through ``level``, or -1.

    ``side`` +1: the inside is below the level, -1: above it.  A start outside, or on the level moving out, gives 0.
    """
    zeros = 0
    lead = side * (level - c[0])
    if lead < 0.0:
        return 0.0
    if lead == 0.0:
        zeros = 1
        while zeros < 4 and c[zeros] == 0.0:
            zeros += 1
        lead = -side * c[zeros]
        if lead < 0.0:
            return 0.0
        if lead == 0.0:
            return -1.0
    if lead > bound_rise(c, degree, zeros, side, xi_end):
        return -1.0
    rounding = EPS * (lead if zeros > 0 else max(abs(level), abs(c[0])))
    total, slope, bound = survey(c, degree, zeros, level, xi_end)
    start = 0.0
    end = xi_end
    margin = lead
    for _i in range(PIECES):
        h = end - start
        rest = -side * total
        fall = -side * slope
        # below rounding of the polynomial its sign at the piece's end is all there is to know
        monotone = abs(fall) > bound * h or h <= SHORTEST_PIECE * xi_end or bound * h * h <= rounding
        if rest <= 0.0 and monotone:
            guess = start + h * margin / (margin - rest)  # chord's root; far better than the middle of a short piece
            return polish(c, degree, zeros, level, side, start, end, guess)
        if rest > 0.0 and (monotone or min(rest, margin) > 0.125 * bound * h * h):
            if end >= xi_end:
                return -1.0
            start = end
            end = min(end + 2.0 * h, xi_end)
            margin = rest
        else:
            end = start + 0.5 * h
        total, slope = deflate(c, degree, zeros, level, end)
    # only for a polynomial that stays at its level for the whole step: its end decides
    total, slope = deflate(c, degree, zeros, level, xi_end)
    if side * total < 0.0:
        return -1.0
    return polish(c, degree, zeros, level, side, start, xi_end, 0.5 * (start + xi_end))


def polish(
    c: Series, degree: int, zeros: int, level: float, side: int, inside: float, outside: float, xi: float
) -> float:
    """Return the root between ``inside`` and ``outside``: Newton from ``xi``, kept in its bracket."""
    for _i in range(100):
        total, slope = deflate(c, degree, zeros, level, xi)
        xi, settled, inside, outside = polish_step(xi, total, slope, side, inside, outside)
        if settled:
            return xi
    return xi
