"""Savitzky-Golay in whole numbers: equal to the convolution, blind to offsets, equal in pieces and as a whole."""

import time as clock
from fractions import Fraction

import numpy as np
import pytest

from daq.compute.compile import compiled
from daq.errors import InputError
from processing.polynomial import moments, savgol
from processing.polynomial.gram import coefficients
from processing.polynomial.stream import SavgolStream


def counts(motion, pitch=7.67e-6, duration=5.0):
    return np.floor(motion(5, duration, jitter=0.0).x / pitch).astype(np.int64)


def slid(count, window, order):
    values = np.empty((3, count.size))
    run = compiled(moments.slide_wide if moments.wide(window) else moments.slide, savgol.KERNELS)
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
def test_a_stream_gives_what_the_whole_record_gives_bit_for_bit(motion, window, order, sign):
    count, pitch = counts(motion) + 10**12, sign * 7.67e-6
    seen = count - count[0]
    time = np.arange(count.size) * 1e-3
    counted = savgol.Counted(sign * seen, abs(pitch))
    whole = savgol.fit(time, seen * pitch, window, order, counted)[0]
    stream = SavgolStream(window, order, (time[-1] - time[0]) / (time.size - 1), pitch)
    cuts = np.sort(np.random.default_rng(3).choice(count.size, 40, replace=False))
    told = [stream.push(part) for part in np.split(count, cuts)]
    assert np.array_equal(np.concatenate([*told, stream.finish()], axis=1), whole)


def test_a_stream_refuses_what_it_could_not_tell_exactly():
    stream = SavgolStream(901, 4, 1e-3)
    with pytest.raises(InputError, match="counts in a sample; take a shorter window"):
        stream.push(np.array([0, 10**6]))
    short = SavgolStream(5, 2, 1e-3)
    assert short.push(np.array([1, 2])).shape == (3, 0)
    with pytest.raises(InputError, match="2 samples came; the window holds 5"):
        short.finish()


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
