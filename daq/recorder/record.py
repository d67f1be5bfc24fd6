"""The recorder: a thread reads the port, the caller's thread writes the journal, the finaliser builds the file.

The first interrupt (the caller sets ``stop``) ends the recording and keeps the data; a second one (KeyboardInterrupt)
leaves the journal, which ``daq recover`` turns into the same file.  The journal is locked from its first byte until the
run file is in place.
"""

import json
import logging
import os
import platform
import queue
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from daq import protocols
from daq.finalise import claim
from daq.protocols import link_budget
from daq.protocols.columns import FORCE
from daq.protocols.request import RecordRequest
from daq.protocols.session import Identity, Plan, Session
from daq.recorder import ports
from daq.recorder.journal_place import JournalPlace
from daq.recorder.reader import Reader
from daq.runfile import journal, provenance
from daq.runfile.journal_header import MOST_SAMPLES
from daq.runfile.rig import Rig, find_replaced
from stickslip.errors import EXIT_INTERRUPTED, DataError, DeviceError, InputError, StickslipError
from stickslip.output import disk
from stickslip.units import Measured

if TYPE_CHECKING:
    from daq.finalise.quality import RecordingQuality

logger = logging.getLogger(__name__)
WAKE_S = 0.1  # how often the writer looks at the clock while nothing comes
LEAVE_S = 3.0  # how long a leaving recorder waits for its reader


class RecordingInterruptedError(StickslipError):
    """Interrupted a second time, and the journal is left as it is; or before there was anything to keep."""

    exit_code = EXIT_INTERRUPTED


class StopRequest(threading.Event):
    """Ends a recording when it is set; ``reason`` is "stopped" or the name of a signal, for the journal."""

    reason = journal.STOPPED
    _asked = False

    def ask(self, reason: str) -> bool:
        """Set it, from a signal handler that another one may interrupt; return whether this is the first time."""
        if self._asked:
            return False
        self._asked = True
        self.reason = reason
        self.set()
        return True


def check_request(request: RecordRequest) -> None:
    """Raise InputError for a request that cannot be carried out; nothing has been touched then."""
    if request.rate_hz is not None and request.rate_hz < 1:
        raise InputError(
            f"the rate is {request.rate_hz} Hz",
            "--rate",
            "it must be 1 Hz or more",
            python="it must be rate_hz=1 or more",
        )
    count_samples(request.duration_s, request.rate_hz or 1000)
    protocols.load(request.protocol).check(request)
    if request.calibration is not None:
        Rig.from_toml(request.calibration, "--rig")
    check_output(request)


def check_output(request: RecordRequest) -> None:
    """Raise InputError for a run file that may not be written, or whose journal is in use or was left."""
    from stickslip.output.atomic import refuse_existing
    from stickslip.output.suffix import check_run

    check_run(request.output)
    refuse_existing(request.output, request.force)
    if request.part.exists() and not claim.remove_empty(request.part):
        raise journal_exists(request.part)


def open_journal(request: RecordRequest, header: dict[str, Any]) -> journal.Writer:
    """Create the journal, unless another recording has completed the run file since `check_output`."""
    from stickslip.output.atomic import refuse_existing

    try:
        writer = journal.Writer(request.part, header)
    except FileExistsError as error:
        raise journal_exists(request.part) from error
    except OSError as error:
        raise disk_error(request.part, error) from error
    try:
        refuse_existing(request.output, request.force)
    except InputError:
        writer.remove()
        raise
    return writer


def journal_exists(part: Path) -> InputError:
    """Return the error of a journal that exists already: another recorder's, or an unfinished one."""
    if claim.is_locked(part):
        what, do = claim.explain_lock(part)
        return InputError(
            what, str(part), f"choose another file with -o, or {do}", python="choose another output, or wait for it"
        )
    return InputError(
        "the journal of an earlier, unfinished recording still exists",
        str(part),
        f"run 'daq recover {part}' to save its data, delete it, or choose another file with -o",
        python=f"run 'daq recover {part}', or call daq.recover, to save its data, delete it, or choose another output",
    )


def count_samples(duration_s: float, rate_hz: float) -> int:
    if not 1 <= duration_s * rate_hz <= MOST_SAMPLES:  # neither is NaN
        what = f"the duration is {duration_s:g} s, {duration_s * rate_hz:g} samples at {rate_hz:g} Hz"
        raise InputError(
            what, "--duration", f"use a duration of 1 to {MOST_SAMPLES} samples", python="use a duration in seconds"
        )
    return round(duration_s * rate_hz)


