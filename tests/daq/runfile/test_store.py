"""The run file: what is written reads back, opens everywhere, and raw data stay as they were."""

import hashlib
import importlib.util
import runpy
import shutil
import subprocess
import sys
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from daq.runfile import nexus, schema, store, tree
from daq.runfile.recording import Recording
from daq.runfile.rig import Rig
from daq.runfile.run_data import EVENTS, Raw, Truth
from processing.cli import app as process
from stickslip.console import application
from stickslip.errors import InputError
from stickslip.output.lock import FileLock
from stickslip.units import Measured

from ...conftest import need
from .runs import RIG, assert_same, run

ROOT = Path(__file__).parents[3]
DOCS = ROOT / "docs"
SAMPLE = ROOT / "data_samples" / "law5.h5"


def imported(n: int = 101) -> Recording:
    bare = run(n, count=None, raw=None, clock_sample=np.empty(0, np.uint32))
    return replace(bare, clock_offset=np.empty(0), rig=Rig(mass=Measured(0.3)))


def smooth(entry: h5py.Group) -> None:
    entry["smooth/parameters/sha256_input"] = "x"
    entry["smooth/kinematics/velocity"] = np.zeros(5_000)


def fit(entry: h5py.Group) -> None:
    entry["fit/ranking/law"] = np.arange(1, 7)


def nxcheck(path: Path) -> tuple[int, int]:
    tool = Path(sys.executable).parent / "nxcheck"
    done = subprocess.run([tool, path], capture_output=True, text=True, check=False)
    counts = {}
    for line in done.stdout.splitlines():
        for kind in ("warnings", "errors"):
            if f"number of {kind}:" in line:
                counts[kind] = int(line.split(":")[1].split("\x1b")[0])
    assert set(counts) == {"warnings", "errors"}, done.stdout + done.stderr
    return counts["warnings"], counts["errors"]


def raw_digest(path: Path) -> str:
    sha = hashlib.sha256()
    with h5py.File(path) as file:
        for group in ("raw", "instrument/encoder/value_log", "clock_sync", "events"):
            for name, item in sorted(file[f"entry/{group}"].items()):
                for chunk in range(item.id.get_num_chunks() if item.chunks else 0):
                    sha.update(item.id.read_direct_chunk(item.id.get_chunk_info(chunk).chunk_offset)[1])
                sha.update(f"{name} {item[()].tolist()}".encode())
    return sha.hexdigest()


def same(recording: Recording, data: Recording) -> None:
    """Compare what a file gives with what was written, but for what only a file has; the truth is apart."""
    of_file = {name: getattr(recording, name) for name in ("source", "default", "digest")}
    assert_same(replace(data, truth=None, **of_file), recording)


n_samples = 37
words = st.text(st.characters(exclude_categories=["Cs", "Cc"]), max_size=20)


@st.composite
def runs(draw: st.DrawFn) -> Recording:
    n = draw(st.integers(1, n_samples))
    finite = st.floats(-1e9, 1e9)

    def column(dtype: Any) -> Any:
        return draw(hnp.arrays(dtype, n))

    steps = draw(hnp.arrays(np.float64, n, elements=st.floats(1e-6, 1e3)))
    raw = None
    if draw(st.booleans()):
        extra = column(np.uint16) if draw(st.booleans()) else None
        u16 = [column(np.uint16) for _ in range(4)]
        raw = Raw(
            sample=column(np.uint32),
            count_up=u16[0],
            count_down=u16[1],
            device_time=column(np.uint32),
            levels=column(np.uint8),
            flags=u16[2],
            illegal=u16[3],
            belt_count=extra,
            edge_time=extra,
        )
    events = draw(st.integers(0, 4))
    truth = draw(hnp.arrays(np.float64, (4, 5), elements=finite)) if draw(st.booleans()) else None
    belt_velocity = draw(hnp.arrays(np.float64, n, elements=finite)) if draw(st.booleans()) else None
    return Recording(
        title=draw(words),
        started="2024-05-01T12:00:00+02:00",
        ended="2024-05-01T12:00:01+02:00",
        rate_hz=draw(st.floats(0.1, 1e6)),
        rig=Rig(name=draw(words), decoder="jk", mass=Measured(draw(st.floats(1e-9, 1e9)), 0.1)) if raw else Rig(),
        time=np.cumsum(steps),
        position=draw(hnp.arrays(np.float64, n, elements=finite)),
        count=column(np.int64) if raw is not None else None,
        raw=raw,
        segment=column(np.uint16) if raw is not None else np.zeros(n, np.uint16),
        config_toml=draw(words),
        event_sample=draw(hnp.arrays(np.uint32, events)),
        event_kind=tuple(draw(st.lists(st.sampled_from(sorted(EVENTS)), min_size=events, max_size=events))),
        event_note=tuple(draw(st.lists(words, min_size=events, max_size=events))),
        belt_velocity=belt_velocity,
        belt_count=column(np.int64) if belt_velocity is not None and draw(st.booleans()) else None,
        truth=None if truth is None else Truth(*truth, scene="rig"),
        operator=draw(words),
        provenance={"software": draw(words), "git_dirty": draw(st.integers(-9, 9))},
    )


@settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=runs())
def test_what_is_written_reads_back_to_the_last_bit(tmp_path: Path, data: Recording) -> None:
    path = tmp_path / "run.h5"
    store.write(path, data, force=True)
    same(store.load(path), data)
    truth = store.truth(path)
    assert (truth is None) == (data.truth is None)
    for name in ("time", "x", "v", "F") if data.truth else ():
        np.testing.assert_array_equal(getattr(truth, name), getattr(data.truth, name))


@pytest.fixture
def path(tmp_path: Path) -> Path:
    store.write(tmp_path / "run.h5", run())
    return tmp_path / "run.h5"


def extend(path: Path, *stages: str) -> None:
    for stage in stages:
        if stage == "smooth":
            store.extend(path, "smooth", smooth, default="smooth")
        else:
            store.extend(path, "fit", fit, default="fit")


def test_a_run_that_its_writer_still_holds_a_lock_on_is_read(path: Path) -> None:
    """For an instant after it was replaced; HDF5 takes a lock too."""
    path.touch()  # a file that this process has not checked yet
    lock = FileLock(path)
    try:
        assert np.array_equal(store.load(path).count, run().count)
    finally:
        lock.release()


def test_equal_runs_give_equal_bytes_and_those_of_another_host_differ_in_their_provenance(path: Path) -> None:
    (path.parent / "other").mkdir()
    other = path.parent / "other" / "run.h5"
    store.write(other, run())
    assert path.read_bytes() == other.read_bytes()
    store.write(other, run(provenance={"software": "stickslip", "git_dirty": 1, "hostname": "beta"}), force=True)
    store.write(path, run(provenance={"software": "stickslip", "git_dirty": 1, "hostname": "alpha"}), force=True)
    differ = []
    with h5py.File(path) as a, h5py.File(other) as b:

        def compare(name: str, item: Any) -> None:
            if dict(item.attrs).keys() != dict(b[name].attrs).keys():
                differ.append(name)
            if isinstance(item, h5py.Dataset) and not np.array_equal(item[()], b[name][()]):
                differ.append(name)

        a.visititems(compare)
    assert differ == ["entry/provenance/hostname"]


def with_every_channel() -> Recording:
    made = run(operator="A. Person", truth=Truth(*np.ones((4, 3)), scene="rig"))
    extra = np.zeros(made.time.size, np.uint16)
    return replace(
        made,
        raw=replace(made.raw, belt_count=extra, edge_time=extra),
        belt_velocity=made.time,
        belt_count=extra.astype(np.int64),
        rig=replace(RIG, belt_metres_per_count=Measured(7.67e-6, 1e-9)),
    )


@pytest.mark.parametrize("made", [with_every_channel(), imported()], ids=["recorded", "imported"])
def test_nxcheck_finds_no_errors_and_no_warnings_in_what_the_schema_names(tmp_path: Path, made: Recording) -> None:
    path = tmp_path / "run.h5"
    store.write(path, made)
    rows = {row.path for row in schema.FIELDS}
    rows |= {f"{row.path}_errors" for row in schema.FIELDS if row.kind == "measured"}
    written: list[str] = []
    with h5py.File(path) as file:
        file["entry"].visititems(lambda name, item: written.append(name) if isinstance(item, h5py.Dataset) else None)
    assert [name for name in written if name not in rows and not name.startswith("provenance/")] == []
    assert nxcheck(path) == (0, 0)


