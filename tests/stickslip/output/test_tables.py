"""Export: a flat table that loses nothing and reads back."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from daq.cli.app import app
from daq.runfile import store
from daq.runfile.rig import Rig
from daq.runfile.run_data import positions
from stickslip.console import application
from stickslip.output import tables

SAMPLE = Path(__file__).parents[3] / "data_samples" / "law5.h5"


@pytest.fixture
def run(tmp_path):
    found = store.load(SAMPLE)
    raw = replace(found.raw, edge_time=np.arange(found.time.size, dtype=np.uint16))
    store.write(tmp_path / "run.h5", replace(found, raw=raw))
    return tmp_path / "run.h5"


COLUMNS = "time_s position_m count segment sample count_up count_down device_time_us levels flags illegal edge_time_us"


def _read_csv(path):
    # Python's own float: pandas' parser may err in the last bit.
    lines = [line.split(",") for line in path.read_text().splitlines()]
    columns = zip(*lines[1:], strict=True)
    return pd.DataFrame({name: [float(c) for c in column] for name, column in zip(lines[0], columns, strict=True)})


def test_both_tables_hold_every_sample_to_the_last_bit(run):
    csv, parquet = run.with_suffix(".csv"), run.with_suffix(".parquet")
    assert application.run(app, ["export", str(run), "--csv", str(csv), "--parquet", str(parquet)]) == 0
    recording = store.load(run)
    for table in (_read_csv(csv), pd.read_parquet(parquet)):
        assert list(table.columns) == COLUMNS.split()
        np.testing.assert_array_equal(table["time_s"], recording.time)
        np.testing.assert_array_equal(table["position_m"], recording.position)
        np.testing.assert_array_equal(table["count_up"], recording.raw.count_up)
        np.testing.assert_array_equal(table["edge_time_us"], recording.raw.edge_time)


def test_an_exported_table_imports_as_the_same_motion(run):
    csv, again = run.with_suffix(".csv"), run.with_name("again.h5")
    assert application.run(app, ["export", str(run), "--csv", str(csv)]) == 0
    assert application.run(app, ["import", str(csv), "-o", str(again)]) == 0
    first, second = store.load(run), store.load(again)
    np.testing.assert_array_equal(second.position, first.position)
    np.testing.assert_array_equal(second.time, first.time - first.time[0])


def test_an_uncalibrated_run_says_count(run):
    recording = store.load(run)
    bare = replace(
        recording, rig=Rig(), position=positions(recording.count, Rig()), raw=None, segment=np.zeros(0, np.uint16)
    )
    other = run.with_name("bare.h5")
    store.write(other, bare)
    csv = run.with_suffix(".csv")
    assert application.run(app, ["export", str(other), "--csv", str(csv)]) == 0
    assert csv.read_text().splitlines()[0] == "time_s,position_count,count"


@pytest.mark.parametrize("number", [0, 40, 101])
def test_a_csv_written_in_parts_is_that_written_at_once(tmp_path, monkeypatch, number):
    rows = pd.DataFrame({"time_s": np.sin(np.arange(number)), "flags": np.arange(number, dtype=np.uint16)})
    monkeypatch.setattr(tables, "TOGETHER", 40)
    done: list[float] = []
    tables.write(rows, tmp_path / "parts.csv", "csv", progress=done.append)
    assert (tmp_path / "parts.csv").read_bytes() == rows.to_csv(index=False, lineterminator="\n").encode()
    assert done == [end for end in (40, 80, 101) if end < number] + [number]


@pytest.mark.parametrize(("name", "read"), [("table.csv", pd.read_csv), ("table.parquet", pd.read_parquet)])
def test_the_suffix_of_an_output_is_its_format(run, name, read):
    target = run.with_name(name)
    assert application.run(app, ["export", str(run), "-o", str(target)]) == 0
    np.testing.assert_array_equal(read(target)["position_m"], store.load(run).position)
