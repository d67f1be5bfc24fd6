"""`fitting` from Python: arrays in, results out, the numbers of the command, and mistakes answered with what to do."""

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest

import daq
import fitting
import processing
from daq.runfile.rig import Rig
from fitting import cli
from fitting.report import page
from stickslip.console import application
from stickslip.errors import InputError, StickslipError

pytestmark = pytest.mark.usefixtures("asked_laws_alone")
ROOT = Path(__file__).resolve().parents[2]
RUN = ROOT / "data_samples" / "law5.h5"
MINE = "Fs/(1 + s/v_s)"


@pytest.fixture(scope="module")
def run():
    return daq.load(RUN)


@pytest.fixture(scope="module")
def ranking(run, asked_laws_alone):
    return fitting.rank(run, laws=(5, fitting.Law("mine", MINE)))


@pytest.fixture(scope="module")
def joint(run, asked_laws_alone):
    motion = processing.smooth(run)
    return fitting.rank([motion, motion], laws=5)


def without_costs(document):
    """Return a JSON document without CPU times and what only the command has."""
    if isinstance(document, dict):
        beside = ("cpu_s", "statistics", "report")
        return {name: without_costs(item) for name, item in document.items() if name not in beside}
    if isinstance(document, list):
        return [without_costs(item) for item in document]
    return None if document != document else document


def test_function_and_command_give_the_same_numbers(tmp_path, capsys):
    path = shutil.copy(RUN, tmp_path / "run.h5")
    flags = ["--laws", "5", "--law", f"mine: {MINE}", "--fix", "gamma=9.6", "--bound", "mine.v_s=0.01:1"]
    flags += ["--mass", "310 g +- 1 g", "--x0", "0.3 mm +- 0.1 mm", "--from", "0.2", "--exclude-cycles", "2"]
    application.run(cli.app, [str(path), *flags, "--no-report", "--json"])
    typed = json.loads(capsys.readouterr().out)
    found = fitting.rank(
        path,
        laws=(5, f"mine: {MINE}"),
        fix={"gamma": 9.6},
        bounds={"mine.v_s": (0.01, 1)},
        mass=(0.31, 1e-3),
        x0="0.3 mm +- 0.1 mm",
        begin=0.2,
        excluded=2,
    )
    called = json.loads(json.dumps(found.as_json()))
    assert without_costs(called) == without_costs(typed)


@pytest.mark.usefixtures("undrawn_report")
def test_a_run_its_motion_and_its_arrays_give_one_answer(run, tmp_path):
    of_arrays = fitting.rank(run.time, run.position, laws=5, mass=run.rig.mass, x0=(0, 5e-4))
    assert "a run in memory" in of_arrays.save_scene(tmp_path / "arrays.toml").read_text()
    page = of_arrays.report(tmp_path / "arrays.html")
    assert of_arrays.report(page) == page  # its own again
    of_motion = fitting.rank(processing.smooth(run), run.rig, 5)
    with pytest.raises(StickslipError, match="contains the report of another run; choose another name, or force=True"):
        of_motion.report(page)
    assert of_motion.best.parameters == fitting.rank(run, laws=5).best.parameters
    for name in ("k/m", "gamma"):  # without the length of a count the rounding is not known
        known = of_motion.best.parameters[name]
        assert abs(of_arrays.best.parameters[name].value - known.value) < 0.5 * known.stderr


def test_callables_are_the_fit_at_any_time(run, ranking):
    row, left = ranking.best, ranking.residuals
    assert left.residual_m.std() == pytest.approx(row.rms_m, rel=1e-3)
    time = left.time_s.to_numpy()
    assert row.position(time) == pytest.approx(left.fitted_m.to_numpy(), abs=1e-7)
    assert np.abs(left.fitted_m - left.position_m - left.residual_m).max() < 1e-12
    middle, half = time[left.phase == "slip"][50:-50:7], 1e-4
    steady = np.ptp(row.velocity(middle[:, None] + [-half, 0, half]), axis=1) < 0.01
    slope = (row.position(middle + half) - row.position(middle - half)) / (2 * half)
    assert row.velocity(middle)[steady] == pytest.approx(slope[steady], abs=1e-4)
    assert np.isnan(row.position([-1.0, 1e3])).all()
    assert row.position(time[100]).shape == ()


