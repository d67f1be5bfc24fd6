"""The filter and smoother of any order: one dense solution, and readings that are next to free of noise."""

import math

import numpy as np
import pytest

from processing.kalman import motion_kernel
from processing.kalman.motion_kernel import LINE, predict, update
from processing.kalman.stick_slip import SNAP

NOISE = 1e-22  # variance of a reading over that of the position that is expected


def states(count=200):
    """Return covariances whose velocity follows from the position: a reading leaves of p11 its own noise alone."""
    rng = np.random.default_rng(3)
    for p00, slope in 10 ** rng.uniform(-8, 0, (count, 2)):
        p = np.zeros(16)
        p[0], p[1], p[5] = p00, slope * p00, slope**2 * p00
        yield p


@pytest.mark.parametrize("alive", [SNAP, LINE])
def test_a_variance_stays_one_beside_readings_without_noise(alive):
    """Rounding left p11 negative; variances of a landing at 6 samples a slip were negative, and their logarithm NaN."""
    for before in states():
        r = NOISE * before[0]
        after = before.copy()
        update(SNAP, alive, 0.0, 1.0 / (before[0] + r), r, np.zeros(4), after)
        assert after[0] > 0
        assert after[5] >= before[5] * NOISE * (1 - 1e-12)
        assert after[1] ** 2 <= after[0] * after[5] * (1 + 1e-9)
        for h in (1e-4, 1e-2, 1.0):
            later = after.copy()
            predict(SNAP, LINE, h, 0.0, 0.0, np.zeros(4), later)
            assert later[0] > 0


@pytest.mark.parametrize("alive", [SNAP, LINE])
def test_the_velocity_keeps_its_exact_variance_where_rounding_does_not_count(alive):
    for p00, p01, p11, r in ((2.0, 0.5, 3.0, 0.7), (1e-6, 3e-5, 2e-3, 1e-9)):
        p = np.zeros(16)
        p[0], p[1], p[5] = p00, p01, p11
        update(SNAP, alive, 0.0, 1.0 / (p00 + r), r, np.zeros(4), p)
        assert p[5] == pytest.approx(p11 - p01**2 / (p00 + r), rel=1e-14)


def noise_of(order, h, q):
    """Return Q of the n-fold integral of white noise by Gauss-Legendre quadrature, exact for its polynomial."""
    node, weight = np.polynomial.legendre.leggauss(order)
    left = h * (1 - node) / 2
    response = np.array([left ** (order - 1 - i) / math.factorial(order - 1 - i) for i in range(order)])
    return q * (response * weight * h / 2) @ response.T


@pytest.mark.parametrize("order", [2, 3, 4, 5])
def test_the_smoother_of_every_order_is_the_conditional_normal_distribution(order):
    """Mean and covariance of the whole path given all readings, by one dense solution; a corner stands within."""
    rng = np.random.default_rng(order)
    time = np.cumsum(rng.uniform(0.1, 0.3, 12))
    corner = time[6] + 0.3 * (time[7] - time[6])
    q, u, r = 0.7, 0.2, 0.4
    keep, jump = min(2, order), 0.3 * np.arange(1.0, order + 1)
    edges = np.insert(time, 7, corner)
    mean, covariances = [np.zeros(order)], [np.diag(np.linspace(2.0, 1.0, order))]
    steps = []
    for h in np.diff(edges):
        carry = np.array(
            [[h ** (j - i) / math.factorial(j - i) if j >= i else 0 for j in range(order)] for i in range(order)]
        )
        steps.append(
            (
                carry,
                noise_of(order, h, q),
                u * np.array([h ** (order - i) / math.factorial(order - i) for i in range(order)]),
            )
        )
    blocks = np.zeros((13, 13, order, order))
    blocks[0, 0] = covariances[0]
    for k, (carry, noise, drift) in enumerate(steps):
        state, spread = carry @ mean[-1] + drift, carry @ blocks[k, k] @ carry.T + noise
        before = [carry @ blocks[k, m] for m in range(k + 1)]
        if k == 6:  # the step ends at the corner
            gone = np.diag((np.arange(order) < keep).astype(float))
            state, spread, before = gone @ state, gone @ spread @ gone + np.diag(jump), [gone @ own for own in before]
        mean.append(state)
        blocks[k + 1, k + 1] = spread
        for m in range(k + 1):
            blocks[k + 1, m], blocks[m, k + 1] = before[m], before[m].T
    prior = blocks.transpose(0, 2, 1, 3).reshape(13 * order, 13 * order)
    seen = [order * k for k in range(13) if k != 7]
    position = rng.standard_normal(12)
    gain = prior[:, seen] @ np.linalg.inv(prior[np.ix_(seen, seen)] + r * np.eye(12))
    flat = np.concatenate(mean)
    smoothed, left = flat + gain @ (position - flat[seen]), prior - gain @ prior[seen]
    n = order
    process = motion_kernel.Process(
        *(np.array([value]) for value in (q, u, r)), np.array([n]), np.array([keep]), jump[None]
    )
    state, stored, found = (
        np.zeros(motion_kernel.state_size(n)),
        np.empty((12, motion_kernel.stored_size(n))),
        np.empty((6, 12)),
    )
    diagonal = n
    for d in range(n):
        state[diagonal] = covariances[0][d, d]
        diagonal += n - d
    state[-1] = time[0]
    label, at, kind = np.zeros(12, np.uint8), np.array([corner]), np.zeros(1, np.uint8)
    shape = (0.0,) * n
    motion_kernel.forward(shape, time, position, label, at, kind, process, state, stored)
    sums = np.zeros((1, 4)), np.zeros((1, n, 2))
    motion_kernel.backward(shape, time, label, at, kind, process, stored, 12, found, 0, *sums, np.empty((0, 2 + 2 * n)))
    for d in range(min(n, 3)):
        own = [k + d for k in seen]
        assert found[d] == pytest.approx(smoothed[own], abs=1e-10 * np.abs(smoothed).max())
        assert found[3 + d] == pytest.approx(left[own, own], rel=1e-9)


