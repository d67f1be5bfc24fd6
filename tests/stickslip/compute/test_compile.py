"""Machine code of kernels: compiled by one process, also where several need it at once."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from stickslip.compute import compile as kernels
from stickslip.output.lock import FileLock

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
from stickslip.compute.compile import ANNOUNCEMENT, compiled
print(compiled(kernel.entry, (kernel.__name__,))(2.0))
"""


def write_kernel(folder, number=0):
    """Write a kernel, another one for each number, before a process needs it: it may not be read half written."""
    (folder / "kernel_used_by_a_test.py").write_text(f"{KERNEL}\nNUMBER = {number}\n")


def start(folder, stderr=subprocess.PIPE):
    line = [sys.executable, "-c", USE.format(folder=str(folder))]
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(folder)}
    return subprocess.Popen(line, stdout=subprocess.PIPE, stderr=stderr, text=True, env=environment)


def test_one_process_compiles_for_others_and_it_is_announced_once_per_installation(tmp_path):
    """Each of two processes compiled the kernels of a fit, 20 s of CPU, and each said "once per installation"."""
    write_kernel(tmp_path)
    assert start(tmp_path, subprocess.DEVNULL).communicate() == ("90.0\n", None)  # prints nowhere: counts for none
    write_kernel(tmp_path, 1)
    both = [start(tmp_path), start(tmp_path)]
    answers = [process.communicate() for process in both]
    assert [out for out, _ in answers] == ["90.0\n", "90.0\n"]
    assert sorted(err for _, err in answers) == ["", kernels.ANNOUNCEMENT + "\n"]
    write_kernel(tmp_path, 2)
    assert start(tmp_path).communicate() == ("90.0\n", "")
    assert len(list((tmp_path / "stickslip").glob("kernels-*"))) == 3


@pytest.mark.skipif(sys.platform == "win32", reason="modes are POSIX")
def test_compilation_that_is_not_kept_is_said_by_each_process(tmp_path):
    tmp_path.chmod(0o777)  # where another user could write, nothing is kept
    write_kernel(tmp_path)
    for process in (start(tmp_path), start(tmp_path)):
        assert process.communicate() == ("90.0\n", kernels.NOT_KEPT + "\n")


def test_a_lock_held_for_too_long_does_not_stop_a_fit(tmp_path, monkeypatch):
    monkeypatch.setattr(kernels, "LONGEST_WAIT_S", 0.1)
    path = tmp_path / "entry.lock"
    path.touch()
    held = FileLock(path)
    assert kernels._wait_for_lock(path) is None
    held.release()
    free = kernels._wait_for_lock(path)
    free.release()


def test_a_folder_without_room_for_locks(tmp_path):
    assert kernels._wait_for_lock(tmp_path / "missing" / "entry.lock") is None


@pytest.mark.skipif(sys.platform == "win32", reason="owners and modes are POSIX")
def test_machine_code_is_kept_only_where_no_other_user_can_write(tmp_path, monkeypatch):
    # Whoever could write into the folder had its user run his code.
    shared = tmp_path / "shared"
    shared.mkdir()
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(shared))
    (shared / "stickslip").mkdir()
    (shared / "stickslip").chmod(0o777)
    folder = kernels.cache_folder(("stickslip.errors",))
    assert {path.stat().st_mode & 0o022 for path in (folder, folder.parent)} == {0}
    shared.chmod(0o777)  # there the folder could be replaced by another one
    assert kernels.cache_folder(("stickslip.errors",)) is None
    shared.chmod(0o1777)
    assert kernels.cache_folder(("stickslip.errors",)) == folder
    monkeypatch.setattr(os, "geteuid", lambda: folder.stat().st_uid + 1)
    assert kernels.cache_folder(("stickslip.errors",)) is None


@pytest.mark.skipif(sys.platform != "linux", reason="the variables are those of Linux")
@pytest.mark.parametrize("value", ["", ".", "cache", "~/cache"])
def test_machine_code_is_never_looked_for_in_the_current_folder(tmp_path, monkeypatch, value):
    # A stranger's data folder could have its reader run anything.
    monkeypatch.chdir(tmp_path)
    home = tmp_path / "home"
    monkeypatch.setenv("HOME", str(home))
    for variable in ("XDG_CACHE_HOME", "NUMBA_CACHE_DIR"):
        monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
        monkeypatch.setenv(variable, value)
        assert kernels.cache_root() == home / ".cache" / "stickslip"
        folder = kernels.cache_folder(("stickslip.errors",))
        assert folder.is_relative_to(home)
        assert list(tmp_path.iterdir()) == [home]
    monkeypatch.setenv("HOME", value)
    root = kernels.cache_root()
    assert root is None or root.is_absolute()


@pytest.mark.skipif(sys.platform == "win32", reason="owners are POSIX")
def test_machine_code_that_another_user_could_leave_is_not_used(tmp_path, monkeypatch):
    # The right of others was taken from an open folder, and what they had put there stayed and was loaded.
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    folder = kernels.cache_folder(("stickslip.errors",))
    left = folder / "left.nbi"
    left.touch()
    folder.chmod(0o777)
    lstat = Path.lstat
    theirs = os.stat_result((0o100644, 0, 0, 1, os.geteuid() + 1, 0, 0, 0, 0, 0))
    monkeypatch.setattr(Path, "lstat", lambda path: theirs if path == left else lstat(path))
    assert kernels.cache_folder(("stickslip.errors",)) is None
    assert kernels.cache_folder(("stickslip.errors",)) is None  # nor the next time
    left.unlink()
    assert kernels.cache_folder(("stickslip.errors",)) == folder
