"""A journal stays where it can be found: what happens when its folder is renamed, removed or unmounted during a run.

An open file outlives its name.  Once a second the recorder asks whether the journal still is the file of that name.  A
journal that was renamed is finished where it is now.  One that has no name any more is copied to the nearest folder
above that still exists (or the home folder, or that for temporary files), and written on there.
"""

import itertools
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

from daq.runfile import journal


class JournalPlace:
    """Follows the journal and its run file (``output``) while it is written; ``changes`` are sentences about moves."""

    def __init__(self, writer: journal.Writer, output: Path, say: Callable[[str], None]) -> None:
        self.output = output
        self.changes: list[str] = []
        self._writer = writer
        self._say = say
        self._folder = output.absolute().parent.resolve()
        self._hopeless = False

    def check(self) -> bool:
        """Find the journal again if it is not where it was; return whether its place has changed."""
        if self._writer.is_at(self._writer.path):
            return False
        before = self._writer.path
        renamed = self._writer.now_at()
        if renamed is not None:
            self._writer.path = renamed
        elif not self._copy_elsewhere():
            return False
        part = self._writer.path
        if not _is_same(part.parent, self.output.parent):
            name = part.name.removesuffix(".part") if part.suffix == ".part" else self.output.name
            self.output = part.with_name(name)
        done = "was renamed" if renamed is not None else "was removed or unmounted"
        self.changes.append(
            f"{before} {done} during the recording. The journal is now {part}, and the run file will be {self.output}"
        )
        self._say(self.changes[-1])
        return True

    def _copy_elsewhere(self) -> bool:
        """Copy the journal to another folder; False where none accepts it."""
        reasons = ""
        for folder in self._folders():
            try:
                self._writer.move(_find_free_name(folder / self.output.name))
            except OSError as error:
                reasons = f"; {folder}: {error.strerror}"
                continue
            return True
        if not self._hopeless:
            self._hopeless = True
            self._say(
                f"{self._writer.path} was removed or unmounted, and the journal cannot be written to any other "
                f"folder{reasons}"
            )
        return False

    def _folders(self) -> Iterator[Path]:
        yield next(folder for folder in (self._folder, *self._folder.parents) if folder.is_dir())
        yield Path.home()
        yield Path(tempfile.gettempdir())


def _is_same(one: Path, other: Path) -> bool:
    try:
        return one.samefile(other)
    except OSError:
        return False


def _find_free_name(output: Path) -> Path:
    """Return the name of a journal in a folder that has neither that journal nor its run file."""
    names = itertools.chain([output.name], (f"{output.stem}-{k}{output.suffix}" for k in itertools.count(2)))
    for name in names:
        run = output.with_name(name)
        part = run.with_name(f"{name}.part")
        if not run.exists() and not part.exists():
            return part
    raise AssertionError("names do not end")
