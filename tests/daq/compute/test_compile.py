"""Machine code of kernels: compiled by one process, also where several need it at once."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from daq.compute import compile as kernels
from daq.output.lock import FileLock

KERNEL = """
def entry(x):
    total = 0.0
    for i in range(10):
        total += x * i
    return total
"""
USE = """
import sys
sys.path.insert(0, {folder!r})
import kernel_used_by_a_test as kernel
from daq.compute.compile import ANNOUNCEMENT, compiled
print(compiled(kernel.entry, (kernel.__name__,))(2.0))
"""


def start(folder: Path) -> "subprocess.Popen[str]":
    (folder / "kernel_used_by_a_test.py").write_text(KERNEL)
    return subprocess.Popen(
        [sys.executable, "-c", USE.format(folder=str(folder))],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "NUMBA_CACHE_DIR": str(folder)},
    )


def test_processes_wait_for_the_one_that_compiles(tmp_path: Path) -> None:
    """Two processes that needed the same kernel each compiled it: 20 s of CPU for those of a fit."""
    both = [start(tmp_path), start(tmp_path)]
    answers = [process.communicate() for process in both]
    assert [out for out, _ in answers] == ["90.0\n", "90.0\n"]
    assert sorted(err for _, err in answers) == ["", kernels.ANNOUNCEMENT + "\n"]


def test_a_lock_held_for_too_long_does_not_stop_a_fit(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(kernels, "LONGEST_WAIT_S", 0.1)
    path = tmp_path / "entry.lock"
    path.touch()
    held = FileLock(path)
    assert kernels._wait_for_lock(path) is None
    held.release()
    free = kernels._wait_for_lock(path)
    assert free is not None
    free.release()


def test_a_folder_without_room_for_locks(tmp_path: Path) -> None:
    assert kernels._wait_for_lock(tmp_path / "missing" / "entry.lock") is None


@pytest.mark.skipif(sys.platform == "win32", reason="owners and modes are POSIX")
def test_machine_code_is_kept_only_where_no_other_user_can_write(tmp_path: Path, monkeypatch) -> None:
    # Whoever could write into the folder had its user run his code.
    shared = tmp_path / "shared"
    shared.mkdir()
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(shared))
    (shared / "stickslip").mkdir()
    (shared / "stickslip").chmod(0o777)
    folder = kernels.cache_folder(("daq.errors",))
    assert folder is not None
    assert {path.stat().st_mode & 0o022 for path in (folder, folder.parent)} == {0}
    shared.chmod(0o777)  # there the folder could be replaced by another one
    assert kernels.cache_folder(("daq.errors",)) is None
    shared.chmod(0o1777)
    assert kernels.cache_folder(("daq.errors",)) == folder
    monkeypatch.setattr(os, "geteuid", lambda: folder.stat().st_uid + 1)
    assert kernels.cache_folder(("daq.errors",)) is None
