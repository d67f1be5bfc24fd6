"""The page of JSON documents names every key that the commands print."""

import contextlib
import io
import json
import re
import shutil

import pytest

from daq.cli.app import app as daq
from fitting.cli import app as fit_friction
from processing.cli import app as process
from stickslip.console import application

from . import examples

PAGE = (examples.ROOT / "docs" / "reference" / "json.md").read_text()
BY_NAME = {"parameters", "rms_by_law"}  # what stands below are names of the record's own


def keys(document, below=""):
    """Yield every key of a document."""
    if isinstance(document, dict):
        for name, value in document.items():
            if below not in BY_NAME:
                yield name
            yield from keys(value, name)
    elif isinstance(document, list):
        for row in document:
            yield from keys(row, below)


@pytest.mark.slow
def test_every_key_that_a_command_prints_is_on_the_page(tmp_path):
    """Half of the keys of fit-friction stood on no page."""
    for name in ("law3", "law5"):
        shutil.copy(examples.ROOT / "data_samples" / f"{name}.h5", tmp_path)
    lines = [
        ("daq", daq, ["record", "--duration", "12", "-o", "run.h5"]),
        ("process smooth", process, ["smooth", "law5.h5"]),
        ("fit-friction", fit_friction, ["law5.h5", "--no-report"]),
        ("fit-friction", fit_friction, ["law3.h5", "--no-report", "--laws", "1"]),
        ("fit-friction", fit_friction, ["law5.h5", "run.h5", "--no-report", "--laws", "5"]),
        ("fit-friction", fit_friction, ["--each", "law5.h5", "--no-report", "--laws", "5"]),
    ]
    for command, app, arguments in lines:
        with contextlib.chdir(tmp_path), contextlib.redirect_stdout(io.StringIO()) as out:
            application.run(app, [*arguments, "--json"])
        section = next(part for part in PAGE.split("\n## ") if command in part.partition("\n")[0])
        named = set(
            re.findall(r"`([^`]+)`", section + PAGE.partition("\n## ")[0] + PAGE.partition("`statistics` has ")[2])
        )
        assert set(keys(json.loads(out.getvalue()))) - named == set(), command
