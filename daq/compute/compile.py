"""Kernels compiled by numba from the very source that runs interpreted; numba loads on the first request.

A kernel module holds plain functions on scalars and arrays.  `compiled` registers every function of the modules named
as callable from machine code and compiles the entry: no second source, no fast-math (it breaks NaN tests).  Machine
code is kept in a folder named by a hash of the sources, so a changed installation never meets a stale cache.
"""

import hashlib
import inspect
import os
import sys
from collections.abc import Callable
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any


@cache
def compiled(function: Callable[..., Any], modules: tuple[str, ...]) -> Callable[..., Any]:
    """Return ``function`` compiled; called like the plain one.

    The first call of a function whose machine code is not yet cached says on stderr that it compiles.

    Parameters
    ----------
    function : callable
        A plain function; numba's nopython subset.
    modules : tuple of str
        Names of the modules whose functions it may call, its own included.
    """
    for name in modules:
        register(name)
    return build(function, cache_folder((*modules, function.__module__)))


def build(function: Callable[..., Any], folder: Path | None, **options: Any) -> Callable[..., Any]:
    """Return ``function`` compiled with numba's ``options``, its machine code kept in ``folder``, if there is one."""
    import numba
    from numba import config

    settings = vars(config)  # numba reads the folder when a cache is enabled
    before = settings["CACHE_DIR"]
    try:
        settings["CACHE_DIR"] = str(folder) if folder else before
        entry = numba.njit(function, cache=folder is not None, **options)
    finally:
        settings["CACHE_DIR"] = before
    if folder is not None:
        _keep_if_possible(entry, folder)
    if folder is None or not any(folder.rglob(f"*.{function.__name__}-*.nbi")):
        sys.stderr.write(f"compiling {function.__name__}: once per installation, some seconds\n")
    return entry  # type: ignore[no-any-return]


def _keep_if_possible(entry: Any, folder: Path) -> None:
    """Let a disk that refuses machine code cost the next call some seconds, and not this one its result."""
    save = entry._cache.save_overload  # noqa: SLF001 - numba has no public way to say that a cache is optional

    def attempt(*what: Any) -> None:
        try:
            save(*what)
        except OSError as error:
            said = f"machine code is not kept: {folder}: {error.strerror or error}\n"
            sys.stderr.write(said)

    entry._cache.save_overload = attempt  # noqa: SLF001


@cache
def register(module: str, **options: Any) -> None:
    """Make every function of a module callable from compiled code, compiled with numba's ``options``."""
    from numba.extending import register_jitable

    make = register_jitable(**options) if options else register_jitable
    for function in vars(import_module(module)).values():
        if inspect.isfunction(function) and function.__module__ == module:
            make(function)


def cache_folder(modules: tuple[str, ...]) -> Path | None:
    """Return the writable folder for the machine code of these modules, or None when there is none to be had."""
    digest = hashlib.sha256()
    for name in modules:
        digest.update(Path(str(import_module(name).__file__)).read_bytes())
    folder = cache_root() / f"kernels-{digest.hexdigest()[:16]}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return None
    return folder if os.access(folder, os.W_OK) else None


def cache_root() -> Path:
    """Return where machine code is kept: $NUMBA_CACHE_DIR, else this user's cache folder."""
    chosen = os.environ.get("NUMBA_CACHE_DIR")
    if chosen:
        return Path(chosen) / "stickslip"
    if sys.platform == "win32":
        base = os.environ.get("LOCALAPPDATA", str(Path.home() / "AppData" / "Local"))
    elif sys.platform == "darwin":
        base = str(Path.home() / "Library" / "Caches")
    else:
        base = os.environ.get("XDG_CACHE_HOME", str(Path.home() / ".cache"))
    return Path(base) / "stickslip"
