"""How far a law's orbit runs from the measured one."""

from types import SimpleNamespace

import numpy as np
import pytest

from fitting.judge.friction import MeasuredOrbit


@pytest.mark.parametrize("late", [0.0, 0.3])
def test_an_orbit_a_tenth_smaller_is_a_tenth_of_its_radius_away_however_late(late):
    time = np.linspace(0, 4 * np.pi, 4000)
    motion = SimpleNamespace(position=np.sin(time), velocity=np.cos(time))
    windows = SimpleNamespace(position=0.9 * np.sin(time - late), time=time, table=[(0, 0, 0, time.size)])
    fit = SimpleNamespace(windows=windows, residual=np.zeros(time.size))
    assert MeasuredOrbit.of(motion).distance(fit) == pytest.approx(0.05, rel=1e-2)  # of the diameter
