"""A lock on a file that one process writes: the system releases it when that process ends, however it ends.

POSIX: ``flock`` on a descriptor of its own.  It is advisory: readers are not held up, and only programs that ask for
the lock respect it.  Windows: one byte far beyond the end of the file is locked, so readers are not held up there
either; the file can also not be removed while it is open.  Some network file systems have no locks.
"""

import errno
import os
import sys
from pathlib import Path

if sys.platform == "win32":
    import msvcrt
else:
    import fcntl

_BEYOND = 1 << 40  # Windows: where the locked byte lies


class FileLock:
    """The lock on a file, held until `release`, `remove` or the end of the process.

    path: An existing file.
    new: The file does not exist, and is made.
    Raises BlockingIOError: another process, or another lock of this one, holds it; or a new file was removed before it
        was locked.
    Raises FileExistsError: A new file exists.
    Raises OSError: the file cannot be opened, or its file system has no locks; a new file is removed.
    """

    def __init__(self, path: Path, *, new: bool = False) -> None:
        try:
            self._fd = os.open(path, os.O_RDWR | (os.O_CREAT | os.O_EXCL if new else 0), 0o600)
        except PermissionError:
            if new:
                raise
            self._fd = os.open(path, os.O_RDONLY)  # enough, except on network file systems
        try:
            _lock(self._fd)
            if new and not self.is_of(path):
                raise BlockingIOError(errno.EWOULDBLOCK, "removed before it was locked", str(path))
        except BlockingIOError:
            self.release()
            raise
        except OSError:
            self.release()
            if new:
                path.unlink(missing_ok=True)
            raise

    @property
    def held(self) -> bool:
        """Whether the lock was not yet let go of."""
        return self._fd >= 0

    def is_of(self, path: Path) -> bool:
        """Return whether the locked file has this name: it may have been removed or renamed before it was locked."""
        try:
            return os.path.samestat(os.fstat(self._fd), os.lstat(path))
        except OSError:
            return False

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
            try:
                path.replace(target)
            except OSError:  # another program has the target open
                path.unlink(missing_ok=True)
                raise
        else:
            path.replace(target)
        self.release()


def _lock(fd: int) -> None:
    if sys.platform == "win32":
        os.lseek(fd, _BEYOND, os.SEEK_SET)
        try:
            msvcrt.locking(fd, msvcrt.LK_NBLCK, 1)
        except PermissionError as error:
            raise BlockingIOError(error.errno, error.strerror) from error
    else:
        fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
