"""Where work is done: in this process, in several on this machine, or by the workers of a dask scheduler.

Each gives a ``map``: results in the order of the items, a few items ahead of the one asked for, the same to the last
bit wherever they were made.
"""

import os
import signal
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from functools import partial
from itertools import islice
from multiprocessing import active_children, get_context, parent_process
from typing import Any

from stickslip.compute.cluster import cluster
from stickslip.compute.interpreter import ignore_settings, safe_path, settings_are_ignored
from stickslip.compute.ordered import AHEAD, Map, ordered
from stickslip.errors import DeviceError

# Results held, for each process, while an earlier item is still in the work.
MOST_HELD = 64


@contextmanager
def workers(jobs: int = 1, scheduler: str | None = None, *, join: bool = False) -> Iterator[Map]:
    """Give ``map(function, items)``; whatever ends the block, Ctrl-C too, ends the work.

    jobs: Processes on this machine; one is this process itself.
    scheduler: Address of a dask scheduler, ``tcp://host:8786`` or ``host:8786``; goes before ``jobs``.
    join: Whether this process is one of the ``jobs`` and works while the others start; for items shorter than a second:
        while it works it passes on no result.
    Raises InputError: when dask.distributed is not installed, nothing answers at the address, no worker is there, or
        the workers hold another version of this package or cannot load the function.
    Raises DeviceError: when a process or worker was killed, or the scheduler lost.
    """
    if scheduler is not None:
        with cluster(scheduler) as each:
            yield each
    elif jobs > 1:
        with _processes(jobs, join) as each:
            yield each
    else:
        yield map


@contextmanager
def _processes(number: int, join: bool) -> Iterator[Map]:
    """Give ``map`` in fresh processes, which are ended, whatever they do, when the block is left by an exception."""
    others = set(active_children())
    fresh = number - 1 if join else number
    with _starting_processes():
        pool = ProcessPoolExecutor(
            fresh, get_context("spawn"), initializer=_follow_parent, initargs=(settings_are_ignored(),)
        )

    def each(function: Callable[[Any], Any], items: Iterable[Any]) -> Iterator[Any]:
        def submit(work: Callable[[Any], Any], item: Any) -> Future[Any]:
            with _starting_processes():
                return pool.submit(work, item)

        if join:
            return _joined(submit, function, items, number)
        return ordered(partial(submit, function), lambda done: done.result(), items, AHEAD * number)

    try:
        yield each
    except BaseException as error:
        for child in set(active_children()) - others:
            child.terminate()
        pool.shutdown(cancel_futures=True)  # a thread of the pool that still ran when Python ends could fail there
        if isinstance(error, BrokenProcessPool):
            do = "a machine short of memory does that: use fewer --jobs"
            raise DeviceError("a process of this command was killed", "--jobs", do) from None
        raise
    pool.shutdown()


@contextmanager
def _starting_processes() -> Iterator[None]:
    """Hold Ctrl-C back: a process that is started here never gets one, and prints no traceback of its imports."""
    with safe_path():
        if sys.platform == "win32":
            yield
            return
        before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
        try:
            yield
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _follow_parent(ignoring_settings: bool) -> None:
    """Leave Ctrl-C to the process that started this one, and end when it ends, however it does."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if ignoring_settings:
        ignore_settings()
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


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
