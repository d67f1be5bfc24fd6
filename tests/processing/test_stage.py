"""The smoothed stage in the run file: read back as written, raw data untouched, open to other readers."""

from dataclasses import replace

import h5py
import numpy as np
import pytest
import xarray

import daq
from daq.runfile import store
from processing import cli, stage
from processing.record.motion import Finding
from processing.smoothing import smooth, smooth_file
from processing.statistics import from_kinematics
from stickslip.errors import InputError


@pytest.fixture
def path(tmp_path, motion, run_data):
    target = tmp_path / "run.h5"
    store.write(target, run_data(motion(5, 5.0, start=0.5)))
    return target


@pytest.fixture
def saved(path):
    """Return a run file with its stage, and the motion that was saved."""
    made = smooth(daq.load(path))
    stage.save(made, path)
    return path, made


def raw_bytes(path):
    with h5py.File(path) as file:
        found = {}

        def visit(name, item):
            if isinstance(item, h5py.Dataset) and not name.startswith("entry/smooth"):
                found[name] = np.asarray(item[()]).tobytes()

        file.visititems(visit)
        return found


def test_what_was_saved_is_loaded(path):
    findings = (Finding("spikes", "3 samples out of line", 3.0), Finding("belt-speed", "0.22 m/s", 0.22, 0.3, 41.0))
    made = replace(smooth(daq.load(path)), findings=findings)
    stage.save(made, path)
    found = stage.load(path)
    assert found.noise == made.noise > 0
    assert str(found.findings) == str(findings)
    for name in ("time", "position", "velocity", "acceleration", "stick"):
        assert np.array_equal(getattr(found, name), getattr(made, name))
    for name in ("position_errors", "velocity_errors", "acceleration_errors"):
        assert getattr(found, name) == pytest.approx(getattr(made, name), rel=1e-6)
    for name in ("method", "window", "order", "times", "belt_speed", "losses", "repaired", "cpu_s"):
        assert getattr(found, name) == getattr(made, name)
    for one, other in zip(found.phases, made.phases, strict=True):
        assert replace(one, start_sd=0, end_sd=0) == replace(other, start_sd=0, end_sd=0)
        assert (one.start_sd, one.end_sd) == pytest.approx((other.start_sd, other.end_sd), rel=1e-6)
    for one, other in zip(found.corners, made.corners, strict=True):
        assert (one.time, one.what) == (other.time, other.what)
        assert one.sd == pytest.approx(other.sd, rel=1e-6)
    assert found.recording.default == "smooth"


def test_a_part_of_a_run_is_smoothed_and_read_back(path):
    before = raw_bytes(path)
    cli.smooth(path, method="sg", window="21", begin="1.5", end="4 s")
    found = stage.load(path)
    assert found.time[[0, -1]] == pytest.approx([1.5, 4.0], abs=2e-3)
    own = store.select_between(path, 1.5, 4.0)
    assert np.array_equal(found.position, smooth(store.load(path, own), "sg", 21).position)
    assert found.recording.time.size == own.stop - own.start
    assert raw_bytes(path) == before
    whole = smooth_file(path, "sg", 21, samples=own)
    assert whole.samples == found.samples
    assert np.array_equal(stage.load(path).velocity, found.velocity)


def test_noise_of_a_stage_written_before_it_was_kept_is_estimated_again(saved):
    path, made = saved
    with h5py.File(path, "r+") as file:
        del file["entry/smooth/parameters/noise"]
    assert stage.load(path).noise == made.noise


def test_the_statistics_are_stored_with_units_and_computed_for_an_older_stage(saved):
    path, made = saved
    expected = from_kinematics(made).as_json()
    stored = stage.load_statistics(path)
    assert repr(stored.as_json()) == repr(expected)
    with xarray.open_dataset(path, engine="h5netcdf", group="entry/smooth/break_aways") as table:
        assert table["break_away"].dims == ("time",)
        assert table["break_away"].attrs["units"] == "m"
        assert table["break_away"].values.tolist() == [row["break_away_m"] for row in expected["break_aways"]]
    with h5py.File(path, "r+") as file:
        counted = file["entry/smooth/statistics"]
        assert counted["slips"][()] == expected["slips"] > 3
        assert counted["break_away_mean"][()] == expected["break_away_m"]["mean"]
        assert counted["break_away_trend"].attrs["units"] == "m/s"
        del file["entry/smooth/statistics"]
        del file["entry/smooth/break_aways"]
    assert repr(stage.load_statistics(path).as_json()) == repr(expected)


