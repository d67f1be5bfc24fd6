"""`daq watch`, and the viewer that `daq record --live` starts."""

import contextlib
import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import cyclopts

from stickslip.compute.interpreter import start_python
from stickslip.console import application, flags
from stickslip.console.application import Answer, Json
from stickslip.errors import InputError

NICE = 5  # the viewer gives way to the recorder on a busy computer
APPEARS_S = 30.0  # how long the viewer of `daq record --live` waits for the journal: a board may take 5 s to answer
LOOK_EVERY_S = 0.05

NoBrowser = Annotated[
    bool,
    cyclopts.Parameter(name="--no-browser", negative=(), help="Print the URL of the page without opening a browser."),
]


def watch(
    run: Annotated[
        Path, cyclopts.Parameter(name="RUN.h5", help="Run file, or the journal of a running recording (RUN.h5.part).")
    ],
    /,
    *,
    wait: Annotated[
        float, flags.quantity("--wait", "time", "Time to wait for the journal, in s or with a unit.")
    ] = 0.0,
    no_browser: NoBrowser = False,
    json: Json = False,
) -> Answer:
    """Show a running recording or a finished run in the browser; the first line of the output is the URL.

    The page is served only to this computer, under a random address.  Closing the page, or stopping this command with
    Ctrl-C, does not affect the recording.  The button "Stop" stops the recording, as Ctrl-C in its terminal does.  The
    command ends when the recording ends; for a finished run, it ends with Ctrl-C.

    Example: daq watch run.h5.part
    """
    from daq.live import assets

    assets.check_installed()
    running = run.with_name(run.name + ".part")
    if run.suffix != ".part" and not run.exists() and running.exists():
        run = running
    if run.suffix == ".part":
        _wait_for(run, wait)
    elif not run.exists():
        do = f"check the path; the journal of a running recording is {running.name}"
        raise InputError("there is no such file, and no recording is writing it", str(run), do)
    with contextlib.suppress(AttributeError, OSError):  # no such call on Windows
        os.nice(NICE)
    from daq.live.server import serve

    pages: list[str] = []

    def show(url: str) -> None:
        pages.append(url)
        if not json:
            sys.stdout.write(url + "\n")
            sys.stdout.flush()
        if not no_browser:
            open_browser(url)

    ended = serve(run, show)
    return Answer({"url": pages[0], "ended": ended})


def _wait_for(journal: Path, wait: float) -> None:
    from daq.runfile.journal import is_empty

    until = time.monotonic() + wait
    while wait and is_empty(journal) and time.monotonic() < until:
        time.sleep(LOOK_EVERY_S)


def open_browser(url: str) -> None:
    """Open the user's browser on a page; its output is discarded."""
    nowhere = subprocess.DEVNULL
    with contextlib.suppress(OSError):
        start_python("webbrowser", "-t", url, stdin=nowhere, stdout=nowhere, stderr=nowhere)


@contextmanager
def run_viewer(journal: Path, no_browser: bool) -> Iterator[None]:
    """Run `daq watch` of a recording that is about to begin in a separate session, and print the URL on stderr."""
    words = ("watch", str(journal), "--wait", str(APPEARS_S), "--no-browser")
    streams = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    try:
        process = start_python("daq.cli.app", *words, **streams, start_new_session=True, text=True)
    except OSError as error:
        application.note(f"the live view could not be started: {error.strerror}")
        yield
        return
    threading.Thread(target=_announce, args=(process, no_browser), daemon=True).start()
    try:
        yield
    except BaseException:
        if not journal.exists():
            process.terminate()  # it still waits for a recording that has not begun
        raise


def _announce(process: subprocess.Popen[str], no_browser: bool) -> None:
    """Print the URL of the page as soon as the viewer serves it, or why it does not."""
    if process.stdout is None or process.stderr is None:
        return
    url = process.stdout.readline().strip()
    served = url.startswith("http")
    if served:
        application.note(url)
        if not no_browser:
            open_browser(url)
    # Read to the end: a full pipe would stop the viewer.
    why = [text.strip() for text in process.stderr if text.strip()]
    if not served and process.wait() > 0:
        application.note(f"the live view could not be started: {why[-1] if why else 'the reason is unknown'}")
