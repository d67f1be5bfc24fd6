"""Export: a flat table that loses nothing and reads back."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from daq.cli.app import app
from daq.runfile import store
from daq.runfile.recording import Recording
from daq.runfile.rig import Rig
from daq.runfile.run_data import Raw, positions
from stickslip.console import application
from stickslip.output import tables
from stickslip.units import Measured

N = 101


@pytest.fixture
def run(tmp_path):
    count = (1000 * np.sin(np.arange(N))).astype(np.int64)
    rig = Rig(metres_per_count=Measured(7.67e-6), datum=Measured(1 / 3))
    raw = Raw(
        sample=np.arange(N, dtype=np.uint32),
        count_up=(count & 0xFFFF).astype(np.uint16),
        count_down=np.zeros(N, np.uint16),
        device_time=np.arange(N, dtype=np.uint32) * 1000,
        levels=np.zeros(N, np.uint8),
        flags=np.zeros(N, np.uint16),
        illegal=np.zeros(N, np.uint16),
        edge_time=np.arange(N, dtype=np.uint16),
    )
    data = Recording(
        title="a run",
        started="2024-05-01T12:00:00+02:00",
        ended="2024-05-01T12:00:01+02:00",
        rate_hz=1000.0,
        rig=rig,
        time=np.cumsum(np.full(N, 1 / 3)),
        position=positions(count, rig),
        count=count,
        raw=raw,
        segment=np.zeros(N, np.uint16),
    )
    store.write(tmp_path / "run.h5", data)
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
