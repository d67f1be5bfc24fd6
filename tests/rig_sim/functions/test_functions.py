"""The functions of rig_sim: the same numbers as their commands, tables, pictures, and systems of one's own."""

import doctest
import inspect
import json
import math

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure

import rig_sim
from rig_sim.cli.app import app
from rig_sim.comparison import error_vs_time
from rig_sim.results import quench as control
from stickslip.console import application
from stickslip.errors import InputError

from ..dynamics.textbook import Henon, Logistic
from ..shared import answer

FUNCTIONS = [name for name in rig_sim.__all__ if inspect.isfunction(getattr(rig_sim, name))]


@pytest.fixture(autouse=True)
def work_is_little(monkeypatch):
    """Measure no CPU times again and again, draw the swing at three amplitudes, and coarsely: nothing is about them."""
    monkeypatch.setattr(error_vs_time, "LONG_ENOUGH_S", 0.0)
    monkeypatch.setattr(control, "RATIOS", (0.5, 1.5, 3))
    monkeypatch.setattr("stickslip.output.plot.SCREEN_DPI", 20)


# Each function as a call from Python, and the command line that asks the same.
CALLS = {
    "cycle": (lambda: rig_sim.cycle("rig"), "cycle rig"),
    "fixed_point": (lambda: rig_sim.fixed_point("damped"), "fixed-point damped"),
    "fixed_point of two": (lambda: rig_sim.fixed_point("two-mass"), "fixed-point two-mass"),
    "floquet": (lambda: rig_sim.floquet("damped", orbit="unstable"), "floquet damped --orbit unstable"),
    "events": (lambda: rig_sim.events("rig", until=5, since="1 s"), "events rig --until 5 --since 1"),
    "events of two": (lambda: rig_sim.events("two-mass", until=20), "events two-mass --until 20"),
    "continue_": (
        lambda: rig_sim.continue_("damped", over=("damper.c", np.linspace(0.35, 0.4, 2))),
        "continue damped --over damper.c=0.35:0.4:2",
    ),
    "continue_ of two": (
        lambda: rig_sim.continue_("two-mass", over="belt.speed=0.083:0.085:2"),
        "continue two-mass --over belt.speed=0.083:0.085:2",
    ),
    "map": (lambda: rig_sim.map("two-mass", d=[0.05, -0.1], iterate=2), "map two-mass --d 0.05,-0.1 --iterate 2"),
    "map of one": (lambda: rig_sim.map("two-mass", d=0.05), "map two-mass --d 0.05"),
    "map, periodic": (lambda: rig_sim.map("two-mass", periodic=True), "map two-mass --periodic"),
    "basins": (lambda: rig_sim.basins("two-mass", cells=300), "basins two-mass --cells 300"),
    "lyapunov": (lambda: rig_sim.lyapunov("two-mass", events=100), "lyapunov two-mass --events 100"),
    "lyapunov, driven": (
        lambda: rig_sim.lyapunov(rig_sim.scene("forced", **{"drive.omega": 1.1}), events=100),
        "lyapunov forced --events 100 --set drive.omega=1.1",
    ),
    "sweep": (
        lambda: rig_sim.sweep("two-mass", over=("belt.speed", [0.1, 0.12]), section="map"),
        "sweep two-mass --over belt.speed=0.1:0.12:2 --section map",
    ),
    "sweep, driven": (
        lambda: rig_sim.sweep("forced", over="drive.omega=1.1:1.2:2", section="slip"),
        "sweep forced --over drive.omega=1.1:1.2:2 --section slip",
    ),
    "quench": (
        lambda: rig_sim.quench(rig_sim.scene("forced", **{"drive.omega": 20, "drive.u0": 1.75})),
        "quench forced --set drive.omega=20 --set drive.u0=1.75",
    ),
    "shaker": (
        lambda: rig_sim.shaker(m="1000 g", k=1, c=0, gamma=0.3, a=0.5, phi=3, band=(0.9, 1.1)),
        "shaker --m 1 --k 1 --c 0 --gamma 0.3 --a 0.5 --phi 3 --band 0.9:1.1",
    ),
    "lock": (lambda: rig_sim.lock("forced", period=2, budget=0.0235), "lock forced --period 2 --budget 0.0235"),
    "lock, search": (
        lambda: rig_sim.lock(rig_sim.scene("forced", **{"drive.omega": 0.9}), period=1, budget=0.0235, method="search"),
        "lock forced --set drive.omega=0.9 --period 1 --budget 0.0235 --method search",
    ),
    "lock, missed": (
        lambda: rig_sim.lock(rig_sim.scene("forced", **{"drive.omega": 1.3}), period=2, budget=0.3, method="search"),
        "lock forced --set drive.omega=1.3 --period 2 --budget 0.3 --method search",
    ),
}


