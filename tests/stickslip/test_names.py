"""`import stickslip as ss`: the public names of the packages, imported on first use, unless a file hides a package."""

import importlib
import subprocess
import sys
from pathlib import Path

import pytest

import stickslip

ROOT = str(Path(stickslip.__file__).resolve().parents[1])
NAMES = {
    "daq": ("Recording", "load", "record"),
    "processing": ("smooth",),
    "fitting": ("Law", "rank", "rank_each"),
    "rig_sim": ("cycle", "events", "run", "scene"),
}


@pytest.mark.parametrize("package", NAMES)
def test_a_name_is_that_of_its_package(package):
    home = importlib.import_module(package)
    assert all(getattr(stickslip, name) is getattr(home, name) for name in NAMES[package])


@pytest.mark.parametrize("package", ["stickslip", *NAMES])
def test_dir_lists_the_public_names(package):
    module = importlib.import_module(package)
    assert dir(module) == sorted(module.__all__)
    with pytest.raises(AttributeError, match=f"module '{package}' has no attribute 'nothing'"):
        _ = module.nothing


def test_the_names_and_those_for_the_type_checker_are_the_same():
    stub = Path(stickslip.__file__).with_suffix(".pyi").read_text()
    typed = {line.split()[-1] for line in stub.splitlines() if line.startswith("from ")}
    assert typed | {"__version__"} == set(stickslip.__all__)
    assert {name for names in NAMES.values() for name in names} == typed


@pytest.mark.parametrize(
    ("file", "name"),
    [("fitting.py", "load"), ("daq.py", "load"), ("processing/__init__.py", "rank"), ("rig_sim.py", "cycle")],
)
def test_a_file_of_the_users_that_hides_a_package_is_named(tmp_path, file, name):
    # Used to end in "No module named 'daq.imports'; 'daq' is not a package", or to run the user's file.
    hiding = tmp_path / file
    hiding.parent.mkdir(exist_ok=True)
    hiding.write_text("print('mine')\n")
    script = tmp_path / "mine.py"
    script.write_text(f"import sys\nsys.path.append({ROOT!r})\nimport stickslip as ss\nss.{name}\n")
    done = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, check=False)
    package = file.partition("/")[0].removesuffix(".py")
    what = f"this file hides the package '{package}' of stickslip; rename it, or start Python in another folder"
    assert done.stdout == ""
    assert done.stderr.splitlines()[-1] == f"stickslip.errors.InputError: {hiding}: {what}"


def test_a_folder_without_code_hides_nothing(tmp_path):
    (tmp_path / "daq").mkdir()
    line = f"import sys; sys.path.append({ROOT!r}); import stickslip as ss; print(ss.load)"
    done = subprocess.run([sys.executable, "-c", line], capture_output=True, text=True, cwd=tmp_path, check=False)
    assert done.stdout.startswith("<function load"), done.stderr
