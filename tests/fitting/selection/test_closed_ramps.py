"""A ramp that is left within a tenth of a millisecond is its jump law."""

from types import SimpleNamespace

import pytest

from fitting.law import SIX
from fitting.selection.equivalence import closed_ramps


@pytest.mark.parametrize(("width", "closed"), [(1e-6, True), (0.0012, True), (0.005, False)])
def test_a_ramp_that_no_record_shows_is_its_jump_law(width, closed):
    # Harsh records of law 3, a ramp of 0.0012: one cycle in 22 left 8 % less under law 4, and the set was {3, 4}.
    problem = SimpleNamespace(motions=[SimpleNamespace(belt_speed=0.22)])
    jump, ramp = (
        SimpleNamespace(law=SIX[law], values=SimpleNamespace(d=d), problem=problem)
        for law, d in ((3, 0.0), (4, 0.22 * width))
    )
    assert closed_ramps([jump, ramp]) == ([(SIX[3], SIX[4])] if closed else [])
