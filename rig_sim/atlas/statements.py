"""The words of the atlas: a TOML file for each chapter, joined here with what the chapter computes.

A figure has a table under its number, with these keys::

    title      its subject
    shows      a sentence about the picture
    choices    what the thesis does not state and was chosen here
    says       what the thesis states about it, a row for each statement
    like       another figure of the file, from which every key that is not given here is taken

A row compares a number that the thesis prints, or a statement in words::

    ["largest displacement", "1.5", "x_max", "why they differ", { within = 0.2 }]
    ["stick lengthens the period", "yes", "period {period:.10g}", "lengthened", "why they differ"]

First what is compared, and what the thesis has.  Then, of a number, the name of the computed one; it agrees within one
unit of the last digit printed, since most were read off a plot, or within ``within``.  Of a statement, what is computed
in words, and the name of the verdict; without one, or with an empty one, the words have to be those of the thesis.  Why
the two differ is shown only where they do.

A name in braces stands for a number or words that the chapter computes for the figure, ``{period:.10g}`` with 10
digits, or for one of the texts in the table ``words`` at the top of the file.
"""

import math
import re
from collections.abc import Callable, Mapping
from functools import cache, partial
from pathlib import Path
from typing import Any

from rig_sim.atlas.figure import Computed, Drawing, StatementCheck
from stickslip import toml
from stickslip.errors import InputError, nearest

CHAPTERS = Path(__file__).with_name("chapters")
WORDS = "words"
LINE_BREAK = re.compile(r"\s*\n\s*")
MULTIPLE_OF_PI = re.compile(r"(\d*) ?pi(?:/(\d+))?")


def read_entries(file: str, figures: Mapping[str, Callable[[], Computed]]) -> dict[str, Callable[[], Drawing]]:
    """Return for each figure of a chapter a function that computes it and adds its words in the chapter's file."""
    return {number: partial(compute_drawing, file, number, compute) for number, compute in figures.items()}


@cache
def read_tables(file: str) -> dict[str, Any]:
    """Return the tables of a chapter's file by the figures' numbers, completed from the figure named by ``like``."""
    tables: dict[str, Any] = join_lines(toml.parse((CHAPTERS / file).read_text(encoding="utf-8"), file))
    for figure in tables.values():
        like = tables.get(figure.pop("like", ""), {})
        figure |= {key: value for key, value in like.items() if key not in figure}
    return tables


def join_lines(value: Any) -> Any:
    """Return a text with a space for each line break, or a list or table of such texts."""
    if isinstance(value, dict):
        return {key: join_lines(item) for key, item in value.items()}
    if isinstance(value, list):
        return [join_lines(item) for item in value]
    return LINE_BREAK.sub(" ", value) if isinstance(value, str) else value


def compute_drawing(file: str, number: str, compute: Callable[[], Computed]) -> Drawing:
    tables = read_tables(file)
    figure, where, computed = tables[number], f"figure {number} in {file}", compute()
    numbers = {**tables.get(WORDS, {}), **computed.numbers}
    try:
        sentence, choices = (format_text(figure.get(key, ""), numbers) for key in ("shows", "choices"))
        table = tuple(check_row(row, numbers) for row in figure.get("says", ()))
    except KeyError as error:
        name = str(error.args[0])
        raise InputError(f"no number {name!r} is computed", where, nearest(name, list(numbers))) from None
    return Drawing(number, figure["title"], sentence, computed.panels, table, computed.columns, choices)


def format_text(text: str, numbers: Mapping[str, Any]) -> str:
    """Return a text with its numbers; a verdict is 'yes' or 'no'."""
    return text.format_map(
        {name: ("yes" if value else "no") if isinstance(value, bool) else value for name, value in numbers.items()}
    )


def check_row(row: list[Any], numbers: Mapping[str, Any]) -> StatementCheck:
    options = row[-1] if isinstance(row[-1], dict) else {}
    quantity, printed, computed, *rest = (format_text(part, numbers) for part in row if part is not options)
    if "{" not in row[2]:
        return compare(quantity, printed, numbers[computed], *rest, **options)
    verdict, why = (*rest, "", "")[:2]
    agrees = bool(numbers[verdict]) if verdict else computed == printed
    return StatementCheck(quantity, printed, computed, agrees, "" if agrees else why)


def compare(
    quantity: str, printed: str, value: float | None, why: str = "", *, within: float | None = None
) -> StatementCheck:
    """Return the comparison of a printed number (a decimal, or a multiple of pi such as '3 pi/2') with a computed one.

    A value of None or NaN agrees with nothing.  ``why`` is shown only where they differ; ``within`` is the tolerance,
    by default one unit of the last printed digit, for a multiple of pi 0.
    """
    of_pi = MULTIPLE_OF_PI.fullmatch(printed)
    number = int(of_pi[1] or 1) * math.pi / int(of_pi[2] or 1) if of_pi else float(printed)
    unit = 0.0 if of_pi else 10.0 ** -len(printed.partition(".")[2])
    computed = math.nan if value is None else float(value)
    agrees = math.isfinite(computed) and abs(computed - number) <= (unit if within is None else within) * (1.0 + 1e-9)
    return StatementCheck(quantity, printed, f"{computed:.8g}", agrees, "" if agrees else why, computed)
