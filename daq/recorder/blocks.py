"""Record blocks of samples that a program hands over: the journal, its safety and the run file are those of a board.

A thread takes the program's blocks, so that the recording can be stopped while the program gives none.  Each is handed
to the system before the next one is asked for, so that a process that is killed keeps every block that was taken; the
disk is synced while the next one is waited for.
"""

import contextlib
import inspect
import json
import queue
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from daq.protocols import blocks
from daq.protocols.request import RecordRequest
from daq.recorder.journal_place import JournalPlace
from daq.recorder.reader import SILENT_S
from daq.recorder.record import (
    LEAVE_S,
    WAKE_S,
    RecordingInterruptedError,
    check_output,
    count_samples,
    keep_journal,
    make_header,
    make_run,
    open_journal,
)
from daq.runfile import journal
from daq.runfile.run_data import FARTHEST, LONGEST_S
from stickslip.compute.arrays import Array, Integers, numbers
from stickslip.errors import DataError, DeviceError, InputError
from stickslip.text import storable

if TYPE_CHECKING:
    from daq.finalise.quality import RecordingQuality

WHERE = "daq.record"
DO = "yield blocks (t, x) of two arrays with equal length: times in s, and positions in m or integer counts"
RATE_WITHIN = 0.1  # relative deviation from the stated rate; a larger one is an error of the times' unit or the rate
FEWEST_STEPS = 20  # before the rate of the times is believed


def record_blocks(
    source: Iterable[Any],
    request: RecordRequest,
    rate_hz: float,
    seconds: float | None,
    warnings: list[str],
    *,
    progress: Callable[[float], None] = lambda seconds: None,
    stop: threading.Event | None = None,
) -> "RecordingQuality":
    """Record blocks of a source at a nominal rate for ``seconds`` (None: all); see `daq.recorder.source.record`."""
    check_output(request)
    samples = None if seconds is None else count_samples(seconds, rate_hz)
    stop = stop or threading.Event()
    taker = _Taking(source, rate_hz, stop, None if seconds is None else max(seconds, SILENT_S))
    with contextlib.closing(taker.items):
        return _write_recording(source, taker, samples, request, warnings, progress)


def _write_recording(
    source: Iterable[Any],
    taker: "_Taking",
    samples: int | None,
    request: RecordRequest,
    warnings: list[str],
    progress: Callable[[float], None],
) -> "RecordingQuality":
    rate_hz = taker.rate_hz
    try:
        first = taker.next()
    except KeyboardInterrupt as error:
        raise RecordingInterruptedError("interrupted before the first block", WHERE, "record again") from error
    except _SourceError as error:
        what = f"the source failed before its first block: {_describe_failure(error)}"
        raise DeviceError(what, WHERE, "mend it") from error.__cause__
    if first is None and taker.ended == journal.STOPPED:
        raise RecordingInterruptedError("stopped before the first block", WHERE, "record again")
    if first is None:
        silent = f" in {taker.patience_s:g} s" if taker.ended == journal.SOURCE_SILENT else ""
        raise DataError(f"the source yielded no samples{silent}", WHERE, DO)
    settings: dict[str, Any] = {
        "protocol": blocks.NAME,
        "columns": blocks.COUNTS if first.counted else blocks.POSITIONS,
        "decoder": None,
        "port": f"source: {type(source).__name__}",
        "baud": None,
        "rate_hz": rate_hz,
        "samples": samples,
        "title": f"{'counts' if first.counted else 'positions'} of a program, {rate_hz:g} Hz",
        "warnings": warnings,
    }
    writer = open_journal(request, make_header(settings, request.notes, {"source": type(source).__name__}))
    place = JournalPlace(writer, request.output, lambda line: None)
    with keep_journal(writer):
        if request.calibration is not None:
            writer.append(journal.CONFIGURATION, time.monotonic_ns(), request.calibration.encode())
        failure = _write_blocks(first, taker, samples, writer, place, progress)
        writer.sync()
        place.check()
        if isinstance(failure, _WrongRateError):
            writer.remove()  # it would stand in the way of the next try, which begins with the same samples
            raise failure
        quality = make_run(request, writer, place)
    if failure is not None:
        kept = f"the {quality.samples} samples before it are in {quality.file}"
        if isinstance(failure, InputError):
            raise InputError(f"{failure.what}; {kept}", failure.where, failure.do) from failure
        what = f"the source failed: {_describe_failure(failure)}"
        raise DeviceError(what, WHERE, f"correct it; {kept}") from failure.__cause__
    return quality


