"""Work on the workers of a running dask scheduler, and what can go wrong there, in words."""

import logging
import pickle
import socket
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import CancelledError
from contextlib import contextmanager, suppress
from importlib.util import find_spec
from typing import Any
from urllib.parse import urlsplit

from stickslip.compute.ordered import AHEAD, Map, yield_in_order
from stickslip.errors import DeviceError, InputError
from stickslip.version import VERSION

FLAG = "--scheduler"
PATIENCE_S = 10


@contextmanager
def connect_cluster(address: str) -> Iterator[Map]:
    """Yield a ``map`` on a dask scheduler's workers."""
    if find_spec("distributed") is None:
        raise InputError("dask.distributed is not installed", FLAG, "pip install 'stickslip[cluster]'")
    from distributed import Client

    _check_address(address)
    try:
        client = Client(address, timeout=PATIENCE_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise InputError(
            f"no dask scheduler answers: {error}", f"{FLAG} {address}", "start one: dask scheduler"
        ) from None
    futures: list[Any] = []

    def map_items(function: Callable[[Any], Any], items: Iterable[Any]) -> Iterator[Any]:
        _check_workers(client, address, function)
        with _cluster_errors(address):
            shared = client.scatter(function, hash=False)  # with what all items share, once
            ahead = AHEAD * max(len(client.nthreads()), 1)

        def submit(item: Any) -> Any:
            with _cluster_errors(address):
                future = client.submit(_call_work, shared, item, pure=False)
            futures.append(future)
            return future

        def result(future: Any) -> Any:
            with _cluster_errors(address):
                value, error = future.result()
            if error is not None:
                raise error
            return value

        return yield_in_order(submit, result, items, ahead)

    with _silence_dask():
        try:
            yield map_items
        finally:
            with suppress(OSError, TimeoutError, CancelledError):  # of a scheduler that is gone
                client.cancel(futures)
                client.close()


def _call_work(function: Callable[[Any], Any], item: Any) -> tuple[Any, Exception | None]:
    """Return the result and None, or None and the function's own error: any other error is the cluster's."""
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
        do = "see the log of the worker; it probably ran out of memory"
        raise DeviceError("a dask worker died during this work", where, do) from None
    except (CancelledError, OSError, TimeoutError):
        what = "the connection to the dask scheduler was lost during this work"
        raise DeviceError(what, where, "start it and its workers again, then repeat the missing work") from None
    except Exception as error:
        what = f"a dask worker failed: {type(error).__name__}: {error}".splitlines()[0]
        raise DeviceError(what, where, f"check that every worker can import stickslip {VERSION}") from error


@contextmanager
def _silence_dask() -> Iterator[None]:
    """Keep dask's messages and tracebacks off the terminal: the error raised here says what failed."""
    loggers = [logging.getLogger(name) for name in ("distributed", "distributed.client")]
    before = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        for logger, level in zip(loggers, before, strict=True):
            logger.setLevel(level)


def _check_address(address: str) -> None:
    """Raise InputError, at once and quietly, when nothing listens at a scheduler's address."""
    parts = urlsplit(address if "://" in address else f"tcp://{address}")
    try:
        host, port = parts.hostname, parts.port
    except ValueError:
        host, port = None, None
    if parts.scheme not in ("tcp", "tls") or not host or port is None:
        raise InputError(
            f"{address!r} is not an address", FLAG, "use the address of the scheduler, such as tcp://127.0.0.1:8786"
        )
    try:
        socket.create_connection((host, port), PATIENCE_S).close()
    except OSError as error:
        what = f"no dask scheduler answers ({error.strerror or error})"
        raise InputError(what, f"{FLAG} {address}", "start one ('dask scheduler') or check the address") from None


def _check_workers(client: Any, address: str, function: Callable[[Any], Any]) -> None:
    """Raise InputError unless there are workers, all of this version, which can load the function."""
    where = f"{FLAG} {address}"
    do = f"install stickslip {VERSION} on the workers too"
    try:
        client.wait_for_workers(1, timeout=PATIENCE_S)
    except TimeoutError:
        raise InputError("the scheduler has no worker", where, f"start one: dask worker {address}") from None
    try:
        versions = set(client.run(_get_version).values())
    except ImportError as error:
        raise InputError(f"the workers do not have the package {error.name}", where, do) from None
    if other := sorted(versions - {VERSION}):
        raise InputError(f"the workers have stickslip {', '.join(other)}", where, do)
    with _cluster_errors(address):
        failures = client.run(_load_error, pickle.dumps(function)).values()
    if lacks := next(filter(None, failures), ""):
        raise InputError(f"the workers cannot load the work: {lacks}", where, do)


def check_sendable(work: Callable[..., Any]) -> None:
    """Refuse work that cannot be sent to another process: a function within a function, or a lambda."""
    try:
        pickle.dumps(work)
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        do = "define the function in a module, outside any other function, or omit jobs and scheduler"
        raise InputError(f"cannot be sent to another process ({error})", "--jobs", do, python=do) from None


def _get_version() -> str:
    return VERSION


def _load_error(pickled: bytes) -> str:
    """Return why this process cannot load a pickled object; "" when it can."""
    try:
        pickle.loads(pickled)
    except Exception as error:
        return f"{type(error).__name__}: {error}".splitlines()[0]
    return ""
