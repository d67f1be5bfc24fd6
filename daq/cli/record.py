"""`daq record`, `daq recover`, `daq ports`."""

import contextlib
import os
import signal
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Annotated

import cyclopts

from daq.cli import sentences
from daq.cli.live import NoBrowser, run_viewer
from daq.cli.settings import NO_FLAGS, BoardFlags, resolve
from daq.protocols.request import RecordRequest
from daq.recorder.notes import NO_NOTES, NoteFlags
from stickslip.console import application, flags
from stickslip.console.application import Answer, Json, SetChanges
from stickslip.console.flags import Force
from stickslip.console.rig_flags import NO_RIG, RigFlags
from stickslip.errors import EXIT_DATA, EXIT_DEVICE, EXIT_DONE, InputError

if TYPE_CHECKING:
    from daq.recorder.record import StopRequest

DEFAULT_SCENE = "rig"

Duration = Annotated[
    float, flags.quantity("--duration", "time", "Duration of the recording, such as '20', '20 s' or '5 min'.")
]
Output = Annotated[
    Path,
    cyclopts.Parameter(
        name=["--output", "-o"],
        metavar="RUN.h5",
        help="Run file to write; run-{n:03}.h5 is numbered automatically.",
        group=flags.OUTPUT,
    ),
]
Scene = Annotated[
    str | None,
    cyclopts.Parameter(
        name="--scene", help="Scene of the simulated rig: a built-in name (default 'rig') or a TOML file."
    ),
]
Realtime = Annotated[
    bool,
    cyclopts.Parameter(name="--realtime", negative=(), help="Run the simulated rig in real time."),
]


Live = Annotated[
    bool,
    cyclopts.Parameter(
        name="--live", negative=(), help="Show the recording in the browser; the simulated rig then runs in real time."
    ),
]


def record(
    *,
    duration: Duration = RecordRequest.duration_s,
    output: Output = RecordRequest.output,
    scene: Scene = None,
    set_: SetChanges = None,
    realtime: Realtime = False,
    live: Live = False,
    no_browser: NoBrowser = False,
    board: BoardFlags = NO_FLAGS,
    known: RigFlags = NO_RIG,
    notes: NoteFlags = NO_NOTES,
    force: Force = False,
    json: Json = False,
) -> Answer:
    """Record a run.  Ctrl-C stops and keeps the data; a second Ctrl-C leaves the journal for 'daq recover'.

    The exit code is 4, with the file kept, if the run has less than 90 % of the duration and was not stopped by Ctrl-C,
    or if more than 10 % of its samples are lost.  It is 3 if the file had to be written to another folder.

    Port, protocol, columns, baud, rate and decoder may also come from the environment (STICKSLIP_PORT ...), from the
    [board] of --rig, or from the user's config.toml, in this order.

    Values given as flags (--mass, --metres-per-count ...) override those of --rig and of the board.

    In the name of the run file, {n} is replaced by the next free number, and {date} by the date and time.

    Example: daq record

    Example: daq record --rate 1000 --duration 20 -o run.h5

    Example: daq record --port /dev/ttyACM0 --protocol text --columns t_us,F_N --stiffness "168 N/m" -o run.h5

    Example: daq record -o 'run-{n:03}.h5' --sample "brass on steel" --operator Ada --tag humidity=45
    """
    from daq.recorder import names
    from daq.recorder.record import record as take

    if live:
        from daq.live import assets

        assets.check_installed()
        realtime = realtime or "port" not in resolve(board)
    if scene is not None or set_ or realtime:
        if board.port is not None:
            flag = "--scene" if scene is not None else "--set" if set_ else "--realtime"
            what = f"{flag} applies only to the simulated rig, but --port {board.port} was given"
            raise InputError(what, flag, "use only one of them")
        board = replace(board, port=rig_port(scene, set_, realtime))
    written = notes.collect()
    target = names.complete_name(output)
    request = RecordRequest(
        output=target, duration_s=duration, force=force, stated=known.stated(), notes=written, **resolve(board)
    )
    view = run_viewer(request.part, no_browser) if live else contextlib.nullcontext()
    with contextlib.ExitStack() as signals:
        stop = signals.enter_context(_stop_on_signal())
        with view, application.progress("recording", duration, "s") as show:
            recorded = take(request, progress=show, status=show.status, say=application.note, stop=stop)
        code = EXIT_DATA if recorded.short or recorded.sparse else EXIT_DONE if recorded.file == target else EXIT_DEVICE
        text = sentences.format_recording("recorded", recorded)
        return Answer(recorded.as_json(), text, code, printed=signals.pop_all())


def rig_port(scene: str | None, changes: list[str] | None, realtime: bool) -> str:
    """Return the URL of the simulated rig with a scene, a built-in name or a TOML file."""
    from daq.recorder.ports import rig_url

    name = scene if scene is not None else DEFAULT_SCENE
    return rig_url(str(Path(name).absolute()) if name.endswith(".toml") else name, changes or [], realtime)


def recover(
    journal: Annotated[Path, cyclopts.Parameter(name="RUN.h5.part", help="Journal of the recording.")],
    /,
    *,
    output: Annotated[
        Path | None,
        cyclopts.Parameter(
            name=["--output", "-o"], help="Run file to write; by default the name of the journal without .part."
        ),
    ] = None,
    force: Force = False,
    json: Json = False,
) -> Answer:
    """Build the run file of an interrupted recording from its journal.

    Example: daq recover run.h5.part
    """
    from daq.recorder import source

    recovered = source.recover(journal, output, force=force)
    return Answer(recovered.as_json(), sentences.format_recording("recovered", recovered))


def ports(*, json: Json = False) -> Answer:
    """List the ports to which a board may be connected, and explain how to open a port that cannot be opened.

    Example: daq ports
    """
    from daq.recorder.ports import list_ports

    infos = list_ports()
    width = max(len(item.port) for item in infos)
    lines = []
    for item in infos:
        lines.append(f"{item.port:<{width}}  {item.description}")
        if item.do:
            lines.append(f"{'':<{width}}  no permission:  {item.do}")
    if len(infos) == 1:
        lines.append("no serial port was found: connect the board and try again")
    data = [vars(item) for item in infos]
    return Answer(data, "\n".join(lines))


@contextlib.contextmanager
def _stop_on_signal() -> Iterator["StopRequest"]:
    """Yield a request set by the first Ctrl-C, SIGTERM or SIGHUP, unless ignored; a second Ctrl-C interrupts."""
    from daq.recorder.record import StopRequest
    from daq.runfile import journal

    stop = StopRequest()

    def on_signal(number: int, frame: FrameType | None) -> None:
        # It may interrupt itself, and whatever is being printed or locked.
        if not stop.ask(journal.STOPPED if number == signal.SIGINT else signal.Signals(number).name):
            if number == signal.SIGINT:
                raise KeyboardInterrupt
            return  # a terminal that closes may send it twice
        with contextlib.suppress(OSError):
            os.write(2, b"Stopping and saving. Press Ctrl-C again to quit immediately.\n")

    numbers = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]
    handled = [number for number in numbers if signal.getsignal(number) != signal.SIG_IGN]
    before = {number: signal.signal(number, on_signal) for number in handled}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