@pytest.fixture(scope="module")
def results():
    """Return every result, each found once."""
    found = {}

    def of(name):
        if name not in found:
            found[name] = CALLS[name][0]()
        return found[name]

    return of


@pytest.mark.parametrize("name", CALLS)
def test_function_command_and_json_give_the_same_numbers(capsys, results, name):
    found, line = results(name), CALLS[name][1]
    assert json.loads(json.dumps(application.plain(found.as_json()))) == answer(line)
    assert application.run(app, line.split()) == 0
    assert capsys.readouterr().out.rstrip("\n") == str(found)


@pytest.mark.parametrize("name", CALLS)
def test_a_table_has_the_numbers_of_the_result_and_units(results, name):
    found = results(name)
    table, rows = found.to_dataframe(), list(found.rows())
    if name.startswith("lock"):  # the landings under control
        states = [] if found.control is None else found.control.states[:, 1].tolist()
        assert table["x"].tolist() == states
        return
    assert len(table) == len(rows)
    assert set(table.columns) == set().union(*rows)
    for place, row in enumerate(rows):
        for column, value in row.items():
            held = table[column].iloc[place]
            if value is None or value != value:
                assert pd.isna(held) or held is None
            else:
                assert application.plain(held) == application.plain(value)
    assert set(table.attrs.get("units", {})) <= set(table.columns)


@pytest.mark.parametrize("name", CALLS)
def test_a_result_draws_into_axes_or_a_figure_of_its_own(results, name):
    import matplotlib.pyplot as plt

    found = results(name)
    _, (first, second) = plt.subplots(1, 2)
    try:
        assert found.plot(ax=second) is second.figure
        assert second.get_xlabel() or second.get_ylabel()
        assert not first.has_data()
        before = plt.get_fignums(), dict(plt.rcParams)
        drawn = found.plot()
        assert isinstance(drawn, Figure)
        assert drawn._repr_png_().startswith(b"\x89PNG")
        assert (plt.get_fignums(), dict(plt.rcParams)) == before  # pyplot does not manage it
    finally:
        plt.close("all")


@pytest.mark.parametrize("name", CALLS)
def test_a_result_is_short_to_read_and_a_table_in_a_notebook(results, name):
    found = results(name)
    assert repr(found).startswith(f"<{type(found).__name__} of ")
    assert len(repr(found).splitlines()) <= 8
    assert "<table>" in found._repr_html_()
    assert len(found._repr_html_()) < 20_000


def test_a_run_in_memory_is_the_run_in_a_file(tmp_path):
    held = rig_sim.run("rig", until="2 s", rate="1 kHz")
    for suffix in ("h5", "csv"):
        path = tmp_path / f"motion.{suffix}"
        data = answer(f"run rig --until 2 --rate 1000 -o {path}")
        written = rig_sim.run("rig", until=2, rate=1000, output=path, force=True)
        assert data == application.plain(written.as_json())
        assert data == application.plain(held.as_json() | {"file": path})
        for name in ("t", "x", "v", "F"):
            assert np.array_equal(getattr(written, name), getattr(held, name))
            assert getattr(held, name).shape == (2001,)
    assert list(held.to_dataframe().columns) == ["t", "x", "v", "F"]
    both = rig_sim.run("two-mass", until=5, rate=10)
    assert both.x.shape == both.v.shape == both.F.shape == (51, 2)
    assert list(both.to_dataframe().columns) == ["t", "x1", "v1", "F1", "x2", "v2", "F2"]
    assert isinstance(held.plot(), Figure)
    assert isinstance(both.plot(), Figure)


def test_a_comparison_has_the_rows_that_its_command_prints():
    found, data = rig_sim.compare("base", until=15), answer("compare base --until 15")
    table = found.to_dataframe()
    assert list(table.columns) == list(data["rows"][0])
    assert [(row["method"], row["setting"], row["error"]) for row in data["rows"]] == [
        (row["method"], row["setting"], row["error"]) for row in application.plain(found.as_json())["rows"]
    ]
    assert list(found.as_json()) == list(data)
    assert isinstance(found.plot(), Figure)


