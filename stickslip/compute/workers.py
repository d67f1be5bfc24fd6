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

from stickslip.compute.cluster import connect_cluster
from stickslip.compute.interpreter import ignore_settings, safe_path, settings_are_ignored
from stickslip.compute.ordered import AHEAD, Map, yield_in_order
from stickslip.errors import DeviceError

# Results held, for each process, while an earlier item is still in the work.
MOST_HELD = 64


@contextmanager
def workers(jobs: int = 1, scheduler: str | None = None, *, join: bool = False) -> Iterator[Map]:
    """Yield ``map`` by a dask ``scheduler``, else by ``jobs`` processes, of which this is one with ``join``."""
    if scheduler is not None:
        with connect_cluster(scheduler) as each:
            yield each
    elif jobs > 1:
        with _processes(jobs, join) as each:
            yield each
    else:
        yield map


@contextmanager
def _processes(number: int, join: bool) -> Iterator[Map]:
    """Yield ``map`` in fresh processes, which are ended when the block ends by an exception."""
    others = set(active_children())
    fresh = number - 1 if join else number
    with _starting_processes():
        pool = ProcessPoolExecutor(
            fresh, get_context("spawn"), initializer=_follow_parent, initargs=(settings_are_ignored(),)
        )

    def map_items(function: Callable[[Any], Any], items: Iterable[Any]) -> Iterator[Any]:
        def submit(work: Callable[[Any], Any], item: Any) -> Future[Any]:
            with _starting_processes():
                return pool.submit(work, item)

        if join:
            return _map_with_parent(submit, function, items, number)
        return yield_in_order(partial(submit, function), lambda done: done.result(), items, AHEAD * number)

    try:
        yield map_items
    except BaseException as error:
        for child in set(active_children()) - others:
            child.terminate()
        pool.shutdown(cancel_futures=True)  # a thread of the pool that still ran when Python ends could fail there
        if isinstance(error, BrokenProcessPool):
            do = "the computer probably ran out of memory: use fewer --jobs"
            raise DeviceError("a process of this command was killed", "--jobs", do) from None
        raise
    pool.shutdown()


@contextmanager
def _starting_processes() -> Iterator[None]:
    """Block Ctrl-C: a process that is started here never gets one, and prints no traceback of its imports."""
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


def _map_with_parent(
    submit: Callable[[Callable[[Any], Any], Any], "Future[Any]"],
    function: Callable[[Any], Any],
    items: Iterable[Any],
    number: int,
) -> Iterator[Any]:
    """Yield the results in order; this process works wherever it would wait, at first for another process to start."""
    ready = submit(_report_ready, None)
    waiting: deque[Future[Any]] = deque()
    remaining = iter(items)
    while True:
        if ready.done():
            ready.result()
            busy = sum(not future.done() for future in waiting)
            waiting.extend(submit(function, item) for item in islice(remaining, max(AHEAD * (number - 1) - busy, 0)))
        if not waiting or (not waiting[0].done() and len(waiting) < MOST_HELD * number):
            if next_item := list(islice(remaining, 1)):
                waiting.append(_work_here(function, next_item[0]))
                continue
            if not waiting:
                return
        yield waiting.popleft().result()


def _work_here(function: Callable[[Any], Any], item: Any) -> "Future[Any]":
    """Return the result of an item that this process works on, or its error, for when its turn comes."""
    future: Future[Any] = Future()
    try:
        future.set_result(function(item))
    except Exception as error:
        future.set_exception(error)
    return future


def _report_ready(_: None) -> None:
    """Return at once: the process that does is ready."""
