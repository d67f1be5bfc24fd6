"""The beginning and the end of a command's process."""

import importlib
import signal
import subprocess
import sys

import pytest

from daq.recorder.record import StopRequest
from stickslip.console import start


@pytest.mark.parametrize("entry", ["stickslip", "daq", "process", "fit_friction", "rig_sim"])
def test_every_entry_point_begins_its_command(entry):
    line = [sys.executable, "-c", f"from stickslip.console.start import {entry} as run; run()", "--version"]
    done = subprocess.run(line, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout.split()[0]) == (0, entry.replace("_", "-"))


def test_an_interrupt_while_modules_are_imported_is_no_traceback(monkeypatch, capfd):
    def interrupted(name):
        raise KeyboardInterrupt

    monkeypatch.setattr(importlib, "import_module", interrupted)
    monkeypatch.setattr(sys, "unraisablehook", sys.unraisablehook)
    monkeypatch.setattr(signal, "signal", lambda *arguments: None)
    with pytest.raises(SystemExit) as ended:
        start.daq()
    assert ended.value.code == 130
    assert capfd.readouterr().err == "daq: interrupted\n"


def test_an_entry_point_imports_nothing_before_it_is_guarded():
    # Ctrl-C 25 ms after the start met the import of `typing`, and ended in a traceback.
    line = "import sys; before = set(sys.modules); import stickslip.console.start; print(*{*sys.modules} - before)"
    done = subprocess.run([sys.executable, "-c", line], capture_output=True, text=True, check=True)
    assert sorted(done.stdout.split()) == [
        "stickslip",
        "stickslip.console",
        "stickslip.console.start",
        "stickslip.lazy",
    ]


def test_a_signal_within_the_handler_of_another_is_not_the_first():
    stop = StopRequest()
    stop.set = lambda: nested.append(stop.ask("SIGTERM"))  # a second signal, before the first one is done
    nested = []
    assert stop.ask("stopped")
    assert (nested, stop.reason) == ([False], "stopped")