def test_xarray_reads_tables_over_time(tmp_path: Path) -> None:
    need(importlib.util.find_spec("xarray"), "xarray is not installed")
    import xarray

    smoothed = Path(shutil.copy(SAMPLE, tmp_path / "run.h5"))
    assert application.run(process, ["smooth", str(smoothed), "--method", "sg"]) == 0
    time = store.load(smoothed).time
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        for group in ("entry/data", "entry/smooth/kinematics"):
            with xarray.open_dataset(smoothed, group=group, engine="h5netcdf") as table:
                assert dict(table.sizes) == {"time": time.size}
                np.testing.assert_array_equal(table["time"], time)
                if group != "entry/data":
                    assert table["velocity_errors"].dims == ("time",)
                    assert table["velocity_errors"].dtype == np.float32


def test_types_and_units_are_those_of_the_layout(path: Path) -> None:
    with h5py.File(path) as file:
        raw = file["entry/raw"]
        wanted = {"sample": "u4", "segment": "u2", "count_up": "u2", "count_down": "u2", "device_time": "u4"}
        wanted |= {"levels": "u1", "flags": "u2", "illegal": "u2"}
        assert {name: item.dtype.str[1:] for name, item in raw.items()} == wanted
        assert file["entry/instrument/encoder/value_log/raw_value"].dtype == np.int64
        assert h5py.check_enum_dtype(file["entry/events/kind"].dtype) == EVENTS
        for name in ("time", "value"):  # links, not copies
            assert file[f"entry/data/{name}"] == file[f"entry/instrument/encoder/value_log/{name}"]
        assert file["entry/duration"][()] == 20  # 20.5 s, an even integer nearest
        assert np.issubdtype(file["entry/duration"].dtype, np.integer)
        without: list[str] = []

        def check(name: str, item: Any) -> None:
            if isinstance(item, h5py.Dataset) and item.dtype.kind == "f" and "units" not in item.attrs:
                without.append(name)

        file.visititems(check)
        assert without == []


def test_stages_leave_raw_data_untouched_drop_what_was_made_from_the_old_one_and_do_not_pile_up(tmp_path: Path) -> None:
    path = tmp_path / "run.h5"
    store.write(path, run(20_001))
    before, loaded = raw_digest(path), store.load(path)
    extend(path, "smooth")
    once = path.stat().st_size
    extend(path, "fit")
    assert raw_digest(path) == before
    after = store.load(path)
    assert (after.digest, after.default) == (loaded.digest, "fit")
    same(after, run(20_001))
    extend(path, *["smooth"] * 5)
    with h5py.File(path) as file:
        assert [name for name in file["entry"] if name.startswith(("smooth", "fit"))] == ["smooth"]
    assert path.stat().st_size < 1.25 * once


