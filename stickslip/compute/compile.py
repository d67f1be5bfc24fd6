"""Kernels compiled by numba from the source that also runs interpreted; numba is imported on the first request.

A kernel module holds plain functions of scalars and arrays.  `compiled` makes every function of the modules named
callable from machine code and compiles the entry: no second source, no fast-math (it breaks NaN tests).  Machine code
is kept in a folder named by a hash of the sources, so that a changed installation never loads stale code.
"""

import gc
import hashlib
import inspect
import os
import stat
import sys
import time
from collections.abc import Callable
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

from stickslip import user_folders
from stickslip.output.lock import FileLock
from stickslip.text import printable
from stickslip.version import VERSION

COMPILING = "compiling numerical kernels"
# Printed once for all commands.  The kernels of smoothing, fits and simulations take 40 s of CPU time together: about
# 30 s on two idle cores, up to a minute where nothing of the installation is in the disk cache yet.
ANNOUNCEMENT = f"{COMPILING}, once per installation; this takes about 30 s, or a minute on a slow machine"
NOT_KEPT = (
    f"{COMPILING} in each command, for up to half a minute, because no folder is available in which only this "
    "user can store them"
)
LONGEST_WAIT_S = 120.0  # for another process that compiles the same kernel; the slowest takes 15 s on an idle core


@cache
def compiled(function: Callable[..., Any], modules: tuple[str, ...], **options: Any) -> Callable[..., Any]:
    """Return ``function`` compiled with numba's ``options``; ``modules`` are those whose functions it may call."""
    from numba import config

    if vars(config)["DISABLE_JIT"]:  # by a program that imports this package; commands read no such setting
        return function
    options = {"error_model": "numpy", **options}
    _give_stacks()
    for name in modules:
        register(name, **options)
    return build(function, cache_folder((*modules, function.__module__), repr(sorted(options.items()))), **options)


def stack(order: tuple[float, ...]) -> Any:
    """Return an unset array of len(order) numbers for a kernel, in compiled code on the stack."""
    return [0.0] * len(order)


def stack_square(order: tuple[float, ...]) -> Any:
    """Return an array as `stack` does, of n n numbers where the tuple has n."""
    return [0.0] * len(order) ** 2


