"""Kernel: t statistics of an outlier, a step, a kick and a corner at every sample, from the scores of a smoother.

Runs as written or compiled (`stickslip.compute.compile`).
"""

from stickslip.compute.arrays import Array, Integers

OUTLIER, STEP, KICK, CORNER = 0, 1, 2, 3  # rows of the statistics
ENDS = 4  # samples at either end of a piece that are not searched for steps, kicks and corners
TRIED = 9.0  # square of the t statistic of a step or a kick above which the templates of kicks are tried


def find_statistics(
    scores: Array,
    steps: Array,
    kicks: Array,
    variance: Array,
    durations: Integers,
    sharpest: float,
    interval: float,
    span: tuple[int, int],
    squares: Array,
    sizes: Array,
    widths: Integers,
) -> None:
    """Write the squares of the t statistics of the samples span[0]..span[1] - 1 of a piece.

    The score of a step over some samples is the mean of their scores; that of a kick, after which the mass soon moves
    with the belt again at ``sharpest`` acceleration at most, is a sum weighted by ``kicks``, whose variances, relative
    to a step, are ``variance``.  ``sizes`` and ``widths`` receive those of the best outlier, step and kick.
    """
    n = scores.shape[0]
    for i in range(span[0], span[1]):
        outlier, step, kick, corner = 0.0, 0.0, 0.0, 0.0
        if scores[i, 1] > 0.0:
            sizes[OUTLIER, i] = scores[i, 0] / scores[i, 1]
            outlier = scores[i, 0] * sizes[OUTLIER, i]
        all_known = scores[i, 3] > 0.0 and scores[i, 5] > 0.0 and scores[i, 7] > 0.0
        if all_known and ENDS <= i < n - ENDS:
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
