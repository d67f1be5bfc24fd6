"""Where the commands begin: a Ctrl-C while their modules are imported ends them without a traceback.

Nothing is imported here before that is guarded.
"""

TYPE_CHECKING = False
if TYPE_CHECKING:
    from sys import UnraisableHookArgs
    from typing import NoReturn

AGAIN_S = 0.01  # until a lost Ctrl-C comes again: a hundred times what the callbacks take in which one was lost


def stickslip() -> "NoReturn":
    """Run ``stickslip``."""
    _run("stickslip", "stickslip.console.commands")


def daq() -> "NoReturn":
    """Run ``daq``."""
    _run("daq", "daq.cli.app")


def process() -> "NoReturn":
    """Run ``process``."""
    _run("process", "processing.cli")


def fit_friction() -> "NoReturn":
    """Run ``fit-friction``."""
    _run("fit-friction", "fitting.cli")


def rig_sim() -> "NoReturn":
    """Run ``rig-sim``."""
    _run("rig-sim", "rig_sim.cli.app")


def _run(name: str, module: str) -> "NoReturn":
    try:
        import signal  # noqa: F401 (for `_end`, which a second Ctrl-C may meet)
        import sys
        import threading  # noqa: F401 (for the hook, which may be called in the middle of an import)
        from importlib import import_module

        sys.unraisablehook = interrupt_again
        import_module(module).main()
    except KeyboardInterrupt:
        _end(name)
    raise SystemExit  # main does not return


def _end(name: str) -> "NoReturn":
    import signal

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    import contextlib
    import os

    from stickslip.console.termination import end_by_signal
    from stickslip.errors import EXIT_INTERRUPTED

    with contextlib.suppress(OSError):
        os.write(2, f"{name}: interrupted\n".encode())
    end_by_signal()
    raise SystemExit(EXIT_INTERRUPTED) from None


def interrupt_again(lost: "UnraisableHookArgs") -> None:
    """Let a Ctrl-C come again that was lost in a callback of a library; report other exceptions as usual.

    An exception cannot leave such a callback: Python prints it and the command goes on.  The signal is sent to the main
    thread, so that it also ends a call which waits there; `_thread.interrupt_main` would take effect behind that call.
    """
    import _thread
    import signal
    import sys
    import threading

    if not issubclass(lost.exc_type, KeyboardInterrupt):
        sys.__unraisablehook__(lost)
        return
    number = getattr(lost.exc_value, "number", signal.SIGINT)  # of a `TerminatedError`
    if sys.platform == "win32":  # has no signals to threads
        timer = threading.Timer(AGAIN_S, _thread.interrupt_main)
    else:
        timer = threading.Timer(AGAIN_S, signal.pthread_kill, (threading.main_thread().ident, number))
    timer.daemon = True
    timer.start()
