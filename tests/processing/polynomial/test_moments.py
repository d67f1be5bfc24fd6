"""Savitzky-Golay in whole numbers: equal to the convolution, blind to offsets, equal in pieces and as a whole."""

import time as clock
from fractions import Fraction

import numpy as np
import pytest

from daq.compute.compile import compiled
from processing.polynomial import moments, savgol
from processing.polynomial.gram import coefficients


def counts(motion, pitch=7.67e-6, duration=5.0):
    return np.floor(motion(5, duration, jitter=0.0).x / pitch).astype(np.int64)


def slid(count, window, order):
    values = np.empty((3, count.size))
    run = compiled(moments.slide, savgol.KERNELS)
    run(count, window // 2, moments.power_weights(window, order), moments.sums(window), values)
    return values[:, window // 2 : -(window // 2)]


@pytest.mark.parametrize("order", [0, 1, 2, 3, 4])
@pytest.mark.parametrize("window", [5, 7, 21, 41, 301, 1001, 3001])
def test_moments_carry_the_gram_weights(window, order):
    j = np.arange(-(window // 2), window // 2 + 1.0)
    found = moments.power_weights(window, order) @ np.array([j**p for p in range(5)])
    true = coefficients(window, order)
    for d in range(3):
        assert np.abs(found[d] - true[d]).max() <= 4e-15 * max(np.abs(true[d]).max(), 1e-30)


@pytest.mark.parametrize(("window", "order"), [(5, 2), (41, 4), (301, 3), (975, 4), (1501, 4), (3001, 4)])
def test_sliding_moments_give_the_exact_fit(motion, window, order):
    count = counts(motion)
    found = slid(count, window, order)
    half = window // 2
    weights = moments.power_weights(window, order)
    for i in (half, count.size // 2, count.size - half - 1):
        own = [int(c) - int(count[i]) for c in count[i - half : i + half + 1]]
        for d in range(3):
            exact = sum(
                Fraction(float(weights[d, p])) * sum(c * j**p for j, c in enumerate(own, -half)) for p in range(5)
            )
            assert abs(Fraction(float(found[d, i - half])) - exact) <= 1e-12 * max(abs(exact), Fraction(1, 10**6))


@pytest.mark.parametrize("offset", [2**31, 2**60, 2**62, -(2**62)])
@pytest.mark.parametrize("window", [41, 3001])
def test_an_offset_of_the_count_changes_nothing(motion, offset, window):
    count = counts(motion)
    assert np.array_equal(slid(count + offset, window, 4), slid(count, window, 4))


@pytest.mark.parametrize(("window", "order"), [(41, 4), (7, 3), (31, 6), (1501, 4), (3001, 4)])
@pytest.mark.parametrize("sign", [1, -1])
def test_a_part_of_the_record_gives_what_the_whole_gives_bit_for_bit(motion, window, order, sign):
    count, pitch = counts(motion), sign * 7.67e-6
    half, begin, end = window // 2, 500, 500 + window + 700
    whole, part = np.empty((3, count.size)), np.empty((3, end - begin))
    savgol.inside(count * pitch, window, order, savgol.Counted(sign * count, abs(pitch)), whole)
    own = count[begin:end]
    savgol.inside(own * pitch, window, order, savgol.Counted(sign * own, abs(pitch)), part)
    assert np.array_equal(part[:, half:-half], whole[:, begin + half : end - half])


def test_counts_too_fast_for_whole_numbers_take_the_convolution(motion):
    count = counts(motion, 1e-8)
    time = np.arange(count.size) * 1e-3
    found = savgol.fit(time, count * 1e-8, 901, 4, savgol.Counted(count, 1e-8))[0]
    assert np.array_equal(found, savgol.fit(time, count * 1e-8, 901, 4)[0])


def test_the_cost_does_not_depend_on_the_window(motion):
    count = np.tile(counts(motion), 20)
    slid(count, 41, 4)
    spent = {}
    for window in (41, 301):
        runs = []
        for _ in range(15):
            begun = clock.process_time()
            slid(count, window, 4)
            runs.append(clock.process_time() - begun)
        spent[window] = min(runs)
    assert spent[301] < 1.6 * spent[41]  # 7.4 times the samples in the window
