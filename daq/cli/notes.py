"""`daq note` and `daq list`: what people wrote about their runs, and the runs of a folder."""

import textwrap
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

WIDTH = 80  # columns of a terminal
LONGEST_NOTE = 2 * WIDTH  # characters of a note in a list; 'daq note RUN.h5' prints all of it


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
        help="A marker: the time since the first sample, and a text; repeatable.",
    ),
]


def note(
    run: Annotated[Path, Parameter(name="RUN.h5", help="The run file.")],
    /,
    *,
    notes: NoteFlags = NO_NOTES,
    mark: Mark = None,
    json: Json = False,
) -> Answer:
    """Add notes and markers to a finished run, or print those it has.

    A note replaces the one before; an empty one removes it.  Samples, smoothed motion and fit stay as they are.

    Example: daq note run.h5 --sample "brass on steel" --tag humidity=45 --mark 12.5 "hand on the guide"
    """
    from daq.runfile import store

    written = notes.collect()
    marks = mark or []
    for _, text in marks:
        check_text(text, "--mark")
    annotated = store.annotate(run, written, marks) if written or marks else store.load(run, slice(1))
    time = store.read_times(run) if "marker" in annotated.event_kind else None
    events = zip(annotated.event_sample, annotated.event_kind, annotated.event_note, strict=True)
    markers = [
        {"t": float(time[sample]), "text": text}
        for sample, kind, text in events
        if time is not None and kind == "marker"
    ]
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
    folders: Annotated[tuple[Path, ...], Parameter(name="FOLDER", help="Folders of runs; default '.'.")] = (),
    /,
    *,
    json: Json = False,
) -> Answer:
    """List the runs in folders, oldest first: title, date, duration, rate, lost samples, sticks and verdict.

    A joint fit stands among them with its date, its runs and its verdict. Of a fit that left something out (--from,
    --to, --laws, --exclude-cycles) it says what was fitted.

    Example: daq list measurements
    """
    from daq.runfile import listing

    rows = listing.list_runs(folders or (Path(),))
    if not rows:
        where = ", ".join(str(folder) for folder in folders) or "this folder"
        return Answer([], f"no runs in {where}")
    return Answer([vars(row) for row in rows], "\n".join(line for row in rows for line in _format_row(row)))


def _format_row(row: "RunRow") -> list[str]:
    """Return the lines about one run: its facts, what people wrote, and the verdict."""
    about = [row.title, row.sample, row.operator, *(f"{name}={value}" for name, value in row.tags.items())]
    facts = [
        (row.date, f"{'file of ' * row.of_file}{(row.date or '')[:16].replace('T', ' ')}"),
        (row.duration, f"{row.duration:.4g} s" if row.duration is not None else ""),
        (row.rate, f"{row.rate:.5g} Hz" if row.rate is not None else ""),
        (row.lost, f"{row.lost} lost"),
        (row.sticks, f"{row.sticks} sticks"),
        (row.runs, f"{row.runs} runs fitted jointly"),
    ]
    lines = [
        ", ".join(text for fact, text in facts if fact is not None),
        ", ".join(text for text in about if text),
        textwrap.shorten(row.note or "", LONGEST_NOTE, placeholder=" ..."),
        f"fitted: {row.part}" if row.part else "",
        row.verdict,
        row.problem,
    ]
    inside = [textwrap.fill(line, WIDTH, initial_indent="  ", subsequent_indent="  ") for line in lines if line]
    return [str(row.file), *inside]
