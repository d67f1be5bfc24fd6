"""The share of frames lost among even times, from the residuals of a fit."""

from types import SimpleNamespace

import numpy as np
import pytest

from fitting.judge.screening import missing_share

RATE, CYCLES, SIZE = 400.0, 16, 500
NOISE = 1e-3  # m; a frame at 0.3 m/s moves by 0.75 mm


def fitted(lost=0.0, smear=1, wrong=0.0, seed=1, count=None):
    """Return a fit of cycles of a sine and the record that it was fitted to.

    ``lost`` is the share of frames lost, ``smear`` the samples that the tracker averages over, ``wrong`` the amplitude
    (m) of what the law leaves in every cycle.  With ``count`` (m) positions are counts, without noise.
    """
    rng = np.random.default_rng(seed)
    n = CYCLES * SIZE
    time = np.arange(n) / RATE
    late = np.cumsum(rng.random(n) < lost) / RATE / (1 - lost)
    true = time * (1 - lost) + late if lost else time
    noise = np.convolve(rng.normal(0, NOISE, n + smear), np.ones(smear) / np.sqrt(smear), "valid")[:n]
    phase = 2 * np.pi * time * RATE / SIZE
    measured = 0.06 * np.sin(2 * np.pi * true * RATE / SIZE) + noise + wrong * np.sin(3 * phase)
    model = 0.06 * np.sin(phase)
    if count is not None:
        measured = count * np.floor((measured - noise) / count)
    windows = SimpleNamespace(
        table=np.array([(k, 0, k * SIZE, SIZE, 0, 0) for k in range(CYCLES)]), time=time, position=measured
    )
    resolution, step = (NOISE, 1e-5) if count is None else (count / np.sqrt(12), count)
    problem = SimpleNamespace(motions=[SimpleNamespace(resolution=resolution, step=step)])
    inliers = np.ones(CYCLES, bool)
    fit = SimpleNamespace(residual=model - measured, inlier_cycles=inliers, windows=windows, problem=problem)
    fit.for_run = lambda run: fit
    return fit, SimpleNamespace(recording=SimpleNamespace(raw=None), time=time, even_times=True)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_share_of_lost_frames_is_found_within_its_error(seed):
    share = missing_share(*fitted(lost=0.05, seed=seed))
    assert share is not None
    assert abs(share.value - 0.05) < 3 * share.sd < 0.05


@pytest.mark.parametrize("changes", [{}, {"smear": 3}, {"smear": 2}, {"wrong": 2e-3}])
def test_noise_a_tracker_that_averages_and_a_law_that_is_wrong_are_no_lost_frames(changes):
    assert not any(missing_share(*fitted(**changes, seed=seed)) for seed in range(5))


@pytest.mark.parametrize("count", [1.5e-3, 3e-3])
def test_counts_that_change_every_other_sample_are_no_lost_frames(count):
    # What rounding leaves is correlated over tens of samples: 1.3 +- 0.05 % of sound frames were "lost or doubled".
    assert missing_share(*fitted(count=count)) is None


def test_times_that_are_not_even_show_by_themselves_what_is_missing():
    fit, record = fitted(lost=0.05)
    record.even_times = False
    assert missing_share(fit, record) is None