@cache
def _give_stacks() -> None:
    """Let compiled code call `stack` and `stack_square`."""
    from llvmlite import ir  # type: ignore[import-untyped]
    from numba.core import types
    from numba.extending import intrinsic, overload

    def reserve(power: int) -> Any:
        @intrinsic
        def memory(typing_context: Any, order: Any) -> Any:
            size = ir.Constant(ir.IntType(64), len(order) ** power)

            def take(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
                with builder.goto_entry_block():
                    return builder.alloca(ir.DoubleType(), size=size)

            return types.CPointer(types.float64)(order), take  # type: ignore[no-untyped-call]

        return memory

    line_memory, square_memory = reserve(1), reserve(2)

    @overload(stack)
    def line(order):  # type: ignore[no-untyped-def]
        return lambda order: line_memory(order)

    @overload(stack_square)
    def square(order):  # type: ignore[no-untyped-def]
        return lambda order: square_memory(order)


def build(function: Callable[..., Any], folder: Path | None, **options: Any) -> Callable[..., Any]:
    """Compile ``function`` with numba's ``options`` and keep its machine code in ``folder``, if there is one."""
    import numba
    from numba import config

    _announce_compilation(folder is not None)
    settings = vars(config)  # numba reads the folder when a cache is enabled
    before = settings["CACHE_DIR"]
    try:
        settings["CACHE_DIR"] = str(folder) if folder else before
        entry = numba.njit(function, cache=folder is not None, **options)
    finally:
        settings["CACHE_DIR"] = before
    if folder is not None:
        _compile_in_one_process(entry, folder)
    return entry  # type: ignore[no-any-return]


@cache
def _announce_compilation(kept: bool) -> None:
    """Report compilation on stderr, and pause the garbage collector meanwhile, which saves a twelfth of the time."""
    from numba.core import event

    class Announcer(event.Listener):
        depth = done = 0
        collecting = True

        def on_start(self, _: Any) -> None:
            if self.depth == self.done == 0:
                if not kept or _is_first():
                    sys.stderr.write(f"{ANNOUNCEMENT if kept else NOT_KEPT}\n")
                if sys.stderr.isatty():
                    sys.stderr.write(f"{COMPILING} ...")
                    sys.stderr.flush()
            if self.depth == 0:
                self.collecting = gc.isenabled()
                gc.disable()
            self.depth += 1

        def on_end(self, _: Any) -> None:
            self.depth -= 1
            self.done += 1
            if self.depth == 0 and self.collecting:
                gc.enable()
            if sys.stderr.isatty():
                sys.stderr.write(f"\r{COMPILING}: {self.done} functions" + ("\r\x1b[K" if self.depth == 0 else ""))
                sys.stderr.flush()

    event.register("numba:compile", Announcer())  # type: ignore[no-untyped-call]


def _is_first() -> bool:
    """Return whether no process of this installation has announced a compilation yet, and mark that one has."""
    import numba

    root = cache_root()
    if root is None:
        return True
    made = f"{VERSION} {numba.__version__} {sys.version} {Path(__file__).resolve()}"
    mark = root / f"announced-{hashlib.sha256(os.fsencode(made)).hexdigest()[:16]}"
    try:
        if os.path.samestat(os.fstat(sys.stderr.fileno()), os.stat(os.devnull)):
            return False
        mark.touch(exist_ok=False)
    except FileExistsError:
        return False
    except (OSError, ValueError):  # a stream that is no file, or no room for the mark
        return True
    return True


def _compile_in_one_process(entry: Any, folder: Path) -> None:
    """Let one process compile an entry, and others wait for its machine code; a failed write is no error."""
    machine_code = entry._cache  # noqa: SLF001 - numba has no public way to say that a cache is optional or shared
    load, save = machine_code.load_overload, machine_code.save_overload
    locks: list[FileLock] = []

    def load_or_lock(*signature: Any) -> Any:
        overload = load(*signature)
        if overload is None and not locks:
            lock = _wait_for_lock(folder / f"{entry.__name__}.lock")
            if lock is not None:
                locks.append(lock)
                overload = load(*signature)  # another process may have kept it while this one waited
                if overload is not None:
                    locks.pop().release()
        return overload

    def try_save(*signature: Any) -> None:
        try:
            save(*signature)
        except OSError as error:
            sys.stderr.write(printable(f"compiled code cannot be stored: {folder}: {error.strerror or error}\n"))
        finally:
            while locks:
                locks.pop().release()

    machine_code.load_overload, machine_code.save_overload = load_or_lock, try_save


def _wait_for_lock(path: Path) -> FileLock | None:
    """Return the lock on a new or existing file; None where there are no locks, or after `LONGEST_WAIT_S`."""
    end = time.monotonic() + LONGEST_WAIT_S
    try:
        path.touch()
        while time.monotonic() < end:
            try:
                return FileLock(path)
            except BlockingIOError:
                time.sleep(0.05)
    except OSError:
        pass
    return None


@cache
def register(module: str, **options: Any) -> None:
    """Make every function of a module callable from compiled code; those named in ``INLINED`` are inlined."""
    from numba.extending import register_jitable

    members = vars(import_module(module))
    for name, function in members.items():
        if inspect.isfunction(function) and function.__module__ == module:
            inlined = {"forceinline": True} if name in members.get("INLINED", ()) else {}
            # no kernel is handed to C: a wrapper less to compile
            register_jitable(no_cfunc_wrapper=True, **options, **inlined)(function)


def cache_folder(modules: tuple[str, ...], options: str = "") -> Path | None:
    """Return the folder for machine code of modules; None without one, or where another user could write."""
    digest = hashlib.sha256(options.encode())
    for name in modules:
        digest.update(Path(str(import_module(name).__file__)).read_bytes())
    root = cache_root()
    if root is None:
        return None
    folder = root / f"kernels-{digest.hexdigest()[:16]}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        above = root.parent.stat().st_mode
        renamed = above & stat.S_IWOTH and not above & stat.S_ISVTX and sys.platform != "win32"
        safe = not renamed and _is_own(root) and _is_own(folder)
    except OSError:
        return None
    return folder if safe and os.access(folder, os.W_OK) else None


def _is_own(folder: Path) -> bool:
    """Return whether this user alone has written to a folder; others lose the right to where that is possible."""
    if sys.platform == "win32":
        return True
    status = folder.stat()
    if status.st_uid != os.geteuid():
        return False
    others = stat.S_IWGRP | stat.S_IWOTH
    if status.st_mode & others:
        if any(entry.lstat().st_uid != status.st_uid for entry in folder.rglob("*")):
            return False
        folder.chmod(stat.S_IMODE(status.st_mode) & ~others)
    return True


def cache_root() -> Path | None:
    """Return the folder of machine code: $NUMBA_CACHE_DIR if absolute, else in this user's cache folder."""
    base = user_folders.read_absolute("NUMBA_CACHE_DIR") or user_folders.find_cache()
    return None if base is None else base / "stickslip"
