"""The run file: load it, write it once, add a stage to it.  Its tree is the table of `daq.runfile.schema`.

Raw data are never open for writing again: `write` builds a new file beside the old name and moves it into place,
`extend` copies the file, adds groups to the copy and moves that into place.  A reader therefore sees the old file
or the new one, whole, and a crash leaves at worst a ``.NAME.partial`` beside it.

Equal runs give equal bytes under the same file name and library versions: nothing here reads a clock.
"""

import os
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from daq.runfile import nexus, schema, tree, trust
from daq.runfile.recording import Raw, Recording, SentAs, Truth, impossible_motion
from daq.runfile.regular import regular_file
from daq.runfile.rig import Rig
from daq.runfile.write import write
from stickslip.compute.arrays import Array
from stickslip.errors import InputError
from stickslip.output import atomic, disk

__all__ = [
    "RunReader",
    "annotate",
    "between",
    "extend",
    "holds",
    "load",
    "opened",
    "read_back",
    "reading",
    "samples",
    "times",
    "truth",
    "write",
]

STRETCH = 1 << 18  # samples that are read back at a time: some 20 MB
# A stage rests on those before it: writing one drops the ones after it, which were made from what it replaces.
STAGES = ("data", "smooth", "fit")
SAMPLE_STAGE = (  # with which `extend` is rehearsed
    *tree.process(STAGES[1], "program", 1, "time"),
    tree.table(f"{STAGES[1]}/table", "time", "value", ""),
    *(
        tree.Field(f"{STAGES[1]}/table/{name}", "f8[n]", "", "", value=lambda source: np.zeros(nexus.CHUNK + 1))
        for name in ("time", "value")
    ),
)
RECORDING = [row for row in schema.TREE if not row.path.startswith("truth")]


def samples(path: str | os.PathLike[str]) -> int:
    """Return how many samples a run holds; InputError as for `load`."""
    with reading(path) as run:
        return run.samples


def load(path: str | os.PathLike[str], own: slice = nexus.EVERY) -> Recording:
    """Read a run.

    path: A run file.
    own: Samples to read; by default all.  Events and clock are those of the whole run, numbered as there.
    Raises InputError: when the file is missing, cut short, not HDF5, not a run file, of another schema, or holds
        something else where a run has its samples.
    """
    with reading(path) as run:
        return run.load(own)


def read_back(path: str | os.PathLike[str]) -> None:
    """Raise InputError, as `load` does, for a run that cannot be loaded; a stretch at a time, which needs no memory."""
    with reading(path) as run:
        for first in range(0, run.samples, STRETCH):
            run.load(slice(first, first + STRETCH + 1))  # with the first sample of the next stretch, for the order


def times(path: str | os.PathLike[str]) -> Array:
    """Return the times of a run's samples, s, shape (n,); InputError as for `load`."""
    with reading(path) as run:
        return run.times()


def between(path: str | os.PathLike[str], begin: float | None, end: float | None) -> slice:
    """Return the samples of a run from time ``begin`` to ``end``, s on its own time axis; None: from or to its end.

    Raises InputError: as `load`; and for times between which the run has fewer than two samples.
    """
    if begin is None and end is None:
        return nexus.EVERY
    time = times(path)
    first = 0 if begin is None else int(np.searchsorted(time, begin))
    last = time.size if end is None else int(np.searchsorted(time, end, side="right"))
    if last - first < 2:
        asked = f"{time[0] if begin is None else begin:g} to {time[-1] if end is None else end:g} s"
        what = f"fewer than two samples from {asked}; the run lasts from {time[0]:.6g} to {time[-1]:.6g} s"
        raise InputError(what, str(path), "give other times with --from and --to")
    return slice(first, last)


@contextmanager
def reading(path: str | os.PathLike[str], own: slice = nexus.EVERY) -> "Iterator[RunReader]":
    """Open a run, or some of its samples, for reading parts one after the other; InputError as for `load`."""
    where = Path(path)
    with opened(where) as file:
        with trust.damage(where):
            reader = RunReader(nexus.read_group(file, "entry", where), where, own)
        yield reader


