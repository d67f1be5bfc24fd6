"""Export: a flat table that loses nothing and reads back."""

from pathlib import Path

import cyclopts
import numpy as np
import pandas as pd
import pytest

from daq.cli.app import app as commands
from daq.runfile import store
from daq.runfile.recording import Recording
from daq.runfile.rig import Rig
from daq.runfile.run_data import Raw, positions
from stickslip.console import application
from stickslip.output import tables
from stickslip.units import Measured

N = 101


@pytest.fixture
def app() -> cyclopts.App:
    return commands


@pytest.fixture
def run(tmp_path: Path) -> Path:
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


def _read_csv(path: Path) -> pd.DataFrame:
    # Python's own float: pandas' parser may err in the last bit.
    lines = [line.split(",") for line in path.read_text().splitlines()]
    columns = zip(*lines[1:], strict=True)
    return pd.DataFrame({name: [float(c) for c in column] for name, column in zip(lines[0], columns, strict=True)})


def test_both_tables_hold_every_sample_to_the_last_bit(run: Path, app: cyclopts.App) -> None:
    csv, parquet = run.with_suffix(".csv"), run.with_suffix(".parquet")
    assert application.run(app, ["export", str(run), "--csv", str(csv), "--parquet", str(parquet)]) == 0
    recording = store.load(run)
    assert recording.raw is not None
    for table in (_read_csv(csv), pd.read_parquet(parquet)):
        assert list(table.columns) == COLUMNS.split()
        np.testing.assert_array_equal(table["time_s"], recording.time)
        np.testing.assert_array_equal(table["position_m"], recording.position)
        np.testing.assert_array_equal(table["count_up"], recording.raw.count_up)
        np.testing.assert_array_equal(table["edge_time_us"], recording.raw.edge_time)


def test_an_exported_table_imports_as_the_same_motion(run: Path, app: cyclopts.App) -> None:
    csv, again = run.with_suffix(".csv"), run.with_name("again.h5")
    assert application.run(app, ["export", str(run), "--csv", str(csv)]) == 0
    assert application.run(app, ["import", str(csv), "-o", str(again)]) == 0
    first, second = store.load(run), store.load(again)
    np.testing.assert_array_equal(second.position, first.position)
    np.testing.assert_array_equal(second.time, first.time - first.time[0])


@pytest.mark.parametrize(
    ("flags", "words"),
    [
        ([], ["-o FILE.csv", "-o FILE.parquet"]),
        (["-o", "run.dat"], ["run.dat", ".csv or .parquet"]),
        (["-o", "table.h5"], ["table.h5", "a run file (HDF5)", ".csv or .parquet"]),
        (["--csv", "table.parquet"], ["table.parquet", "a Parquet table", "table.csv"]),
        (["-o", "table.csv", "--csv", "./table.csv"], ["table.csv", "two outputs"]),
        (["--csv", "old.csv"], ["old.csv", "--force"]),
        (["--parquet", "no/where.parquet"], ["no/where.parquet", "folder"]),
    ],
)
def test_bad_requests_are_one_line_and_write_nothing(
    run: Path,
    app: cyclopts.App,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    flags: list[str],
    words: list[str],
) -> None:
    monkeypatch.chdir(run.parent)
    Path("old.csv").write_text("precious")
    assert application.run(app, ["export", "run.h5", *flags]) == 2
    line = capsys.readouterr().err
    assert line.count("\n") == 1
    for word in words:
        assert word in line
    assert Path("old.csv").read_text() == "precious"
    assert sorted(item.name for item in Path().iterdir()) == ["old.csv", "run.h5"]


def test_an_uncalibrated_run_says_count(run: Path, app: cyclopts.App) -> None:
    recording = store.load(run)
    assert recording.count is not None
    bare = Recording(
        title="bare",
        started=recording.started,
        ended=recording.ended,
        rate_hz=1000.0,
        rig=Rig(),
        time=recording.time,
        position=positions(recording.count, Rig()),
        count=recording.count,
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
def test_the_suffix_of_an_output_is_its_format(run: Path, app: cyclopts.App, name: str, read: object) -> None:
    """``daq export -o`` did not exist."""
    if name.endswith(".parquet"):
        pytest.importorskip("pyarrow")
    target = run.with_name(name)
    assert application.run(app, ["export", str(run), "-o", str(target)]) == 0
    assert callable(read)
    np.testing.assert_array_equal(read(target)["position_m"], store.load(run).position)
