"""Where the four commands begin: a Ctrl-C while their modules are imported ends them without a traceback."""

import contextlib
import os
import signal
from importlib import import_module
from typing import NoReturn

from daq.errors import EXIT_INTERRUPTED


def daq() -> NoReturn:
    """Run ``daq``."""
    _run("daq", "daq.cli.app")


def process() -> NoReturn:
    """Run ``process``."""
    _run("process", "processing.cli")


def fit_friction() -> NoReturn:
    """Run ``fit-friction``."""
    _run("fit-friction", "fitting.cli")


def rig_sim() -> NoReturn:
    """Run ``rig-sim``."""
    _run("rig-sim", "rig_sim.cli.app")


def _run(name: str, module: str) -> NoReturn:
    try:
        import_module(module).main()
    except KeyboardInterrupt:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        with contextlib.suppress(OSError):
            os.write(2, f"{name}: interrupted\n".encode())
        raise SystemExit(EXIT_INTERRUPTED) from None
    raise SystemExit  # main does not return
