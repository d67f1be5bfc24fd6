"""Python as the commands run it: neither the current folder nor settings for other users of a library reach it.

A data folder may come from a stranger.  A process that is started here imports nothing from it (``-P``), and a command
reads no ``matplotlibrc`` or ``.numba_config.yaml``, whose values change pictures, switch compiling off, or end in an
error.  A program that imports the packages keeps its settings: nothing here is done on import.
"""

import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.machinery import ModuleSpec, PathFinder
from types import ModuleType
from typing import Any

SAFE_PATH = "PYTHONSAFEPATH"  # as -P, for processes that a library starts
# NUMBA_CACHE_DIR is documented: where the machine code is kept.
KEPT = "NUMBA_CACHE_DIR"
# Modules that read a file of settings while they are imported, and its name.
SETTINGS = {"matplotlib": "matplotlibrc", "numba.core.config": ".numba_config.yaml"}


def start_python(module: str, *arguments: str, **how: Any) -> "subprocess.Popen[Any]":
    """Start a module of an installed package in a new interpreter; ``how`` is that of `subprocess.Popen`."""
    return subprocess.Popen([sys.executable, "-P", "-m", module, *arguments], **how)


@contextmanager
def safe_path() -> Iterator[None]:
    """Let interpreters that a library starts in the block import nothing from the current folder."""
    before = os.environ.get(SAFE_PATH)
    os.environ[SAFE_PATH] = "1"
    try:
        yield
    finally:
        if before is None:
            del os.environ[SAFE_PATH]
        else:
            os.environ[SAFE_PATH] = before


def ignore_settings() -> None:
    """Let this process, which is a command's, run on the libraries' defaults, before it imports them."""
    for name in list(os.environ):
        if name in ("MPLBACKEND", "MATPLOTLIBRC") or (name.startswith("NUMBA_") and name != KEPT):
            del os.environ[name]
    if not settings_are_ignored():
        sys.meta_path.insert(0, _WithoutSettings())


def settings_are_ignored() -> bool:
    """Return whether `ignore_settings` was called in this process."""
    return any(isinstance(finder, _WithoutSettings) for finder in sys.meta_path)


class _WithoutSettings:
    """Finds the modules of `SETTINGS`; while one is loaded, its file exists in its package's folder alone."""

    def find_spec(self, name: str, path: Sequence[str] | None, target: ModuleType | None = None) -> ModuleSpec | None:
        if name not in SETTINGS:
            return None
        spec = PathFinder.find_spec(name, path, target)
        if spec is None or spec.loader is None or spec.origin is None:
            return spec
        load, home = spec.loader.exec_module, os.path.dirname(spec.origin)

        def load_without_settings(module: ModuleType) -> None:
            with _hidden(SETTINGS[name], home):
                load(module)
            if hasattr(module, "_config_fname"):  # numba reads it again whenever it compiles
                vars(module)["_config_fname"] = os.devnull

        spec.loader.exec_module = load_without_settings  # type: ignore[method-assign]
        return spec


@contextmanager
def _hidden(file: str, home: str) -> Iterator[None]:
    """Let no file of this name outside a folder exist for who asks `os.path.exists`."""
    exists = os.path.exists

    def exists_at_home(path: Any) -> bool:
        hidden = isinstance(path, str) and os.path.basename(path) == file and not path.startswith(home)
        return not hidden and exists(path)

    os.path.exists = exists_at_home
    try:
        yield
    finally:
        os.path.exists = exists