def prior_of(time, order, q, first):
    """Return the covariance of the positions at ``time`` of a motion that starts with the covariance ``first``."""
    carried = [np.eye(order)]
    covariance = [first]
    for h in np.diff(time):
        step = np.array(
            [[h ** (j - i) / math.factorial(j - i) if j >= i else 0 for j in range(order)] for i in range(order)]
        )
        carried.append(step)
        covariance.append(step @ covariance[-1] @ step.T + noise_of(order, h, q))
    found = np.empty((time.size, time.size))
    for i, own in enumerate(covariance):
        row = own[0]
        for k in range(i, time.size):
            if k > i:
                row = carried[k] @ row
            found[i, k] = found[k, i] = row[0]
    return found


def scored(time, position, q, r, first):
    """Return the scores of all samples of a motion of white jerk."""
    n = time.size
    process = motion_kernel.Process(
        *(np.array([value]) for value in (q, 0.0, r)), np.array([3]), np.array([3]), np.zeros((1, 3))
    )
    state, stored, scores = np.zeros(10), np.empty((n, 11)), np.empty((n, 8))
    state[[3, 6, 8]], state[-1] = np.diag(first), time[0]
    none = np.zeros(n, np.uint8), np.empty(0), np.empty(0, np.uint8)
    motion_kernel.forward((0.0,) * 3, time, position, *none, process, state, stored)
    sums = np.zeros((1, 4)), np.zeros((1, 3, 2))
    motion_kernel.backward((0.0,) * 3, time, *none, process, stored, 0, np.empty((6, 0)), 0, *sums, scores)
    return scores


def test_scores_are_those_of_generalised_least_squares():
    """Of an outlier, and of a step of x, v and a before every sample: estimate and variance, by one dense solution."""
    rng = np.random.default_rng(5)
    time, q, r, first = np.cumsum(rng.uniform(0.1, 0.3, 12)), 0.7, 0.4, np.diag([2.0, 1.5, 1.0])
    position = rng.standard_normal(12)
    inverse = np.linalg.inv(prior_of(time, 3, q, first) + r * np.eye(12))
    found = scored(time, position, q, r, first)
    for i in range(12):
        since = np.maximum(time - time[i], 0.0)
        after = np.arange(12) >= i
        changes = [np.arange(12) == i, *(after * since**d / math.factorial(d) for d in range(3))]
        for k, change in enumerate(changes):
            assert found[i, 2 * k] == pytest.approx(change @ inverse @ position, rel=1e-9, abs=1e-12)
            assert found[i, 2 * k + 1] == pytest.approx(change @ inverse @ change, rel=1e-9)


def test_a_missing_reading_is_one_that_was_not_taken():
    rng = np.random.default_rng(6)
    time, q, r, first = np.cumsum(rng.uniform(0.1, 0.3, 14)), 0.7, 0.4, np.diag([2.0, 1.5, 1.0])
    position = rng.standard_normal(14)
    missing = np.array([3, 4, 9])
    position[missing] = np.nan
    known = np.delete(np.arange(14), missing)
    found = scored(time, position, q, r, first)
    assert found[known] == pytest.approx(scored(time[known], position[known], q, r, first), rel=1e-9)
    assert not found[missing, :2].any()
