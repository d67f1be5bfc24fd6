"""Quantiles and tails against scipy.stats, which is too slow to import in a command."""

import pytest

from fitting import distributions


@pytest.fixture(scope="module")
def stats():
    """Import scipy.stats, which takes 2 s, where it is asked and not in every process that collects tests."""
    from scipy import stats

    return stats


@pytest.mark.parametrize("p", [0.975, 1 - 5e-10])
def test_quantiles_are_those_of_scipy_stats(stats, p):
    assert distributions.student_quantile(p, 9) == pytest.approx(stats.t.ppf(p, 9), rel=1e-12)
    assert distributions.normal_quantile(p) == pytest.approx(stats.norm.ppf(p), rel=1e-12)
    found = distributions.gamma_upper_quantile(1 - p, 0.3, 0.1)
    assert found == pytest.approx(stats.gamma.isf(1 - p, 9, scale=1 / 30), rel=1e-12)


def test_tails_are_those_of_scipy_stats(stats):
    assert distributions.gamma_tail(0.8, 0.3, 0.1) == pytest.approx(stats.gamma.sf(0.8, 9, scale=1 / 30), rel=1e-12)
    assert distributions.gamma_tail(-0.2, 0.3, 0.1) == 1  # below the gamma's beginning
    assert distributions.fisher_log_tail(31.0, 2, 17) == pytest.approx(stats.f.logsf(31.0, 2, 17), rel=1e-12)