def record(
    request: RecordRequest,
    *,
    progress: Callable[[float], None] = lambda seconds: None,
    status: Callable[[str], None] = lambda words: None,
    say: Callable[[str], None] = lambda line: None,
    stop: threading.Event | None = None,
) -> "RecordingQuality":
    """Record a run into ``request.output``, or where its folder was moved meanwhile, until ``stop``."""
    check_request(request)
    board, identity, plan, warnings, calibration = _connect(request)
    stop = stop or threading.Event()
    if stop.is_set():
        board.close()
        raise RecordingInterruptedError("interrupted before the recording began", request.port, "record again")
    say(f"{identity.ident.name or 'a board'} on {ports.shorten_url(request.port)}, decoder {identity.ident.decoder}")
    logger.info("%s at %g Hz, blocks of %d, journal %s", request.port, plan.rate_hz, plan.block, request.part)
    try:
        samples = count_samples(request.duration_s, plan.rate_hz)
        writer = open_journal(request, _make_board_header(request, board, identity, plan, samples, warnings))
    except StickslipError:
        board.close()
        raise
    if not writer.locked:
        say(f"{writer.path} cannot be locked on this file system: do not run 'daq recover' until the recording ends")
    place = JournalPlace(writer, request.output, say)
    reader = Reader(board, lambda: _connect(request).board, plan.rate_hz, samples, say)
    with keep_journal(writer):
        try:
            if calibration is not None:
                writer.append(journal.CONFIGURATION, time.monotonic_ns(), calibration.encode())
            began = time.monotonic()

            def show(reached: int) -> None:
                progress(min(reached, samples) / plan.rate_hz)
                status(reader.tally.describe(time.monotonic() - began))

            _write_records(reader, writer, place, show, stop)
            logger.info("ended: %s; %s", reader.ended, reader.tally.describe(time.monotonic() - began))
            if reader.failure is not None:
                if not reader.heard:
                    writer.remove()  # it is empty, and would block the next recording
                raise reader.failure
            return make_run(request, writer, place)
        except DataError as error:
            why = f": {reader.tally.notice}" if reader.tally.notice else ""
            if reader.heard:
                what = f"no sample could be read from the {reader.heard} bytes received{why}"
                do = f"check --baud and --protocol; the bytes are kept in {writer.path}"
                raise DataError(what, request.port, do) from error
            writer.remove()  # it is empty, and would block the next recording
            if stop.is_set():
                what = "interrupted before the first sample"
                raise RecordingInterruptedError(what, request.port, "record again") from error
            raise DataError(f"no sample arrived{why}", request.port, "check the board, then record again") from error


@contextmanager
def keep_journal(writer: journal.Writer) -> Iterator[None]:
    """Close a journal at the end; after an interrupt or a refusing disk the error says where it is kept."""
    try:
        yield
    except KeyboardInterrupt as error:
        do = f"get its data with 'daq recover {writer.path}'"
        what, python = (
            "interrupted; the journal was kept",
            f"get its data with 'daq recover {writer.path}', or call daq.recover",
        )
        raise RecordingInterruptedError(what, str(writer.path), do, python=python) from error
    except OSError as error:
        raise disk_error(writer.path, error) from error
    except disk.RefusedError as error:
        do = f"correct that, then get the data with 'daq recover {writer.path}'"
        raise disk.RefusedError(f"{error.what}; the journal is kept", error.where, do) from error
    finally:
        writer.abandon()


def make_run(request: RecordRequest, writer: journal.Writer, place: JournalPlace) -> "RecordingQuality":
    """Make the run file; once more where the folder is moved meanwhile."""
    from daq.finalise.run import finalise

    while True:
        try:
            quality = finalise(
                writer.path, place.output, finished_by="daq record", force=request.force, remove=writer.remove
            )
        except InputError as error:
            if place.check():
                continue
            do = f"get the data with 'daq recover {writer.path} -o OTHER.h5'"
            raise InputError(f"{error.what}; the journal is kept: {writer.path}", error.where, do) from error
        except (OSError, disk.RefusedError):
            if not place.check():
                raise
        else:
            return replace(quality, warnings=(*quality.warnings, *place.changes))


class _Connected(NamedTuple):
    """A board that is ready, how the recording will go, warnings, and the calibration that replaces the board's."""

    board: Session
    identity: Identity
    plan: Plan
    warnings: list[str]
    calibration: str | None


def _connect(request: RecordRequest) -> _Connected:
    """Open the port, identify the board, check that it can carry out the request, and configure it."""
    backend = protocols.load(request.protocol)
    port = ports.open_port(request.port, request.baud or backend.BAUD)
    try:
        board = backend.session(port, request.port, request)
        identity = board.identify()
        plan = board.plan(identity)
        baud = ports.line_baud(request.port, port)
        calibration = _replace_calibration(request, identity)
        rig = _read_rig(calibration or identity.config or "", identity)
        stored = _read_rig(request.calibration or identity.config or "", identity)
        warnings = [*plan.notes, *link_budget.check(identity.ident, rig, plan, baud)]
        warnings += [row.text for row in find_replaced(stored, stored.stating(request.stated))]
        identity = board.prepare(plan)
    except OSError as error:
        port.close()
        raise DeviceError(f"the port was lost: {error}", request.port, "check the cable and try again") from error
    except BaseException:
        port.close()
        raise
    return _Connected(board, identity, plan, warnings, calibration)


