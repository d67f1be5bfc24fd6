"""Kernel: one pass over the positions for steps of zero, two or three times the usual length.

Runs as written or compiled (`stickslip.compute.compile`).
"""

from stickslip.compute.arrays import Array

WIDE = 7  # steps on either side that determine the usual one
# The nearest of those steps, and how far the parabola through the means of near and far ones lies beyond the near mean
# at the compared step: 14/3 / (63/2 - 14/3), from the mean squares of 1 to 3 and of 4 to 7 steps.
BESIDE, BEYOND = 3, 28 / 161
# Of the usual step: largest scatter of the steps around a compared one.  Two lost frames among them make 0.25, the
# middle of a slip of 16 samples 0.35, a mass that starts or stops 0.7.
EVEN = 0.25
BY_NOISE = 2.75  # of the variance of a step by noise: scatter of 12 steps, in all but one of a thousand places
BEND_NOISE = 37 / 144  # variance of the difference of the near and the far mean, in variances of a position
MEAN_NOISE = 6 / WIDE  # three standard deviations by noise of the difference of two means of `WIDE` steps
MOST_NOISE = 6.0  # standard deviations of a position: largest difference of a step by noise


def count_steps(x: Array, noise: float, least: float, near: float, sums: Array) -> None:
    """Compare every step of the position with the usual one of its neighbours.

    The usual step is the mean of ``WIDE`` steps on either side without the largest and the smallest.  Steps are not
    compared where these differ among themselves, or one turns back or is longer than two lost frames make it: at a
    corner of the motion, or in a slip of few samples, a long step is not a sign of a lost frame.  Steps are clear of
    ``noise``, m, above ``least``, m, and must lie within ``near`` usual steps of a multiple.

    Added to ``sums``: [0] number of clear steps, [1:5] those of two, three, zero and minus one usual steps; of others
    [5] the cubes of the excess over the usual step, [6] the cubes of the usual step, [7] their number, [8] the
    excess, [9] its squares, and [10] the squared bend times the usual step, without the contribution of noise.
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
        # In the middle of a slip of 16 samples a step is 1.4 times the mean of its neighbours, as a parabola shows.
        inner = (x[i] - x[i - BESIDE] + x[i + 1 + BESIDE] - x[i + 1]) / (2 * BESIDE)
        outer = (x[i - BESIDE] - x[i - WIDE] + x[i + 1 + WIDE] - x[i + 1 + BESIDE]) / (2 * (WIDE - BESIDE))
        more, bent = step - size, step - abs(inner + BEYOND * (inner - outer))
        if size >= least:
            if abs(bent) < abs(more):  # the smaller residual of mean and parabola
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
