"""Examples of the public functions do what they say; the page of rig.toml has every key."""

import doctest
import re
import shutil
from pathlib import Path

import pytest

import daq
import processing
from daq.cli.settings import KEYS
from daq.runfile.rig import SECTIONS
from fitting import Law, Ranking, rank
from stickslip.units import QUANTITIES

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize(
    "what",
    [
        *(daq.Recording.from_arrays, daq.load, daq.record, daq.recover, processing.smooth, Law),
        *(pytest.param(what, marks=pytest.mark.slow) for what in (rank, Ranking)),
    ],
    ids=lambda what: what.__name__,
)
def test_its_example_does_what_it_says(what, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    shutil.copytree(ROOT / "data_samples", "data_samples")
    (test,) = [found for found in doctest.DocTestFinder(recurse=False).find(what, what.__name__) if found.examples]
    said: list[str] = []
    result = doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE).run(test, out=said.append)
    assert result.attempted > 0
    assert result.failed == 0, "".join(said)


def test_the_page_of_rig_toml_has_every_key():
    page = (ROOT / "docs" / "reference" / "run-file.md").read_text()
    without_sd = re.findall(r"`(\w+)`", page.split("`KEY`, for all keys except ")[1].split(".\n")[0])
    for section, keys in {**SECTIONS, "board": tuple(KEYS)}.items():
        rows = re.findall(r"^\| `(\w+)` \|", page.split(f"| key of `[{section}]`")[1].split("\n\n")[0], re.MULTILINE)
        assert set(rows) == set(keys)
        if section != "board":
            assert set(rows) - set(without_sd) == {name for name in keys if name in QUANTITIES}


def test_importing_daq_and_asking_for_a_run_loads_no_command_line(tmp_path):
    import subprocess
    import sys

    daq.Recording.from_arrays([0, 1, 2], [0.0, 0.1, 0.2]).save(tmp_path / "run.h5")
    source = (
        "import sys, daq; daq.load('run.h5'); daq.Recording.from_arrays([0, 1], [0.0, 1.0]);"
        "print(sorted({name.split('.')[0] for name in sys.modules} "
        "& {'cyclopts', 'rich', 'pandas', 'scipy', 'matplotlib'}))"
    )
    done = subprocess.run([sys.executable, "-c", source], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
