"""Whatever comes from a board, a file or a stranger: a result or one error, never a crash, a hang or a lost file.

To see one input fail again: ``python -c "from tests.reliability.bad_input import again; again('h5', 17)"``.
"""

import functools
import random
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from daq.runfile import provenance

from .inputs import batch, files, streams
from .result import Result, Size


@dataclass(frozen=True)
class Kind:
    """One kind of input: what tries some of it, the sound ones, how many at full size, and its name in the table."""

    one: Callable[[random.Random, Path], None]
    sound: Callable[[], object]
    full: int
    name: str


STREAMS = {
    "frames": Kind(streams.damaged_frames, streams.payloads, 400_000, "frames"),
    "text": Kind(streams.damaged_text, streams.payloads, 250_000, "lines of text"),
    "qsb": Kind(streams.damaged_qsb, streams.payloads, 250_000, "records of a QSB"),
    "journal": Kind(streams.damaged_journal, streams.payloads, 100_000, "records of a journal"),
}
FILES = {
    "toml": Kind(files.damaged_toml, files.tomls, 60_000, "TOML and --set"),
    "csv": Kind(files.damaged_csv, files.tables, 40_000, "tables (.csv)"),
    "h5": Kind(files.damaged_h5, files.runs, 4_000, "run files (.h5)"),
    "mat": Kind(files.damaged_mat, files.mats, 6_000, "MATLAB files (.mat)"),
    "sr": Kind(files.damaged_sr, files.captures, 10_000, "captures (.sr)"),
}


def bad_streams(size: Size, folder: Path) -> list[Result]:
    return [_tried(name, size, folder) for name in STREAMS]


def bad_files(size: Size, folder: Path) -> list[Result]:
    return [_tried(name, size, folder) for name in FILES]


def again(name: str, number: int, seed: int = 1) -> None:
    with tempfile.TemporaryDirectory() as folder:
        _one(name, seed, number, Path(folder))


def _tried(name: str, size: Size, folder: Path) -> Result:
    kinds, together = (STREAMS, streams.TOGETHER) if name in STREAMS else (FILES, 1)
    kind = kinds[name]
    place = folder / name
    place.mkdir()
    kind.sound()  # made here once, not in each child
    calls = max(1, size.amount * kind.full // sum(each.full for each in kinds.values()) // together)
    found = batch.run(name, calls, place, functools.partial(_one, name, size.seed), together)
    crashed = f", of them {found.crashed} after a crash of the child process" if found.crashed else ""
    return Result(
        f"damaged {kind.name}: a result or one error",
        f"{found.inputs} by chance, seed {size.seed}",
        f"{found.taken} read, {found.inputs - found.taken} refused{crashed}; at most {found.slowest_s:.2f} s and "
        f"{found.most_bytes >> 20} MB; {found.cpu_s:.0f} CPU s",
        tuple(found.faults),
    )


def _one(name: str, seed: int, number: int, folder: Path) -> None:
    provenance._find_commit = lambda folder: {}  # git, the only program that a command starts
    (STREAMS | FILES)[name].one(random.Random(f"{seed} {name} {number}"), folder)