def _replace_calibration(request: RecordRequest, identity: Identity) -> str | None:
    """Return the calibration that replaces the board's, with a pitch from measured units or forces; else None."""
    dimension, size = identity.measured or ("", 0.0)
    if not request.stated and not dimension:
        return request.calibration
    rig = _read_rig(request.calibration or identity.config or "", identity).stating(request.stated)
    if not dimension:
        return rig.to_toml()
    if "metres_per_count" in request.stated:
        what = "the positions have a unit, but metres per count are given"
        raise InputError(what, "--metres-per-count", "omit it; it applies only to counts")
    pitch = Measured(size)
    if dimension == FORCE:
        if rig.stiffness is None:
            what = "the columns contain a force, but the stiffness of its spring is not known"
            raise InputError(what, "--columns", "add --stiffness '10.5 N/m', or a stiffness in the rig.toml")
        pitch = Measured(size / rig.stiffness.value, size * rig.stiffness.sd / rig.stiffness.value**2)
    return replace(rig, metres_per_count=pitch, counts_per_revolution=None).to_toml()


def _read_rig(calibration: str, identity: Identity) -> Rig:
    try:
        rig = Rig.from_toml(calibration, "the board's CONFIG")
    except InputError:
        rig = Rig()  # the finaliser reads the same text, and its warning names the error
    return replace(rig, decoder=identity.ident.decoder)


def _make_board_header(
    request: RecordRequest, board: Session, identity: Identity, plan: Plan, samples: int, warnings: list[str]
) -> dict[str, Any]:
    how = {name: getattr(board.request, name) for name in ("protocol", "columns", "decoder", "port")} | {
        "baud": ports.uart_baud(request.port, board.port),
        "rate_hz": plan.rate_hz,
        "samples": samples,
        "title": f"{identity.ident.name or 'stick-slip'}, {plan.rate_hz:g} Hz",
        "warnings": warnings,
    }
    return make_header(
        how, request.notes, {"port": request.port, "firmware": ".".join(map(str, identity.ident.firmware))}
    )


def make_header(how: Mapping[str, Any], notes: Mapping[str, Any], origin: Mapping[str, str]) -> dict[str, Any]:
    """Return the header of a journal that begins now: ``how`` it is recorded, notes, and where its samples are from."""
    now = datetime.now().astimezone()
    offset = now.utcoffset()
    return {
        **how,
        **dict.fromkeys(("operator", "sample_name", "note"), ""),
        "tags": {},
        **notes,
        "wall_ns": time.time_ns(),
        "monotonic_ns": time.monotonic_ns(),
        "pid": os.getpid(),
        "host": platform.node(),
        "utc_offset_s": int(offset.total_seconds()) if offset else 0,
        "provenance": provenance.collect_provenance() | dict(origin),
    }


def _write_records(
    reader: Reader,
    writer: journal.Writer,
    place: JournalPlace,
    progress: Callable[[int], None],
    stop: threading.Event,
) -> None:
    """Write the reader's records until it ends, and sync the journal; the reader has ended in every case."""
    try:
        for stamp, data in reader.board.received:
            writer.append(journal.RECEIVED, stamp, data)
        reader.start()
        while True:
            if stop.is_set():
                reader.stop()
            try:
                item = reader.items.get(timeout=WAKE_S)
                if item is None:
                    break
                writer.append(*item)
                progress(reader.tally.reached)
            except queue.Empty:
                pass
            if writer.tick():
                place.check()
                if writer.is_asked_to_stop():
                    stop.set()
        stopped_by = stop.reason if isinstance(stop, StopRequest) else journal.STOPPED
        reason = stopped_by if reader.ended == journal.STOPPED else reader.ended
        writer.append(journal.END, time.monotonic_ns(), json.dumps({"reason": reason}).encode())
        writer.sync()
        place.check()
    except BaseException:
        reader.stop()
        raise
    finally:
        _dismiss(reader)


def _dismiss(reader: Reader) -> None:
    """Empty the reader's queue until it ends, so that it never waits for this thread."""
    deadline = time.monotonic() + LEAVE_S
    while reader.is_alive() and time.monotonic() < deadline:
        try:
            reader.items.get(timeout=WAKE_S)
        except queue.Empty:
            continue


def disk_error(part: Path, error: OSError) -> StickslipError:
    """Return the error of a disk that refuses; it mentions the journal when there is one."""
    if part.exists():
        do = f"correct that, then get the data with 'daq recover {part}'"
    else:
        do = "record into a folder you may write to, with -o"
    refused = disk.describe_refusal(part, error)
    kept = "; the journal is kept up to that point" if part.exists() else ""
    return disk.RefusedError(refused.what + kept, refused.where, do)
