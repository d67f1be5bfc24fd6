"""One step of Newton's method kept in a bracket: the rule every event's root is polished with."""

EPS = 2.0**-52


def newton_step(tau: float, error: float, slope: float, inside: float, outside: float) -> tuple[float, bool]:
    """Return the next iterate, and whether it is the last: the root to two ulp, or an empty bracket.

    ``error`` and ``slope`` are the function and its derivative at ``tau``; the root lies between ``inside`` and
    ``outside`` (the larger), one of which is ``tau`` already.  A step that would leave the bracket goes to its middle,
    unless it is within rounding of ``tau``: there the bracket's sides are rounding too.
    """
    following = inside
    if slope != 0.0:
        following = tau - error / slope
        if abs(following - tau) <= 2.0 * EPS * tau:
            return tau, True
    if not inside < following < outside:
        following = 0.5 * (inside + outside)
    return following, abs(following - tau) <= 2.0 * EPS * following or not inside < following < outside


def polish_step(
    tau: float, error: float, slope: float, side: int, inside: float, outside: float
) -> tuple[float, bool, float, float]:
    """Return `newton_step` and the bracket made narrower: ``side`` times the error is above 0 outside."""
    if error == 0.0:
        return tau, True, inside, outside
    if side * error > 0.0:
        outside = tau
    else:
        inside = tau
    following, settled = newton_step(tau, error, slope, inside, outside)
    return following, settled, inside, outside
