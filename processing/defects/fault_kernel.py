"""Kernels: one pass over the positions for readings out of line, for values that are held, and for odd steps.

Every function runs as written or compiled (`daq.base.compute.compile`).  Each writes as many places as ``found`` has
rows and returns how many there are.
"""

from daq.base.compute.arrays import Array, Integers

REACH = 4  # readings that `find_outliers` looks at on either side of one
# Times the third difference of readings on a parabola: how far the next one may lie off it.  Chosen: towards a landing
# the third difference of a sine falls, so 1 would do in the limit of many samples; with 0.75 landings of slips of 10
# samples are called faults seven times as often, and with 2 each of two equal faults side by side excuses the other.
PARABOLA = 1.5
NEAR = 32  # samples on either side that say how much readings scatter there
WIDE = 7  # steps on either side that say how long one usually is
# Of those the nearest, and how far the parabola through the means of the near and the far ones lies beyond the near
# mean at the compared step: 14/3 / (63/2 - 14/3), from the mean squares of 1 to 3 and of 4 to 7 steps.
BESIDE, BEYOND = 3, 28 / 161
# Of the usual step: the most that the steps beside a compared one scatter by.  Two lost frames among them make 0.25, a
# mass that starts or stops 0.7, the middle of a slip of 16 samples 0.35.  At half, two lost frames of 14 steps exclude
# each other; at twice, the middles of slips of 12 to 20 samples are up to half of all frames "lost", and none is.
EVEN = 0.25
# Of the variance of a step by noise: what 12 steps scatter by at most, in all but one of a thousand places.
BY_NOISE = 2.75
BEND_NOISE = 37 / 144  # variance of the difference of the near and the far mean, in variances of a position
MEAN_NOISE = 6 / WIDE  # three standard deviations by noise of the difference of two means of `WIDE` steps
MOST_NOISE = 6.0  # standard deviations of a position that a step differs by from what it would be without noise


def median_of_five(a: float, b: float, c: float, d: float, e: float) -> float:
    """Return the middle one of five numbers."""
    low, high = max(min(a, b), min(d, e)), min(max(a, b), max(d, e))
    return max(min(low, high), min(max(low, high), c))


def find_outliers(x: Array, limit: float, share: float, found: Integers, size: Array) -> int:
    """Find single readings out of line by more than ``limit``, m.

    A reading is out of line where it differs from the median of five, and from the lines through its neighbours on
    either side: at a turning point and in the tip of a triangle those of one side agree.  It must also exceed the bend
    of the motion beside it (twice the smaller one and 0.4 of the larger one; the top of a parabola, and a spike two
    samples from another, have half of it; 0.3 where one side is straight), and most differences from the median nearby
    must be below ``share`` of its own, so that a stretch of larger noise has none.

    Where the motion beside it bends by more than ``limit`` from sample to sample, as in slips of 10 to 50 samples, a
    line says little: there the reading must be off the parabolas of both sides too (`on_parabola`).  A landing is on
    one of them, since the acceleration changes there, and position and velocity do not.

    Parameters
    ----------
    x : array of shape (n + 2 REACH,)
        Positions, m, with `REACH` more on either side.
    limit, share : float
        As above.
    found, size : array of shape (k,)
        Get the samples, 0 to n - 1, and by how much they are out of line, m.
    """
    count = 0
    n = x.size - 2 * REACH
    for i in range(REACH, n + REACH):
        here = x[i]
        # These first: they cost least, and reject nearly every reading.  Of two opposite spikes with a sound reading
        # between them each lies on the line through the other: a side agrees if the line past its second reading does.
        line, past = abs(here - 2 * x[i - 1] + x[i - 2]), abs(here - 1.5 * x[i - 1] + 0.5 * x[i - 3])
        if line <= limit and past <= 2 * limit:
            continue
        line, past = abs(here - 2 * x[i + 1] + x[i + 2]), abs(here - 1.5 * x[i + 1] + 0.5 * x[i + 3])
        if line <= limit and past <= 2 * limit:
            continue
        off = abs(here - median_of_five(x[i - 2], x[i - 1], here, x[i + 1], x[i + 2]))
        if off <= limit:
            continue
        before, behind = abs(x[i - 1] - 2 * x[i - 2] + x[i - 3]), abs(x[i + 1] - 2 * x[i + 2] + x[i + 3])
        less, more = min(before, behind), max(before, behind)
        if off <= 2 * less + (0.3 if less <= limit else 0.4) * more:
            continue
        if more > limit and (on_parabola(x, i, -1, limit) or on_parabola(x, i, 1, limit)):
            continue
        quiet = total = 0
        for j in range(max(i - NEAR, REACH - 1), min(i + NEAR, n + REACH) + 1):
            near = abs(x[j] - median_of_five(x[j - 2], x[j - 1], x[j], x[j + 1], x[j + 2]))
            quiet += near < share * off
            total += 1
        if 2 * quiet <= total:
            continue
        if count < found.size:
            found[count], size[count] = i - REACH, off
        count += 1
    return count


