"""A MATLAB file is imported as a CSV is: vectors by their names, exact, refused with a reason when it cannot be."""

import numpy as np
import pytest
from scipy.io import savemat

import daq
import processing
from daq.cli import sentences
from daq.imports import table_to_run
from daq.imports.options import ImportOptions
from stickslip.errors import InputError


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
    words = sentences.columns(table_to_run.read(path[0], ImportOptions(time="t", position="qm")))
    assert words.startswith("read as: vectors of a MATLAB file, time from column 't' in s")


def test_process_smooths_what_daq_import_made_of_it(path, tmp_path):
    from daq.runfile import store

    target = tmp_path / "run.h5"
    store.write(target, table_to_run.read(path[0], ImportOptions(time="t", position="qm")).run)
    motion = processing.smooth(daq.load(target))
    inner = slice(200, -200)
    assert np.abs(motion.velocity - 0.3 * np.cos(3 * path[1]))[inner].max() < 1e-4


def test_a_name_that_is_not_there_is_told_with_those_that_are(path):
    with pytest.raises(InputError, match="qm"):
        table_to_run.read(path[0], ImportOptions(time="t", position="q"))


def test_what_is_no_matlab_file_is_refused(tmp_path):
    target = tmp_path / "fake.mat"
    target.write_text("t,x\n0,1\n")
    with pytest.raises(InputError, match="is not a MATLAB file"):
        table_to_run.read(target, ImportOptions())
    savemat(tmp_path / "empty.mat", {"name": "nothing"})
    with pytest.raises(InputError, match="holds no vector"):
        table_to_run.read(tmp_path / "empty.mat", ImportOptions())
    with pytest.raises(InputError, match="no such file"):
        table_to_run.read(tmp_path / "missing.mat", ImportOptions())


def test_a_file_that_crashes_the_matlab_library_is_refused(tmp_path):
    # One in 400 damaged files ended the command with a segmentation fault: this one says that its numbers are complex.
    target = tmp_path / "run.mat"
    savemat(target, {"t": np.arange(40) / 100, "x": np.arange(40.0)})
    content = bytearray(target.read_bytes())
    assert content[144:146] == b"\x06\x00"  # class and flags of the first variable
    content[145] |= 8
    target.write_bytes(content)
    with pytest.raises(InputError, match="it crashes the library"):
        table_to_run.read(target, ImportOptions())
