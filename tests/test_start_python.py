"""Children of a command import nothing from the current folder, and there is one place that starts Python."""

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("stickslip", "daq", "processing", "fitting", "rig_sim")
HELPER, WORKERS = "stickslip/compute/interpreter.py", "stickslip/compute/workers.py"
SAFE_NAMES = {"Future", "CancelledError", "BrokenProcessPool"}  # of the modules that start processes


def starts_of_python(tree):
    """Yield the lines of a module that name the interpreter in a command, or start processes that are interpreters."""
    harmless = {
        id(inner)
        for node in ast.walk(tree)
        if isinstance(node, ast.JoinedStr)
        or (isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "Path")
        for inner in ast.walk(node)
    }
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and node.attr in ("executable", "_base_executable"):
            if id(node) not in harmless:
                yield node.lineno
        elif isinstance(node, ast.List | ast.Tuple) and node.elts and isinstance(node.elts[0], ast.Constant):
            words = [element.value for element in node.elts if isinstance(element, ast.Constant)]
            if str(words[0]).startswith("python") and {"-m", "-c", "-P"} & set(map(str, words)):
                yield node.lineno
        elif isinstance(node, ast.ImportFrom):
            names = {alias.name for alias in node.names}
            starts = (node.module or "").startswith(("multiprocessing", "concurrent.futures")) and names - SAFE_NAMES
            if starts or (node.module == "sys" and "executable" in names):
                yield node.lineno
        elif isinstance(node, ast.Import):
            if any(alias.name.startswith(("multiprocessing", "concurrent.futures")) for alias in node.names):
                yield node.lineno


def test_python_is_started_in_one_place():
    found = {
        f"{path.relative_to(ROOT).as_posix()}:{line}"
        for package in PACKAGES
        for path in sorted((ROOT / package).rglob("*.py"))
        for line in starts_of_python(ast.parse(path.read_text()))
        if path.relative_to(ROOT).as_posix() not in (HELPER, WORKERS)
    }
    assert not found


@pytest.mark.parametrize(
    "code",
    [
        "subprocess.run([sys.executable, '-m', 'x'])",
        "line = (sys.executable, '-c', 'x')",
        "subprocess.Popen(['python3', '-m', 'x'])",
        "from concurrent.futures import ProcessPoolExecutor",
        "import multiprocessing",
        "from sys import executable",
    ],
)
def test_another_place_would_be_seen(code):
    assert list(starts_of_python(ast.parse(code)))


CALLS = {
    "any module": "from stickslip.compute.interpreter import start_python\nstart_python('webbrowser', '--help').wait()",
    "a browser": "import time\nfrom daq.cli.live import open_browser\nopen_browser('file:///no'); time.sleep(0.5)",
    "a child that reads a file": (
        "from daq.runfile import isolation\nfrom daq.runfile import trust\nfrom pathlib import Path\n"
        "try: isolation._spawn(Path.read_bytes, Path('none'), 20.0, 1 << 30)\nexcept Exception: pass"
    ),
    "processes": (
        "if __name__ == '__main__':\n    from stickslip.compute.workers import workers\n"
        "    with workers(2) as each: assert list(each(abs, [-1, -2])) == [1, 2]"
    ),
}


@pytest.mark.parametrize("name", CALLS)
def test_modules_of_the_current_folder_are_not_run(tmp_path, name):
    data, scripts = tmp_path / "data", tmp_path / "scripts"
    data.mkdir(), scripts.mkdir()
    for module in ("webbrowser", "daq", "multiprocessing", "fitting", "starlette", "argparse", "json", "selectors"):
        (data / f"{module}.py").write_text(f"open({str(tmp_path / 'RAN')!r}, 'w').write({module!r})")
    script = scripts / "call.py"
    script.write_text(CALLS[name])
    environment = os.environ | {"PYTHONPATH": str(ROOT), "BROWSER": "true %s"}
    subprocess.run([sys.executable, script], cwd=data, check=True, env=environment, timeout=60)
    assert not (tmp_path / "RAN").exists()
