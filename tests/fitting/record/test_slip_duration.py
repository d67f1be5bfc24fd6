"""How long a slip lasts, as readings show it, beside the events of a simulator that shares nothing with ours."""

import numpy as np
import pytest

from fitting.record.motion import harmonic_share, slip_duration

from ...rig import follow
from .. import scales


def _slip(number, rate_hz, noise=0.0):
    """Return the slip's duration as estimated and as it is, s."""
    contact = scales.draw(number).contact
    time = np.arange(0, contact.duration, 1 / rate_hz)
    true = follow(contact, time)
    scatter = noise * contact.Fs / contact.k
    readings = true.position + np.random.default_rng(number).normal(0, scatter, time.size)
    expected = float(np.median(true.landings[1:] - true.break_aways[1 : true.landings.size]))
    return slip_duration(time, readings, scatter), expected


@pytest.mark.parametrize("number", [38, 43, 64])
def test_a_slip_of_few_samples_lasts_as_long_as_it_does(number):
    """A slip of 7.2 samples was said to have 5, one of 4.2 to have 6."""
    found, expected = _slip(number, scales.draw(number).rate_hz)
    assert found == pytest.approx(expected, rel=0.15)


def test_noise_of_a_finely_sampled_record_makes_no_slips():
    found, expected = _slip(34, 40 * scales.draw(34).rate_hz, noise=0.005)
    assert found == pytest.approx(expected, rel=0.15)


def test_a_mass_that_grazes_the_belt_slips_for_a_whole_swing():
    time = np.arange(0, 60, 0.9)
    assert slip_duration(time, np.sin(time), 1e-3) == pytest.approx(2 * np.pi, rel=0.15)


def test_rest_before_the_belt_starts_is_no_slip():
    time = np.arange(0, 200, 0.5)
    swings = np.where(time < 120, 0.0, np.sin(time - 120))
    assert slip_duration(time, swings, 1e-3) == pytest.approx(2 * np.pi, rel=0.15)


def test_a_record_without_a_turn_has_no_slip_shorter_than_itself():
    time = np.arange(10.0)
    assert slip_duration(time, 2 * time, 1e-3) == 9.0


def test_rests_between_moves_with_the_belt_are_no_slips():
    # Seen from half the belt's speed a mass at rest falls, by nothing: "float division by zero".
    time = np.arange(0, 40, 0.1)
    steps = np.floor(time / 4) + np.clip(time % 4 / 2, 0, 1)
    assert slip_duration(time, steps, 1e-4) == time[-1]


def test_the_harmonic_share_is_that_of_a_harmonic_motion():
    for share in (0.1, 0.5, 1.0):
        slow = np.pi + 2 * np.arcsin(share / 2)  # of amplitude 1 and frequency 1, slower than half the belt
        assert harmonic_share(share * slow / 2) == pytest.approx(share, abs=1e-6)
