"""Many runs, each fitted separately: an error of one appears in its row and does not stop the others."""

import os
import traceback
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from fitting import job
from fitting.job import FitOptions, FitOutput, LoadedRun
from fitting.report import comparison, page
from fitting.report.comparison import ComparedRun
from stickslip import errors
from stickslip.compute.workers import workers
from stickslip.console import application
from stickslip.errors import DataError, DeviceError, InputError, StickslipError

FAILURES = (errors.EXIT_DATA, errors.EXIT_INPUT, errors.EXIT_DEVICE, errors.EXIT_BUG)
SEVERITY = (errors.EXIT_DONE, errors.EXIT_UNDECIDED, errors.EXIT_NO_LAW, *FAILURES)  # least first


@dataclass(frozen=True)
class Failure:
    """Why a run has no ranking, its exit code, and what was found nevertheless."""

    what: str
    where: str
    do: str
    code: int
    data: dict[str, Any] = field(default_factory=dict)

    def as_error(self) -> StickslipError:
        kinds = (InputError, DeviceError, DataError)
        kind = next((kind for kind in kinds if kind.exit_code == self.code), StickslipError)
        error = kind(self.what, self.where, self.do)
        error.data |= self.data
        return error


@dataclass(frozen=True)
class BatchRow:
    file: Path
    document: dict[str, Any]
    failure: Failure | None = None

    @property
    def code(self) -> int:
        """The exit code of this run alone."""
        if self.failure is not None:
            return self.failure.code
        return job.exit_code(self.document)

    def as_json(self) -> dict[str, Any]:
        if self.failure is None:
            return {"file": self.file} | self.document
        error = {"what": self.failure.what, "where": self.failure.where, "do": self.failure.do}
        return {"file": self.file, "error": error} | self.failure.data


def fit(
    files: Sequence[Path],
    places: Sequence[Path],
    options: FitOptions,
    jobs: int = 1,
    scheduler: str | None = None,
    progress: Callable[[float], None] | None = None,
    *,
    force: bool = False,
) -> list[BatchRow]:
    """Fit every run separately; this process alone reads and writes the files.

    ``places`` are those of the reports, if wanted; the workers of a dask ``scheduler`` need no files; ``progress`` gets
    the number of finished runs. An unusable run becomes a row; DeviceError is raised only where all workers were lost
    before the first run had finished.
    """
    rows: list[BatchRow] = []
    pairs = [(file, places[number : number + 1]) for number, file in enumerate(files)]
    outcomes = fit_each(files, _read(pairs, options, force), options, jobs, scheduler)
    for (file, place), outcome in zip(pairs, outcomes, strict=True):
        rows.append(_saved(file, place, outcome, force))
        if progress is not None:
            progress(float(len(rows)))
    return rows


def fit_each(
    files: Sequence[Path],
    runs: Iterable[LoadedRun | Failure],
    options: FitOptions,
    jobs: int = 1,
    scheduler: str | None = None,
) -> Iterator[FitOutput | Failure]:
    """Yield the result of each run, in order; raises as `fit`."""
    if jobs < 1:
        raise InputError(f"jobs is {jobs}", "--jobs", "give 1 or more")
    done = 0
    try:
        with workers(min(jobs, len(files)), scheduler) as each:
            for outcome in each(partial(_fitted, options=options), runs):
                yield outcome
                done += 1
    except DeviceError as error:
        if done == 0:
            raise
        yield from (read_failure(error, file) for file in files[done:])


def exit_code(rows: Sequence[BatchRow]) -> int:
    """Return the worst failure's code, else 6 when no law describes a run, 5 when a run is undecided, else 0."""
    return max((row.code for row in rows), key=SEVERITY.index, default=errors.EXIT_DONE)


def summary(rows: Sequence[BatchRow]) -> str:
    count = Counter(errors.EXIT_BUG if row.failure else row.code for row in rows)
    without = f"{count[errors.EXIT_NO_LAW]} that no law describes, " if count[errors.EXIT_NO_LAW] else ""
    undecided = f"{count[errors.EXIT_UNDECIDED]} undecided"
    return f"{count[errors.EXIT_DONE]} decided, {undecided}, {without}{count[errors.EXIT_BUG]} failed"


def text(rows: Sequence[BatchRow], compared: Path | None) -> list[Any]:
    """Return the printed table of file, set and verdict, or of errors, and all warnings."""
    table = application.table("runs fitted one by one", ("file", "set", "verdict"))
    table.columns[0].overflow = table.columns[2].overflow = "fold"
    table.columns[2].justify, table.columns[2].no_wrap = "left", False
    common = Path(os.path.commonpath([row.file.absolute().parent for row in rows]))
    for row in rows:
        failed = row.failure
        named = () if failed else (*row.document["set"], *row.document.get("rivals", ()))
        members = "-" if failed else ", ".join(map(str, named)) or "none"
        verdict = f"error: {failed.what}; {failed.do}" if failed else row.document["verdict"]
        table.add_row(str(row.file.absolute().relative_to(common)), members, verdict)
    lines: list[Any] = [table]
    for row in rows:
        lines += [f"warning: {row.file.name}: {warning}" for warning in row.document.get("warnings", ())]
    lines.append(f"{len(rows)} runs: {summary(rows)}" + (f"; comparison: {compared}" if compared else ""))
    return lines


def compare(rows: Sequence[BatchRow], path: Path, alpha: float, *, force: bool = False) -> None:
    runs = [ComparedRun(row.file, row.document, row.failure.what if row.failure else "") for row in rows]
    comparison.write(runs, path, alpha, summary(rows), force=force)


def _read(
    pairs: Sequence[tuple[Path, Sequence[Path]]], options: FitOptions, force: bool
) -> Iterator[LoadedRun | Failure]:
    """Read each run; an existing file in place of its report that is not its report is a failure."""
    for file, places in pairs:
        try:
            run = job.load_run(file, options)
            for place in places:
                page.refuse_foreign_file(place, [run.recording.digest], files=[file], force=force)
            yield run
        except Exception as error:
            yield read_failure(error, file)


def _fitted(run: LoadedRun | Failure, options: FitOptions) -> FitOutput | Failure:
    if isinstance(run, Failure):
        return run
    try:
        return job.fit_runs([run], options)
    except Exception as error:
        return read_failure(error, run.recording.source)


def _saved(file: Path, places: Sequence[Path], outcome: FitOutput | Failure, force: bool) -> BatchRow:
    """Save the result and the report, and return the row."""
    if isinstance(outcome, Failure):
        return BatchRow(file, {}, outcome)
    try:
        outcome.save(next(iter(places), None), force=force)
    except Exception as error:
        return BatchRow(file, {}, read_failure(error, file))
    return BatchRow(file, outcome.as_json() | {"report": next(iter(places), None)})


def read_failure(error: Exception, file: Path) -> Failure:
    """Return the message and exit code of an error."""
    if isinstance(error, StickslipError):
        return Failure(error.what, error.where, error.do, error.exit_code, error.data)
    if isinstance(error, OSError):
        do = "check the path, its permissions and the free space on the disk"
        return Failure(error.strerror or str(error), os.fspath(error.filename or file), do, errors.EXIT_DEVICE)
    last = traceback.extract_tb(error.__traceback__)[-1]
    what = f"{type(error).__name__}: {error} ({Path(last.filename).name}, line {last.lineno})"
    return Failure(what, str(file), "this is a bug: fit this run alone, without --json, and report it", errors.EXIT_BUG)
