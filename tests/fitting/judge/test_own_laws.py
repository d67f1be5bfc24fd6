"""Laws of one's own beside the six: the same answers where they are the same curve, and what is said of them."""

import csv
import tomllib
from dataclasses import replace
from types import SimpleNamespace

import h5py
import numpy as np
import pytest

import fitting
from daq.runfile import listing
from daq.runfile.rig import Rig
from fitting import job, rank
from fitting.judge.parameters import RUN_PARAMETERS
from fitting.laws import SIX
from processing.smoothing import smooth
from rig_sim.motion.play import events
from rig_sim.scenes.scene import scene
from stickslip.console import application
from stickslip.errors import DataError, InputError
from stickslip.units import Measured

from .. import command

pytestmark = pytest.mark.usefixtures("asked_laws_alone")
VISCOUS = {"curve": "stribeck", "Fc": 0.6, "v_s": 0.08, "Fv": 0.15, "c": 0.01, "scatter": 0.03, "duration": 10.0}
MINE = "Fc + (Fs - Fc)*exp(-s/v_s) + Fv*s"


def restated(law):
    """Return one of the six under a name of its own, so that its formula is fitted."""
    return replace(SIX[law], name=f"law{law}")


def recorded(belt_rig, **changes):
    """Return a contact, and its record by an encoder."""
    contact = belt_rig.Contact(**VISCOUS | {"seed": 4} | changes)
    return contact, belt_rig.by_encoder(contact, damping_sd=4e-3)


@pytest.fixture(scope="module")
def won(belt_rig, asked_laws_alone):
    """Give a contact that a formula of one's own describes, and its ranking beside law 5."""
    contact, recording = recorded(belt_rig)
    motion = smooth(recording)
    ranking = fitting.rank(motion, laws=(5, fitting.Law("mine", MINE)))
    return SimpleNamespace(contact=contact, recording=recording, motion=motion, ranking=ranking)


@pytest.fixture(scope="module")
def hyperbolic(smoothed):
    """Give a smoothed record of law 5, which costs a third of one that none of the six describes."""
    return smoothed(law=5, duration=8.0)


@pytest.mark.parametrize(
    ("law", "known"),
    [(5, True), (5, False), (3, True), (3, False), (6, True), pytest.param(2, True, marks=pytest.mark.slow)],
)
def test_a_law_typed_as_a_formula_gives_the_answers_of_the_law(belt_rig, law, known):
    """They differed by 0.2 standard errors."""
    recording, ramp = belt_rig.recording(law=law, duration=10.0), law % 2 == 0
    typed = fitting.Law("typed", SIX[law].formula, ramp=ramp)
    ranking = rank(smooth(recording if known else replace(recording, rig=Rig())), laws=(law, typed))
    own, formula = ranking.row(law), ranking.row("typed")
    assert (formula.law, formula.formula, formula.asked) == ("typed", typed.formula, True)
    assert own.in_set
    assert formula.in_set
    assert job.exit_code(ranking.as_json()) == 5  # the same curve twice
    assert formula.rms_m == pytest.approx(own.rms_m, rel=1e-4 if ramp else 1e-6)
    alike = own.parameters.keys() & formula.parameters.keys()
    assert {"k/m", "v_dr", *(("gamma",) if law == 5 else ())} <= alike
    # weights of cycles and noise are estimated by each fit of a ramp for itself
    for name in {"k/m"} if ramp else alike:
        value, error = own.parameters[name].value, own.parameters[name].stderr
        assert formula.parameters[name].value == pytest.approx(value, abs=0.02 * error), name
        assert formula.parameters[name].stderr == pytest.approx(error, rel=0.1), name


