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
ANNOUNCEMENT = f"{COMPILING}, once per installation: about 30 s in all, on a slow or cold machine a minute"
NOT_KEPT = f"{COMPILING}: some seconds to half a minute in each command, as no folder of this user's own can keep them"
LONGEST_WAIT_S = 120.0  # for another process that compiles the same kernel; the slowest takes 15 s on an idle core


@cache
def compiled(function: Callable[..., Any], modules: tuple[str, ...], **options: Any) -> Callable[..., Any]:
    """Return ``function`` compiled; called like the plain one.

    Where its machine code is not yet kept, the first call compiles it, and stderr says so once per installation.

    function: A plain function; numba's nopython subset.
    modules: Names of the modules whose functions it may call, its own included.
    **options: Passed to numba, for the entry and for every function of the modules.  Division by zero gives an infinity
        or NaN, as numpy's: to check every divisor takes about a tenth more time to compile.
    """
    from numba import config

    if vars(config)["DISABLE_JIT"]:  # by a program that imports this package; commands read no such setting
        return function
    options = {"error_model": "numpy", **options}
    _give_stacks()
    for name in modules:
        register(name, **options)
    return build(function, cache_folder((*modules, function.__module__), repr(sorted(options.items()))), **options)


def stack(order: tuple[float, ...]) -> Any:
    """Return an array for a kernel's own use, of as many numbers as the tuple has; its contents are not set.

    Compiled code gets memory on the stack, which costs nothing and may stay in registers.
    """
    return [0.0] * len(order)


def stack_square(order: tuple[float, ...]) -> Any:
    """As `stack`, of n n numbers where the tuple has n."""
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

    one, two = reserve(1), reserve(2)

    @overload(stack)
    def line(order):  # type: ignore[no-untyped-def]
        return lambda order: one(order)

    @overload(stack_square)
    def square(order):  # type: ignore[no-untyped-def]
        return lambda order: two(order)


def build(function: Callable[..., Any], folder: Path | None, **options: Any) -> Callable[..., Any]:
    """Return ``function`` compiled with numba's ``options``, its machine code kept in ``folder``, if there is one."""
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
    """Report on stderr that numba compiles: one line per installation, and on a terminal how many functions are done.

    Where machine code is not ``kept`` it is one line per process.

    The garbage collector rests meanwhile: nearly all that a compiler makes lives until it is done, and to search it
    again and again takes a twelfth of the time.
    """
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
    """Return whether no process of this installation has said yet that it compiles; where nobody listens, nobody has.

    A file beside the machine code marks that it was said.
    """
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
    """Let one process compile an entry, and others that need it meanwhile wait for its machine code.

    A failed write of machine code costs the next call some seconds, and not this one its result.
    """
    machine_code = entry._cache  # noqa: SLF001 - numba has no public way to say that a cache is optional or shared
    load, save = machine_code.load_overload, machine_code.save_overload
    held: list[FileLock] = []

    def load_or_lock(*what: Any) -> Any:
        found = load(*what)
        if found is None and not held:
            lock = _wait_for_lock(folder / f"{entry.__name__}.lock")
            if lock is not None:
                held.append(lock)
                found = load(*what)  # another process may have kept it while this one waited
                if found is not None:
                    held.pop().release()
        return found

    def attempt(*what: Any) -> None:
        try:
            save(*what)
        except OSError as error:
            sys.stderr.write(printable(f"machine code is not kept: {folder}: {error.strerror or error}\n"))
        finally:
            while held:
                held.pop().release()

    machine_code.load_overload, machine_code.save_overload = load_or_lock, attempt


def _wait_for_lock(path: Path) -> FileLock | None:
    """Return the lock on a file, which is made; None where there are no locks, or after `LONGEST_WAIT_S`."""
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
    """Make every function of a module callable from compiled code, compiled with numba's ``options``.

    Those that the module names in ``INLINED`` are copied into their callers.
    """
    from numba.extending import register_jitable

    found = vars(import_module(module))
    for name, function in found.items():
        if inspect.isfunction(function) and function.__module__ == module:
            inlined = {"forceinline": True} if name in found.get("INLINED", ()) else {}
            # no kernel is handed to C: a wrapper less to compile
            register_jitable(no_cfunc_wrapper=True, **options, **inlined)(function)


def cache_folder(modules: tuple[str, ...], options: str = "") -> Path | None:
    """Return the folder for the machine code of these modules, compiled so.

    None where none can be written, or where another user could: who writes there has this user run it.
    """
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
    """Return whether this user alone writes to a folder; the right of others is taken away where that is possible.

    Where others had that right, what one of them has left there counts: the folder is not used.
    """
    if sys.platform == "win32":
        return True
    found = folder.stat()
    if found.st_uid != os.geteuid():
        return False
    others = stat.S_IWGRP | stat.S_IWOTH
    if found.st_mode & others:
        if any(inside.lstat().st_uid != found.st_uid for inside in folder.rglob("*")):
            return False
        folder.chmod(stat.S_IMODE(found.st_mode) & ~others)
    return True


def cache_root() -> Path | None:
    """Return where machine code is kept: $NUMBA_CACHE_DIR, else this user's cache folder; None without either.

    Numba's index of it is a pickle, so who writes there has this user run it: a relative path does not count.
    """
    base = user_folders.absolute("NUMBA_CACHE_DIR") or user_folders.cache()
    return None if base is None else base / "stickslip"
