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
from daq.runfile.recording import Recording
from daq.runfile.regular import open_regular
from daq.runfile.rig import Rig
from daq.runfile.run_data import Raw, SentAs, Truth, explain_impossible
from daq.runfile.write import write as write
from stickslip.compute.arrays import Array
from stickslip.errors import InputError
from stickslip.output import atomic, disk

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


def count_samples(path: str | os.PathLike[str]) -> int:
    with open_reader(path) as run:
        return run.samples


def load(path: str | os.PathLike[str], selected: slice = nexus.EVERY) -> Recording:
    """Read a run, or ``selected`` samples of it with the events and the clock of all."""
    with open_reader(path) as run:
        return run.load(selected)


def read_back(path: str | os.PathLike[str]) -> None:
    """Raise InputError, as `load` does, for a run that cannot be loaded; a stretch at a time, to save memory."""
    with open_reader(path) as run:
        for first in range(0, run.samples, STRETCH):
            run.load(slice(first, first + STRETCH + 1))  # with the first sample of the next stretch, for the order


def read_times(path: str | os.PathLike[str]) -> Array:
    """Return the times of a run's samples, s, (n,)."""
    with open_reader(path) as run:
        return run.times()


def select_between(path: str | os.PathLike[str], begin: float | None, end: float | None) -> slice:
    """Return the samples of a run from time ``begin`` to ``end``, s on its own time axis; None: from or to its end."""
    if begin is None and end is None:
        return nexus.EVERY
    time = read_times(path)
    first = 0 if begin is None else int(np.searchsorted(time, begin))
    last = time.size if end is None else int(np.searchsorted(time, end, side="right"))
    if last - first < 2:
        requested = f"{time[0] if begin is None else begin:g} to {time[-1] if end is None else end:g} s"
        what = (
            f"there are fewer than two samples from {requested}; the run lasts from {time[0]:.6g} to {time[-1]:.6g} s"
        )
        raise InputError(what, str(path), "choose other times with --from and --to")
    return slice(first, last)


@contextmanager
def open_reader(path: str | os.PathLike[str], selected: slice = nexus.EVERY) -> "Iterator[RunReader]":
    """Open a run, or some of its samples, for reading parts one after the other."""
    where = Path(path)
    with open_run(where) as file:
        with trust.damage(where):
            reader = RunReader(nexus.read_group(file, "entry", where), where, selected)
        yield reader


class RunReader:
    """A run file that stays open, or its ``selected`` samples, numbered from the first."""

    def __init__(self, entry: h5py.Group, where: Path, selected: slice = nexus.EVERY) -> None:
        self._entry, self._where = entry, where
        n = int(nexus.read_dataset(entry, f"{schema.ENCODER_LOG}/time", where).size)
        self._selected, self._whole = range(n)[selected], selected == nexus.EVERY
        self.samples = len(self._selected)

    def _in_file(self, selected: slice) -> slice:
        if self._whole and selected == nexus.EVERY:
            return selected  # a column of another length shows
        part = self._selected[selected]
        return slice(part.start, part.stop)

    def load(self, selected: slice = nexus.EVERY) -> Recording:
        """Return the run, or some of its samples (`load`)."""
        with trust.damage(self._where):
            values = tree.read(self._entry, RECORDING, self._where, self._in_file(selected))
            time, position = values["time"], values["position"]
            if wrong := explain_impossible(time, position) if time.size else "has no samples":
                raise InputError(wrong, str(self._where), nexus.AGAIN)
            raw, sent_as = tree.select_part(values, "raw"), tree.select_part(values, "sent_as")
            return Recording(
                **{key: value for key, value in values.items() if "." not in key},
                rig=Rig(**tree.select_part(values, "rig")),
                raw=Raw(**raw) if raw else None,
                sent_as=SentAs(**sent_as) if sent_as else None,
                source=self._where,
                default=nexus.decode_text(self._entry.attrs.get("default", "data")),
            )

    def times(self) -> Array:
        return self._column("time", nexus.EVERY)

    def positions(self, selected: slice) -> Array:
        """Return the positions of some samples, m or counts."""
        return self._column("value", selected)

    def _column(self, name: str, selected: slice) -> Array:
        path = f"{schema.ENCODER_LOG}/{name}"
        with trust.damage(self._where):
            return np.asarray(nexus.read_array(self._entry, path, np.float64, self._where, self._in_file(selected)))


def truth(path: str | os.PathLike[str]) -> Truth | None:
    """Read the exact motion of a simulated run, if it was stored; only comparisons and benchmarks may use it."""
    where = Path(path)
    with open_run(where) as file, trust.damage(where):
        entry = nexus.read_group(file, "entry", where)
        columns = tree.select_part(tree.read(entry, tree.select_groups(schema.TREE, "truth"), where), "truth")
        return Truth(**columns) if columns else None


