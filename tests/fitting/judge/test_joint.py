"""Several runs of one contact fitted together: one law, one spring, a belt speed for each run."""

import shutil
import subprocess
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path

import h5py
import numpy as np
import pytest

from daq.runfile import joint, listing, store
from daq.runfile.recording import Recording
from fitting import drawing, palette, rank
from fitting.report import page, pictures
from processing.smoothing import smooth
from stickslip.errors import DataError, InputError

from .. import command

pytestmark = pytest.mark.usefixtures("undrawn_reports", "asked_laws_alone")
SPEEDS = (0.15, 0.2, 0.3)


@pytest.fixture(scope="module")
def runs_of(belt_rig):
    """Give a function that smooths one contact's runs at three belt speeds, nominal disturbances and all."""

    @cache
    def of(law, seed, **changes):
        scenes = [belt_rig.nominal(law, seed, belt=speed, duration=11.0) for speed in SPEEDS]
        return [smooth(belt_rig.recording(scene, **changes, seed=10 * seed + n)) for n, scene in enumerate(scenes)]

    return of


@pytest.mark.slow
def test_a_spring_one_percent_hard_is_seen_in_runs_fitted_together(belt_rig, tmp_path):
    """Joint fits were rejected from 1.5 times the noise on; this spring leaves 1.0 times."""
    hard = 0.01 * 10.5552 / 0.177**2
    runs = []
    for seed, belt in enumerate((0.15, 0.22, 0.3), start=1):
        contact = belt_rig.Contact(belt=belt, duration=16.0, scatter=0.03, k3=hard, seed=seed)
        time, position = belt_rig.recorded(contact, count=50e-6)
        runs.append(smooth(belt_rig.imported(tmp_path / f"{seed}.csv", time, position, decimals=7)))
    found = rank(runs, laws=(5,)).adequacy
    assert found.verdict == "none of the laws fitted"
    assert found.goodness.misfit < 1.1
    assert found.departures[0].name == "spring-nonlinear"
    assert found.departures[0].value == pytest.approx(hard / 0.3, rel=0.1)


@pytest.fixture(scope="module")
def law_five(runs_of, asked_laws_alone):
    """Give the joint fit of law 5 alone to its own runs."""
    return rank(runs_of(5, 2), laws=(5,))


def test_runs_of_one_contact_share_all_but_their_belts(law_five):
    assert "of 3 runs" in law_five.verdict
    assert law_five.best.cycles == sum(run.best.cycles for run in law_five.runs)
    assert law_five.best.parameters["k/m"].value == pytest.approx(35.184, rel=1e-3)
    for speed, run in zip(SPEEDS, law_five.runs, strict=True):
        assert run.best.parameters["v_dr"].value == pytest.approx(speed, rel=3e-3)
        assert run.best.parameters["k/m"] == law_five.best.parameters["k/m"]


@pytest.mark.slow
def test_narrow_ramps_are_told_from_belts_that_give_by_a_share_of_their_speed(simulated):
    changes = ("droop.fraction=0.01", "friction.law=5")
    runs = [simulated(f"belt.speed={speed}", *changes, f"seed={number}") for number, speed in enumerate(SPEEDS)]
    assert rank(runs[1], laws=(5, 6)).laws_in_set == (5, 6)
    assert rank(runs, laws=(5, 6)).laws_in_set == (5,)


def test_runs_that_stick_and_runs_that_graze_are_not_one_contact(runs_of):
    with pytest.raises(DataError, match="but other runs have"):
        rank([runs_of(5, 2)[1], runs_of(1, 3, kick=0.0)[1]])


@pytest.fixture(scope="module")
def files(tmp_path_factory, belt_rig, runs_of):
    folder, paths = tmp_path_factory.mktemp("joint"), []
    for number, kinematics in enumerate(runs_of(5, 2), start=1):
        paths.append(belt_rig.written(folder / f"run{number}.h5", kinematics.recording))
    return paths


@pytest.fixture(scope="module")
def fitted(files, undrawn_reports, asked_laws_alone):
    """Give the answer of a joint fit, and what the files of the runs held before."""
    before = [path.read_bytes() for path in files]
    return command.fit(*files, laws="3,5"), before