def on_parabola(x: Array, i: int, way: int, limit: float) -> bool:
    """Return whether reading i lies on the parabola through three neighbours, to ``limit`` and its own error.

    ``way`` is -1 for the neighbours before, 1 for those behind.  The parabola errs by about the third difference.
    Where that is larger than the second, there is a fault among the neighbours, and nothing lies on their parabola.
    """
    a, b, c, d = x[i + way], x[i + 2 * way], x[i + 3 * way], x[i + 4 * way]
    bend, error = abs(a - 2 * b + c), abs(a - 3 * b + 3 * c - d)
    return bool(error < bend and abs(x[i] - 3 * a + 3 * b - c) <= limit + PARABOLA * error)


def find_held(x: Array, least: int, jump: float, found: Integers) -> int:
    """Find runs of at least ``least`` equal values beside a change of more than ``jump``, m: first and last, (k, 2)."""
    count = first = 0
    for i in range(1, x.size):
        if x[i] == x[i - 1]:
            continue
        if i - first >= least and first > 0 and max(abs(x[i] - x[i - 1]), abs(x[first] - x[first - 1])) > jump:
            if count < found.shape[0]:
                found[count, 0], found[count, 1] = first, i - 1
            count += 1
        first = i
    return count


def count_steps(x: Array, noise: float, least: float, near: float, sums: Array) -> None:
    """Compare every step of the position with the usual one of its neighbours.

    The usual step is the mean of ``WIDE`` steps on either side, the largest and the smallest left out.  There is none
    where these steps differ among themselves, or one of them turns back or is longer than two lost frames make it: at a
    corner of the motion, or in a slip of few samples, a long step is no sign of a lost frame.

    Parameters
    ----------
    x : array of shape (n,)
        Positions, m.
    noise, least : float
        Standard deviation of one position, and the usual step above which a single step is clear of noise, m.
    near : float
        How near a multiple of the usual step a step must lie, in usual steps.
    sums : array of shape (11,)
        Added to: number of clear steps; of those twice and three times the usual one, of those of none and of minus
        one; and of the steps that are not clear the sum of cubes of what they exceed the usual one by, the sum of its
        own cubes, their number, and the sums of the excess and of its squares; and of the square by which the near
        steps differ from the far ones, times the usual one, without what noise makes of it.
    """
    for i in range(WIDE, x.size - WIDE - 1):
        low = high = x[i] - x[i - 1]
        squares = 0.0
        total = x[i + WIDE + 1] - x[i + 1] + x[i] - x[i - WIDE]
        for j in range(i - WIDE, i + WIDE + 1):
            if j != i:
                step = x[j + 1] - x[j]
                low, high = min(low, step), max(high, step)
                squares += step**2
        usual = (total - low - high) / (2 * WIDE - 2)
        size = abs(usual)
        if size < noise:
            continue
        scatter = (squares - low**2 - high**2) / (2 * WIDE - 2) - usual**2
        if scatter > (EVEN * size) ** 2 + BY_NOISE * 2 * noise**2:
            continue
        turn = abs(x[i + WIDE + 1] - x[i + 1] - x[i] + x[i - WIDE]) / WIDE
        if turn > EVEN * size + MEAN_NOISE * noise:  # the mean steps of the two sides
            continue
        back, ahead = (low, high) if usual > 0 else (-high, -low)
        if back < -near * size - MOST_NOISE * noise or ahead > (3 + near) * size + MOST_NOISE * noise:
            continue
        step = (x[i + 1] - x[i]) * (1.0 if usual > 0 else -1.0)
        # At the middle of a slip of 16 samples a step is 1.4 times the mean of those beside it; a parabola shows that.
        inner = (x[i] - x[i - BESIDE] + x[i + 1 + BESIDE] - x[i + 1]) / (2 * BESIDE)
        outer = (x[i - BESIDE] - x[i - WIDE] + x[i + 1 + WIDE] - x[i + 1 + BESIDE]) / (2 * (WIDE - BESIDE))
        more, bent = step - size, step - abs(inner + BEYOND * (inner - outer))
        if size >= least:
            if abs(bent) < abs(more):  # what both of them leave
                more = bent
            sums[0] += 1
            sums[1] += abs(more - size) < near * size
            sums[2] += abs(more - 2 * size) < near * size
            sums[3] += abs(more + size) < near * size
            sums[4] += abs(more + 2 * size) < near * size
        elif abs(bent) < MOST_NOISE * noise + 3 * size:
            sums[5] += bent**3
            sums[6] += size**3
            sums[7] += 1
            sums[8] += bent
            sums[9] += bent**2
            sums[10] += size * ((inner - outer) ** 2 - BEND_NOISE * noise**2)
