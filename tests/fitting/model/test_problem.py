"""What is known of the cycles when a law is fitted."""

from dataclasses import replace

import numpy as np

from fitting.laws import SIX
from fitting.model.problem import EstimationProblem, Run
from fitting.record import cycles


def test_overtaking_is_added_to_the_cycles_that_are_fitted_and_to_no_others(motion_of):
    motion = motion_of(law=5)
    cut = cycles.segment_cycles(motion)
    known, excluded = 1, 2  # one known to overtake before, one that is not fitted
    marked = [
        replace(cycle, overtakes=k == known, flag="excluded" if k == excluded else cycle.flag)
        for k, cycle in enumerate(cut.cycles)
    ]
    first = Run(motion, replace(cut, cycles=tuple(marked)))
    problem = EstimationProblem.build(SIX[5], [first, Run(motion, cut)])
    added = np.zeros(len(problem.cycles), bool)
    added[[2, len(first.cut.used)]] = True  # the fourth cycle of the first run, the first one of the second
    found = problem.with_overtaking(added)
    expected = {(0, known), (0, 3), (1, next(k for k, cycle in enumerate(cut.cycles) if not cycle.flag))}
    assert {
        (number, k)
        for number, run in enumerate(found.runs)
        for k, cycle in enumerate(run.cut.cycles)
        if cycle.overtakes
    } == expected
    assert [cycle.overtakes for cycle in problem.cycles].count(True) == 1, "the problem itself stays"
