"""Folders of the user's own: configuration and machine code, by the XDG Base Directory Specification.

A variable counts only where it holds an absolute path, as that specification demands: an empty or relative one would
lead into the current folder, which may be somebody else's, and machine code that is found there is run.
"""

import os
import sys
from pathlib import Path


def config() -> Path | None:
    """Return the folder of this user's configurations; None where there is none."""
    return absolute("XDG_CONFIG_HOME") or _home(".config")


def cache() -> Path | None:
    """Return the folder of what this user's programs can make again; None where there is none."""
    if sys.platform == "win32":
        return absolute("LOCALAPPDATA") or _home("AppData", "Local")
    if sys.platform == "darwin":
        return _home("Library", "Caches")
    return absolute("XDG_CACHE_HOME") or _home(".cache")


def absolute(variable: str) -> Path | None:
    """Return the absolute path in an environment variable; None where it is not set, or holds anything else."""
    path = Path(os.environ.get(variable, ""))
    return path if path.is_absolute() else None


def _home(*parts: str) -> Path | None:
    try:
        path = Path.home().joinpath(*parts)
    except RuntimeError:  # a user without a home
        return None
    return path if path.is_absolute() else None
