"""`daq note` and `daq list`: what people wrote about their runs, and the runs of a folder."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import cyclopts
from cyclopts import Parameter

from daq.recorder.notes import NO_NOTES, NoteFlags, check_text
from stickslip.console.application import Answer, Json

if TYPE_CHECKING:
    from daq.runfile.listing import RunRow
    from daq.runfile.recording import Recording

END_OF_LAW = re.compile(r"[:,.;] ")  # in a verdict, after the name of its law


def _parse_markers(type_: Any, tokens: Sequence[cyclopts.Token]) -> list[tuple[float, str]]:
    from stickslip import units

    typed = [token.value for token in tokens]
    return [(units.quantity(time, "time", "--mark"), text) for time, text in zip(typed[::2], typed[1::2], strict=True)]


Mark = Annotated[
    list[tuple[float, str]] | None,
    Parameter(
        name="--mark",
        negative=(),
        converter=_parse_markers,
        n_tokens=2,
        consume_multiple=False,
        help="Add a marker at a time since the first sample, with a text; repeatable.",
    ),
]


def note(
    run: Annotated[Path, Parameter(name="RUN.h5", help="Run file.")],
    /,
    *,
    notes: NoteFlags = NO_NOTES,
    mark: Mark = None,
    json: Json = False,
) -> Answer:
    """Add notes and markers to a finished run, or print its notes.

    A new note replaces the old one, and an empty note removes it.  Samples, smoothed motion and fit do not change.

    Example: daq note run.h5 --sample "brass on steel" --tag humidity=45 --mark 12.5 "hand on the guide"
    """
    from daq.runfile import store

    written = notes.collect()
    marks = mark or []
    for _, text in marks:
        check_text(text, "--mark")
    annotated = store.annotate(run, written, marks) if written or marks else store.load(run, slice(1))
    times = store.read_times(run) if "marker" in annotated.event_kind else annotated.time
    markers = [{"t": time, "text": text} for time, text in annotated.list_markers(times)]
    data = {"file": run, **_list_notes(annotated), "markers": markers}
    lines = [f"{run}: {annotated.title}"]
    lines += [f"{name}: {text}" for name, text in annotated.remarks().items()]
    lines += [f"{marker['t']:.3f} s: {marker['text']}" for marker in markers]
    return Answer(data, "\n".join(lines))


def _list_notes(run: "Recording") -> dict[str, Any]:
    return {
        "title": run.title,
        "operator": run.operator,
        "sample": run.sample_name,
        "note": run.note,
        "tags": dict(run.tags),
    }


def list_runs(
    folders: Annotated[tuple[Path, ...], Parameter(name="FOLDER", help="Folders that contain runs; default '.'.")] = (),
    /,
    *,
    json: Json = False,
) -> Answer:
    """List the runs in folders, oldest first, with date, duration, rate, sticks, verdict and title.

    'daq note RUN.h5' prints the notes of a run, and --json prints all data.

    Example: daq list measurements
    """
    from daq.runfile import listing

    rows = listing.list_runs(folders or (Path(),))
    if not rows:
        where = ", ".join(str(folder) for folder in folders) or "this folder"
        return Answer([], f"no runs in {where}")
    width = max(len(str(row.file)) for row in rows)
    return Answer([vars(row) for row in rows], "\n".join(f"{row.file!s:{width}}  {_describe(row)}" for row in rows))


def _describe(row: "RunRow") -> str:
    """Return the facts of a run, the law of its verdict, and what people wrote, on one line."""
    facts = [
        f"{'file of ' * row.of_file}{row.date[:16].replace('T', ' ')}" if row.date else "",
        f"{row.duration:.4g} s" if row.duration is not None else "",
        f"{row.rate:.5g} Hz" if row.rate is not None else "",
        f"{row.lost} lost" if row.lost else "",
        f"{row.sticks} sticks" if row.sticks is not None else "",
        f"{row.runs} runs fitted jointly" if row.runs is not None else "",
        END_OF_LAW.split(row.verdict)[0] if row.verdict else "",
        f"fitted: {row.part}" if row.part else "",
        row.problem or "",
        *(text for text in (row.title, row.sample) if text),
        *(f"{name}={value}" for name, value in row.tags.items()),
    ]
    return ", ".join(" ".join(fact.split()) for fact in facts if fact)