def test_a_named_law_that_wins_ends_with_exit_code_0(won):
    document = application.plain(won.ranking.as_json())
    assert (document["set"], document["rivals"]) == ([], ["mine"])
    assert document["adequacy"]["verdict"] == "adequate"
    assert job.exit_code(document) == 0
    assert document["verdict"].startswith(f"law mine, F = {MINE}: ")
    assert "Law 5 (hyperbolic) is worse by" in document["verdict"]
    row = document["ranking"][0]
    assert (row["law"], row["formula"], row["asked"], row["in_set"]) == ("mine", MINE, True, True)
    assert won.ranking.best is won.ranking.row("mine")
    contact = won.contact
    true = {"Fs": contact.Fs, "Fc": contact.Fc, "v_s": contact.v_s, "Fv": contact.Fv, "k": contact.k}
    for name, value in true.items():
        item = row["parameters"][name]
        assert abs(item["value"] - value) < 4 * item["stderr"]
    assert row["parameters"]["Fv"]["unit"] == "N s/m"
    assert row["parameters"]["Fv/m"]["unit"] == "s^-1"


def test_levels_and_ageing_are_those_of_the_law_that_wins(won):
    """They would be those of the best of the six, whose Fs is half of the contact's."""
    levels = [event.break_away_level / event.kinetic_scale for event in won.ranking.events if not event.flag]
    assert np.median(levels) == pytest.approx(1.0, abs=0.02)
    assert won.ranking.adequacy.departures == ()
    assert won.ranking.findings == ()


def test_formulas_alone_may_compete(hyperbolic):
    document = rank(hyperbolic, laws=("stribeck", restated(5))).as_json()
    assert [row["law"] for row in document["ranking"]] == ["law5", "stribeck"]
    assert (document["set"], document["rivals"]) == ([], ["law5"])
    assert document["ranking"][0]["asked"] is True
    assert job.exit_code(document) == 0


def test_parameters_are_fixed_and_bounded(won):
    law = fitting.Law("mine", MINE, bounds={"Fv": (0.0, None)})
    ranking = rank(won.motion, laws=(5, law), fix={"v_s": 0.08, "Fc": 0.6, "k/m": 35.184}, bounds={"5.gamma": (0, 2.0)})
    found = ranking.as_json()["ranking"]
    mine = next(row["parameters"] for row in found if row["law"] == "mine")
    five = next(row["parameters"] for row in found if row["law"] == 5)
    for row, name, value in ((mine, "v_s", 0.08), (mine, "Fc", 0.6), (mine, "k/m", 35.184), (five, "k/m", 35.184)):
        assert (row[name]["value"], row[name]["fixed"]) == (value, True)
        assert row[name]["stderr"] in (0.0, None)
    assert "fixed" not in mine["Fs"]
    assert mine["Fs"]["stderr"] > 0
    assert five["gamma"]["value"] <= 2.0
    free = won.ranking
    assert ranking.row("mine").fit.law_parameters == free.row("mine").fit.law_parameters - 3
    assert ranking.row(5).fit.law_parameters == free.row(5).fit.law_parameters - 1


def test_what_is_given_of_the_six_holds_in_the_fit(smoothed, hyperbolic):
    motion = smoothed(law=6, duration=8.0)
    free = rank(motion, laws=(6,))
    given = {"gamma": 9.618, "d": 0.03, "v_dr": 0.22, "x0": 0.0, "c/m": 0.0, "Fs/m": 4.6}
    held = rank(motion, laws=(5, 6), fix=given, start={"k/m": 36.0})
    assert held.laws_in_set == (6,)
    for name, value in given.items():
        item = held.row(6).parameters[name]
        assert (item.value, item.stderr, item.fixed) == (value, 0.0, True)
    assert held.row(6).parameters["k/m"].stderr < 0.7 * free.row(6).parameters["k/m"].stderr
    assert held.row(6).rms_m < 1.02 * free.row(6).rms_m
    # what is wrong is seen in the fit
    wrong = rank(hyperbolic, laws=(5,), fix={"gamma": 8.0})
    assert wrong.row(5).parameters["gamma"].value == 8.0
    assert not wrong.adequacy.adequate