@pytest.mark.parametrize("law", [5, "mine"])
def test_friction_is_the_formula_at_the_fitted_parameters(ranking, law):
    row, s = ranking.row(law), np.array([0.0, 0.01, 0.3])
    found = {name: item.value for name, item in row.parameters.items()}
    bend = found["gamma"] if law == 5 else 1 / found["v_s"]
    assert row.friction(s) == pytest.approx(found["Fs"] / (1 + bend * s), rel=1e-5)
    assert row.friction(-s[1:]) == pytest.approx(-row.friction(s[1:]))


def test_the_band_of_a_law_is_the_interval_of_its_friction_level_at_rest(ranking):
    row = ranking.row(5)
    value, low, high = row.friction([0.0, 0.3], band=True)
    level = row.parameters["Fs"]
    np.testing.assert_allclose((value[0], low[0], high[0]), (level.value, level.lo, level.hi), rtol=1e-4)
    np.testing.assert_array_equal(value, row.friction([0.0, 0.3]))
    assert np.all((low < value) & (value < high))


def test_summary_is_a_row_and_a_parameter_an_item(ranking, run):
    (row,) = ranking.summary().to_dict("records")
    assert (row["verdict"], row["law"], row["name"]) == (ranking.verdict, 5, "hyperbolic")
    assert (row["gamma"], row["gamma stderr"]) == (ranking["gamma"].value, ranking["gamma"].stderr)
    assert ranking.summary().attrs["units"]["gamma"] == "s/m"
    with pytest.raises(KeyError, match="did you mean 'gamma'"):
        ranking["gama"]


def test_reports_have_the_form_of_lmfit_and_the_numbers_of_the_row(ranking):
    report, intervals = ranking.fit_report(), ranking.ci_report()
    for part in ("[[Model]]", "[[Fit Statistics]]", "[[Variables]]", "[[Correlations]]", ranking["gamma"].brief):
        assert part in report
    gamma = next(line.split() for line in intervals.splitlines() if line.startswith("gamma:"))
    assert gamma[1:] == [f"{end:.3f}" for end in (ranking["gamma"].lo, ranking["gamma"].value, ranking["gamma"].hi)]
    n, k = ranking.best.fit.residual.size, ranking.best.fit.q.size + ranking.best.fit.local.size
    assert ranking.bic - ranking.aic == pytest.approx(k * (np.log(n) - 2))
    assert ranking.aic == pytest.approx(2 * k + n * np.log(np.mean(ranking.residuals.residual_m**2)), rel=1e-9)


def test_a_saved_ranking_is_loaded_as_it_was(ranking, tmp_path):
    path = ranking.save(tmp_path / "run.ranking")
    loaded = fitting.Ranking.load(path)
    assert without_costs(application.plain(loaded.as_json())) == without_costs(application.plain(ranking.as_json()))
    np.testing.assert_array_equal(loaded.best.position([2.0, 3.0]), ranking.best.position([2.0, 3.0]))
    with pytest.raises(InputError, match="exists"):
        ranking.save(path)
    for name, content in (("none", None), ("other", b"stickslip ranking 0.0\n")):
        if content is not None:
            (tmp_path / name).write_bytes(content)
        with pytest.raises(InputError, match="no such file" if content is None else "was not saved by"):
            fitting.Ranking.load(tmp_path / name)


def test_covariance_has_the_standard_errors_of_the_parameters(ranking):
    found = ranking.covariance
    errors = {name: ranking.best.parameters[name].stderr for name in found}
    assert np.sqrt(np.diag(found)) == pytest.approx(list(errors.values()))
    assert found.attrs["units"]["gamma"] == "s/m"
    assert np.linalg.eigvalsh(ranking.correlation).min() > 0
    scale = np.outer(list(errors.values()), list(errors.values()))
    assert (ranking.correlation * scale).to_numpy() == pytest.approx(found.to_numpy())
    assert list(ranking.bootstrap(3, seed=1)) == list(found)


