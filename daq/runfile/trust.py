"""What a run file from somebody else may hold: everything in the file itself, no more than fits into it, and no traps.

HDF5 can name other files of the computer as the content of a dataset, and declare data of any size.  Its library does
not survive every damaged file, and it copies whatever lies in memory beside a chunk that is shorter than it should be.
So a file is opened here only after a child process has read all of it: of 4215 files with one byte changed one crashed
the library, and the command with it.
"""

import math
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from daq.runfile.isolation import BrokenOffError, run_isolated
from stickslip.errors import InputError

DO = "do not trust this file; ask who made it"
AGAIN = "copy it again from its source, or run 'daq recover' on its journal"
# Bytes of data per byte of file.  Half an hour of a mass that never moved has 73, a moving one 3.3.  Half may refuse
# such a run with all its stages; double lets a file of 3 MB fill 2 GB.
MOST_EXPANSION = 300
FREE_BYTES = 1 << 24  # that any file may declare
SCHEMA, JOINT, JOINT_SCHEMA = "stickslip_schema", "stickslip_joint_fit", 1  # attributes of a run, of /entry/runs
MOST_OBJECTS = 10_000  # a run file with all its stages has about 400
FILTERS = (h5py.h5z.FILTER_SHUFFLE, h5py.h5z.FILTER_DEFLATE, h5py.h5z.FILTER_FLETCHER32)  # in this order
# CPU time of a child, and for each byte of the file; half an hour at 1 kHz, 23 MB, takes 0.1 s.  And its memory, to
# which the file's size is added.
SECONDS, SECONDS_PER_BYTE, MEMORY = 8.0, 2e-7, 1 << 30
# What h5py raises for what it cannot read.
DAMAGE = (OSError, RuntimeError, KeyError, ValueError, TypeError, ArithmeticError)

_done: set[tuple[object, ...]] = set()  # what children of this process have done to which files


def open_trusted(path: Path) -> h5py.File:
    """Open a file for reading that a child process could read; OSError for what is not HDF5."""
    check(path, _visit)
    return _read_only(path)


def _read_only(path: Path) -> h5py.File:
    """Open a file without HDF5's lock: a run is replaced as a whole, and just then its writer still holds a lock."""
    return h5py.File(path, "r", locking=False)


@contextmanager
def damage(path: Path) -> Iterator[None]:
    """Turn what a damaged file raises from deep inside the HDF5 library into an InputError."""
    try:
        yield
    except DAMAGE as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(f"is damaged: {reason}", str(path), AGAIN) from error


def check(path: Path, work: Callable[[Path], bytes]) -> None:
    """Let a child process do ``work`` to a file, or a copy, before this process does; once for each file."""
    key = _make_key(path, work)
    if key in _done:
        return
    try:
        size = path.stat().st_size
        run_isolated(work, path, SECONDS + SECONDS_PER_BYTE * size, MEMORY + size)
    except BrokenOffError as error:
        raise InputError(f"is damaged: it {error}", str(path), AGAIN) from error
    _done.add(key)


def trust_own(path: Path) -> None:
    """Mark a file that this process has just written, so that no child need read it."""
    with suppress(OSError):  # it is gone again
        _done.add(_make_key(path, _visit))


def _make_key(path: Path, work: Callable[[Path], bytes]) -> tuple[object, ...]:
    status = path.stat()
    return work, status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns


def _visit(path: Path) -> bytes:
    """Read everything in a run; InputError for what does not belong into one, or cannot be listed."""
    with suppress(OSError):  # whoever opens it finds out what it is
        file = _read_only(path)
        with file, damage(path):
            visit = _Visit(file, path)
            visit.check_links()
            if is_marked(file):
                file["entry"].attrs.get("default")
                visit.everything()
    return b""


def is_marked(file: h5py.File) -> bool:
    return read_mark(file) is not None or is_joint(file)


def read_mark(file: h5py.File) -> Any:
    """Return the schema number that a run states, of whatever type it is; None of every other file."""
    # On the root it would be found too, and heeded first: that is where a person looks for it.
    provenance = file.get("entry/provenance")
    inside = provenance.attrs.get(SCHEMA) if isinstance(provenance, h5py.Group) else None
    return file.attrs.get(SCHEMA, inside)


def is_joint(file: h5py.File) -> bool:
    """Return whether a file says that it is a joint fit of the schema that this version reads."""
    runs = file.get("entry/runs")
    return isinstance(runs, h5py.Group) and bool(np.array_equal(runs.attrs.get(JOINT), JOINT_SCHEMA))


