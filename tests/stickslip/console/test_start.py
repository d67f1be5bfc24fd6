"""The beginning and the end of a command's process."""

import importlib
import signal
import subprocess
import sys
import time
import weakref

import pytest

from daq.recorder.record import StopRequest
from stickslip.console import start


@pytest.mark.parametrize("entry", ["stickslip", "daq", "process", "fit_friction", "rig_sim"])
def test_every_entry_point_begins_its_command(entry):
    line = [sys.executable, "-c", f"from stickslip.console.start import {entry} as run; run()", "--version"]
    done = subprocess.run(line, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout.split()[0]) == (0, entry.replace("_", "-"))


def test_an_interrupt_while_modules_are_imported_is_no_traceback(monkeypatch, capfd):
    # Ctrl-C 50 to 400 ms after the start used to end in a traceback, 8 times of 31.
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


def test_an_interrupt_that_a_callback_loses_comes_again(monkeypatch, capfd):
    # In a callback of the import system or of LLVM it was printed as "Exception ignored", and the command went on; sent
    # again by `_thread.interrupt_main`, it did not end a call that was waiting by then.
    monkeypatch.setattr(sys, "unraisablehook", start.interrupt_again)

    class Thing:
        pass

    def lose():
        thing = Thing()
        watch = weakref.ref(thing, lambda gone: signal.raise_signal(signal.SIGINT))
        del thing
        assert watch() is None
        time.sleep(20)

    began = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        lose()
    assert time.monotonic() - began < 15
    assert capfd.readouterr().err == ""


def test_a_signal_within_the_handler_of_another_is_not_the_first():
    # INT, TERM and HUP together used to set the request within its own lock, and to print within a print.
    stop = StopRequest()
    stop.set = lambda: nested.append(stop.ask("SIGTERM"))  # a second signal, before the first one is done
    nested = []
    assert stop.ask("stopped")
    assert (nested, stop.reason) == ([False], "stopped")
