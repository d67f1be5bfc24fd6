"""SIGTERM and SIGHUP end a command by that signal and leave nothing of what it was writing."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[4]
COMMAND = """
import os, signal, sys, time
from pathlib import Path
from stickslip.console import application, start
from stickslip.output import atomic, disk

NUMBER = int(os.environ["NUMBER"])
app = application.application("writing", "Write.", "writing")

def come():
    os.kill(os.getpid(), NUMBER)

class Lost:
    def __del__(self):
        come()
        sum(range(1000))

@app.default
def write():
    with atomic.replacing(Path("out"), False) as temporary:
        {moment}
    return application.Answer({{}})

sys.unraisablehook = start.interrupt_again
application.main(app)
"""
MOMENTS = {
    "while it writes": "temporary.write_text('half'); come(); time.sleep(5)",
    "twice": "temporary.write_text('half'); come(); come(); time.sleep(5)",
    "twice, the second one while it clears": (
        "\n        try: come(); time.sleep(5)\n        finally: come(); sum(range(1000))"
    ),
    "within HDF5": "\n        with disk.open_hdf5(temporary, 'w') as file: file['x'] = 1; come(); file['y'] = 2",
    "lost in a callback": "lost = Lost(); del lost; time.sleep(5)",
}


def ended(folder, moment, number):
    code = COMMAND.format(moment=MOMENTS[moment])
    return subprocess.run(
        [sys.executable, "-c", code],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": str(ROOT), "NUMBER": str(int(number))},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
        preexec_fn=lambda: signal.signal(number, signal.SIG_DFL),
    )


@pytest.mark.parametrize(
    ("moment", "number"), [*((moment, signal.SIGTERM) for moment in MOMENTS), ("while it writes", signal.SIGHUP)]
)
def test_nothing_is_left(tmp_path, moment, number):
    done = ended(tmp_path, moment, number)
    assert done.returncode == -number, done.stderr
    assert "Traceback" not in done.stderr
    assert not list(tmp_path.iterdir())
