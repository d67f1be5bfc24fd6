"""What each command loads: only what it needs, seen through sys.modules in a process of its own."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from stickslip.version import VERSION

ROOT = str(Path(__file__).resolve().parent.parent)
MODULES = {
    "stickslip": "stickslip.console.commands",
    "daq": "daq.cli.app",
    "process": "processing.cli",
    "fit-friction": "fitting.cli",
    "rig-sim": "rig_sim.cli.app",
}
PACKAGES = ("stickslip", "daq", "processing", "fitting", "rig_sim")
HELP = {
    "stickslip": "record import smooth fit list watch export sim demo doctor",
    "daq": "record recover check calibrate replay decode import export ports doctor demo",
    "process": "smooth compare inspect export",
    "fit-friction": "",
    "rig-sim": "scenes cycle events run compare",
}
LIGHT = "numpy scipy mpmath pandas matplotlib numba h5py serial"
LOADER = """
import json, sys
found = []
for sys.argv in {lines!r}:
    try:
        from {module} import main
        main()
    except SystemExit as stop:
        code = stop.code
    found.append([code, sorted({{".".join(name.split(".")[:n]) for name in sys.modules for n in (1, 2)}})])
sys.stderr.write("\\nLOADED " + json.dumps(found))
"""


def loaded(command, *lines, cwd=None):
    """Run a command, line after line, in a fresh interpreter; return the modules and submodules after each."""
    source = LOADER.format(lines=[[command, *line] for line in lines], module=MODULES[command])
    done = subprocess.run([sys.executable, "-c", source], capture_output=True, text=True, cwd=cwd, check=False)
    assert "LOADED " in done.stderr, done.stderr
    found = json.loads(done.stderr.rsplit("LOADED ", 1)[1])
    assert all(code in (0, None) for code, _ in found), done.stderr
    return [set(names) for _, names in found]


@pytest.mark.parametrize("command", HELP)
def test_help_loads_no_numerical_package(command):
    lines = [["--help"], *([name, "--help"] for name in HELP[command].split())]
    heavy = {"numpy", "h5py", "scipy", "pandas", "matplotlib", "numba", "pydantic", "serial", "jinja2"}
    for line, names in zip(lines, loaded(command, *lines), strict=True):
        assert not names & heavy, line


@pytest.mark.parametrize(
    ("command", "line", "needed", "spared"),
    [
        ("daq", "record --duration 0.5 --json", "numpy h5py serial", "scipy pandas matplotlib numba jinja2"),
        ("rig-sim", "cycle base --json", "", LIGHT),
        ("rig-sim", "events rig --until 20 --json", "", LIGHT),
        ("process", "smooth law5.h5 --json", "numba", "pandas matplotlib"),
    ],
)
def test_a_command_loads_what_it_needs(tmp_path, command, line, needed, spared):
    shutil.copy(f"{ROOT}/data_samples/law5.h5", tmp_path)
    (names,) = loaded(command, line.split(), cwd=tmp_path)
    assert set(needed.split()) <= names
    assert not set(spared.split()) & names


@pytest.mark.parametrize("package", PACKAGES)
def test_importing_a_package_or_asking_its_version_loads_nothing_else(package):
    seen = "json.dumps(sorted(sys.modules))"
    here = f"import sys; sys.path.insert(0, {ROOT!r})"
    source = f"{here}; import json, {package}; print({seen}); print({package}.__version__); print({seen})"
    done = subprocess.run([sys.executable, "-I", "-c", source], capture_output=True, text=True, check=True)
    first, version, last = done.stdout.splitlines()
    assert version == VERSION
    names = set(json.loads(last))
    lazy = ("stickslip", "stickslip.lazy")
    ours = [{name for name in json.loads(loaded) if name.split(".")[0] in PACKAGES} for loaded in (first, last)]
    assert ours == [{package, *lazy}, {package, *lazy, "stickslip.version"}]
    assert not names & {"numpy", "h5py", "scipy", "numba", "pydantic", "serial", "cyclopts"}
