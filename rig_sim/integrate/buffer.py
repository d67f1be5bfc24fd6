"""The kernels' working buffer: one flat list or array of numbers, and what stands where in it."""

from typing import Any

Buffer = Any  # list of floats (interpreted) or one-dimensional float64 array (compiled)

ORDER = 28  # of the Taylor series: 24 to 32 cost about the same per unit of time
# The working buffer, one and flat (compiled code counts the references of every array it hands on): five series ...
W = 0  # w
P = ORDER + 2  # p
Q = 2 * P  # 1/q0 of the hyperbola's denominator; the square of w on a measured curve
D = 3 * P  # the hyperbola's fall
U = 4 * P  # the drive
# ... and single numbers: steps taken and allowed, events in a row without time passing, the unit of time of the last
# Taylor step, the closed form's damping and acceleration at its start and its solution at its exit, how much later than
# its duration says a phase was left, what compensated summation holds below the last digit of t, p and w, and of
# the last Taylor step on a measured curve the piece and the number of terms
(
    STEPS,
    STEPS_ALLOWED,
    RAPID,
    TIME_SCALE,
    ZETA,
    START,
    EXIT,
    EXIT_S,
    EXIT_E,
    LATE,
    CARRY,
    P_REST,
    W_REST,
    PIECE,
    DEGREE,
) = range(5 * P, 5 * P + 15)
WORK = 5 * P + 15


def new_work(max_steps: int = 1_000_000, *, compiled: bool = False) -> Buffer:
    """Return the kernels' working buffer: a list for interpreted calls, a float64 array for compiled ones.

    A step is one closed-form phase or one Taylor step; they are counted over the buffer's life, and a kernel that would
    exceed ``max_steps`` ends in the outcome `step limit`.
    """
    work: Buffer
    if compiled:
        import numpy

        work = numpy.zeros(WORK)
    else:
        work = [0.0] * WORK
    work[STEPS_ALLOWED] = float(max_steps)
    work[TIME_SCALE] = 1.0
    return work
