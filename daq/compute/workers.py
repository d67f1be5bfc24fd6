"""Where work is done: in this process, in several on this machine, or by the workers of a dask scheduler.

Each gives a ``map``: results in the order of the items, a few items ahead of the one asked for, the same to the last
bit wherever they were made.
"""

import logging
import os
import pickle
import signal
import socket
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import CancelledError, Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from functools import partial
from importlib.util import find_spec
from itertools import islice
from multiprocessing import active_children, get_context, parent_process
from typing import Any
from urllib.parse import urlsplit

from daq.errors import DeviceError, InputError
from daq.version import VERSION

Map = Callable[[Callable[[Any], Any], Iterable[Any]], Iterator[Any]]
FLAG = "--scheduler"
# Items a worker: one in the work, two at hand.  With one at hand a worker waits where another one has a long item: two
# made a sweep whose values take 8 to 420 ms 1.90 times as fast, with two at hand 1.97 times; 8 gain 1 % and hold more.
AHEAD = 3
# Results held, for each process, while an earlier item is still in the work.
MOST_HELD = 64
PATIENCE_S = 10


@contextmanager
def workers(jobs: int = 1, scheduler: str | None = None, *, join: bool = False) -> Iterator[Map]:
    """Give ``map(function, items)``; whatever ends the block, Ctrl-C too, ends the work.

    Parameters
    ----------
    jobs : int
        Processes on this machine; one is this process itself.
    scheduler : str, optional
        Address of a dask scheduler, ``tcp://host:8786`` or ``host:8786``; goes before ``jobs``.
    join : bool
        Whether this process is one of the ``jobs`` and works while the others start; for items shorter than a second:
        while it works it passes on no result.

    Raises
    ------
    InputError
        When dask.distributed is not installed, nothing answers at the address, no worker is there, or the workers hold
        another version of this package or cannot load the function.
    DeviceError
        When a process or worker was killed, or the scheduler lost.
    """
    if scheduler is not None:
        with _cluster(scheduler) as each:
            yield each
    elif jobs > 1:
        with _processes(jobs, join) as each:
            yield each
    else:
        yield map


@contextmanager
def _processes(number: int, join: bool) -> Iterator[Map]:
    """Give ``map`` in fresh processes, which are ended, not waited for, when the block is left by an exception."""
    others = set(active_children())
    fresh = number - 1 if join else number
    pool = ProcessPoolExecutor(fresh, mp_context=get_context("spawn"), initializer=_follow_parent)

    def each(function: Callable[[Any], Any], items: Iterable[Any]) -> Iterator[Any]:
        def submit(work: Callable[[Any], Any], item: Any) -> Future[Any]:
            with _without_interrupts():  # it may start a process
                return pool.submit(work, item)

        if join:
            return _joined(submit, function, items, number)
        return _ordered(partial(submit, function), lambda done: done.result(), items, AHEAD * number)

    try:
        yield each
    except BaseException as error:
        pool.shutdown(wait=False, cancel_futures=True)
        for child in set(active_children()) - others:
            child.terminate()
        if isinstance(error, BrokenProcessPool):
            do = "a machine short of memory does that: use fewer --jobs"
            raise DeviceError("a process of this command was killed", "--jobs", do) from None
        raise
    pool.shutdown()