def test_the_slope_of_law_3_is_fixed_in_newtons(smoothed):
    ranking = rank(smoothed(law=3, duration=10.0), laws=(3, 5), fix={"G_slip": 0.6})
    assert (ranking.laws_in_set, ranking.rivals) == ((3,), ())
    row = ranking.as_json()["ranking"][0]
    assert (row["law"], row["name"]) == (3, "linear")
    assert "formula" not in row
    assert row["parameters"]["G_slip"] == {**row["parameters"]["G_slip"], "value": 0.6, "stderr": 0.0, "fixed": True}
    assert row["parameters"]["Fs"]["value"] == pytest.approx(1.3793, rel=3e-3)


def test_parameters_that_enter_only_as_a_product_are_said_to_be_undetermined(hyperbolic):
    law = fitting.Law("two", "a*b/(1 + s/v_s)")
    ranking = rank(hyperbolic, laws=(5, law))
    assert any("friction depends only on a combination of a and b" in text for text in ranking.warnings)
    (found,) = (row["parameters"] for row in ranking.as_json()["ranking"] if row["law"] == "two")
    assert found["a"]["stderr"] is found["b"]["stderr"] is None
    assert found["v_s"]["stderr"] > 0
    assert found["a"]["value"] * found["b"]["value"] == pytest.approx(1.379, rel=0.05)
    fixed = rank(hyperbolic, laws=(5, law), fix={"b": 1.0})
    assert not any("product" in text for text in fixed.warnings)
    assert fixed.row("two").parameters["a"].stderr > 0
    assert ranking.row("two").fit.law_parameters == fixed.row("two").fit.law_parameters


UNFITTABLE = {
    "-abs(Fs)": "friction is negative",
    "Fs*s": "friction is not above 0",
    "Fs/(1e-300+s)": "overflow",
    "Fs + b*log(s)": "log of 0",
}


@pytest.fixture(scope="module")
def beside_unfittable(hyperbolic, asked_laws_alone):
    """Rank law 5 beside formulas that are no friction curve with any values, called mine0, mine1 and so on."""
    return rank(hyperbolic, laws=(5, *(fitting.Law(f"mine{k}", formula) for k, formula in enumerate(UNFITTABLE))))


@pytest.mark.parametrize(("number", "formula"), list(enumerate(UNFITTABLE)))
def test_a_law_that_cannot_be_fitted_is_a_row_that_says_why(beside_unfittable, number, formula):
    name, reason, ranking = f"mine{number}", UNFITTABLE[formula], beside_unfittable
    assert ranking.best.law == 5
    fitted, *others = ranking.as_json()["ranking"]
    (missing,) = (row for row in others if row["law"] == name)
    assert (fitted["fitted"], missing["fitted"], missing["formula"]) == (True, False, formula)
    assert reason in missing["reason"]
    assert {missing[key] for key in ("score", "weight", "rms_m", "cycles", "orbit_distance", "cpu_s")} == {None}
    assert (missing["in_set"], missing["parameters"], set(fitted) - set(missing)) == (False, {}, set())
    table = ranking.to_dataframe().set_index("law")
    assert set(table.index) == {5, *(f"mine{k}" for k in range(len(UNFITTABLE)))}
    assert reason in table.reason[name]
    assert "not fitted" in ranking._repr_html_()
    with pytest.raises(KeyError, match="was not fitted: "):
        ranking.row(name)


def test_where_no_requested_law_can_be_fitted_each_reason_is_said(hyperbolic):
    with pytest.raises(
        DataError, match=r"none of the requested laws can be fitted \(law mine: .*negative.*; law two: "
    ):
        rank(hyperbolic, laws=(fitting.Law("mine", "-abs(Fs)"), fitting.Law("two", "Fs*s")))


@pytest.mark.parametrize(
    ("stiffness", "laws", "given", "said"),
    [
        (None, (5,), {"start": {"Fs": "1.4 N"}}, "the mass is not known"),
        (Measured(10.5552, 0.01), (5, fitting.Law("mine", MINE)), {"fix": {"mine.Fc": 0.6}}, "depends on k/m"),
    ],
)
def test_a_value_in_newtons_needs_a_mass(hyperbolic, stiffness, laws, given, said):
    rig = replace(hyperbolic.recording.rig, mass=None, stiffness=stiffness)
    with pytest.raises(InputError, match=said):
        rank(hyperbolic, rig, laws=laws, **given)


