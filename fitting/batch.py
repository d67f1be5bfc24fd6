"""Many runs, each fitted separately: an error of one appears in its row and does not stop the others."""

import os
import traceback
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from copy import copy
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from fitting import job
from fitting.job import LoadedRun
from fitting.options import Options
from fitting.report import page
from fitting.report.comparison import ComparedRun
from fitting.result import Ranking
from fitting.words.warnings import merge_warnings
from stickslip import errors
from stickslip.compute.workers import workers
from stickslip.console import application
from stickslip.errors import DeviceError, StickslipError

FAILURES = (errors.EXIT_DATA, errors.EXIT_INPUT, errors.EXIT_DEVICE, errors.EXIT_BUG)
SEVERITY = (errors.EXIT_DONE, errors.EXIT_UNDECIDED, errors.EXIT_NO_LAW, *FAILURES)  # least first
Outcome = tuple[Ranking, str] | StickslipError  # of a run: its ranking and the page of its report, or why it has none


def fit(
    files: Sequence[Path],
    places: Sequence[Path],
    options: Options,
    progress: Callable[[float], None] | None = None,
    *,
    force: bool = False,
) -> list[ComparedRun]:
    """Fit every run separately; this process alone reads and writes the files.

    ``places`` are those of the reports, if wanted. An unusable run becomes a row; DeviceError is raised only where all
    workers were lost before the first run had finished.
    """
    rows: list[ComparedRun] = []
    reports: Sequence[Path | None] = places or [None] * len(files)
    loads = [partial(_load, file, report, options, force) for file, report in zip(files, reports, strict=True)]
    outcomes = fit_each(files, loads, options, draw=bool(places))
    for file, place, outcome in zip(files, reports, outcomes, strict=True):
        rows.append(_saved(file, place, outcome, force))
        if progress is not None:
            progress(float(len(rows)))
    return rows


def fit_each(
    files: Sequence[Path], loads: Sequence[Callable[[], LoadedRun]], options: Options, *, draw: bool = False
) -> Iterator[Outcome]:
    """Load each run and yield its result, in order; raises as `fit`."""
    done, work = 0, partial(_fitted, options=replace(options, jobs=1, scheduler=None), draw=draw)
    try:
        with workers(min(options.jobs, len(files)), options.scheduler) as each:
            for outcome in each(work, map(_read, files, loads)):
                yield outcome
                done += 1
    except DeviceError as error:
        if done == 0:
            raise
        yield from [error] * (len(files) - done)


def _code(row: ComparedRun) -> int:
    return job.exit_code(row.document) if row.failure is None else row.failure.exit_code


def exit_code(rows: Sequence[ComparedRun]) -> int:
    """Return the worst failure's code, else 6 when no law describes a run, 5 when a run is undecided, else 0."""
    return max(map(_code, rows), key=SEVERITY.index, default=errors.EXIT_DONE)


def summary(rows: Sequence[ComparedRun]) -> str:
    count = Counter(errors.EXIT_BUG if row.failure else _code(row) for row in rows)
    without = f"{count[errors.EXIT_NO_LAW]} that no law describes, " if count[errors.EXIT_NO_LAW] else ""
    undecided = f"{count[errors.EXIT_UNDECIDED]} undecided"
    return f"{count[errors.EXIT_DONE]} decided, {undecided}, {without}{count[errors.EXIT_BUG]} failed"


def text(rows: Sequence[ComparedRun], compared: Path | None) -> list[Any]:
    table = application.table("runs fitted one by one", ("file", "set", "verdict"))
    table.columns[0].overflow = table.columns[2].overflow = "fold"
    table.columns[2].justify, table.columns[2].no_wrap = "left", False
    common = Path(os.path.commonpath([row.file.absolute().parent for row in rows]))
    for row in rows:
        failed = row.failure
        named = () if failed else (*row.document["set"], *row.document.get("rivals", ()))
        members = "-" if failed else ", ".join(map(str, named)) or "none"
        verdict = f"error: {failed.what}; {failed.do}" if failed else row.document["verdict"].split(". ")[0]
        table.add_row(str(row.file.absolute().relative_to(common)), members, verdict)
    lines: list[Any] = [table]
    warned = [row.document.get("warnings", ()) for row in rows]
    lines += [f"warning: {text}" for text in merge_warnings(warned, [row.file.name for row in rows])]
    lines.append(f"{len(rows)} runs: {summary(rows)}" + (f"; comparison: {compared}" if compared else ""))
    return lines


def _failure(error: Exception, file: Path) -> StickslipError:
    """Return what stopped the fit of a run as an error with its message and exit code."""
    if isinstance(error, StickslipError):
        return copy(error)  # without the frames, and their arrays, that a traceback keeps
    if isinstance(error, OSError):
        do = "check the path, its permissions and the free space on the disk"
        return DeviceError(error.strerror or str(error), os.fspath(error.filename or file), do)
    last = traceback.extract_tb(error.__traceback__)[-1]
    what = f"{type(error).__name__}: {error} ({Path(last.filename).name}, line {last.lineno})"
    return StickslipError(what, str(file), "this is a bug: fit this run alone, without --json, and report it")


def _load(file: Path, report: Path | None, options: Options, force: bool) -> LoadedRun:
    """Read a run; InputError for a file in place of its report that is not its report."""
    run = job.load_run(file, options)
    if report is not None:
        page.refuse_foreign_file(report, [run.recording.digest], files=[file], force=force)
    return run


def _read(file: Path, load: Callable[[], LoadedRun]) -> LoadedRun | StickslipError:
    try:
        return load()
    except Exception as error:
        return _failure(error, file)


def _fitted(run: LoadedRun | StickslipError, options: Options, draw: bool) -> Outcome:
    if isinstance(run, StickslipError):
        return run
    try:
        ranking = job.fit_runs([run], options)
        return ranking, page.render(ranking) if draw else ""
    except Exception as error:
        return _failure(error, run.recording.source)


def _saved(file: Path, place: Path | None, outcome: Outcome, force: bool) -> ComparedRun:
    if isinstance(outcome, StickslipError):
        return ComparedRun(file, {}, outcome)
    ranking, text = outcome
    try:
        job.save(ranking, place, text, force=force)
    except Exception as error:
        return ComparedRun(file, {}, _failure(error, file))
    return ComparedRun(file, ranking.as_json() | {"report": place})