def test_a_fixed_parameter_has_no_covariance_and_no_profile(run):
    found = fitting.rank(run, laws=5, fix={"gamma": 9.6})
    assert "gamma" not in found.covariance
    with pytest.raises(StickslipError, match="gamma is fixed; choose a fitted parameter"):
        found.best.profile("gamma")


def test_curve_and_forms_are_tables_with_errors(ranking, run):
    curve, forms = ranking.curve, fitting.rank(run, laws=(5, "stribeck")).forms
    assert ((curve.lo < curve.friction) & (curve.friction < curve.hi)).all()
    assert curve.attrs["units"]["friction"] == "N"
    stribeck = forms[forms.name == "stribeck"].iloc[0]
    assert stribeck["chi"] > 2  # it is law 5
    assert stribeck["v_s"] > 0
    assert not stribeck["inside_band"]


def test_a_data_set_has_samples_parameters_and_curve(ranking):
    found = ranking.to_xarray()
    assert found.value.sel(law="5", parameter="gamma").item() == ranking.best.parameters["gamma"].value
    assert np.isnan(found.value.sel(law="5", parameter="v_s"))
    assert (found.fitted - found.position).values == pytest.approx(found.residual.values, abs=1e-12)
    assert found.friction.attrs["units"] == "N"
    assert found.sizes["speed"] == len(ranking.curve)


def test_a_picture_goes_into_axes_that_are_given(ranking):
    from matplotlib.figure import Figure

    axes = Figure().add_subplot()
    assert ranking.plot(ax=axes) is axes.figure
    assert len(axes.get_lines()) >= 2
    assert axes.get_ylabel() == "friction $F$ (N)"


def test_several_runs_have_residuals_each_and_no_common_time(joint):
    left = joint.residuals
    first, second = (left.residual_m[left.run == number].to_numpy() for number in (1, 2))
    assert first == pytest.approx(second, abs=1e-9)
    assert joint.runs[0].best.position(3.0) == pytest.approx(joint.runs[1].best.position(3.0))
    with pytest.raises(StickslipError, match=r"use those of one run: ranking.runs\[0\].row\(5\)"):
        joint.best.position(3.0)
    with pytest.raises(StickslipError, match=r"ranking.best.profile\(name\)"):
        joint.runs[0].best.profile("k/m")
    assert "v_dr (1)" in joint.covariance
    assert list(joint.bootstrap(2, seed=1)) == list(joint.covariance)
    assert joint.best.profile("k/m").deviance.max() > 4


def test_where_no_law_describes_the_record_tables_say_what_to_take(run):
    found = fitting.rank(run, laws=1)
    assert found.adequacy.rejected
    for table in (lambda: found.covariance, lambda: found.correlation, lambda: found.bootstrap(2)):
        with pytest.raises(StickslipError, match=r"use ranking.curve, which needs no law"):
            table()
    assert len(found.curve) > 100
    assert found.residuals.residual_m.std() > 10 * found.adequacy.noise_m
    assert np.isnan(found.to_xarray().stderr.sel(law="1", parameter="k/m"))


@pytest.mark.parametrize("call", [lambda t, x: fitting.rank(t, x, laws=5), daq.Recording.from_arrays])
def test_positions_in_mm_are_asked_about(run, call):
    with pytest.warns(UserWarning, match="are the positions in m"):
        call(run.time, 1000 * run.position)