def test_a_mass_that_grazes_the_belt_may_have_a_formula(smoothed):
    ranking = rank(smoothed(law=1, duration=10.0), laws=(1, 2, fitting.Law("level", "F0")))
    assert ranking.row("level").in_set
    assert ranking.laws_in_set == (1,)
    assert ranking.verdict.startswith("without a sustained stick")


def test_runs_are_fitted_together_with_a_formula(smoothed):
    speeds = (0.18, 0.28)
    runs = [smoothed(law=5, belt=v, seed=n, duration=9.0) for n, v in enumerate(speeds)]
    ranking = rank(runs, laws=(5, fitting.Law("mine", "Fs/(1 + s/v_s)")))
    row = ranking.row("mine")
    assert row.in_set
    for number, belt in enumerate(speeds, start=1):
        item = row.parameters[f"v_dr ({number})"]
        assert abs(item.value - belt) < 4 * item.stderr
        side = ranking.sides[number - 1].row("mine")
        assert not {name for name in side.parameters if "(1)" in name}
        assert len(side.fit.cycles) < len(row.fit.cycles)
    assert not set(RUN_PARAMETERS) & row.parameters.keys()
    assert abs(row.parameters["v_s"].value - 1 / 9.618) < 4 * row.parameters["v_s"].stderr
    document = application.plain(ranking.as_json())
    assert "mine" in document["runs"][0]["rms_by_law"]
    with pytest.raises(InputError, match="a joint fit does not accept one belt speed for all runs"):
        rank(runs, laws=(5,), fix={"v_dr": 0.2})


@pytest.fixture
def run(won, belt_rig, tmp_path):
    return belt_rig.written(tmp_path / "run.h5", won.recording)


def test_files_hold_a_formula_whose_names_a_scene_changes_where_its_section_has_them(run, tmp_path):
    curve, table, file = tmp_path / "curve.csv", tmp_path / "ranking.csv", tmp_path / "rig.toml"
    text = "Fc + d*exp(-s/static) + Fv*s"
    answer = command.fit(
        run, laws="5", law=[f"mine: {text}"], csv=table, curve_csv=curve, save_scene=file, no_report=True
    )
    assert answer.exit_code == 0
    found = application.plain(answer.data)["ranking"][0]["parameters"]
    with table.open() as opened:
        rows = list(csv.DictReader(opened))
    assert [(row["law"], row["formula"]) for row in rows] == [("mine", text), ("5", "")]
    with curve.open() as opened:
        columns = next(csv.reader(opened))
    assert columns[-1] == "law mine (N)"
    with h5py.File(run) as opened:
        assert list(opened["entry/fit/formulas/law_name"].asstr()) == ["mine"]
        assert opened["entry/fit_law_mine/parameters/static"][()] == found["static"]["value"]
        assert "friction_curve" in opened["entry/fit_law_mine"]
    (row,) = listing.list_runs([run.parent])
    assert row.part == "law 5; with law mine"
    friction = tomllib.loads(file.read_text())["friction"]
    assert friction["formula"] == "Fc + d_*exp(-s/static_) + Fv*s"
    for name, own in {"Fc": "Fc", "d_": "d", "static_": "static"}.items():
        assert friction[name] == found[own]["value"]
    played = events(scene(file), 20.0)
    assert played.outcome == "completed"
    assert len(played.events) > 10
    # fitted again without the formula, its group is gone
    command.fit(run, laws="5", no_report=True)
    with h5py.File(run) as opened:
        assert "fit_law_mine" not in opened["entry"]


def test_a_law_without_free_parameters_is_fitted(hyperbolic):
    law = fitting.Law("mine", "Fs/(1 + gamma*s)", fix={"Fs": "4.6 m/s^2", "gamma": "9.6e-3 s/mm"})  # a ValueError
    assert rank(hyperbolic, laws=(5, law)).row("mine").rms_m < 1e-4