def test_a_run_that_was_not_smoothed_has_no_stage(path):
    assert stage.load(path) is None
    with pytest.raises(InputError, match=r"not smoothed yet; run 'process smooth run\.h5'"):
        stage.load_statistics(path)


def test_unknown_numbers_survive_the_file(tmp_path, imported, path, run_data, motion):
    still = motion(5, 0.4, start=0.5)  # the belt has not started yet
    target = tmp_path / "still.h5"
    store.write(target, run_data(still))
    stage.save(smooth(daq.load(target)), target)
    found = stage.load(target)
    assert np.isnan(found.belt_speed)
    assert found.phases == ()


def test_xarray_reads_the_kinematics_the_default_plot_and_the_whole_tree(saved):
    """Plot and tree ended in KeyError 'time': the linked fields had their dimension scale in another group."""
    path, made = saved
    for group, name in (("kinematics", "velocity"), ("phase_portrait", "velocity"), ("phase_portrait", "position")):
        with xarray.open_dataset(path, engine="h5netcdf", group=f"entry/smooth/{group}") as table:
            assert table[name].dims == ("time",)
            assert np.array_equal(table["time"].values, made.time)
            assert np.array_equal(table[name].values, getattr(made, name))
            if group == "kinematics":
                assert table["velocity"].attrs["units"] == "m/s"
                assert table["velocity_errors"].dtype == np.float32
    with xarray.open_datatree(path, engine="h5netcdf", phony_dims="sort") as tree:
        assert np.array_equal(tree["entry/smooth/phase_portrait/velocity"].values, made.velocity)


def test_every_field_written_is_in_the_tree(saved):
    path, _ = saved
    with h5py.File(path) as file:
        written = []
        file["entry"].visititems(lambda name, item: written.append(name) if isinstance(item, h5py.Dataset) else None)
    of_stage = {name for name in written if name.startswith("smooth/") and not name.startswith("smooth/model/")}
    assert of_stage
    assert of_stage <= {row.path for row in stage.TREE}


def test_a_stage_made_from_other_raw_data_is_refused(saved):
    path, _ = saved
    with h5py.File(path, "r+") as file:
        del file["entry/smooth/parameters/sha256_input"]
        file["entry/smooth/parameters/sha256_input"] = "0" * 64
    with pytest.raises(InputError, match=r"computed from other raw data; run 'process smooth run\.h5"):
        stage.load(path)


@pytest.mark.parametrize(
    ("law", "spikes"),
    [
        pytest.param(5, 0, id="sticks"),
        pytest.param(1, 0, id="few sticks"),
        pytest.param(6, 0, id="creep"),
        pytest.param(5, 300, id="spikes"),
        pytest.param(0, 0, id="none"),
    ],
)
def test_a_stored_model_smooths_the_run_again_without_learning(
    tmp_path, motion, recorded, imported, law, spikes, monkeypatch
):
    """What was found while the model was learned is what the model finds, to the last bit."""
    time = np.arange(20_000) / 1e3
    record = recorded(motion(law, 20.0)) if law else imported(time, np.round(0.1 * np.sin(6 * time), 6))
    if spikes:
        rng = np.random.default_rng(3)
        at = rng.choice(record.count.size, spikes, replace=False)
        count = record.count.copy()
        count[at] += rng.choice([-1, 1], spikes) * rng.integers(400, 4000, spikes)
        record = replace(record, count=count, position=count * record.rig.metres_per_count.value)
    store.write(tmp_path / "model.h5", record)
    run = daq.load(tmp_path / "model.h5")
    made = smooth(run)
    stage.save(made, tmp_path / "model.h5")
    stored = stage.load(tmp_path / "model.h5").model
    assert ("sticks" in stored["method"]) == bool(law)
    monkeypatch.setattr("processing.blocks.learn", None)
    again = smooth(run, model=stored)
    assert np.array_equal(again.velocity, made.velocity)
    assert np.array_equal(again.velocity_errors, made.velocity_errors)
    assert again.phases == made.phases
    assert again.faults == made.faults
    assert len(made.faults) >= 0.9 * spikes


def test_every_float_of_a_stored_model_has_units(saved):
    path, _ = saved
    floats = []
    with h5py.File(path) as file:
        file["entry/smooth/model"].visititems(
            lambda name, found: (
                floats.append(found) if isinstance(found, h5py.Dataset) and found.dtype.kind == "f" else None
            )
        )
        assert len(floats) > 20
        assert all("units" in found.attrs for found in floats)
        assert file["entry/smooth/model/method/sticks/even/process_density"].attrs["units"] == "m^2/s^7"