class _Visit:
    """Reads every object of a file, by the functions of h5py's low level: each costs a tenth there."""

    def __init__(self, file: h5py.File, path: Path) -> None:
        self._file, self._path = file.id, path
        self._size = path.stat().st_size
        self._declared = 0

    def everything(self) -> None:
        names: list[bytes] = []
        h5py.h5o.visit(self._file, names.append)
        for name in names:
            # Of what cannot be read whoever needs it finds out.  Of the attributes none but the marks is ever read.
            with suppress(*DAMAGE):
                item = h5py.h5o.open(self._file, name)
                if isinstance(item, h5py.h5d.DatasetID):
                    self._read(item, f"/{name.decode(errors='replace')}")

    def check_links(self) -> None:
        """Refuse a file that links to others, or holds more objects than any run."""
        external: list[bytes] = []
        names: list[bytes] = []

        def note_link(name: bytes, info: h5py.h5l.LinkInfo) -> bool | None:
            names.append(name)
            if info.type == h5py.h5l.TYPE_EXTERNAL:
                external.append(name)
            return True if external or len(names) > MOST_OBJECTS else None

        self._file.links.visit(note_link, info=True)
        if external:
            raise self._refusal(f"/{external[0].decode(errors='replace')} is a link to another file")
        if len(names) > MOST_OBJECTS:
            raise self._refusal(f"has more than {MOST_OBJECTS} objects")

    def _read(self, dataset: h5py.h5d.DatasetID, place: str) -> None:
        creation, kind = dataset.get_create_plist(), dataset.dtype
        layout = creation.get_layout()
        refuse_stored_elsewhere(dataset, place, self._path)
        chunk = math.prod(creation.get_chunk()) * kind.itemsize if layout == h5py.h5d.CHUNKED else 0
        size = max(math.prod(dataset.shape) * kind.itemsize, chunk)
        self._declared += size
        if self._declared > max(FREE_BYTES, MOST_EXPANSION * self._size):
            raise self._refusal(f"{place} declares {size} bytes, but the file has {self._size}")
        if chunk and not kind.hasobject:
            self._check_chunks(dataset, creation, chunk, place)
        else:
            dataset.read(h5py.h5s.ALL, h5py.h5s.ALL, np.empty(dataset.shape, kind))

    def _check_chunks(self, dataset: h5py.h5d.DatasetID, creation: h5py.h5p.PropDCID, whole: int, place: str) -> None:
        """Refuse a dataset with a chunk that does not hold ``whole`` bytes."""
        filters = [creation.get_filter(index)[0] for index in range(creation.get_nfilters())]
        if filters != [code for code in FILTERS if code in filters]:
            raise self._refusal(f"{place} uses a compression method that run files do not use")
        trailer = 4 if h5py.h5z.FILTER_FLETCHER32 in filters else 0
        offsets: list[tuple[int, ...]] = []
        dataset.chunk_iter(lambda chunk: offsets.append(chunk.chunk_offset))
        for offset in offsets:
            skipped, content = dataset.read_direct_chunk(offset)
            content = content[: len(content) - trailer]
            if h5py.h5z.FILTER_DEFLATE in filters and not skipped:
                try:
                    content = zlib.decompressobj().decompress(content, whole + 1)
                except zlib.error:
                    continue  # as a wrong checksum is found by whoever needs it
            if skipped or len(content) != whole:
                what = f"is damaged: {place} has a chunk of {len(content)} bytes instead of {whole}"
                raise InputError(what, str(self._path), AGAIN)

    def _refusal(self, what: str) -> InputError:
        return InputError(what, str(self._path), DO)


def refuse_stored_elsewhere(dataset: h5py.h5d.DatasetID, place: str, path: Path) -> None:
    """Raise InputError for a dataset whose data are in another file."""
    creation = dataset.get_create_plist()
    if creation.get_layout() == h5py.h5d.VIRTUAL or creation.get_external_count():
        raise InputError(f"{place} reads its data from another file", str(path), DO)


def refuse_external_link(group: h5py.Group, name: str, path: Path) -> None:
    """Raise InputError for a name in a group that links to another file."""
    if isinstance(group.get(name, getlink=True), h5py.ExternalLink):
        raise InputError(f"{name} is a link to another file", str(path), DO)