def extend(
    path: str | os.PathLike[str],
    names: str | Sequence[str],
    writer: Callable[[h5py.Group], None],
    *,
    default: str | None = None,
) -> None:
    """Add a stage: ``writer`` writes groups ``names`` into a copy without them and later stages."""
    target = Path(path)
    wanted = (names,) if isinstance(names, str) else tuple(names)
    for name in wanted:
        if not name.startswith(STAGES[1:]):
            raise ValueError(f"{name!r} is no stage; extend writes {' or '.join(STAGES[1:])} groups, never the record")
    with open_run(target):
        pass
    trust.check(target, _add_stage)
    stage = min(STAGES.index(name.split("_")[0]) for name in wanted)
    with atomic.replacing(target, force=True) as temporary:
        shutil.copyfile(target, temporary)
        with disk.open_hdf5(temporary, "r+") as file:
            with trust.damage(target):
                entry = file["entry"]
                for name in list(entry):
                    if name in wanted or name.split("_")[0] in STAGES[stage + 1 :]:
                        del entry[name]
            writer(entry)
            if default is not None:
                entry.attrs["default"] = default
    trust.trust_own(target)


def is_same_run(path: str | os.PathLike[str], run: Recording) -> bool:
    """Return whether a file is this recording: the same start and raw data, with all events of ``run``."""
    try:
        with open_reader(path) as reader:
            stored = reader.load(slice(1))
    except InputError:
        return False
    same = (stored.started, stored.digest) == (run.started, schema.compute_digest(run))
    return same and set(_list_events(run)) <= set(_list_events(stored))


def _list_events(run: Recording) -> Iterator[tuple[int, str, str]]:
    return zip(run.event_sample.tolist(), run.event_kind, run.event_note, strict=True)


def annotate(
    path: str | os.PathLike[str], notes: Mapping[str, Any], marks: Sequence[tuple[float, str]] = ()
) -> Recording:
    """Change the notes on a finished run and add markers (s, words); return it with its first sample and all events."""
    target = Path(path)
    with atomic.replacing(target, force=True) as temporary:  # from here on no other command changes the run
        with open_reader(target) as reader:
            run, time = reader.load(slice(1)), reader.times()
        trust.check(target, _change_notes)
        tags = {name: value for name, value in {**run.tags, **notes.get("tags", {})}.items() if value}
        run = replace(run, **{**notes, "tags": tags})
        for seconds, text in marks:
            if not 0 <= seconds <= time[-1]:
                what = f"the marker at {seconds:g} s is outside the run, which lasts {time[-1]:.6g} s"
                raise InputError(what, "--mark", "use a time since the first sample")
            run = _add_marker(run, int(np.argmin(np.abs(time - seconds))), text)
        shutil.copyfile(target, temporary)
        with disk.open_hdf5(temporary, "r+") as file, trust.damage(target):
            schema.rewrite_notes(file, run)
    trust.trust_own(target)
    return run


def _add_stage(path: Path) -> bytes:
    """Do to a copy in memory what `extend` will do to the file."""
    with trust.damage(path), disk.open_rehearsal(path) as file:
        entry = file["entry"]
        for name in list(entry):
            if name.split("_")[0] in STAGES[1:]:
                del entry[name]
        tree.write(entry, SAMPLE_STAGE, None)
        entry.attrs["default"] = STAGES[1]
    return b""


def _change_notes(path: Path) -> bytes:
    """Do to a copy in memory what `annotate` will do to the file."""
    with trust.damage(path), disk.open_rehearsal(path) as file:
        run = RunReader(file["entry"], path).load(slice(1))
        schema.rewrite_notes(file, replace(run, note="text", operator="text", tags={"name": "text"}))
    return b""


def _add_marker(run: Recording, sample: int, text: str) -> Recording:
    """Return the run with one more marker, after the events of the same sample."""
    index = int(np.searchsorted(run.event_sample, sample, side="right"))
    return replace(
        run,
        event_sample=np.insert(run.event_sample, index, sample).astype(np.uint32),
        event_kind=(*run.event_kind[:index], "marker", *run.event_kind[index:]),
        event_note=(*run.event_note[:index], text, *run.event_note[index:]),
    )


@contextmanager
def open_run(path: Path) -> Iterator[h5py.File]:
    """Open a run file for reading; InputError says what the file is instead."""
    where = str(path)
    open_regular(path, "choose a run file in it").close()
    with _open(path) as file:
        mark = trust.read_mark(file)
        if mark is None and trust.is_joint(file):
            raise InputError("contains a joint fit, not a run", where, "use the runs that were fitted")
        if mark is None:
            raise InputError(
                "is an HDF5 file but not a run file (it has no @stickslip_schema)",
                where,
                "use a file written by daq record, daq import or daq replay",
            )
        if not isinstance(mark, int | np.integer) or isinstance(mark, np.bool_):
            raise InputError(f"@stickslip_schema is {mark!r}, not a whole number", where, "record or import again")
        what = f"has schema {int(mark)}, but this version reads only schema {schema.SCHEMA}"
        if mark > schema.SCHEMA:
            raise InputError(what, where, "install a newer stickslip")
        if mark < schema.SCHEMA:
            raise InputError(
                what, where, "make it again with 'daq recover' from its journal, or with 'daq import' from its table"
            )
        yield file


def _open(path: Path) -> h5py.File:
    try:
        return trust.open_trusted(path)
    except PermissionError as error:
        raise InputError("cannot be read", str(path), "check its permissions") from error
    except OSError as error:
        raise _explain_unopened(path, error) from error


def _explain_unopened(path: Path, error: OSError) -> InputError:
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
            "use a run file; 'daq import' converts a table and 'daq replay' a capture",
            python="pass a run file or a table",
        )
    detail = "is cut short" if "truncated" in str(error) else f"is damaged HDF5 ({str(error).splitlines()[0]})"
    return InputError(detail, str(path), trust.AGAIN)
