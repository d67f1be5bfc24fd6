"""Refused writes (disk full, read-only, gone) as one error that names the file, whatever library met them.

HDF5 must not meet such a disk: where a write fails as a file is closed it leaves objects behind that may end the
process with a segmentation fault.  So a file is written through a `Sink`, which keeps the first refusal to itself, goes
on in memory, and raises it when HDF5 is done.

Changes can be tried without a disk: `rehearsed`.
"""

import errno
import io
import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any

from stickslip.errors import DeviceError

if TYPE_CHECKING:
    import h5py


def sync_folder(path: Path) -> None:
    """Put the name of a new file on the disk: the entry in its folder.  Where folders cannot be synced, do nothing."""
    if hasattr(os, "O_DIRECTORY"):
        folder = os.open(path.absolute().parent, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)


class RefusedError(DeviceError):
    """The disk refuses a file."""


def refusal(path: Path, error: OSError) -> RefusedError:
    """Return what an error of the operating system means for a file that was to be written."""
    if error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
        return RefusedError("the disk is full", str(path), "free space, or choose a folder on another disk")
    if error.errno in (errno.EACCES, errno.EPERM, errno.EROFS):
        return RefusedError("may not be written", str(path), "give a place that you may write to")
    return RefusedError(f"cannot be written: {error.strerror or error}", str(path), "give another place")


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Raise `RefusedError` for every OSError of the block, which writes ``path`` or something on its way there."""
    try:
        yield
    except OSError as error:
        raise refusal(path, error) from error


@contextmanager
def interrupts_later() -> Iterator[None]:
    """Hold Ctrl-C and its like back until the block has ended: within HDF5 their exception would be lost."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    numbers = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]
    handlers = {number: handler for number in numbers if callable(handler := signal.getsignal(number))}
    came: list[tuple[int, FrameType | None]] = []
    try:
        for number in handlers:
            signal.signal(number, lambda number, frame: came.append((number, frame)))
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
    for number, frame in came:
        handlers[number](number, frame)


@contextmanager
def hdf5(path: Path, mode: str) -> "Iterator[h5py.File]":
    """Open an HDF5 file for writing, "w" or "r+"; OSError at the end if the disk refused any of it."""
    import h5py

    with path.open("w+b" if mode == "w" else "r+b", buffering=0) as file:
        sink = Sink(file)
        with interrupts_later(), h5py.File(sink, mode) as made:
            yield made
        if sink.error is not None:
            raise sink.error


@contextmanager
def rehearsed(path: Path) -> "Iterator[h5py.File]":
    """Open an HDF5 file for changes that stay in memory."""
    import h5py

    with h5py.File(io.BytesIO(path.read_bytes()), "r+") as made:
        yield made


class Sink(io.RawIOBase):
    """A file, until the disk refuses; then its content in memory, so that whoever writes need not know.

    error: The first refusal.
    """

    def __init__(self, file: io.FileIO) -> None:
        self._file: io.FileIO | io.BytesIO = file
        self.error: OSError | None = None

    def readable(self) -> bool:
        """Return True, as of `writable` and `seekable`."""
        return True

    writable = seekable = readable

    def readinto(self, buffer: Any) -> int:
        """Read; past the end there is nothing."""
        return self._file.readinto(buffer) or 0

    def write(self, data: Any) -> int:
        rest = memoryview(data).cast("B")
        while len(rest):
            try:
                done = self._file.write(rest) or 0
            except OSError as error:
                self._go_on_in_memory(error)
                continue
            rest = rest[done:]
        return len(memoryview(data).cast("B"))

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Go to a place."""
        return self._file.seek(offset, whence)

    def tell(self) -> int:
        """Return the place."""
        return self._file.tell()

    def truncate(self, size: int | None = None) -> int:
        """Cut, or lengthen by zeros."""
        wanted = self.tell() if size is None else size
        if not isinstance(self._file, io.BytesIO):
            try:
                return self._file.truncate(wanted)
            except OSError as error:
                self._go_on_in_memory(error)
        place = self.tell()
        short = wanted - self.seek(0, os.SEEK_END)
        self._file.write(bytes(max(0, short)))  # BytesIO only cuts
        self._file.truncate(wanted)
        self.seek(place)
        return wanted

    def _go_on_in_memory(self, error: OSError) -> None:
        self.error = self.error or error
        place = self._file.tell()
        self._file.seek(0)
        self._file = io.BytesIO(self._file.read())
        self._file.seek(place)