def test_the_command_writes_the_fit_of_several_runs_into_one_file_beside_the_first(files, fitted):
    """Each run's file and a report beside it used to be written."""
    answer, before = fitted
    assert answer.data["set"] == [5]
    assert answer.exit_code == 0
    assert [run["file"] for run in answer.data["runs"]] == files
    assert {cycle["run"] for cycle in answer.data["cycles"]} == {1, 2, 3}
    assert answer.data["joint_file"] == files[0].with_name("run1+2.fit.h5")
    assert answer.data["report"] == files[0].with_name("run1+2.report.html")
    page = answer.data["report"].read_text()
    assert [path.read_bytes() for path in files] == before
    assert sorted(path.name for path in files[0].parent.iterdir()) == sorted(
        [*(path.name for path in files), "run1+2.fit.h5", "run1+2.report.html"]
    )
    with h5py.File(answer.data["joint_file"]) as file:
        entry = file["entry"]
        assert entry["fit/parameters/verdict"][()].decode() == answer.data["verdict"]
        assert list(entry["fit/ranking/law"]) == [3, 5]
        signal = entry[entry.attrs["default"]]
        signal = signal[signal.attrs["default"]]
        assert signal[signal.attrs["signal"]].shape == (2,)
        assert entry["runs/file"].asstr()[:].tolist() == [path.name for path in files]
        assert entry["fit_law5/parameters/gamma"].attrs["units"] == "s/m"
        assert "v_dr" not in entry["fit_law5/parameters"]
        for number, (path, speed, run) in enumerate(zip(files, SPEEDS, answer.data["runs"], strict=True), start=1):
            digest = store.load(path).digest
            assert entry["runs/sha256_raw"].asstr()[number - 1] == digest
            assert digest in page
            own = entry[f"fit_law5/parameters_run{number}/v_dr"][()]
            assert own == run["parameters"]["v_dr"]["value"] == pytest.approx(speed, rel=3e-3)
            assert entry[f"fit/cycles_run{number}/t"].size == sum(
                cycle["run"] == number for cycle in answer.data["cycles"]
            )


@pytest.mark.slow
def test_the_file_of_a_joint_fit_passes_the_nexus_validator(fitted):
    tool = Path(sys.executable).with_name("nxcheck")
    done = subprocess.run([tool, fitted[0].data["joint_file"]], check=True, capture_output=True, text=True)
    assert "Total number of warnings: 0" in done.stdout
    assert "Total number of errors: 0" in done.stdout


def test_a_joint_fit_is_listed_and_is_no_run(files, fitted, tmp_path, capsys):
    joint_file = fitted[0].data["joint_file"]
    (row,) = [row for row in listing.list_runs([files[0].parent]) if row.runs]
    assert (row.file, row.runs, row.problem) == (joint_file, 3, None)
    assert row.verdict.startswith("law 5 ")
    with pytest.raises(InputError, match="contains a joint fit, not a run"):
        store.load(joint_file)
    copy = Path(shutil.copy(files[0], tmp_path))
    answer = command.fit(copy, joint_file, each=True, laws="5", no_report=True)  # a pattern named both
    assert [run["file"] for run in answer.data["runs"]] == [copy]
    assert f"{joint_file} contains a joint fit and is skipped" in capsys.readouterr().err
    with pytest.raises(InputError, match="all files contain joint fits, not runs"):
        command.fit(joint_file, each=True)


@pytest.mark.parametrize("content", ["mine", "run", "joint fit"])
def test_a_foreign_file_is_refused_before_a_joint_fit_and_replaced_by_force(files, tmp_path, content):
    copies = [Path(shutil.copy(path, tmp_path)) for path in files]
    named = [store.load(path) for path in copies]
    place = joint.name_output(copies[:2])
    if content == "mine":
        place.write_text(content)
    elif content == "run":
        shutil.copy(files[0], place)
    else:
        joint.write(place, [named[0], named[2]], lambda entry: None)
    before = place.read_bytes()
    with pytest.raises(InputError, match="other runs" if content == "joint fit" else "not the file of a joint fit"):
        command.fit(*copies[:2], laws="5", no_report=True)
    assert place.read_bytes() == before
    joint.write(place, named[:2], lambda entry: None, force=True)
    joint.refuse_foreign_file(place, named[1::-1])


def test_no_joint_fit_replaces_one_of_its_runs(files, tmp_path):
    first, other = tmp_path / "a.h5", tmp_path / "a+1.fit.h5"
    shutil.copy(files[0], first)
    shutil.copy(files[1], other)
    with pytest.raises(InputError, match="is also an input"):
        command.fit(first, other, laws="5", no_report=True, force=True)


