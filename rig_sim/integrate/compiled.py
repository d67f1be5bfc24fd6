"""The kernels compiled by numba, from the very source that runs interpreted; numba loads on the first request.

Every kernel function is registered as jitable, then the entry is compiled: no second source, no fast-math.  Machine
code is kept in a folder named by a hash of the kernels' sources, so a changed installation never meets a stale cache.
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

KERNEL_MODULES = (
    "rig_sim.friction.curve",
    "rig_sim.integrate.bracket",
    "rig_sim.integrate.modes",
    "rig_sim.integrate.linear",
    "rig_sim.integrate.taylor",
    "rig_sim.integrate.driven",
    "rig_sim.integrate.hybrid",
)

# Division by zero gives an infinity, which ends a run as `not finite`.  No kernel makes an array, so numba need not
# count references to them (_nrt): at every call from kernel to kernel that costs as much as the arithmetic.
JIT_OPTIONS: dict[str, Any] = {"error_model": "numpy", "_nrt": False}

ENTRIES = {
    "initial_mode": "rig_sim.integrate.modes",
    "force": "rig_sim.integrate.modes",
    "next_event": "rig_sim.integrate.hybrid",
    "next_turn": "rig_sim.integrate.hybrid",
    "sample_phase": "rig_sim.integrate.hybrid",
    "sample": "rig_sim.integrate.hybrid",
    "run": "rig_sim.integrate.hybrid",
}


def compiled(name: str) -> Callable[..., Any]:
    """Return the compiled kernel ``name``; called like the plain one, with arrays for buffers.

    Raises
    ------
    ValueError
        For a name that is not an entry.
    """
    if name not in ENTRIES:
        raise ValueError(f"{name!r} is no kernel; known: {', '.join(ENTRIES)}")
    return compile_entry(getattr(import_module(ENTRIES[name]), name))


@cache
def compile_entry(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return ``function`` compiled; it may call any kernel, helpers registered with `JIT_OPTIONS`, and make no array.

    The first call of a function whose machine code is not yet cached says on stderr that it compiles.
    """
    register_kernels()
    import numba
    from numba import config

    folder = cache_folder(function)
    settings = vars(config)  # numba reads the folder when a cache is enabled
    before = settings["CACHE_DIR"]
    try:
        settings["CACHE_DIR"] = str(folder) if folder else before
        entry = numba.njit(function, cache=folder is not None, **JIT_OPTIONS)
    finally:
        settings["CACHE_DIR"] = before
    if folder is None or not any(folder.rglob(f"*{function.__name__}*.nbi")):
        sys.stderr.write(f"compiling {function.__name__}: once per installation, some ten seconds\n")
    return entry  # type: ignore[no-any-return]


@cache
def register_kernels() -> None:
    """Make every kernel function callable from compiled code."""
    from numba.extending import register_jitable

    for name in KERNEL_MODULES:
        module = import_module(name)
        for function in vars(module).values():
            if inspect.isfunction(function) and function.__module__ == name:
                register_jitable(forceinline=True, **JIT_OPTIONS)(function)


def cache_folder(function: Callable[..., Any]) -> Path | None:
    """Return the writable folder for the machine code of ``function``, or None when there is none to be had."""
    digest = hashlib.sha256()
    for name in (*KERNEL_MODULES, function.__module__, __name__):
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
