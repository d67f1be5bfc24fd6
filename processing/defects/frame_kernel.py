"""Kernel: one pass over the positions for steps of twice, or none of, the usual length.

Runs as written or compiled (`stickslip.compute.compile`).
"""

from stickslip.compute.arrays import Array

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


def count_steps(x: Array, noise: float, least: float, near: float, sums: Array) -> None:
    """Compare every step of the position with the usual one of its neighbours.

    The usual step is the mean of ``WIDE`` steps on either side, the largest and the smallest left out.  There is none
    where these steps differ among themselves, or one of them turns back or is longer than two lost frames make it: at a
    corner of the motion, or in a slip of few samples, a long step is no sign of a lost frame.

    x: Positions, m.
    noise, least: Standard deviation of one position, and the usual step above which a single step is clear of noise, m.
    near: How near a multiple of the usual step a step must lie, in usual steps.
    sums: Added to: number of clear steps; of those twice and three times the usual one, of those of none and of minus
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