@contextmanager
def _without_interrupts() -> Iterator[None]:
    """Hold Ctrl-C back: a process that is started here never gets one, and prints no traceback of its imports."""
    if sys.platform == "win32":
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _follow_parent() -> None:
    """Leave Ctrl-C to the process that started this one, and end when it ends, however it does."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


@contextmanager
def _cluster(address: str) -> Iterator[Map]:
    """Give ``map`` on a dask scheduler's workers."""
    if find_spec("distributed") is None:
        raise InputError("dask.distributed is not installed", FLAG, "pip install 'stickslip[cluster]'")
    from distributed import Client

    _knock(address)
    try:
        client = Client(address, timeout=PATIENCE_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise InputError(
            f"no dask scheduler answers: {error}", f"{FLAG} {address}", "start one: dask scheduler"
        ) from None
    futures: list[Any] = []

    def each(function: Callable[[Any], Any], items: Iterable[Any]) -> Iterator[Any]:
        _check_workers(client, address, function)
        with _cluster_errors(address):
            sent = client.scatter(function, hash=False)  # with what all items share, once
            ahead = AHEAD * max(len(client.nthreads()), 1)

        def submit(item: Any) -> Any:
            with _cluster_errors(address):
                future = client.submit(_call, sent, item, pure=False)
            futures.append(future)
            return future

        def result(future: Any) -> Any:
            with _cluster_errors(address):
                value, error = future.result()
            if error is not None:
                raise error
            return value

        return _ordered(submit, result, items, ahead)

    with _quiet():
        try:
            yield each
        finally:
            with suppress(OSError, TimeoutError, CancelledError):  # of a scheduler that is gone
                client.cancel(futures)
                client.close()


def _call(function: Callable[[Any], Any], item: Any) -> tuple[Any, Exception | None]:
    """Return the result and None, or None and the function's own error: any other one is the cluster's."""
    try:
        return function(item), None
    except Exception as error:
        return None, error


@contextmanager
def _cluster_errors(address: str) -> Iterator[None]:
    """Turn whatever the cluster raises into a DeviceError."""
    from distributed.scheduler import KilledWorker

    where = f"{FLAG} {address}"
    try:
        yield
    except KilledWorker:
        do = "see the worker's log; short of memory, most likely"
        raise DeviceError("a dask worker died during this work", where, do) from None
    except (CancelledError, OSError, TimeoutError):
        what = "the connection to the dask scheduler was lost during this work"
        raise DeviceError(what, where, "start it and its workers again, then do what is missing") from None
    except Exception as error:
        what = f"a dask worker failed: {type(error).__name__}: {error}".splitlines()[0]
        raise DeviceError(what, where, f"check that every worker can import stickslip {VERSION}") from error


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep dask's own messages, tracebacks of lost connections, off the terminal: the error here says what failed."""
    loggers = [logging.getLogger(name) for name in ("distributed", "distributed.client")]
    before = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        for logger, level in zip(loggers, before, strict=True):
            logger.setLevel(level)


def _knock(address: str) -> None:
    """Raise InputError, at once and quietly, when nothing listens at a scheduler's address."""
    parts = urlsplit(address if "://" in address else f"tcp://{address}")
    try:
        host, port = parts.hostname, parts.port
    except ValueError:
        host, port = None, None
    if parts.scheme not in ("tcp", "tls") or not host or port is None:
        raise InputError(f"{address!r} is not an address", FLAG, "give the scheduler's, such as tcp://127.0.0.1:8786")
    try:
        socket.create_connection((host, port), PATIENCE_S).close()
    except OSError as error:
        what = f"no dask scheduler answers ({error.strerror or error})"
        raise InputError(what, f"{FLAG} {address}", "start one ('dask scheduler') or check the address") from None


def _check_workers(client: Any, address: str, function: Callable[[Any], Any]) -> None:
    """Raise InputError unless there are workers, and all hold this version and can load the function."""
    where = f"{FLAG} {address}"
    do = f"install stickslip {VERSION} there, as here"
    try:
        client.wait_for_workers(1, timeout=PATIENCE_S)
    except TimeoutError:
        raise InputError("the scheduler has no worker", where, f"start one: dask worker {address}") from None
    try:
        found = set(client.run(_version).values())
    except ImportError as error:
        raise InputError(f"the workers lack {error.name}", where, do) from None
    if other := sorted(found - {VERSION}):
        raise InputError(f"the workers hold stickslip {', '.join(other)}", where, do)
    with _cluster_errors(address):
        failures = client.run(_load_error, pickle.dumps(function)).values()
    if lacks := next(filter(None, failures), ""):
        raise InputError(f"the workers cannot load the work: {lacks}", where, do)


def _version() -> str:
    return VERSION


def _load_error(pickled: bytes) -> str:
    """Return why this process cannot load what was pickled; "" when it can."""
    try:
        pickle.loads(pickled)
    except Exception as error:
        return f"{type(error).__name__}: {error}".splitlines()[0]
    return ""


def _ordered(
    submit: Callable[[Any], Any], result: Callable[[Any], Any], items: Iterable[Any], ahead: int
) -> Iterator[Any]:
    """Yield the results in order; of the items only so many are made, and held, at a time."""
    waiting: deque[Any] = deque()
    for item in items:
        waiting.append(submit(item))
        if len(waiting) >= ahead:
            yield result(waiting.popleft())
    while waiting:
        yield result(waiting.popleft())


def _joined(
    submit: Callable[[Callable[[Any], Any], Any], "Future[Any]"],
    function: Callable[[Any], Any],
    items: Iterable[Any],
    number: int,
) -> Iterator[Any]:
    """Yield the results in order; this process works wherever it would wait, at first for another process to start."""
    ready = submit(_nothing, None)
    waiting: deque[Future[Any]] = deque()
    there = iter(items)
    while True:
        if ready.done():
            ready.result()
            busy = sum(not future.done() for future in waiting)
            waiting.extend(submit(function, item) for item in islice(there, max(AHEAD * (number - 1) - busy, 0)))
        if not waiting or (not waiting[0].done() and len(waiting) < MOST_HELD * number):
            if own := list(islice(there, 1)):
                waiting.append(_done(function, own[0]))
                continue
            if not waiting:
                return
        yield waiting.popleft().result()


def _done(function: Callable[[Any], Any], item: Any) -> "Future[Any]":
    """Return the result of an item that this process works on, or its error, for when its turn comes."""
    future: Future[Any] = Future()
    try:
        future.set_result(function(item))
    except Exception as error:
        future.set_exception(error)
    return future


def _nothing(_: None) -> None:
    """Return at once: the process that does is ready."""
