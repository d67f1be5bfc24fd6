"""The motion along the windows of a fit against scipy's solution of the same equations."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fitting.model import memory
from fitting.model.memory_flow import BRISTLES, PER_WINDOW, RATE_AND_STATE, follow_window
from rig_sim.friction.memory import BRISTLE, MEMORY_LAWS
from stickslip.compute.compile import compiled

BENCHMARKS = Path(__file__).parents[3] / "benchmarks"
NEVER_BENT = -700.0  # log of a deflection over that of steady slip
RADIANS = 30.0  # of the oscillator: some four cycles, more than a window has
# Settings without drive and ripple, which windows do not have, and without s2, which is part of their damping.
CASES = [(law, n) for law in ("lugre", "dahl") for n in (0, 1, 3, 4, 8)]
CASES += [(law, n) for law in ("ageing", "slip") for n in (0, 1, 2, 3, 4, 5, 6, 7)]


@pytest.mark.parametrize(("law", "number"), CASES)
def test_a_window_is_followed_as_by_scipy(monkeypatch, law, number):
    """The share of the travel: 0.1 um of 100 mm. Creep that ended at 1e-6 of the belt's speed erred by 5e-5 of it."""
    monkeypatch.syspath_prepend(BENCHMARKS)
    from oracles import memory as peer

    case = peer.SETTINGS[law][number]
    case = replace(case, until=min(case.until, RADIANS * math.sqrt(case.m / case.k)))
    times = np.linspace(0.0, case.until, 1001)
    expected, _ = peer.solve(case, times)
    values = {name: one if name in ("v_s", "D", "v0") else one / case.m for name, one in case.parameters.items()}
    code = MEMORY_LAWS[law].code
    if law == "dahl":
        values |= {"Fs": values["Fc"], "v_s": 1.0}
    names = BRISTLES if code == BRISTLE else RATE_AND_STATE
    p = np.array([case.k / case.m, case.speed, 0.0, case.c / case.m, *(values[name] for name in names)])
    change = NEVER_BENT if code == BRISTLE else -math.log(values["v0"] / case.speed)
    follow = compiled(follow_window, memory.KERNELS, _nrt=False)
    for looser, error in ((memory.LOOSER, 1e-6), (memory.SEARCH_LOOSER, 2e-5)):  # at the end of a search, and in it
        scale = np.array([1.0, memory.TOLERANCE * np.ptp(expected), looser])
        x, work = np.empty((3, times.size)), np.empty((4, columns := p.size + PER_WINDOW, 3))
        own = np.array([case.x, 0.0, 0.0, 0.0, change])
        assert follow(code, p, own, scale, times, x, np.empty((0, columns)), work, None)
        assert np.sqrt(np.mean((x[0] - expected) ** 2)) < error * np.ptp(expected)
