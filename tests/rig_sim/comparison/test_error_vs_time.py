"""The reference against closed forms and the kernel; the peers; and ``rig-sim compare``."""

import re
from functools import cache

import mpmath
import pytest

from rig_sim.cli.app import app
from rig_sim.comparison import error_vs_time
from rig_sim.comparison.error_vs_time import compare, describe_peers, difference, find_tightest, pair_events
from rig_sim.comparison.reference import Uncovered, events
from rig_sim.integrate.events import EventList, list_events
from rig_sim.scenes.scene import scene
from stickslip.console import application

from ..shared import answer, flow_of


@pytest.fixture(scope="module", autouse=True)
def _each_method_runs_once():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(error_vs_time, "LONG_ENOUGH_S", 0.0)
        yield


def test_reference_has_the_first_stick_of_law_1_to_30_digits():
    found = events(flow_of(1), 0.0, 0.0, 3.0)
    with mpmath.workdps(40):
        expected = [mpmath.pi / 6, mpmath.pi / 6 + mpmath.sqrt(3)]
        assert [kind for _, kind, _ in found] == ["N>S", "S>N"]
        assert max(abs(t - at) for (t, _, _), at in zip(found, expected, strict=True)) < mpmath.mpf(10) ** -31


def test_reference_has_the_period_of_law_5_to_18_digits():
    found = [t for t, kind, _ in events(flow_of(5), 1.0, 0.5, 20.0) if kind == "S>N"]
    with mpmath.workdps(40):
        assert abs(found[-1] - found[-2] - mpmath.mpf("8.28274352267811740")) < mpmath.mpf(10) ** -17


def test_reference_says_what_it_does_not_cover():
    with pytest.raises(Uncovered, match="driven ramp"):
        events(flow_of(6, d=1e-6, u0=0.1, omega=1.0), 0.0, 0.0, 10.0)


def test_lists_that_part_have_no_error_but_say_where():
    exact = list_events(flow_of(5), 0.0, 0.0, 30.0)
    expected = list(zip(exact.t, exact.kinds, strict=True))
    assert difference(exact, expected, 30.0) == (0.0, "")
    assert difference(exact, [*expected[:2], (9.0, "N>P")], 30.0)[1].startswith("other events from t = 9")
    assert difference(exact, expected[:-1], 30.0)[0] is None


@cache
def compared(name):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(error_vs_time, "LONG_ENOUGH_S", 0.0)  # nothing here is about CPU times
        return compare(scene(name), 10.0)


@pytest.fixture
def once(monkeypatch):
    """Let ``rig-sim compare`` show a comparison that was made before."""
    monkeypatch.setattr(error_vs_time, "compare", lambda found, until, progress: compared(found.name))


@pytest.mark.usefixtures("once")
@pytest.mark.parametrize("name", ["base", "rig"])
def test_compare_prints_a_table_of_80_columns_with_whole_names(capsys, monkeypatch, name):
    """Beside "other events from t = 18.2702" the name rk4-henon was cut to "rk4-h..."."""
    monkeypatch.setenv("COLUMNS", "80")
    assert application.run(app, ["compare", name, "--until", "10"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert sum(line.startswith("rk4-henon ") for line in lines) == 4
    rows = [line for line in lines if line.startswith(("exact ", "rk4-henon ", "dop853 ", "radau ", "lsoda "))]
    assert max(len(row) for row in rows) <= 80


@pytest.mark.usefixtures("once")
def test_compare_ranks_the_methods_of_the_contract():
    found = answer("compare base --until 10")
    rows = {(row["method"], row["setting"]): row for row in found["rows"]}
    assert {method for method, _ in rows} == {"exact", "rk4-henon", "dop853", "radau", "lsoda"}
    for rtol in ("1e-06", "1e-09", "1e-12", "2.3e-14"):
        assert ("dop853", f"rtol {rtol}") in rows
    for setting in ("interpreted", "compiled"):
        assert rows["exact", setting]["error"] <= 1e-14
    assert all({"method", "setting", "error", "cpu_s", "us_per_cycle"} <= set(row) for row in found["rows"])
    near = {method for (method, _), row in rows.items() if row["error"] is not None and row["error"] < 1e-6}
    assert near == {"exact", "rk4-henon", "dop853", "radau", "lsoda"}
    assert "mpmath" in found["reference"]
    assert rows["exact", "compiled"]["error"] < rows["dop853", "rtol 2.3e-14"]["error"]


@pytest.mark.parametrize(
    ("name", "changes", "until"),
    [
        ("rig", {}, 4.0),
        ("base", {"belt.ripple": 0.05, "belt.ripple_hz": 0.3, "wear.rate": 0.001}, 20.0),
    ],
)
def test_a_scene_that_changes_between_events_is_played_by_every_method(name, changes, until):
    """DOP853 may find a landing twice at its tightest, by the processor's dot products: one near rival is enough."""
    found = compare(scene(name, **changes), until, methods=("exact", "rk4-henon", "dop853"))
    rows = {(row.method, row.setting): row for row in found.results}
    assert found.cycles >= 2
    assert "the most accurate other method" in found.reference
    assert rows["rk4-henon", "h 0.003"].error < 1e-7
    assert min(row.error for row in found.results if row.method != "exact" and row.error is not None) < 1e-9
    compared = re.search("exact with dop853 (rtol [^;]*)", found.reference)
    assert rows["exact", "interpreted"].error == rows["dop853", compared[1]].error


def listed(*events):
    return EventList(
        tuple(t for t, _ in events), (0.0,) * len(events), tuple(kind for _, kind in events), "completed", "", 0
    )


def test_a_list_with_a_landing_found_twice_is_no_reference():
    """DOP853 at 2.3e-14 landed at the time of a break-away, and the exact method was said to find "other events"."""
    events = ((1.0, "S>N"), (2.0, "N>S"), (4.0, "S>N"), (5.0, "N>S"))
    twice = listed(*events[:3], (4.0, "N>S"), (4.001, "S>N"), (5.001, "N>S"))
    right = {("exact", "interpreted"): listed(*events), ("dop853", "rtol 1e-12"): listed(*events)}
    lists = right | {("dop853", "rtol 2.3e-14"): twice, ("radau", "rtol 1e-09"): listed(*events)}
    peers = {method: find_tightest(lists, method, 9.0) for method in ("exact", "dop853", "radau")}
    assert all(lists[peer].t == right["exact", "interpreted"].t for peer in peers.values())
    assert describe_peers(peers) == ("; compared: exact with dop853 rtol 1e-12; dop853, radau with exact interpreted")
    assert difference(twice, pair_events(lists["exact", "interpreted"]), 9.0) == (None, "other events from t = 4")