def _write_blocks(
    block: "_Block | None",
    taker: "_Taking",
    samples: int | None,
    writer: journal.Writer,
    place: JournalPlace,
    progress: Callable[[float], None],
) -> "InputError | _SourceError | None":
    """Write blocks until there are enough, or the source ends; return the error that ended it."""

    def sync() -> None:
        if writer.tick():
            place.check()
            if writer.is_asked_to_stop():
                taker.stop.set()

    failure: InputError | _SourceError | None = None
    reason = journal.COMPLETE
    try:
        while block is not None:
            stamp = time.monotonic_ns()
            for data in blocks.pack(block.time, block.values):
                writer.append(journal.RECEIVED, stamp, data)
            sync()
            progress(taker.taken_s)
            if samples is not None and taker.taken >= samples and not taker.stop.is_set():
                break
            block = taker.next(sync)
        else:
            ended_early = samples is not None or taker.ended != journal.SOURCE_ENDED
            reason = taker.ended if ended_early else journal.COMPLETE
        taker.items.end()
    except KeyboardInterrupt:
        reason = journal.STOPPED
    except (InputError, _SourceError) as error:
        failure, reason = error, journal.SOURCE_FAILED
    if failure is not None:
        writer.append(journal.LOST, time.monotonic_ns(), _describe_failure(failure).encode())
    writer.append(journal.END, time.monotonic_ns(), json.dumps({"reason": reason}).encode())
    return failure


class _SourceError(Exception):
    """The source raised an exception, which is the cause of this one."""


class _WrongRateError(InputError):
    """The times of the blocks have another rate than was stated."""


class _Items:
    """Takes the items of a source in a thread, one at each request."""

    def __init__(self, source: Iterable[Any]) -> None:
        self.asked = False  # for an item that has not come yet
        self._questions: queue.SimpleQueue[bool] = queue.SimpleQueue()  # False: close the source
        self._answers: queue.SimpleQueue[tuple[Any, BaseException | None]] = queue.SimpleQueue()
        self._closed = False
        threading.Thread(target=self._answer, args=(source,), name="daq source", daemon=True).start()

    def _answer(self, source: Iterable[Any]) -> None:
        items: Iterator[Any] | None = None
        while self._questions.get():
            try:
                items = iter(source) if items is None else items
                self._answers.put((next(items), None))
            except BaseException as error:
                self._answers.put((None, error))
        try:
            if inspect.isgenerator(items):
                items.close()  # so that it can close its device
            self._answers.put((None, None))
        except BaseException as error:
            self._answers.put((None, error))

    def ask(self) -> None:
        """Request the next item, unless one is pending."""
        if not self.asked:
            self.asked = True
            self._questions.put(True)

    def take(self, patience_s: float) -> Any:
        """Return the item; `queue.Empty` if it does not come."""
        item, error = self._answers.get(timeout=patience_s)
        self.asked = False
        if error is not None:
            if isinstance(error, Exception) and not isinstance(error, StopIteration):
                raise _SourceError from error
            raise error
        return item

    def close(self) -> None:
        """Let the thread close a generator that has not ended by itself, as soon as no item is pending."""
        if not self._closed:
            self._closed = True
            self._questions.put(False)

    def end(self) -> None:
        """Close the source and wait for it, but not for one with a pending item."""
        blocked = self.asked
        self.close()
        if not blocked:
            with contextlib.suppress(queue.Empty):
                self.take(LEAVE_S)


@dataclass(frozen=True)
class _Block:
    """Times, s, and counts or positions, m, of one block, (n,) each."""

    time: Array
    values: Array | Integers

    @property
    def counted(self) -> bool:
        return self.values.dtype.kind == "i"