class RunReader:
    """A run file that stays open; of the samples ``own`` alone, where they are given, numbered from the first."""

    def __init__(self, entry: h5py.Group, where: Path, own: slice = nexus.EVERY) -> None:
        self._entry, self._where = entry, where
        n = int(nexus.read_dataset(entry, f"{schema.ENCODER_LOG}/time", where).size)
        self._own, self._whole = range(n)[own], own == nexus.EVERY
        self.samples = len(self._own)

    def _in_file(self, own: slice) -> slice:
        if self._whole and own == nexus.EVERY:
            return own  # a column of another length shows
        part = self._own[own]
        return slice(part.start, part.stop)

    def load(self, own: slice = nexus.EVERY) -> Recording:
        """Return the run, or some of its samples (`load`)."""
        with trust.damage(self._where):
            found = tree.read(self._entry, RECORDING, self._where, self._in_file(own))
            _check_motion(found["time"], found["position"], self._where)
            raw, sent_as = tree.part(found, "raw"), tree.part(found, "sent_as")
            return Recording(
                **{key: value for key, value in found.items() if "." not in key},
                rig=Rig(**tree.part(found, "rig")),
                raw=Raw(**raw) if raw else None,
                sent_as=SentAs(**sent_as) if sent_as else None,
                source=self._where,
                default=nexus.text(self._entry.attrs.get("default", "data")),
            )

    def times(self) -> Array:
        """Return the times of all samples, s."""
        return self._column("time", nexus.EVERY)

    def positions(self, own: slice) -> Array:
        """Return the positions of some samples, m or counts."""
        return self._column("value", own)

    def _column(self, name: str, own: slice) -> Array:
        path = f"{schema.ENCODER_LOG}/{name}"
        with trust.damage(self._where):
            return np.asarray(nexus.read_array(self._entry, path, np.float64, self._where, self._in_file(own)))


def truth(path: str | os.PathLike[str]) -> Truth | None:
    """Read the exact motion of a simulated run that was asked for it; None for every other run.

    Only comparisons and benchmarks may call this: processing and fitting know no more than a real rig shows.
    """
    where = Path(path)
    with opened(where) as file, trust.damage(where):
        entry = nexus.read_group(file, "entry", where)
        found = tree.part(tree.read(entry, tree.below(schema.TREE, "truth"), where), "truth")
        return Truth(**found) if found else None


def extend(
    path: str | os.PathLike[str],
    names: str | Sequence[str],
    writer: Callable[[h5py.Group], None],
    *,
    default: str | None = None,
) -> None:
    """Add a stage to a run: copy the file, write into the copy, sync it, move it into place.

    path: The run file.
    names: The groups of /entry that ``writer`` writes; groups of these names are removed first, and so is every later
        stage ("fit", "fit_law1" ... when "smooth" is written again).
    writer: Takes /entry of the copy, open for writing.
    default: The new ``/entry/@default``: the group that viewers open on.
    Raises InputError: as `load`, for a file that is no run.
    Raises ValueError: when a name belongs to the recording itself.
    """
    target = Path(path)
    wanted = (names,) if isinstance(names, str) else tuple(names)
    for name in wanted:
        if not name.startswith(STAGES[1:]):
            raise ValueError(f"{name!r} is no stage; extend writes {' or '.join(STAGES[1:])} groups, never the record")
    with opened(target):
        pass
    trust.check(target, _add_stage)
    stage = min(STAGES.index(name.split("_")[0]) for name in wanted)
    with atomic.replacing(target, force=True) as temporary:
        shutil.copyfile(target, temporary)
        with disk.hdf5(temporary, "r+") as file:
            with trust.damage(target):
                entry = file["entry"]
                for name in list(entry):
                    if name in wanted or name.split("_")[0] in STAGES[stage + 1 :]:
                        del entry[name]
            writer(entry)
            if default is not None:
                entry.attrs["default"] = default
    trust.trust_own(target)


def holds(path: str | os.PathLike[str], run: Recording) -> bool:
    """Return whether a file is this recording: the same start and raw data, with all events of ``run``."""
    try:
        with reading(path) as reader:
            found = reader.load(slice(1))
    except InputError:
        return False
    same = (found.started, found.digest) == (run.started, schema.digest(run))
    return same and set(_events(run)) <= set(_events(found))


def _events(run: Recording) -> Iterator[tuple[int, str, str]]:
    return zip(run.event_sample.tolist(), run.event_kind, run.event_note, strict=True)