def test_the_drawn_orbit_is_the_one_whose_numbers_are_given():
    for scene in ("base", rig_sim.scene("rig", **{"friction.law": 6}), rig_sim.scene("base", **{"belt.speed": -0.5})):
        found = rig_sim.cycle(scene)
        line = found.plot().axes[0].lines[0]
        x, v = line.get_data()
        size = found.x_max - found.x_min
        assert (x.min(), x.max()) == pytest.approx((found.x_min, found.x_max), abs=1e-4 * size)
        assert (v.min(), v.max()) == pytest.approx((found.v_min, found.v_max), rel=1e-3, abs=1e-4)
        assert (x[0], v[0]) == pytest.approx((x[-1], v[-1]), abs=1e-9)


@pytest.mark.parametrize("name", [*FUNCTIONS, "FormulaMap"])
def test_the_example_of_the_docstring_is_true(name):
    given = getattr(rig_sim, name)
    finder = doctest.DocTestFinder(recurse=False)
    (example,) = finder.find(given, name, globs={})
    assert example.examples, f"{name} has no example"
    failed, _ = doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE).run(example)
    assert failed == 0


# Systems of one's own -------------------------------------------------------------------------------------------------


def test_a_map_of_ones_own_has_the_exponent_basins_and_orbits_of_the_textbook():
    found = rig_sim.lyapunov(Logistic(4.0), events=5_000)
    assert found.exponent == pytest.approx(math.log(2.0), abs=4.0 * found.stderr)
    assert (found.per, found.name) == ("step", "Logistic")
    henon = rig_sim.lyapunov(Henon(1.4), events=5_000)  # 0.419 (Sprott)
    assert henon.exponent == pytest.approx(0.4192, abs=4.0 * henon.stderr)
    (attractor,) = rig_sim.basins(Logistic(3.3), cells=200).attractors
    assert attractor.period == 2
    assert rig_sim.map(Logistic(3.2), d=[0.5, 2.0]).outcome == ("completed", "outside")
    (orbit,) = rig_sim.map(Logistic(3.2), iterate=2, periodic=True).periodic
    assert orbit.slope == pytest.approx(4.0 + 2.0 * 3.2 - 3.2**2, abs=1e-9)
    for result in (found, rig_sim.map(Logistic(3.2), iterate=2), rig_sim.basins(Logistic(3.2), cells=50)):
        assert isinstance(result.plot(), Figure)


def test_a_family_of_maps_is_swept_and_continued():
    rows = rig_sim.sweep(Logistic, over="r=2.9:3.5:3").to_dataframe()
    assert list(rows["period"]) == [1, 2, 4]
    assert rows["points"][1] == pytest.approx((0.5130445, 0.7994555), abs=1e-7)
    found = rig_sim.continue_(Logistic, over=("r", np.linspace(2.82, 3.12, 4)))
    assert [(point.kind, point.value) for point in found.points] == [("period-doubling", pytest.approx(3.0, abs=1e-8))]
    assert {(branch.kind, branch.stable) for branch in found.branches} == {
        ("period 1", True),
        ("period 1", False),
        ("period 2", True),
    }
    assert isinstance(rig_sim.sweep(Logistic, over="r=2.9:3.5:3").plot(), Figure)
    with pytest.raises(InputError, match="is not a map of an interval"):
        rig_sim.continue_(Henon, over="a=1:1.2:3")


def test_a_system_of_ones_own_is_locked_onto_its_unstable_orbit():
    found = rig_sim.lock(Henon(1.4), period=1, budget=0.01)
    assert found.locked
    x = (-0.7 + math.sqrt(0.49 + 5.6)) / 2.0
    assert found.orbit["points"][0] == pytest.approx((x, x), abs=1e-10)
    table = found.to_dataframe()
    assert list(table.columns) == ["x0", "x1", "change"]
    assert isinstance(found.plot(), Figure)
    assert "locked" in repr(found)


def test_a_family_that_no_process_can_be_handed_is_refused_with_what_to_do():
    with pytest.raises(InputError, match="define the function in a module"):
        rig_sim.sweep(lambda r: Logistic(r), over="r=2.9:3.5:3", jobs=2)
