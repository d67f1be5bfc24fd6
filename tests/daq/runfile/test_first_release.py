"""Run files and journals of the first release load, recover, smooth and fit with the numbers it gave, or nearly."""

import contextlib
import gzip
import io
import json
import shutil
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import daq
import fitting
import processing
from daq.cli.app import app
from daq.runfile import store
from processing import stage
from stickslip.console import application

FIXTURES = Path(__file__).with_name("fixtures")
NUMBERS = json.loads((FIXTURES / "numbers.json").read_text())


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with the run files, those of the journals recovered."""
    folder = tmp_path_factory.mktemp("first-release")
    for name in ("simulated", "imported"):
        (folder / f"{name}.h5").write_bytes(gzip.decompress((FIXTURES / f"{name}.h5.gz").read_bytes()))
    for name in ("clean.h5.part", "damaged.h5.part", "damaged.h5.markers"):
        shutil.copy(FIXTURES / name, folder / name)
    for name in ("clean", "damaged"):
        with contextlib.chdir(folder), contextlib.redirect_stdout(io.StringIO()) as said:
            assert application.run(app, ["recover", f"{name}.h5.part", "--json"]) == 0
        (folder / f"{name}.json").write_text(said.getvalue())
    return folder


@pytest.mark.parametrize("name", ["clean", "damaged"])
def test_a_journal_recovers_with_the_same_counts(files: Path, name: str) -> None:
    found, wanted = json.loads((files / f"{name}.json").read_text()), NUMBERS[name]["recover"]
    assert len(found.pop("warnings")) == len(wanted["warnings"])
    for key in wanted.keys() - {"warnings"}:
        assert found[key] == pytest.approx(wanted[key], rel=1e-9), key


@pytest.mark.parametrize("name", list(NUMBERS))
def test_a_run_loads_with_the_same_content(files: Path, name: str) -> None:
    run, wanted = daq.load(files / f"{name}.h5"), NUMBERS[name]["load"]
    assert run.digest == wanted["digest"]
    assert (run.title, run.started, run.unit) == (wanted["title"], wanted["started"], wanted["unit"])
    assert (run.time.size, len(set(run.segment.tolist()))) == (wanted["samples"], wanted["segments"])
    assert run.time[-1] == pytest.approx(wanted["duration"], abs=1e-12)
    assert run.position[-1] == wanted["last"]
    assert float(run.position.sum()) == pytest.approx(wanted["sum"], rel=1e-12)
    assert (run.rig.to_toml(), run.config_toml) == (wanted["rig"], wanted["config"])
    assert run.clock_ppm == pytest.approx(wanted["ppm"])
    assert set(wanted["provenance"]) <= set(run.provenance)
    events = sorted(zip(run.event_sample.tolist(), run.event_kind, run.event_note, strict=True))
    assert [event[:2] for event in events] == [tuple(event[:2]) for event in wanted["events"]]
    if wanted["belt"] is None:
        assert run.belt_count is None
    else:
        assert run.belt_count[-1] == wanted["belt"][0]
        assert float(run.belt_velocity.sum()) == pytest.approx(wanted["belt"][1], rel=1e-9)


def test_the_truth_of_a_simulated_run_is_read(files: Path) -> None:
    truth, wanted = store.truth(files / "simulated.h5"), NUMBERS["simulated"]["truth"]
    assert (truth.time.size, truth.scene) == (wanted["samples"], wanted["scene"])
    for name in ("x", "v", "F"):
        assert float(getattr(truth, name).sum()) == pytest.approx(wanted[name], rel=1e-12)
    assert store.truth(files / "imported.h5") is None


def test_the_stored_smoothing_is_read(files: Path) -> None:
    motion, wanted = stage.load(files / "simulated.h5"), NUMBERS["simulated"]["smooth"]
    assert (motion.method, motion.window, motion.order) == (wanted["method"], wanted["window"], wanted["order"])
    assert motion.belt_speed == wanted["belt_speed"]
    assert [[phase.kind, phase.start, phase.end] for phase in motion.phases] == wanted["phases"]
    assert daq.load(files / "simulated.h5").default == "fit"


@pytest.fixture(scope="module")
def smoothed(files: Path) -> Callable[[str], processing.Kinematics]:
    return cache(lambda name: processing.smooth(daq.load(files / f"{name}.h5")))


@pytest.mark.parametrize("name", list(NUMBERS))
def test_a_run_smooths_to_the_same_motion(smoothed: Callable[[str], processing.Kinematics], name: str) -> None:
    motion, wanted = smoothed(name), NUMBERS[name]["motion"]
    assert motion.method == wanted["method"]
    assert sum(phase.kind == "stick" for phase in motion.phases) == wanted["sticks"]
    # Landings lie elsewhere by parts of a sample, where the acceleration jumps; at some the mass overtakes the belt.
    assert motion.belt_speed == pytest.approx(wanted["belt_speed"], rel=4e-6)
    assert float(np.sqrt(np.mean(motion.velocity**2))) == pytest.approx(wanted["rms_velocity"], rel=4e-6)
    assert float(np.sqrt(np.mean(motion.acceleration**2))) == pytest.approx(wanted["rms_acceleration"], rel=2e-3)


def test_a_simulated_run_smooths_to_its_true_velocity(
    files: Path, smoothed: Callable[[str], processing.Kinematics]
) -> None:
    motion, truth = smoothed("simulated"), store.truth(files / "simulated.h5")
    error = motion.velocity - np.interp(motion.time, truth.time, truth.v)
    assert float(np.sqrt(np.mean(error**2))) < 0.2e-3


@pytest.mark.usefixtures("asked_law_alone")
@pytest.mark.parametrize("name", ["simulated", "imported"])
def test_a_run_fits_with_the_same_parameters(smoothed: Callable[[str], processing.Kinematics], name: str) -> None:
    wanted: Any = NUMBERS[name]["fit"]
    found = fitting.rank(smoothed(name), laws=wanted["laws"])
    # Evidence counts effective samples, where it counted cycles: a set can be smaller.
    assert found.laws_in_set[0] == wanted["set"][0]
    assert set(found.laws_in_set) <= set(wanted["set"])
    rows = {str(row.law): row for row in found.rows}
    for law, parameters in wanted["parameters"].items():
        # Of the import, without a calibration, the record says next to nothing of a damping, and its friction level is
        # known less well than its errors said: the scatter of the levels stood in for the datum.
        left_out, widest = ({"c", "c/m"}, 3.0) if name == "imported" else (set(), 1.5)
        for key, (value, stderr) in ((key, parameters[key]) for key in parameters.keys() - left_out):
            assert rows[law].parameters[key].value == pytest.approx(value, abs=stderr), key
            # Damping lies at its bound of zero: the error of half a normal distribution is 0.6 of the whole one's.
            assert 0.6 * stderr < rows[law].parameters[key].stderr < stderr * widest, key