def annotate(
    path: str | os.PathLike[str], notes: Mapping[str, Any], marks: Sequence[tuple[float, str]] = ()
) -> Recording:
    """Change the notes on a finished run and add markers; the file is copied, changed and moved into place.

    path: The run file.
    notes: New values of ``title``, ``operator``, ``sample_name``, ``note`` and ``tags`` of `Recording`; the others
        stay. Tags are added to those of the run, and one of an empty value is removed.
    marks: Markers: seconds since the first sample, and words.  Each becomes an event of the nearest sample.
    Returns: The run as it is now, with its first sample alone but all its events.
    Raises InputError: as `load`; or for a marker outside the run.
    """
    target = Path(path)
    with atomic.replacing(target, force=True) as temporary:  # from here on no other command changes the run
        with reading(target) as reader:
            run, time = reader.load(slice(1)), reader.times()
        trust.check(target, _change_notes)
        tags = {name: value for name, value in {**run.tags, **notes.get("tags", {})}.items() if value}
        run = replace(run, **{**notes, "tags": tags})
        for seconds, text in marks:
            if not 0 <= seconds <= time[-1]:
                what = f"the marker at {seconds:g} s is outside the run, which lasts {time[-1]:.6g} s"
                raise InputError(what, "--mark", "give a time since the first sample")
            run = _marked(run, int(np.argmin(np.abs(time - seconds))), text)
        shutil.copyfile(target, temporary)
        with disk.hdf5(temporary, "r+") as file, trust.damage(target):
            schema.rewrite_notes(file, run)
    trust.trust_own(target)
    return run


def _add_stage(path: Path) -> bytes:
    """Do to a copy in memory what `extend` will do to the file."""
    with trust.damage(path), disk.rehearsed(path) as file:
        entry = file["entry"]
        for name in list(entry):
            if name.split("_")[0] in STAGES[1:]:
                del entry[name]
        tree.write(entry, SAMPLE_STAGE, None)
        entry.attrs["default"] = STAGES[1]
    return b""


def _change_notes(path: Path) -> bytes:
    """Do to a copy in memory what `annotate` will do to the file."""
    with trust.damage(path), disk.rehearsed(path) as file:
        run = RunReader(file["entry"], path).load(slice(1))
        schema.rewrite_notes(file, replace(run, note="text", operator="text", tags={"name": "text"}))
    return b""


def _marked(run: Recording, sample: int, text: str) -> Recording:
    """Return the run with one more marker, after the events of the same sample."""
    at = int(np.searchsorted(run.event_sample, sample, side="right"))
    return replace(
        run,
        event_sample=np.insert(run.event_sample, at, sample).astype(np.uint32),
        event_kind=(*run.event_kind[:at], "marker", *run.event_kind[at:]),
        event_note=(*run.event_note[:at], text, *run.event_note[at:]),
    )


@contextmanager
def opened(path: Path) -> Iterator[h5py.File]:
    """Open a run file for reading, or raise an InputError that names what the file is instead."""
    where = str(path)
    regular_file(path, "give the run file in it").close()
    with _open(path) as file:
        found = trust.mark(file)
        if found is None and trust.is_joint(file):
            raise InputError("is the file of a joint fit, not of a run", where, "give the runs that were fitted")
        if found is None:
            raise InputError(
                "is HDF5 but not a run file (it has no @stickslip_schema)",
                where,
                "give a file made by daq record, daq import or daq replay",
            )
        if not isinstance(found, int | np.integer) or isinstance(found, np.bool_):
            raise InputError(f"@stickslip_schema is {found!r}, not a whole number", where, "record or import again")
        what = f"has schema {int(found)}; this version reads only schema {schema.SCHEMA}"
        if found > schema.SCHEMA:
            raise InputError(what, where, "install a newer stickslip")
        if found < schema.SCHEMA:
            raise InputError(what, where, "make it again: daq recover on its journal, or daq import on its CSV")
        yield file


def _open(path: Path) -> h5py.File:
    try:
        return trust.opened(path)
    except PermissionError as error:
        raise InputError("cannot be read", str(path), "check its permissions") from error
    except OSError as error:
        raise _unopened(path, error) from error


def _unopened(path: Path, error: OSError) -> InputError:
    with path.open("rb") as stream:
        head = stream.read(32)
    if head.startswith(b"stickslip journal"):
        return InputError(
            "is a journal, not a finished run",
            str(path),
            f"run: daq recover {path.name}",
            python=f"run: daq recover {path.name}, or call daq.recover",
        )
    if not head.startswith(b"\x89HDF\r\n\x1a\n"):
        what = "is empty" if not head else "is not an HDF5 file"
        return InputError(
            what,
            str(path),
            "give a run file; a CSV is read by daq import, a capture by daq replay",
            python="give a run file or a table",
        )
    detail = "is cut short" if "truncated" in str(error) else f"is damaged HDF5 ({str(error).splitlines()[0]})"
    return InputError(detail, str(path), trust.AGAIN)


def _check_motion(time: Array, position: Array, where: Path) -> None:
    what = impossible_motion(time, position) if time.size else "holds no samples"
    if what is not None:
        raise InputError(what, str(where), nexus.AGAIN)
