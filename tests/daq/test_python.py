"""Examples of the public functions do what they say; the page of rig.toml has every key."""

import doctest
import re
import shutil
from pathlib import Path

import pytest

import daq
import processing
from daq.base.console.settings import KEYS
from daq.base.measured import QUANTITIES
from daq.runfile.rig import SECTIONS
from fitting import Law, Ranking, rank

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize(
    "what",
    [daq.Recording.from_arrays, daq.load, daq.record, daq.recover, processing.smooth, rank, Ranking, Law],
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
    page = (ROOT / "docs" / "reference" / "rig-toml.md").read_text()
    for section, keys in {**SECTIONS, "board": tuple(KEYS)}.items():
        part = page.split(f"| key of `[{section}]`")[1].split("\n\n")[0]
        rows = dict(re.findall(r"^\| `(\w+)` \|.*\| ?(yes)? ?\|$", part, re.MULTILINE))
        rows |= {name: "" for name in re.findall(r"^\| `(\w+)` \|", part, re.MULTILINE) if name not in rows}
        assert tuple(rows) == keys or set(rows) == set(keys)
        if section != "board":
            assert {name for name, sd in rows.items() if sd} == {name for name in keys if name in QUANTITIES}


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
