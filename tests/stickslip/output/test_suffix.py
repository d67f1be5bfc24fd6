"""The suffix of an output is that of its format, in every command that writes one."""

from pathlib import Path

import pytest

from daq.cli.app import app
from stickslip.console import application
from stickslip.errors import InputError
from stickslip.output import suffix


@pytest.mark.parametrize("name", ["run.h5", "run.H5", "run", "run.nxs", "run.2024-05-01", "run.v2"])
def test_a_name_that_promises_nothing_else_is_accepted(name: str) -> None:
    suffix.check_run(Path(name))


@pytest.mark.parametrize("name", ["run.csv", "run.CSV", "run.txt", "run.parquet"])
def test_a_run_under_the_suffix_of_a_table_is_refused_with_the_command_that_writes_one(name: str) -> None:
    with pytest.raises(InputError) as refused:
        suffix.check_run(Path(name))
    assert "name it run.h5 (-o)" in refused.value.do
    assert f"daq export run.h5 -o {name}" in refused.value.do


@pytest.mark.parametrize(
    ("form", "name"),
    [(suffix.PAGE, "report.pdf"), (suffix.CSV, "table.h5"), (suffix.TOML, "rig.h5"), (suffix.CSV, "table.tsv")],
)
def test_every_format_refuses_the_suffixes_of_others(form: suffix.Format, name: str) -> None:
    with pytest.raises(InputError, match="is the suffix of"):
        suffix.check(Path(name), form)


@pytest.mark.parametrize(
    "words",
    [
        ["record", "--duration", "1", "-o", "out.csv"],
        ["import", "track.csv", "-o", "out.csv"],
        ["replay", "run.h5.part", "-o", "out.csv"],
        ["recover", "run.h5.part", "-o", "out.csv"],
        ["calibrate", "-o", "out.csv"],
    ],
)
def test_hdf5_under_the_name_of_a_table_is_refused_before_anything_is_done(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], words: list[str]
) -> None:
    """``-o run.csv`` wrote HDF5, exit code 0."""
    monkeypatch.chdir(tmp_path)
    Path("track.csv").write_text("t,x\n0,0.1\n0.1,0.2\n")
    Path("run.h5.part").write_bytes(b"")
    before = sorted(Path().iterdir())
    assert application.run(app, words) == 2
    said = capsys.readouterr().err
    assert "out.csv: .csv is the suffix of a CSV table" in said
    assert said.count("\n") == 1
    assert sorted(Path().iterdir()) == before
