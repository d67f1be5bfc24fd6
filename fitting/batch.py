"""Many runs, each fitted separately: an error of one appears in its row and does not stop the others."""

import os
import traceback
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from fitting import job
from fitting.job import LoadedRun
from fitting.options import Options
from fitting.report import comparison, page
from fitting.report.comparison import ComparedRun
from fitting.selection.result import Ranking
from stickslip import errors
from stickslip.compute.workers import workers
from stickslip.console import application
from stickslip.errors import DeviceError, StickslipError

FAILURES = (errors.EXIT_DATA, errors.EXIT_INPUT, errors.EXIT_DEVICE, errors.EXIT_BUG)
SEVERITY = (errors.EXIT_DONE, errors.EXIT_UNDECIDED, errors.EXIT_NO_LAW, *FAILURES)  # least first
Outcome = tuple[Ranking, str] | StickslipError  # of a run: its ranking and the page of its report, or why it has none


@dataclass(frozen=True)
class BatchRow:
    file: Path
    document: dict[str, Any]
    failure: StickslipError | None = None

    @property
    def code(self) -> int:
        """The exit code of this run alone."""
        return job.exit_code(self.document) if self.failure is None else self.failure.exit_code

    def as_json(self) -> dict[str, Any]:
        if self.failure is None:
            return {"file": self.file} | self.document
        return {"file": self.file, "error": self.failure.as_json()} | self.failure.data


def fit(
    files: Sequence[Path],
    places: Sequence[Path],
    options: Options,
    progress: Callable[[float], None] | None = None,
    *,
    force: bool = False,
) -> list[BatchRow]:
    """Fit every run separately; this process alone reads and writes the files.

    ``places`` are those of the reports, if wanted; the workers of a dask scheduler need no files; ``progress`` gets the
    number of finished runs. An unusable run becomes a row; DeviceError is raised only where all workers were lost
    before the first run had finished.
    """
    rows: list[BatchRow] = []
    pairs = [(file, places[number] if places else None) for number, file in enumerate(files)]
    outcomes = fit_each(files, _read(pairs, options, force), options, draw=bool(places))
    for (file, place), outcome in zip(pairs, outcomes, strict=True):
        rows.append(_saved(file, place, outcome, force))
        if progress is not None:
            progress(float(len(rows)))
    return rows


def fit_each(
    files: Sequence[Path], runs: Iterable[LoadedRun | StickslipError], options: Options, *, draw: bool = False
) -> Iterator[Outcome]:
    """Yield the result of each run, in order; raises as `fit`."""
    done, work = 0, partial(_fitted, options=replace(options, jobs=1, scheduler=None), draw=draw)
    try:
        with workers(min(options.jobs, len(files)), options.scheduler) as each:
            for outcome in each(work, runs):
                yield outcome
                done += 1
    except DeviceError as error:
        if done == 0:
            raise
        yield from [error] * (len(files) - done)


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


def read_failure(error: Exception, file: Path) -> StickslipError:
    """Return what stopped the fit of a run as an error with its message and exit code."""
    if isinstance(error, StickslipError):
        return copy(error)  # without the frames, and their arrays, that a traceback keeps
    if isinstance(error, OSError):
        do = "check the path, its permissions and the free space on the disk"
        return DeviceError(error.strerror or str(error), os.fspath(error.filename or file), do)
    last = traceback.extract_tb(error.__traceback__)[-1]
    what = f"{type(error).__name__}: {error} ({Path(last.filename).name}, line {last.lineno})"
    return StickslipError(what, str(file), "this is a bug: fit this run alone, without --json, and report it")


def _read(
    pairs: Sequence[tuple[Path, Path | None]], options: Options, force: bool
) -> Iterator[LoadedRun | StickslipError]:
    """Read each run; an existing file in place of its report that is not its report is a failure."""
    for file, place in pairs:
        try:
            run = job.load_run(file, options)
            if place is not None:
                page.refuse_foreign_file(place, [run.recording.digest], files=[file], force=force)
            yield run
        except Exception as error:
            yield read_failure(error, file)


def _fitted(run: LoadedRun | StickslipError, options: Options, draw: bool) -> Outcome:
    if isinstance(run, StickslipError):
        return run
    try:
        ranking = job.fit_runs([run], options)
        return ranking, job.draw(ranking) if draw else ""
    except Exception as error:
        return read_failure(error, run.recording.source)


def _saved(file: Path, place: Path | None, outcome: Outcome, force: bool) -> BatchRow:
    """Save the result and the report, and return the row."""
    if isinstance(outcome, StickslipError):
        return BatchRow(file, {}, outcome)
    ranking, text = outcome
    try:
        job.save(ranking, place, text, force=force)
    except Exception as error:
        return BatchRow(file, {}, read_failure(error, file))
    return BatchRow(file, ranking.as_json() | {"report": place})
