"""Refused writes (disk full, read-only, gone) as one error that names the file, whatever library met them.

HDF5 must not meet such a disk: where a write fails as a file is closed it leaves objects behind that may end the
process with a segmentation fault.  So a file is written through a `Sink`, which keeps the first refusal to itself, goes
on in memory, and raises it when HDF5 is done.

Changes can be tried without a disk: `open_rehearsal`.
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
    """Sync the entry of a new file in its folder; do nothing where folders cannot be synced."""
    if hasattr(os, "O_DIRECTORY"):
        folder = os.open(path.absolute().parent, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)


class RefusedError(DeviceError):
    """The disk refuses a file."""


def describe_refusal(path: Path, error: OSError) -> RefusedError:
    if error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
        return RefusedError("the disk is full", str(path), "free space, or choose a folder on another disk")
    if error.errno in (errno.EACCES, errno.EPERM, errno.EROFS):
        return RefusedError(
            "cannot be written: permission denied", str(path), "choose a folder in which you have write permission"
        )
    return RefusedError(f"cannot be written: {error.strerror or error}", str(path), "choose another folder")


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Raise `RefusedError` for every OSError of the block, which writes ``path`` or something on its way there."""
    try:
        yield
    except OSError as error:
        raise describe_refusal(path, error) from error


@contextmanager
def defer_interrupts() -> Iterator[None]:
    """Defer Ctrl-C and similar signals until the block has ended: within HDF5 their exception would be lost."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    numbers = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]
    handlers = {number: handler for number in numbers if callable(handler := signal.getsignal(number))}
    received: list[tuple[int, FrameType | None]] = []
    try:
        for number in handlers:
            signal.signal(number, lambda number, frame: received.append((number, frame)))
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
    for number, frame in received:
        handlers[number](number, frame)


@contextmanager
def open_hdf5(path: Path, mode: str) -> "Iterator[h5py.File]":
    """Open an HDF5 file for writing, "w" or "r+"; OSError at the end if the disk refused any of it."""
    import h5py

    with path.open("w+b" if mode == "w" else "r+b", buffering=0) as file:
        sink = Sink(file)
        with defer_interrupts(), h5py.File(sink, mode) as hdf5_file:
            yield hdf5_file
        if sink.error is not None:
            raise sink.error


@contextmanager
def open_rehearsal(path: Path) -> "Iterator[h5py.File]":
    """Open an HDF5 file for changes that stay in memory."""
    import h5py

    with h5py.File(io.BytesIO(path.read_bytes()), "r+") as hdf5_file:
        yield hdf5_file


class Sink(io.RawIOBase):
    """A file; from the first refusal of the disk (``error``) on, its content in memory."""

    def __init__(self, file: io.FileIO) -> None:
        self._file: io.FileIO | io.BytesIO = file
        self.error: OSError | None = None

    def readable(self) -> bool:
        return True

    writable = seekable = readable

    def readinto(self, buffer: Any) -> int:
        return self._file.readinto(buffer) or 0

    def write(self, data: Any) -> int:
        rest = memoryview(data).cast("B")
        while len(rest):
            try:
                written = self._file.write(rest) or 0
            except OSError as error:
                self._go_on_in_memory(error)
                continue
            rest = rest[written:]
        return len(memoryview(data).cast("B"))

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        return self._file.seek(offset, whence)

    def tell(self) -> int:
        return self._file.tell()

    def truncate(self, size: int | None = None) -> int:
        """Cut the file, or lengthen it by zeros."""
        new_size = self.tell() if size is None else size
        if not isinstance(self._file, io.BytesIO):
            try:
                return self._file.truncate(new_size)
            except OSError as error:
                self._go_on_in_memory(error)
        offset = self.tell()
        short = new_size - self.seek(0, os.SEEK_END)
        self._file.write(bytes(max(0, short)))  # BytesIO only cuts
        self._file.truncate(new_size)
        self.seek(offset)
        return new_size

    def _go_on_in_memory(self, error: OSError) -> None:
        self.error = self.error or error
        offset = self._file.tell()
        self._file.seek(0)
        self._file = io.BytesIO(self._file.read())
        self._file.seek(offset)
