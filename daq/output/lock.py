"""A lock on a file that one process writes: the system releases it when that process ends, however it ends.

POSIX: ``flock`` on a descriptor of its own.  It is advisory: readers are not held up, and only programs that ask for
the lock respect it.  Windows: one byte far beyond the end of the file is locked, so readers are not held up there
either; the file can also not be removed while it is open.  Some network file systems have no locks.
"""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

if sys.platform == "win32":
    import msvcrt
else:
    import fcntl

_BEYOND = 1 << 40  # Windows: where the locked byte lies


class FileLock:
    """The lock on a file, held until `release`, `remove` or the end of the process.

    Parameters
    ----------
    path : Path
        An existing file.

    Raises
    ------
    BlockingIOError
        Another process, or another lock of this one, holds it.
    OSError
        The file cannot be opened, or its file system has no locks.
    """

    def __init__(self, path: Path) -> None:
        try:
            self._fd = os.open(path, os.O_RDWR)
        except PermissionError:
            self._fd = os.open(path, os.O_RDONLY)  # enough, except on network file systems
        try:
            _lock(self._fd)
        except OSError:
            self.release()
            raise

    def release(self) -> None:
        """Let go of the file; a second call does nothing."""
        fd, self._fd = self._fd, -1
        if fd >= 0:
            os.close(fd)

    def remove(self, path: Path) -> None:
        """Remove the file, if it is still there, and let go of it."""
        if sys.platform == "win32":
            self.release()
        path.unlink(missing_ok=True)
        self.release()

    def rename(self, path: Path, target: Path) -> None:
        """Give the file the name of another one, which it replaces, and let go of it."""
        if sys.platform == "win32":
            self.release()
        path.replace(target)
        self.release()


@contextmanager
def folder_locked(folder: Path) -> Iterator[None]:
    """Wait for the lock on a folder, and hold it; where folders cannot be locked, hold nothing."""
    try:
        fd = os.open(folder, os.O_RDONLY)
    except OSError:  # Windows opens no folders
        yield
        return
    try:
        with suppress(OSError):  # a file system without locks
            _lock(fd, wait=True)
        yield
    finally:
        os.close(fd)


def _lock(fd: int, wait: bool = False) -> None:
    if sys.platform == "win32":
        os.lseek(fd, _BEYOND, os.SEEK_SET)
        try:
            msvcrt.locking(fd, msvcrt.LK_NBLCK, 1)
        except PermissionError as error:
            raise BlockingIOError(error.errno, error.strerror) from error
    else:
        fcntl.flock(fd, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
