"""Folders of the user's own: configuration and machine code, by the XDG Base Directory Specification.

A variable counts only where it holds an absolute path, as that specification demands: an empty or relative one would
lead into the current folder, which may be somebody else's, and machine code that is found there is run.
"""

import os
import sys
from pathlib import Path


def find_config() -> Path | None:
    return read_absolute("XDG_CONFIG_HOME") or _find_home(".config")


def find_cache() -> Path | None:
    if sys.platform == "win32":
        return read_absolute("LOCALAPPDATA") or _find_home("AppData", "Local")
    if sys.platform == "darwin":
        return _find_home("Library", "Caches")
    return read_absolute("XDG_CACHE_HOME") or _find_home(".cache")


def read_absolute(variable: str) -> Path | None:
    """Return the absolute path in an environment variable; None where it is unset or not absolute."""
    path = Path(os.environ.get(variable, ""))
    return path if path.is_absolute() else None


def _find_home(*parts: str) -> Path | None:
    try:
        path = Path.home().joinpath(*parts)
    except RuntimeError:  # a user without a home
        return None
    return path if path.is_absolute() else None
