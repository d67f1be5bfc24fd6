"""A MATLAB file is imported as a CSV is: vectors by their names, exact, refused with a reason when it cannot be."""

import numpy as np
import pytest
from scipy.io import savemat

import daq
import processing
from daq.cli import sentences
from daq.imports import table_to_run
from daq.imports.options import ImportOptions


@pytest.fixture
def path(tmp_path):
    time = np.arange(5000) / 1000
    position = 0.1 * np.sin(3 * time) + 1e-6 * np.random.default_rng(1).standard_normal(time.size)
    target = tmp_path / "DATA_EMPS.mat"
    savemat(
        target, {"t": time[:, None], "qm": position[None, :], "vir": np.ones((5000, 2)), "gtau": 35.15, "s": "EMPS"}
    )
    return target, time, position


def test_vectors_become_columns_bit_for_bit(path):
    found = table_to_run.read(path[0], ImportOptions(time="t", position="qm")).run
    assert np.array_equal(found.time, path[1])
    assert np.array_equal(found.position, path[2])


def test_vectors_are_not_described_as_text_with_a_delimiter(path):
    # It was "read as: delimiter tab, decimal '.'".
    words = sentences.format_columns(table_to_run.read(path[0], ImportOptions(time="t", position="qm")))
    assert words.startswith("read as: vectors of a MATLAB file, time from column 't' in s")


def test_process_smooths_what_daq_import_made_of_it(path, tmp_path):
    from daq.runfile import store

    target = tmp_path / "run.h5"
    store.write(target, table_to_run.read(path[0], ImportOptions(time="t", position="qm")).run)
    motion = processing.smooth(daq.load(target))
    inner = slice(200, -200)
    assert np.abs(motion.velocity - 0.3 * np.cos(3 * path[1]))[inner].max() < 1e-4
