"""Kernel: what the scores of a smoother say of an outlier, a step, a kick and a corner at every sample.

Runs as written or compiled (`stickslip.compute.compile`).
"""

from stickslip.compute.arrays import Array, Integers

OUTLIER, STEP, KICK, CORNER = 0, 1, 2, 3  # rows of the statistics
ENDS = 4  # samples at either end of a piece at which neither step, kick nor corner is looked for
# Of the square of a t statistic of a step or a kick that begins at a sample: the templates of kicks that are over in
# some samples are tried where it is more.  They look alike, so that below nothing reaches the threshold of a kick.
TRIED = 9.0


def find_statistics(
    scores: Array,
    steps: Array,
    kicks: Array,
    variance: Array,
    durations: Integers,
    sharpest: float,
    interval: float,
    own: tuple[int, int],
    squares: Array,
    sizes: Array,
    widths: Integers,
) -> None:
    """Write the squares of the t statistics of the samples own[0]..own[1] - 1 of a piece of n samples.

    The score of a step of the position that takes some samples is the mean of the scores of these; that of a kick after
    which the mass moves with the belt again is a weighted sum, for the position moves by a parabola.

    scores: Of `processing.kalman.white_jerk.smooth_piece`.
    steps: Variance of the score of a step at once over that of the sum of 1, 2, ... of them.
    kicks, variance, durations: Weights of the scores of kicks that are over after so many samples, and likewise their
        variance.
    sharpest: The acceleration by which a kick may be over.
    interval: Of the samples.
    squares: Of outlier, step, kick and corner.
    sizes, widths: Of the best outlier, step and kick; samples that the step takes.
    """
    n = scores.shape[0]
    for i in range(own[0], own[1]):
        outlier, step, kick, corner = 0.0, 0.0, 0.0, 0.0
        if scores[i, 1] > 0.0:
            sizes[OUTLIER, i] = scores[i, 0] / scores[i, 1]
            outlier = scores[i, 0] * sizes[OUTLIER, i]
        known = scores[i, 3] > 0.0 and scores[i, 5] > 0.0 and scores[i, 7] > 0.0
        if known and ENDS <= i < n - ENDS:
            sizes[KICK, i] = scores[i, 4] / scores[i, 5]
            kick = scores[i, 4] * sizes[KICK, i]
            corner = scores[i, 6] * scores[i, 6] / scores[i, 7]
            score, best, width = 0.0, 0.0, 1
            for d in range(1, min(steps.size, n - ENDS - i) + 1):
                score += scores[i + d - 1, 2]
                if score * score * steps[d - 1] > step:
                    step, best, width = score * score * steps[d - 1], score, d
            step /= scores[i, 3]
            sizes[STEP, i] = best * steps[width - 1] * width / scores[i, 3]
            widths[i] = width
        if max(step, kick) >= TRIED:
            for k in range(durations.size):
                d = durations[k]
                if i + d > n - ENDS:
                    break
                score = 0.0
                for j in range(d):
                    score += kicks[k, j] * scores[i + j, 2]
                information = variance[k] * scores[i, 3]
                square = score * score / information
                size = 2 * score / (information * d * interval)
                if square > kick and abs(size) <= sharpest * d * interval:
                    kick = square
                    sizes[KICK, i] = size
        squares[OUTLIER, i], squares[STEP, i], squares[KICK, i], squares[CORNER, i] = outlier, step, kick, corner


def find_largest(squares: Array, ends: Integers, near: Array) -> None:
    """Write the largest square of each kind, (4, n), in the spans ends[k, 0]..ends[k, 1] - 1 into ``near``, (k, 4)."""
    for k in range(ends.shape[0]):
        for kind in range(4):
            most = 0.0
            for i in range(ends[k, 0], ends[k, 1]):
                most = max(most, squares[kind, i])
            near[k, kind] = most
