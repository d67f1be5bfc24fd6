"""The sample runs: as the manifest says, and the same when made again from their scenes and seeds."""

import contextlib
import hashlib
import importlib
import importlib.util
import io
import json
from pathlib import Path

import numpy as np
import pytest

import daq
from stickslip.console import application

SAMPLES = Path(__file__).resolve().parent.parent / "data_samples"
MANIFEST = json.loads((SAMPLES / "manifest.json").read_text())
RUNS = sorted(name for name in MANIFEST if name.endswith(".h5"))


def called(folder, module, *arguments):
    """Run a command in a folder, within this process, which has loaded what it needs."""
    with contextlib.chdir(folder), contextlib.redirect_stdout(io.StringIO()) as out:
        assert application.run(importlib.import_module(module).app, list(map(str, arguments))) == 0, out.getvalue()


@pytest.fixture(scope="module")
def made_again(tmp_path_factory):
    spec = importlib.util.spec_from_file_location("regenerate", SAMPLES / "regenerate.py")
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    script.command = called
    folder = tmp_path_factory.mktemp("samples")
    script.main(folder)
    return folder


def test_there_is_a_run_of_each_law_and_a_camera_table():
    assert [MANIFEST[name]["changes"]["friction.law"] for name in RUNS] == [1, 2, 3, 4, 5, 6]
    assert "camera.csv" in MANIFEST


@pytest.mark.parametrize("name", sorted(MANIFEST))
def test_a_sample_has_the_bytes_of_the_manifest(name):
    assert hashlib.sha256((SAMPLES / name).read_bytes()).hexdigest() == MANIFEST[name]["sha256"]


@pytest.mark.parametrize("name", RUNS)
def test_a_run_made_again_holds_the_same_samples(made_again, name):
    kept, fresh = daq.load(SAMPLES / name), daq.load(made_again / name)
    np.testing.assert_array_equal(kept.raw.device_time, fresh.raw.device_time)
    # Another machine's sine may differ in its last bit and move an edge across a sample: one count, no more.
    assert np.max(np.abs(kept.count - fresh.count)) <= 1
    assert kept.rig == fresh.rig
    assert kept.time.size == MANIFEST[name]["duration_s"] * MANIFEST[name]["rate_hz"]


def test_the_camera_table_made_again_is_the_same_text(made_again):
    assert (SAMPLES / "camera.csv").read_bytes() == (made_again / "camera.csv").read_bytes()


def test_the_manifest_made_again_names_the_same_scenes(made_again):
    def without_hash(manifest):
        return {name: {key: line[key] for key in line if key != "sha256"} for name, line in manifest.items()}

    assert without_hash(json.loads((made_again / "manifest.json").read_text())) == without_hash(MANIFEST)
