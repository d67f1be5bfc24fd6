"""What a caller from Python is told: the call to make, never a flag."""

import re

import pytest

import rig_sim
from stickslip.errors import InputError

FLAG = re.compile(r"(?<![\w-])--([a-z][a-z0-9-]*)")


def said(call):
    with pytest.raises(InputError) as refused:
        call()
    line = str(refused.value)
    assert not FLAG.search(line), line
    assert "\n" not in line
    return line


MISTAKES = [
    (lambda: rig_sim.scene("rig", friction=9), "write rig_sim.scene('rig', **{'friction.KEY': VALUE})"),
    (lambda: rig_sim.events("base", until=-1), "until: is -1; use a positive number"),
    (lambda: rig_sim.events("base", until=None), "until: is None; use a number"),
    (lambda: rig_sim.events("base", until=10, max_steps=2.5), "max_steps: is 2.5, not a whole number"),
    (lambda: rig_sim.run("base", until=10, rate=10, method="exat"), "method: unknown method 'exat'; use one of exact"),
    (lambda: rig_sim.run("base", until=10, rate=10, output="a.pdf"), "choose a name that ends in .h5 or .csv (output)"),
    (lambda: rig_sim.floquet("damped", orbit="unstabel"), "orbit: unknown orbit 'unstabel'; did you mean 'unstable'?"),
    (
        lambda: rig_sim.continue_("damped", over="c=1:2"),
        "write over='damper.c=0.3:0.6:31', or over=('damper.c', values)",
    ),
    (lambda: rig_sim.continue_("damped", over="damper.c=0.3:0.6", draws=5), "fitting.rank(run).save_scene(path)"),
    (lambda: rig_sim.map("base", d=0.1), "write rig_sim.scene('base', coupling={'a': 1.2, 'b': 1.3})"),
    (lambda: rig_sim.map("two-mass", d="much"), "d: 'much' contains something that is not a number"),
    (lambda: rig_sim.basins(rig_sim.FormulaMap([1.0, 1.0])), "write super().__init__(..., interval=(lo, hi))"),
    (lambda: rig_sim.sweep("two-mass", over="belt.speed=0.1:0.2:3", jobs=0), "jobs: is 0; use 1 or more"),
    (lambda: rig_sim.cycle("two-mass"), "use rig_sim.events, run, fixed_point"),
    (
        lambda: rig_sim.quench(rig_sim.scene("forced", **{"drive.omega": 0})),
        "write rig_sim.scene('forced', **{'drive.omega': 1.6})",
    ),
    (lambda: rig_sim.lock("forced", period=1, budget="little"), "budget: is 'little'; use a number"),
    (lambda: rig_sim.shaker(m=1, k=1, c=0, gamma=0, a=0, phi=0, band=3), "use (low, high) in rad/s"),
]


@pytest.mark.parametrize(("call", "words"), MISTAKES, ids=range(len(MISTAKES)))
def test_a_mistake_is_answered_with_the_call_to_make(call, words):
    """The functions used to raise the errors of the commands: "write --set friction.KEY=VALUE"."""
    assert words in said(call)
