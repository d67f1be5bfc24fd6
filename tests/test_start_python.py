"""Children of a command import nothing from the current folder."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


CALLS = {
    "any module": "from stickslip.compute.interpreter import start_python\nstart_python('webbrowser', '--help').wait()",
    "a browser": "import time\nfrom daq.cli.live import open_browser\nopen_browser('file:///no'); time.sleep(0.5)",
    "a child that reads a file": (
        "from daq.runfile import isolation\nfrom pathlib import Path\n"
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
