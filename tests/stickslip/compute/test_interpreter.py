"""Settings for other users of a library change nothing in a command; a program that imports a package keeps its own."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[4]
SEEN = """
import json, os, sys
from stickslip.compute import interpreter
if sys.argv[1:] == ["command"]:
    interpreter.ignore_settings()
import matplotlib
from numba.core import config
config.reload_config()
print(json.dumps([matplotlib.rcParams["savefig.dpi"], str(matplotlib.rcParams._get("backend"))[:8] == "template",
                  config.DISABLE_JIT, config.DEBUG, os.environ.get("NUMBA_CACHE_DIR")]))
"""
DEFAULTS = ["figure", False, 0, 0, "/kept"]


def settings_seen(folder, environment, *words):
    others = {name: value for name, value in os.environ.items() if not name.startswith(("NUMBA", "MPL", "MATPL"))}
    environment = others | {"PYTHONPATH": str(ROOT), "NUMBA_CACHE_DIR": "/kept"} | environment
    line = [sys.executable, "-W", "error", "-c", SEEN, *words]
    done = subprocess.run(line, cwd=folder, env=environment, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


SEVEN, UNCOMPILED = b"savefig.dpi: 7\n", b"disable_jit: 1\n"


@pytest.mark.parametrize(
    ("files", "environment"),
    [
        (
            {"matplotlibrc": SEVEN, ".numba_config.yaml": UNCOMPILED},
            {"MPLBACKEND": "template", "NUMBA_DISABLE_JIT": "1", "NUMBA_DEBUG": "1"},
        ),
        (
            {"matplotlibrc": b"\xff\xfe damaged \x80", ".numba_config.yaml": b"a: [\n"},
            {"MPLBACKEND": "bogus", "NUMBA_OPT": "x"},
        ),
        ({"matplotlibrc": None, ".numba_config.yaml": None}, {}),  # FIFOs: to read one waits for ever
        ({"rc": SEVEN, "matplotlib/matplotlibrc": SEVEN}, {"MATPLOTLIBRC": "rc", "XDG_CONFIG_HOME": "."}),
    ],
)
def test_a_command_runs_on_the_defaults(tmp_path, files, environment):
    for name, content in files.items():
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        if content is None:
            os.mkfifo(path)
        else:
            path.write_bytes(content)
    assert settings_seen(tmp_path, environment, "command") == DEFAULTS


def test_a_program_keeps_its_settings(tmp_path):
    (tmp_path / "matplotlibrc").write_text("savefig.dpi: 7\n")
    seen = settings_seen(tmp_path, {"MPLBACKEND": "template", "NUMBA_DISABLE_JIT": "1"})
    assert seen == [7.0, True, 1, 0, "/kept"]


def test_a_program_that_switches_compiling_off_gets_the_same_numbers(tmp_path):
    code = (
        "if __name__ == '__main__':\n import numpy as np, processing\n t = np.arange(150) / 400\n"
        " print(processing.smooth(t, 0.01 * np.sin(6 * t), method='sg').velocity[75].round(6))"
    )
    script = tmp_path / "own.py"
    script.write_text(code)
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    said = [
        subprocess.run(
            [sys.executable, script], env=environment | extra, capture_output=True, text=True, check=True, timeout=120
        ).stdout
        for extra in ({}, {"NUMBA_DISABLE_JIT": "1"})
    ]
    assert said[0] == said[1]
