"""Record from anything that gives samples: a port, the simulated rig, or a program's own blocks."""

import contextlib
import os
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from numbers import Integral
from pathlib import Path
from typing import TYPE_CHECKING, Any

from daq.protocols.request import RecordRequest
from daq.recorder import names
from daq.recorder.blocks import WHERE, record_blocks
from daq.recorder.notes import NoteFlags
from daq.recorder.record import record as record_board
from daq.runfile.journal_header import FASTEST_HZ, SLOWEST_HZ
from daq.runfile.rig import Rig, find_replaced
from stickslip import toml
from stickslip.compute.interpreter import start_python
from stickslip.errors import InputError, check_type
from stickslip.units import Stated, exact_in_si, read_all_stated

if TYPE_CHECKING:
    from daq.finalise.quality import RecordingQuality

DURATION_S = RecordRequest.duration_s  # from a port, where none is stated
APPEARS_S = "30 s"  # how long the live view waits for a recording that begins


def record(
    source: str | Iterable[Any],
    output: str | os.PathLike[str],
    *,
    rate_hz: float | str | None,
    seconds: float | str | None = None,
    mass: Stated | None = None,
    stiffness: Stated | None = None,
    damping: Stated | None = None,
    belt_speed: Stated | None = None,
    x0: Stated | None = None,
    metres_per_count: Stated | None = None,
    rig: str | os.PathLike[str] | None = None,
    protocol: str = "frames",
    columns: str | None = None,
    baud: int | None = None,
    decoder: str | None = None,
    title: str | None = None,
    operator: str | None = None,
    sample: str | None = None,
    note: str | None = None,
    tags: Mapping[str, str] | None = None,
    live: bool = False,
    force: bool = False,
    progress: Callable[[float], None] = lambda seconds: None,
    say: Callable[[str], None] = lambda line: None,
    stop: threading.Event | None = None,
) -> "RecordingQuality":
    """Record a run from a port, a URL or an iterable of blocks of samples, such as a data acquisition card's.

    While it runs the recording is a journal, ``OUTPUT.part``, from which ``daq recover`` makes the run file if the
    process is killed: with all blocks that were taken before.  Ctrl-C ends the recording and keeps its data.

    Parameters
    ----------
    source : str or iterable
        A device (``"/dev/ttyACM0"``, ``"COM3"``) or URL (``"rig://rig"``, the simulated rig), as ``daq record --port``
        takes them; or an iterable of blocks ``(t, x)`` or ``(t, count)``: arrays of one length, or single numbers, with
        times in s by one clock and positions in m, or counts as integers.
    output : path
        The run file; ``run-{n:03}.h5`` is numbered.
    rate_hz : float, text with a unit, or None
        Nominal sample rate, Hz or ``"1 kHz"``.  Where times step by n periods, n - 1 samples are counted as lost.  None
        for a port that sets its own rate (text lines).
    seconds : float or text with a unit, optional
        Duration, s or ``"2 min"``; by default until the iterable ends, and 20 s from a port.  The recording also ends
        if an iterable yields no sample for this time, or for 5 s if that is longer.
    mass, stiffness, damping, belt_speed, x0, metres_per_count : quantity, optional
        What is known of the rig, as for `Recording.from_arrays`; overrides the board and ``rig``.
    rig : path, optional
        A rig.toml.
    protocol, columns, baud, decoder
        Of a port, as the flags of ``daq record``.
    title, operator, sample, note, tags
        Notes on the run; tags are a mapping of texts.
    live : bool
        Show the recording in the browser (``daq watch``), in a separate process.
    force : bool
        Replace an existing file.
    progress, say : callable
        Called with the seconds recorded so far, and with a line of text about a board.
    stop : threading.Event, optional
        Ends the recording when it is set; at most 3 s later where the iterable yields nothing.

    Returns
    -------
    RecordingQuality
        Samples, losses, clock, warnings and ``file``, the run file: what ``daq record --json`` prints.

    Raises
    ------
    InputError
        For impossible arguments, an existing file, a block that is not two columns of equal length, times that do
        not increase, or a rate that they do not have.  Blocks before a wrong one are kept in the file.
    DeviceError
        The port does not answer; the source raised an exception (its ``__cause__``): what came before is in the file;
        or the disk refuses, and the journal is kept.
    DataError
        There was not one sample.

    Examples
    --------
    >>> import numpy as np
    >>> import daq
    >>> def blocks():  # a card that gives 0.1 s at a time
    ...     for k in range(20):
    ...         t = (100 * k + np.arange(100)) / 1000
    ...         yield t, 0.01 * np.sin(6 * t)
    >>> found = daq.record(blocks(), "card.h5", rate_hz=1000, mass="300 g")
    >>> found
    <RecordingQuality card.h5: 2000 samples, 2 s at 1000 Hz, no sample lost>
    >>> daq.load("card.h5").rig.mass
    Measured(value=0.3, sd=0.0)
    """
    texts = {"title": title, "operator": operator, "sample": sample, "note": note}
    for name, text in (texts | {"protocol": protocol, "columns": columns, "decoder": decoder}).items():
        check_type(text, str, name, WHERE, "text")
    check_type(output, (str, os.PathLike), "output", WHERE, "a path")
    check_type(rig, (str, os.PathLike), "rig", WHERE, "the path of a rig.toml")
    check_type(tags, Mapping, "tags", WHERE, "a mapping of texts, such as {'humidity': '45 %'}")
    check_type(baud, Integral, "baud", WHERE, "a whole number, such as 115200")
    check_type(stop, threading.Event, "stop", WHERE, "a threading.Event")
    rate, length_s = exact_in_si(rate_hz, "rate", "rate_hz"), exact_in_si(seconds, "time", "seconds")
    typed_tags = [f"{name}={value}" for name, value in (tags or {}).items()]
    request = RecordRequest(
        output=names.complete_name(Path(output)),
        duration_s=DURATION_S if length_s is None else length_s,
        force=force,
        baud=baud,
        protocol=protocol,
        columns=columns,
        decoder=decoder,
        notes=NoteFlags(title, operator, sample, note, typed_tags or None).collect(),
        stated=read_all_stated(
            mass=mass,
            stiffness=stiffness,
            damping=damping,
            belt_speed=belt_speed,
            x0=x0,
            metres_per_count=metres_per_count,
        ),
        calibration=None if rig is None else toml.read_text(Path(rig), "rig"),
    )
    with _viewer(request.part) if live else contextlib.nullcontext():
        if isinstance(source, str):
            request = replace(request, port=source, rate_hz=_check_whole(rate))
            return record_board(request, progress=progress, say=say, stop=stop)
        if isinstance(source, Mapping) or not isinstance(source, Iterable):
            what = f"the source must not be a {type(source).__name__}"
            raise InputError(what, WHERE, "pass a port, a URL, or an iterable of blocks (t, x)")
        if rate is None or not SLOWEST_HZ <= rate <= FASTEST_HZ:
            raise InputError(f"rate_hz is {rate_hz}", WHERE, "pass the samples per second of the source")
        stored = Rig.from_toml(request.calibration or "", str(rig))
        used = stored.stating(request.stated)
        warnings = [row.text for row in find_replaced(stored, used)]
        request = replace(request, calibration=used.to_toml())
        return record_blocks(source, request, rate, length_s, warnings, progress=progress, stop=stop)


