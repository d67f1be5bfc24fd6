"""What the campaign of contacts calls a fault, and what its draws hold."""

from dataclasses import replace

import numpy as np
import pytest

from ..fitting import scales
from . import contacts

TRUTH = scales.Truth(sticks=30, samples_per_slip=40.0, cycles=30)
RIGHT = contacts.Outcome(
    number=4,
    kind="law5",
    truth=TRUTH,
    rate_hz=1000.0,
    exit=0,
    what="",
    broken="",
    cpu_s=1.0,
    verdict="law 5",
    named=(5,),
    adequacy="adequate",
    p_value=0.3,
)
FEW = "a slip has 5.1 samples a slip; a verdict needs 8; record at 1.6 kHz or more"


def refused(what, samples=40.0, sticks=30):
    truth = scales.Truth(sticks=sticks, samples_per_slip=samples, cycles=sticks)
    return replace(RIGHT, exit=4, what=what, truth=truth, named=(), adequacy="", p_value=None)


@pytest.mark.parametrize(
    ("found", "expected"),
    [
        (RIGHT, ""),
        (refused("about 26 % of the frames are lost"), "refused for a reason that is not true"),
        (refused(FEW), "refused for a reason that is not true"),
        (refused(FEW, samples=5.0), ""),
        (refused(FEW, samples=8.5), "names other samples a slip"),
        (refused("no law comes near it", samples=5.0), "does not name the samples a slip and a rate"),
        (refused(FEW.replace("1.6 kHz", "1600 Hz"), samples=5.0), ""),
        (refused(FEW.replace("1.6 kHz", "100 Hz"), samples=5.0), "names too low a rate"),
        (replace(RIGHT, truth=replace(TRUTH, samples_per_slip=5.0)), "not refused"),
        (refused("no belt stick-slip in this record: no slip between two sticks", sticks=0), ""),
        (refused("no slip between two sticks", sticks=30), "refused for a reason that is not true"),
        (refused("no belt stick-slip in this record: no law comes near it", sticks=0), "refused for a reason that is"),
    ],
)
def test_a_refusal_needs_a_reason_that_the_truth_allows(found, expected):
    assert contacts.untrue_reason(found).startswith(expected)
    assert bool(contacts.untrue_reason(found)) == bool(expected)


def test_a_share_of_right_laws_below_the_promise_is_a_fault_that_names_each_contact():
    wrong = [replace(RIGHT, number=n, named=(3,)) for n in (104, 114)]
    kept = contacts._laws([RIGHT] * 38 + wrong)
    broken = contacts._laws([RIGHT] * 37 + wrong)
    assert kept.faults == ()
    assert "contacts 104, 114" in kept.measured
    assert [fault.partition(",")[0] for fault in broken.faults] == ["contact 104", "contact 114"]
    assert all("python -m tests.fitting.scales 1" in fault for fault in broken.faults)


def test_a_law_that_is_named_without_describing_the_record_is_not_right():
    assert RIGHT.right
    assert not replace(RIGHT, adequacy="none of the six").right
    assert not replace(RIGHT, named=(3, 6)).right


def test_adequate_without_a_p_value_is_a_fault():
    assert contacts._judged([RIGHT]).faults == ()
    assert len(contacts._judged([RIGHT, replace(RIGHT, p_value=None)]).faults) == 1


def test_draws_are_the_same_each_time_and_reach_over_the_scales_that_are_stated():
    drawn = [scales.draw(number) for number in range(400)]
    assert drawn[::7] == [scales.draw(number) for number in range(0, 400, 7)]
    assert {each.kind for each in drawn} == set(scales.KINDS)
    for ends, values in (
        (scales.MASS, [each.contact.m for each in drawn]),
        (scales.OMEGA, [each.contact.omega for each in drawn]),
        (scales.STRETCH, [each.contact.Fs / each.contact.k for each in drawn]),
        (scales.NOISE, [each.noise_m * each.contact.k / each.contact.Fs for each in drawn]),
    ):
        within = (np.log(values) - np.log(ends[0])) / np.log(ends[1] / ends[0])
        assert -1e-9 < within.min() < 0.02
        assert 0.98 < within.max() < 1 + 1e-9


@pytest.mark.parametrize("number", [5, 18, 32])
def test_a_table_holds_what_its_truth_says(number, tmp_path):
    """Times and positions are in the table's own order, direction and origin; the sticks run at the belt's speed."""
    drawn = scales.draw(number)
    truth = scales.write_table(drawn, tmp_path / "t.csv")
    time, position = np.loadtxt(tmp_path / "t.csv", delimiter=",", skiprows=1, unpack=True)
    assert time[0] == pytest.approx(drawn.begin_s)
    np.testing.assert_allclose(np.diff(time), 1 / drawn.rate_hz, rtol=1e-5)
    stretch = drawn.contact.Fs / drawn.contact.k
    moved = (position - drawn.x0_m) * (-1 if drawn.mirrored else 1) / stretch
    assert abs(moved[0]) < 0.03
    assert moved.max() > 0.95
    pulled = slice(np.argmax(moved > 0.4), np.argmax(moved > 0.8))  # by the belt, before the first slip
    speed = np.polyfit(time[pulled], moved[pulled] * stretch, 1)[0]
    assert 1 - drawn.contact.ramp / drawn.contact.belt - 0.02 < speed / drawn.contact.belt < 1.02
    after = moved[np.argmax(moved > 0.95) :]
    middle = 0.5 * (after.min() + after.max())
    slips = np.sum((after[1:] < middle) & (after[:-1] >= middle))
    assert abs(slips - truth.sticks) <= 2
