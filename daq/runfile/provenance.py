"""Where a file comes from: software and its commit, interpreter, platform, host, command line.

Everything in here may differ between two files of the same data; nothing else in a run file may.
"""

import platform
import shlex
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from stickslip.text import storable
from stickslip.version import VERSION


def here(command: Sequence[str] | None = None) -> dict[str, str | int]:
    """Return the provenance of a file made now by this process.

    command: The command line; the process's own by default.
    Returns: ``software, python, numpy, platform, hostname, command_line`` and, in a checkout with git, ``git_commit``
        and ``git_dirty`` (1 when the checkout had changes). Bytes of a path that are no UTF-8 are escaped.
    """
    import numpy as np

    facts: dict[str, str | int] = {
        "software": f"stickslip {VERSION}",
        "python": platform.python_version(),
        "numpy": np.__version__,
        "platform": platform.platform(),
        "hostname": platform.node(),
        "command_line": shlex.join(_typed() if command is None else command),
    }
    known = facts | _commit(Path(__file__).resolve().parents[2])
    return {name: storable(value) if isinstance(value, str) else value for name, value in known.items()}


def _typed() -> list[str]:
    """Return the process's command line as a person would type it, without the folder the program lives in."""
    program = Path(sys.argv[0])
    name = f"python -m {program.parent.name}.{program.stem}" if program.suffix == ".py" else program.name
    return [*name.split(), *sys.argv[1:]]


def _commit(folder: Path) -> dict[str, str | int]:
    # Only our own checkout: an installed package inside somebody else's repository has no commit of ours.
    if not (folder / ".git").exists():
        return {}
    try:
        commit = _git(folder, "rev-parse", "HEAD")
        changes = _git(folder, "status", "--porcelain", "--untracked-files=no")
    except (OSError, subprocess.SubprocessError):
        return {}
    return {"git_commit": commit, "git_dirty": int(bool(changes))}


def _git(folder: Path, *arguments: str) -> str:
    # Without the option `git status` rewrites the index too, and leaves its lock behind when the timeout kills it.
    command = ["git", "--no-optional-locks", "-C", str(folder), *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=5)
    return done.stdout.strip()
