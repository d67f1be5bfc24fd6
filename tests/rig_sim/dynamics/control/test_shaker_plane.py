"""Shaker formulas: against mpmath's roots, a complex simulation of the linear rig, and the rig of law 5."""

import math

import mpmath
import numpy as np
import pytest

from rig_sim.analyses.control.shaker import ShakerPlane, phasor, phasor_roots, shaker_for

from ...shared import CHAPTERS

THESIS = CHAPTERS["chapter6"]["phase_shift_control"]


def exact_roots(m: float, k: float, S: float, a: float, phi: float) -> list[complex]:
    """Return both roots of the characteristic equation, found by mpmath to 60 digits, the higher frequency first."""
    with mpmath.workdps(60):
        B = -1j * (S + mpmath.mpf(a) * mpmath.expj(-mpmath.mpf(phi)))
        size = mpmath.sqrt(mpmath.mpf(k) / m) + abs(B) / m
        first = mpmath.findroot(lambda z: m * z * z + B * z - k, size * mpmath.mpc(1.1, 0.3), solver="muller")
        assert abs(m * first * first + B * first - k) <= 1e-45 * (abs(B * first) + k)
        return sorted((complex(first), complex(-B / m - first)), key=lambda root: -root.real)


@pytest.mark.parametrize("seed", range(4))
def test_frequency_and_growth_are_the_roots_of_the_characteristic_equation(seed: int) -> None:
    # The small root is a difference of large numbers where the shaker is strong: it used to lose its digits.
    generator = np.random.default_rng(seed)
    for _ in range(40):
        m, k, a = (float(value) for value in 10.0 ** generator.uniform([-2, -2, -3], [2, 4, 5]))
        S, phi = float(generator.normal()), float(generator.uniform(-7, 7))
        for found, expected in zip(phasor_roots(m, k, S, a, phi), exact_roots(m, k, S, a, phi), strict=True):
            assert abs(found - expected) <= 1e-12 * abs(expected)
        Omega = phasor(m, k, S, a, phi)
        assert Omega.real > 0.0


def test_amplification_and_phase_follow_from_frequency_and_growth() -> None:
    generator = np.random.default_rng(5)
    for _ in range(50):
        m, k, omega = (float(value) for value in 10.0 ** generator.uniform(-1, 1, 3))
        S, delta = generator.normal(size=2).tolist()
        a, phi = shaker_for(m, k, S, omega, delta)
        assert abs(exact_roots(m, k, S, a, phi)[0] - complex(omega, delta)) < 1e-11 * abs(complex(omega, delta))
    with pytest.raises(ValueError, match="above 0"):
        shaker_for(1.0, 1.0, 0.3, 0.0, -0.1)


@pytest.mark.parametrize("band", [None, (0.9, 1.1), (0.3, 0.8), (1.02, 3.0)])
@pytest.mark.parametrize("S", [0.3, -0.4])
def test_intervals_are_those_of_every_single_phase_and_amplification(
    band: tuple[float, float] | None, S: float
) -> None:
    plane = ShakerPlane(0.8, 1.3, S, band)

    def stable(a: float, phi: float) -> bool:
        Omega = exact_roots(0.8, 1.3, S, a, phi)[0]
        return Omega.imag < 0 and (band is None or band[0] <= Omega.real <= band[1])

    generator = np.random.default_rng(11)
    for a, phi in zip(generator.uniform(0, 4, 20).tolist(), generator.uniform(0, 6.28, 20).tolist(), strict=True):
        inside = stable(a, phi)
        assert any(low <= phi <= high for low, high in plane.stable_phases(a)) == inside
        assert any(low <= a <= high for low, high in plane.stable_amplifications(phi)) == inside
        assert plane.is_stable(a, phi) == inside


def test_thesis_thresholds_and_best_phases() -> None:
    plane = ShakerPlane(1.0, 1.0, 0.3)
    for phi, threshold in ((math.pi, 0.3), (2.5, THESIS["phi_2_5"]), (2.0, THESIS["phi_2_0"])):
        assert plane.stable_amplifications(phi)[0][0] == pytest.approx(threshold, abs=1e-12)
    for delta, a in ((0.0, 0.3), (-0.1, 0.5), (-0.2, 0.7)):
        assert shaker_for(1.0, 1.0, 0.3, math.sqrt(1 - delta**2), delta) == pytest.approx((a, math.pi), abs=1e-12)
    for name, best in THESIS["optimum_phi_over_pi"].items():
        phases = np.linspace(0.85, 1.05, 4001)
        growth = [phasor(1.0, 1.0, 0.3, float(name[2:]), math.pi * phi).imag for phi in phases]
        assert phases[int(np.argmin(growth))] == pytest.approx(best, abs=1e-4)
    # the thesis finds "almost pi/2" of phase left by a band of 10 %; the widest range is 1.18 rad, at a = 0.36
    banded = ShakerPlane(1.0, 1.0, 0.3, (0.9, 1.1))
    widest = max(sum(high - low for low, high in banded.stable_phases(float(a))) for a in np.linspace(0.3, 2.0, 200))
    assert widest == pytest.approx(1.17, abs=0.02)