# A mistake, and the words that say what to do.
MISTAKES = [
    (lambda run: fitting.rank(run.time), "fitting.rank(time, position)"),
    (lambda run: fitting.rank(run, run.position), "pass only the run"),
    (
        lambda run: fitting.rank(run.time, run.position[1:]),
        "time has 6000 values, but position has 5999; pass one value for each sample",
    ),
    (lambda run: fitting.rank([]), "no run; pass at least one"),
    (
        lambda run: fitting.rank(run, fix={"gama": 10}),
        "fix: none of the fitted laws has a parameter gama; did you mean",
    ),
    (lambda run: fitting.rank(run, fix=[("gamma", 10)]), "write fix={'gamma': 9.6}"),
    (lambda run: fitting.rank(run, fix={"gamma": "10"}), "fix: the value of gamma is '10'; write fix="),
    (lambda run: fitting.rank(run, bounds={"gamma": 10}), "write bounds={'gamma': (0, 20)}"),
    (
        lambda run: fitting.rank(run, bounds={"gamma": (10, 5)}),
        "bounds: the lower bound of gamma, 10, is not below the upper one, 5",
    ),
    (lambda run: fitting.rank(run, mass=0.3, stiffness=10), "mass and stiffness cannot be combined; state only one"),
    (lambda run: fitting.rank(run, belt_speed=0), "belt_speed: belt speed is 0"),
    (lambda run: fitting.rank(run, belt_speed="channel"), "belt_speed: the run has no belt counts"),
    (lambda run: fitting.rank(run, begin=3), "fitting.rank('run.h5', begin=5), or slice the arrays"),
    (lambda run: fitting.rank(RUN, begin=30), "choose other times with begin and end"),
    (lambda run: fitting.rank([run, run], excluded=2), "excluded: cycles cannot be excluded from a joint fit"),
    (lambda run: fitting.rank([run, run], belt_speed=0.2), "a joint fit does not accept one belt speed"),
    (lambda run: fitting.rank([run, run], rig=[Rig()]), "rig: 1 rigs for 2 runs; pass one rig for all"),
    (lambda run: fitting.rank(run.time, np.arange(6000)), "daq.Recording.from_arrays(time, counts, metres_per_count="),
    (lambda run: fitting.Law("mine", "Fc + foo(s)"), "formula: unknown function foo; known: exp, log"),
    (
        lambda run: fitting.Law("mine", MINE, start={"v": 1}),
        "start: law mine has no parameter v; did you mean 'v_s'?",
    ),
    (
        lambda run: fitting.Law("mine", MINE, bounds={"v_s": (0.0, None)}, start={"v_s": -1}),
        "start: v_s = -1 is outside",
    ),
    (lambda run: fitting.Law("mine", MINE, bounds={"v_s": (0.2, 0.1)}), "bounds: the lower bound of v_s"),
    (lambda run: fitting.Law("mine", abs), 'write fitting.Law("mine", "Fs/(1 + s/v_s)")'),
]
OF_A_RANKING = [
    (lambda found: fitting.rank(found), "pass a run: fitting.rank(daq.load(path))"),
    (lambda found: found.best.profile("gama"), "law 5 has no parameter 'gama'; did you mean 'gamma'?"),
    (lambda found: found.best.profile("wear"), "wear is computed from other parameters; choose one of k/m"),
    (lambda found: found.best.position("now"), "t: t is 'now'; pass numbers, as in t=np.linspace(0, 1, 101)"),
    (lambda found: found.bootstrap(1), "bootstrap: n must be a whole number, 2 or more, not 1"),
    (lambda found: found.report("other.html"), "choose another name, or force=True to replace it"),
    (lambda found: found.report("run.pdf"), "name it run.html (path); then print the page from a browser"),
    (lambda found: found.save_scene("rig.h5"), "the output is a TOML file; name it rig.toml (path)"),
]


@pytest.mark.parametrize(
    ("mistake", "words", "of"),
    [(*one, "run") for one in MISTAKES] + [(*one, "ranking") for one in OF_A_RANKING],
    ids=[words[:40] for _, words in MISTAKES + OF_A_RANKING],
)
def test_a_mistake_names_keyword_and_cure(mistake, words, of, request, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("there.toml").write_text("mine = 1")
    Path("other.html").write_text(f'{page.MARK} 0.2.0">{"1" * 64}')  # a report of another run
    with pytest.raises(StickslipError) as caught:
        mistake(request.getfixturevalue(of))
    assert words in str(caught.value)
    assert not re.search(r"(?<!\w)--\w", str(caught.value))
    assert {path.name for path in tmp_path.iterdir()} == {"there.toml", "other.html"}