def recover(
    journal: str | os.PathLike[str], output: str | os.PathLike[str] | None = None, *, force: bool = False
) -> "RecordingQuality":
    """Build the run file of a recording that was killed, out of its journal; ``daq recover`` does the same.

    Parameters
    ----------
    journal : path
        The journal of the recording, ``RUN.h5.part``.
    output : path, optional
        The run file; by default the journal's name without ``.part``.
    force : bool
        Replace an existing file.

    Returns
    -------
    RecordingQuality

    Raises
    ------
    InputError
        The journal is missing, not a journal, or still being written; or the run file exists.
    DataError
        The journal has no samples.

    Examples
    --------
    >>> import daq
    >>> found = daq.recover("run.h5.part")  # doctest: +SKIP
    """
    from daq.finalise.run import finalise
    from stickslip.output import suffix

    part = Path(journal)
    if part.suffix != ".part":
        raise InputError("is not a journal", str(part), "use the file RUN.h5.part of the recording")
    target = part.with_suffix("") if output is None else Path(output)
    suffix.check_run(target)
    return finalise(part, target, finished_by="daq recover", force=force)


def _check_whole(rate_hz: float | None) -> int | None:
    if rate_hz is not None and not rate_hz.is_integer():  # nor are infinity and NaN
        raise InputError(f"rate_hz is {rate_hz}", WHERE, "a port requires whole Hz, such as rate_hz=1000")
    return None if rate_hz is None else int(rate_hz)


@contextlib.contextmanager
def _viewer(part: Path) -> Iterator[None]:
    """Show a recording that is about to begin in the browser, by a process that ends soon after it."""
    process = start_python("daq.cli.app", "watch", str(part), "--wait", APPEARS_S, start_new_session=True)
    try:
        yield
    except BaseException:
        if not part.exists():
            process.terminate()  # it still waits for a recording that has not begun
        raise