def test_a_stage_that_fails_leaves_the_file_as_it_was(path: Path) -> None:
    before = path.read_bytes()

    def broken(entry: h5py.Group) -> None:
        smooth(entry)
        raise RuntimeError("stop")

    with pytest.raises(RuntimeError, match="stop"):
        store.extend(path, "smooth", broken)
    with pytest.raises(ValueError, match="never the record"):
        store.extend(path, "raw", lambda entry: None)
    assert path.read_bytes() == before
    assert [item.name for item in path.parent.iterdir()] == ["run.h5"]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"position": np.zeros(3)}, "position has shape"),
        ({"time": np.zeros(501)}, "time does not increase at sample 1"),
        ({"position": np.full(501, np.nan)}, "finite"),
        ({"count": None}, "count is None"),
        ({"event_kind": ("gap",)}, "event_kind has shape"),
        ({"clock_offset": np.zeros(3)}, "clock_offset has shape"),
        ({"event_kind": ("gap", "flood")}, r"\['flood'\] are unknown"),
        ({"started": "2024-05-01T12:00:00"}, "zone"),
    ],
)
def test_parts_that_do_not_belong_together_are_refused(tmp_path: Path, changes: Any, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        store.write(tmp_path / "run.h5", run(**changes))
    assert list(tmp_path.iterdir()) == []


def refused(path: Path) -> str:
    with pytest.raises(InputError) as error:
        store.load(path)
    line = str(error.value)
    assert "\n" not in line
    assert str(path) in line
    assert error.value.do
    return line


def test_missing_foreign_and_cut_files_are_named(path: Path) -> None:
    whole = path.read_bytes()
    for kept in (len(whole) - 1, len(whole) // 2, 100):
        path.write_bytes(whole[:kept])
        assert "cut short" in refused(path)
    for content, words in (
        (b"", "is empty"),
        (b"t,x\n0,1\n", "not an HDF5 file"),
        (b"stickslip journal 1\n", "daq recover"),
    ):
        path.write_bytes(content)
        assert words in refused(path)
    path.unlink()
    assert "no such file" in refused(path)
    assert "is a folder" in refused(path.parent)
    with h5py.File(path, "w") as file:
        file["numbers"] = [1, 2]
    assert "not a run file" in refused(path)


def test_a_damaged_chunk_is_found_by_its_checksum(tmp_path: Path) -> None:
    path = tmp_path / "run.h5"
    store.write(path, run(20_001))
    with h5py.File(path) as file:
        offset = file["entry/raw/count_up"].id.get_chunk_info(0).byte_offset
    content = bytearray(path.read_bytes())
    content[offset + 50] ^= 0xFF
    path.write_bytes(content)
    assert "is damaged" in refused(path)


@pytest.mark.parametrize("place", ["/", "/entry/provenance"])
@pytest.mark.parametrize(
    ("schema", "words"), [(0, "has schema 0"), (2, "newer stickslip"), ("1", "not a whole number")]
)
def test_other_schemas_are_refused(path: Path, place: str, schema: Any, words: str) -> None:
    with h5py.File(path, "r+") as file:
        file[place].attrs["stickslip_schema"] = schema
    assert words in refused(path)
    before = path.read_bytes()
    with pytest.raises(InputError):
        store.extend(path, "smooth", smooth)
    assert path.read_bytes() == before


LOG = "instrument/encoder/value_log"


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        (f"{LOG}/time", None, "has no /entry/instrument/encoder/value_log/time"),
        (f"{LOG}/time", ["a", "b"], "instead of one column of float64"),
        (f"{LOG}/time", np.zeros(501), "time does not increase at sample 1"),
        (f"{LOG}/value", np.zeros(3), "has 3 values instead of 501"),
        (f"{LOG}/value", np.full(501, np.inf), "not finite at sample 0"),
        (f"{LOG}/value", np.full(501, 1e300), "too large at sample 0"),
        (f"{LOG}/time", np.arange(501) * 1e300, "its times reach"),
        (f"{LOG}/time", np.arange(501) * 1e-310, "are too many"),
        (f"{LOG}/raw_value", np.zeros(501), "instead of one column of int64"),
        ("raw/count_up", np.zeros((501, 2), np.uint16), "2-dimensional"),
        ("raw/levels", np.zeros(5, np.uint8), "has 5 values"),
        ("sample/mass", "heavy", "is not a number"),
        ("title", 5, "is not text"),
        ("events/kind", None, "has no /entry/events/kind"),
        ("raw/flags", None, "has no /entry/raw/flags"),
        ("clock_sync/sample", np.zeros(5, np.uint32), "has 2 values instead of 5"),
    ],
)
def test_wrong_content_is_named(path: Path, name: str, value: Any, words: str) -> None:
    with h5py.File(path, "r+") as file:
        del file["entry"][name]
        if value is not None:
            file["entry"][name] = value
    assert words in refused(path)


def test_float_fields_need_units_and_columns_of_one_axis_one_length(tmp_path: Path) -> None:
    rows = [
        tree.Field(f"t/{name}", "f8[n]", unit, "", value=lambda source, n=n: np.zeros(n))
        for name, unit, n in (("time", "s", 101), ("x", "m", 100))
    ]
    with h5py.File(tmp_path / "x.h5", "w") as file:
        with pytest.raises(ValueError, match="no units"):
            nexus.field(file, "speed", 0.22)
        with pytest.raises(ValueError, match=r"t/x has shape \(100,\); t/time"):
            tree.write(file, (tree.table("t", "time", "x", "table"), *rows), None)


def test_the_documentation_has_a_row_for_every_field() -> None:
    script = runpy.run_path(str(DOCS / "run_file_table.py"))
    assert f"{{include}} {script['TABLES'].name}" in (DOCS / "reference" / "run-file.md").read_text()
    for documented in script["TREES"].values():
        table = script["documentation"](documented)
        rows = {line.split("|")[1].strip().removesuffix("?") for line in table.splitlines()}
        groups = {f"**{row.path or '/entry'}**" for row in documented if isinstance(row, tree.Group)}
        assert groups | {row.name for row in documented if isinstance(row, tree.Field) and row.text} <= rows