def test_the_page_of_a_joint_fit_has_all_runs_in_every_picture(runs_of, law_five):
    with drawing.look():
        shown = (pictures.cycle, pictures.record, pictures.residuals, pictures.break_aways)
        texts = [pictures.embed(*picture(law_five), "one") for picture in shown]
    for text in texts:
        for number in (1, 2, 3):
            assert f">run {number}</text>" in text
            assert palette.run_colour(number).lower() in text


def test_the_page_of_a_joint_fit_has_a_line_and_a_row_of_each_run(runs_of, law_five):
    """The first screen asked for the one belt speed of the joint fit, which has one of each run."""
    text = page.render(law_five)
    for number, side in enumerate(law_five.runs, start=1):
        speed = side.best.parameters["v_dr"]
        assert f"<p>run {number}: " in text
        assert f"belt {speed.value:.{speed.decimals}f} ± {speed.stderr:.{speed.decimals}f} m/s" in text


@pytest.mark.slow
def test_several_processes_give_the_same_ranking_to_the_last_bit(smoothed):
    runs = [smoothed(law=4, duration=10.0, belt=speed) for speed in SPEEDS[1:]]
    alone, side_by_side = (rank(runs, laws=(4, 5), jobs=jobs) for jobs in (1, 2))
    for one, other in zip(alone.rows, side_by_side.rows, strict=True):
        for name in ("law", "score", "rms_m", "parameters"):
            assert getattr(one, name) == getattr(other, name)
        assert (one.fit.residual == other.fit.residual).all()
    assert alone.verdict == side_by_side.verdict


@pytest.mark.slow
def test_runs_of_two_contacts_are_not_one_though_a_curve_describes_both(belt_rig):
    # Each run has levels and a rest position of its own, so a logarithmic curve described both at 1.08 times the noise.
    contacts = [belt_rig.Contact(Fs=1.1, gamma=8.0, belt=0.1), belt_rig.Contact(Fs=1.5, gamma=4.0, belt=0.2, seed=2)]
    runs, time = [], np.arange(0.0, 25.0, 1 / 240)
    for number, contact in enumerate(contacts):
        noise = np.random.default_rng(number).normal(0.0, 2e-4, time.size)
        made = belt_rig.simulate(replace(contact, c=0.02, scatter=0.03, duration=25.0), time) + noise
        runs.append(Recording.from_arrays(time, made))
    ranking = rank(runs, mass=0.3)
    assert [finding.code for finding in ranking.findings] == ["not-one-contact"]
    assert ranking.verdict.startswith("these runs do not share one contact: law 5 describes each run separately")
    assert not ranking.laws_in_set
    assert ranking.adequacy.verdict != "adequate"
    assert all(row.weight is None and not row.in_set for row in ranking.rows)


@pytest.mark.slow
def test_levels_that_differ_between_runs_alone_determine_no_rest_position(belt_rig):
    # The levels of two runs trade against their rest positions: x0 was 15.0 +- 0.4 mm for 0.
    one = belt_rig.Contact(curve="stribeck", Fs=1.5, Fc=0.9, v_s=0.03, Fv=0.0, m=0.5, k=80.0, belt_start=1.0)
    runs = []
    for belt in (0.05, 0.1):
        time = np.arange(0.0, 15.0, 0.004)
        noise = np.random.default_rng(round(1e3 * belt)).normal(0.0, 1e-4, time.size)
        runs.append(
            Recording.from_arrays(time, belt_rig.simulate(replace(one, belt=belt, duration=15.0), time) + noise)
        )
    assert "x0 (1)" not in rank(runs, laws=(5, "stribeck")).row("stribeck").parameters


@pytest.mark.slow
def test_runs_of_two_contacts_accuse_no_rest_position_that_each_agrees_with(belt_rig):
    # Without x0 a Stribeck curve came near both, each with a rest position of its own, and x0 was "contradicted" twice.
    contacts = [belt_rig.Contact(Fs=1.1, gamma=9.6, belt=0.1), belt_rig.Contact(Fs=1.5, gamma=4.5, belt=0.2, seed=2)]
    contacts = [replace(contact, c=0.02, scatter=0.03, duration=20.0) for contact in contacts]
    runs = [belt_rig.by_encoder(contact) for contact in contacts]
    ranking = rank(runs, laws=(5, "stribeck-viscous"), mass=0.3, x0=(1e-4, 1e-4))
    assert {finding.code for finding in ranking.findings} == {"not-one-contact"}
