"""Drift and offset through USB batches and stalls; silence where the two clocks cannot be compared."""

import numpy as np
import pytest

from daq import clock


def late_by_usb(device, drift, rng, batch_s=0.016):
    """Return host times: true time, the USB chip's wait from a batch's first frame on, scatter, stalls of 0.3 s."""
    true = device / (1 + drift)
    host = np.empty(len(true))
    flush = -1.0
    for frame, taken in enumerate(true):
        if taken > flush:
            flush = taken + batch_s
        host[frame] = flush
    host += 0.002 + np.repeat(rng.exponential(0.0005, len(true)), 2)[: len(true)]
    for start in rng.uniform(0, true[-1], 12):
        stalled = (host > start) & (host < start + 0.3)
        host[stalled] = start + 0.3
    return host


@pytest.mark.parametrize("ppm", [-3000, -40, 0, 250, 3000])
def test_drift_is_found_within_5_ppm_in_a_minute(ppm):
    device = np.arange(0, 60, 0.008)
    host = late_by_usb(device, ppm * 1e-6, np.random.default_rng(ppm + 5000))
    assert clock.compare(host, device).ppm == pytest.approx(ppm, abs=5)


def test_the_offset_is_the_least_delay():
    device = np.arange(0, 60, 0.008)
    host = 100 + late_by_usb(device, 0.0, np.random.default_rng(3))
    found = clock.compare(host, device)
    assert np.median(found.offset) == pytest.approx(100.002, abs=1e-3)
    assert len(found.offset) == 60
    assert np.array_equal(found.offset, (host - device)[found.frame])


def test_a_stream_faster_than_real_time_has_no_drift():
    device = np.arange(0, 60, 0.008)
    found = clock.compare(device / 40, device)
    assert found.ppm is None
    assert len(found.offset) == 0


@pytest.mark.parametrize("seconds", [0.0, 0.5, 2.0])
def test_a_short_run_has_no_drift(seconds):
    device = np.arange(0, seconds, 0.008)
    assert clock.compare(device + 0.01, device).ppm is None


def test_an_hour_takes_no_more_than_the_wider_bins():
    device = np.arange(0, 3600, 0.5)
    found = clock.compare(device / (1 + 1e-4) + 0.01, device)
    assert len(found.frame) <= clock.MOST_POINTS + 1
    assert found.ppm == pytest.approx(100, abs=0.1)


def test_theil_sen_is_not_moved_by_a_quarter_of_outliers():
    x = np.arange(41.0)
    y = 2 * x + 1
    y[::4] += 1000
    assert clock.theil_sen(x, y) == pytest.approx(2)
