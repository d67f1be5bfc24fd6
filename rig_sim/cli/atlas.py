"""The command ``rig-sim atlas``: the thesis's figures, each a picture and a table."""

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from stickslip.console import application
from stickslip.console.application import Answer, Json


def atlas(
    figures: Annotated[
        list[str] | None,
        Parameter(help="Numbers of figures, such as 2.7, or of a chapter, such as 2; by default all figures."),
    ] = None,
    /,
    *,
    output: Annotated[
        Path, Parameter(name=["--output", "-o"], help="Folder for the pictures and for the page that shows them.")
    ],
    force: Annotated[bool, Parameter(negative=(), help="Replace existing files.")] = False,
    json: Json = False,
) -> Answer:
    """Redraw figures of the thesis, and compare its numbers with the computed ones.

    The folder receives figure-2.7.png ... and atlas.md, which shows them with their tables. Figures that the text of
    the thesis does not define are listed with the reason.

    Example: rig-sim atlas 2.7 4 -o atlas
    """
    from rig_sim.atlas.redraw import PAGE, redraw, select_figures
    from rig_sim.atlas.registry import NOT_REDRAWN

    numbers = select_figures(figures)
    missing = {number: NOT_REDRAWN[number] for number in numbers if number in NOT_REDRAWN}
    with application.progress("drawing", len(numbers) - len(missing)) as show:
        done = redraw(numbers, output, force=force, progress=show)
    data = {
        "folder": output,
        "page": output / PAGE,
        "figures": [
            {
                "figure": each.number,
                "title": each.title,
                "sentence": each.sentence,
                "choices": each.choices,
                "file": each.file,
                "table": [asdict(row) for row in each.table],
            }
            for each in done
        ],
        "not_redrawn": [{"figure": number, "why": why} for number, why in missing.items()],
    }
    lines = []
    for each in done:
        differing = [row for row in each.table if not row.agrees]
        lines.append(f"{each.number:5} {each.title}: {each.file}")
        lines += [
            f"      {row.quantity}: thesis {row.thesis}, computed {row.computed} ({row.why})" for row in differing
        ]
    lines += [f"{number:5} not redrawn: {why}" for number, why in missing.items()]
    lines.append(f"{len(done)} figures, {len(missing)} not redrawn; {output / PAGE} shows them")
    return Answer(data, "\n".join(lines))
