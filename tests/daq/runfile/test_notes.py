"""Notes on runs: title, operator, sample, note, tags and markers, and the list of the runs in a folder."""

import json
import re
from pathlib import Path

import h5py
import numpy as np
import pytest

from daq.cli.app import app
from daq.recorder import names
from daq.runfile import listing, store
from stickslip.console import application
from stickslip.errors import InputError

from .runs import imported_run


def datasets(file: Path) -> dict[str, bytes]:
    with h5py.File(file) as opened:
        names: list[str] = []
        opened.visit(names.append)
        found = [(name, opened[name]) for name in names if isinstance(opened[name], h5py.Dataset)]
        return {name: item[()].tobytes() for name, item in found if item.dtype.kind != "O"}


def daq(*arguments: str | Path) -> int:
    return application.run(app, [str(argument) for argument in arguments])


def test_a_finished_run_is_annotated_and_keeps_its_samples_and_stages(tmp_path: Path) -> None:
    file = tmp_path / "run.h5"
    events = {"event_sample": np.array([100, 300], np.uint32), "event_kind": ("gap", "notice")}
    events["event_note"] = ("3 samples", "low battery")
    store.write(file, imported_run(**events, operator="Ada", sample_name="brass on steel", tags={"a": "1", "b": "2"}))
    store.extend(file, "smooth", lambda entry: entry.create_group("smooth") and None)
    before, identity = datasets(file), h5py.File(file)["entry/entry_identifier_uuid"][()]
    marks = [(2.004, "a hand"), (1.0, "after the gap")]
    store.annotate(file, {"title": "new", "operator": "", "tags": {"a": "3", "b": ""}}, marks)
    store.annotate(file, {"note": "two\nlines"})
    again = store.load(file)
    assert (again.title, again.operator, again.note, again.tags) == ("new", "", "two\nlines", {"a": "3"})
    assert again.sample_name == "brass on steel"
    assert again.event_sample.tolist() == [100, 100, 200, 300]
    assert again.event_kind == ("gap", "marker", "marker", "notice")
    assert again.event_note == ("3 samples", "after the gap", "a hand", "low battery")
    after = datasets(file)
    assert {name for name in before if after.get(name) != before[name]} == {"entry/events/sample", "entry/events/kind"}
    with h5py.File(file) as opened:
        assert opened["entry/entry_identifier_uuid"][()] == identity
        assert opened["entry/data"].attrs["title"] == "new"
        assert opened["entry/sample/name"][()] == b"brass on steel"
        assert opened["entry/notes"].attrs["NX_class"] == "NXnote"
        assert "operator" not in opened["entry"]
        assert "smooth" in opened["entry"]
        # A run written with these notes at once has the same tree.
        store.write(tmp_path / "other.h5", again)
        with h5py.File(tmp_path / "other.h5") as other:
            assert set(other["entry"]) == set(opened["entry"]) - {"smooth"}


@pytest.mark.parametrize("seconds", [-0.1, 4.0, float("nan")])
def test_a_marker_outside_the_run_is_refused_and_nothing_is_changed(tmp_path: Path, seconds: float) -> None:
    file = tmp_path / "run.h5"
    store.write(file, imported_run())
    before = file.read_bytes()
    with pytest.raises(InputError, match="outside the run"):
        store.annotate(file, {"title": "new"}, [(seconds, "x")])
    assert file.read_bytes() == before


def test_the_commands_record_note_and_list(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    notes = ("--title", "first", "--operator", "Ada", "--sample", "brass", "--note", "dry", "--tag", "T=21")
    for _ in range(2):
        assert daq("record", "--duration", "0.5", "-o", "run-{n:03}.h5", *notes) == 0
    assert daq("note", "run-002.h5", "--title", "second", "--mark", "200 ms", "a hand") == 0
    (tmp_path / "bad.h5").write_text("no")
    (tmp_path / "left.h5.part").write_text("stickslip journal")
    capsys.readouterr()
    assert daq("note", "run-002.h5", "--json") == 0
    found = json.loads(capsys.readouterr().out)
    shown = [found[key] for key in ("title", "operator", "sample", "note", "tags")]
    assert shown == ["second", "Ada", "brass", "dry", {"T": "21"}]
    assert [(round(marker["t"], 2), marker["text"]) for marker in found["markers"]] == [(0.2, "a hand")]
    assert daq("list", "--json") == 0
    rows = json.loads(capsys.readouterr().out)
    assert [row["file"] for row in rows] == ["run-001.h5", "run-002.h5", "bad.h5", "left.h5.part"]
    assert [row["title"] for row in rows] == ["first", "second", None, None]
    first = rows[0]
    assert (first["duration"], first["rate"], first["lost"]) == (pytest.approx(0.5, abs=1e-3), 1000.0, 0)
    assert (first["sticks"], first["verdict"]) == (None, None)
    assert rows[2]["problem"] == "is not an HDF5 file"
    assert "daq recover" in rows[3]["problem"]
    assert [row["note"] for row in rows] == ["dry", "dry", None, None]
    assert daq("list") == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 4  # a run took up to five lines
    assert lines[0].startswith("run-001.h5    ")
    assert lines[0].endswith("0.5 s, 1000 Hz, first, brass, T=21")


def test_the_list_names_sticks_and_verdict_of_a_finished_run() -> None:
    samples = Path(__file__).parents[3] / "data_samples"
    for row in listing.list_runs([samples]):
        with h5py.File(row.file) as file:
            stages = set(file["entry"])
        assert (row.sticks is not None) == ("smooth" in stages), row
        assert (row.verdict is not None) == ("fit" in stages), row


@pytest.mark.parametrize(
    ("flags", "what"),
    [
        (("--tag", "humidity"), "is not a tag"),
        (("--tag", "a b=1"), "is not a tag"),
        (("--tag", "a=1", "--tag", "a=2"), "given twice"),
        (("--title", "a\x1b[2J"), "cannot be printed"),
        (("--note", "x" * 20_000), "20000 characters"),
        (("--mark", "soon", "x"), "soon"),
    ],
)
def test_notes_that_cannot_be_kept_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], flags: tuple[str, ...], what: str
) -> None:
    file = tmp_path / "run.h5"
    store.write(file, imported_run())
    assert daq("note", file, *flags) == 2
    assert what in capsys.readouterr().err


def test_output_names_are_completed(tmp_path: Path) -> None:
    for name in ("run-001.h5", "run-007.h5.part", "run-12x.h5", "other-99.h5"):
        (tmp_path / name).touch()
    assert names.complete_name(tmp_path / "run-{n:03}.h5") == tmp_path / "run-008.h5"
    assert names.complete_name(tmp_path / "new{n}.h5") == tmp_path / "new1.h5"
    assert names.complete_name(tmp_path / "plain.h5") == tmp_path / "plain.h5"
    assert re.fullmatch(r"r-\d{8}-\d{6}\.h5", names.complete_name(tmp_path / "r-{date}.h5").name)


@pytest.mark.parametrize("name", ["{m}.h5", "{n", "{n:x}.h5", "{n!r}.h5", "{0}.h5", "{date.year}.h5", "{n}/run.h5"])
def test_other_fields_in_an_output_name_are_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError):
        names.complete_name(tmp_path / name)