class _Taking:
    """Takes the blocks of a source and checks them; after the last one ``ended`` is the reason, as in a journal."""

    def __init__(self, source: Iterable[Any], rate_hz: float, stop: threading.Event, patience_s: float | None) -> None:
        self.taken = 0  # samples
        self.ended = ""
        self.items, self.rate_hz, self.stop, self.patience_s = _Items(source), rate_hz, stop, patience_s
        self._number = 0
        self._stopped_s = 0.0
        self._counted: bool | None = None
        self._first_s = self._last_s = 0.0
        self._steps: list[float] | None = []  # periods of the first samples; None once their rate was checked

    @property
    def taken_s(self) -> float:
        return self._last_s - self._first_s + 1 / self.rate_hz

    def next(self, idle: Callable[[], None] = lambda: None) -> _Block | None:
        """Return the next block with a sample, calling ``idle`` while it waits; None: there is none (``ended``)."""
        began = time.monotonic()
        while not self._is_over(began):
            self.items.ask()
            try:
                item = self.items.take(WAKE_S)
            except queue.Empty:
                idle()
                continue
            except StopIteration:
                self.ended = journal.SOURCE_ENDED
                break
            self._number += 1
            block = self._check_block(item)
            if len(block.time):
                return block
        return None

    def _is_over(self, began: float) -> bool:
        """Return whether to stop waiting; a block that was requested before the stop has `LEAVE_S` to come."""
        if self.stop.is_set():
            self._stopped_s = self._stopped_s or time.monotonic()
            if not self.items.asked or time.monotonic() - self._stopped_s > LEAVE_S:
                self.ended = journal.STOPPED
        elif self.patience_s is not None and time.monotonic() - began > self.patience_s:
            self.ended = journal.SOURCE_SILENT
        return bool(self.ended)

    def _check_block(self, item: Any) -> _Block:
        try:
            times, values = item
        except (TypeError, ValueError) as error:
            what = f"block {self._number} is {_describe_item(item)} instead of two arrays"
            do = f"{DO}; for complete arrays use daq.Recording.from_arrays(t, x).save(path)"
            raise InputError(what, WHERE, do) from error
        where = f"{WHERE}, block {self._number}"
        time = numbers(times, "time", where, DO, single=True)
        column = numbers(values, "position", where, DO, single=True)
        if len(time) != len(column):
            what = f"block {self._number} has {len(time)} times and {len(column)} values"
            raise InputError(what, WHERE, DO)
        counted = column.dtype.kind in "iu"
        if self._counted is not None and len(time) and counted != self._counted:
            kinds = "counts (integers)", "positions (floats)"
            what = f"block {self._number} has {kinds[not counted]} after {kinds[not self._counted]}"
            raise InputError(what, WHERE, "use the same kind in all blocks, as with np.asarray(x, float)")
        seconds = time.astype(np.float64)
        self._check_values(seconds, column)
        if len(seconds):
            self._check_rate(seconds)
            self._first_s = self._first_s if self.taken else float(seconds[0])
            self._counted, self._last_s, self.taken = counted, float(seconds[-1]), self.taken + len(seconds)
        return _Block(seconds, column.astype(np.int64) if counted else column.astype(np.float64))

    def _check_values(self, time: Array, column: "np.ndarray[Any, Any]") -> None:
        for name, values, most in (("time", time, np.inf), ("value", column.astype(np.float64), FARTHEST)):
            wrong = np.flatnonzero(~((np.abs(values) <= most) & np.isfinite(values)))
            if wrong.size:
                what = f"the {name} of sample {wrong[0]} in block {self._number} is {values[wrong[0]]:g}"
                raise InputError(what, WHERE, "omit samples that are not numbers")
        steps = np.diff(time, prepend=self._last_s if self.taken else -np.inf)
        wrong = np.flatnonzero(~(steps > 0))
        if wrong.size:
            sample = int(wrong[0])
            before = float(time[sample - 1]) if sample else self._last_s
            what = f"time does not increase at sample {sample} in block {self._number}"
            do = "use the times of one clock, in s, that continue from block to block"
            raise InputError(f"{what}: {time[sample]:.9g} s after {before:.9g} s", WHERE, do)
        if len(time) and time[-1] - (self._first_s if self.taken else time[0]) > LONGEST_S:
            raise InputError(f"its times reach {time[-1]:.3g} s", WHERE, "give times in s, not in ms or us")

    def _check_rate(self, time: Array) -> None:
        if self._steps is None:
            return
        before = [self._last_s] if self.taken else []
        self._steps += np.diff([*before, *time[: FEWEST_STEPS + 1].tolist()]).tolist()
        if len(self._steps) < FEWEST_STEPS:
            return
        rate_hz = 1 / float(np.median(self._steps))
        self._steps = None
        if abs(rate_hz / self.rate_hz - 1) > RATE_WITHIN:
            what = f"the times have a rate of {rate_hz:.4g} Hz, but rate_hz is {self.rate_hz:g}"
            raise _WrongRateError(what, WHERE, f"use rate_hz={rate_hz:.4g}, or times in s")


def _describe_item(item: Any) -> str:
    shape = getattr(item, "shape", None)
    return f"a {type(item).__name__}" + (f" of shape {shape}" if shape is not None else "")


def _describe_failure(error: InputError | _SourceError) -> str:
    if isinstance(error, InputError):
        return error.what
    cause = error.__cause__
    try:
        text = str(cause)
    except Exception:
        text = ""
    return storable(f"{type(cause).__name__}: {text}".rstrip(": "))
