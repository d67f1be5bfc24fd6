"""Colours, dashes and marks of the pictures, as matplotlib takes them."""

from collections.abc import Iterable
from typing import Any

Dashes = str | tuple[float, tuple[float, ...]]  # a line style of matplotlib; lengths in line widths
COLOURS = {1: "#56B4E9", 2: "#0072B2", 3: "#E69F00", 4: "#D55E00", 5: "#009E73", 6: "#CC79A7"}
FORMULAS = ("#A03070", "#6B4226", "#5B6BBF", "#808000", "#1F7A7A")  # of formulas in the order of the ranking, repeated
DASHES: dict[int, Dashes] = {
    1: (0, (1.2, 2)),
    2: (0, (2.5, 1.5)),
    3: (0, (6, 2)),
    4: (0, (6, 2, 1.5, 2)),
    5: "-",
    6: (0, (10, 2, 2, 2)),
}
FORMULA_DASHES: tuple[Dashes, ...] = (
    (0, (4, 1.5, 1, 1.5, 1, 1.5)),
    (0, (8, 1.5, 1.5, 1.5, 1.5, 1.5)),
    (0, (3, 3)),
    (0, (0.8, 1.5)),
    (0, (12, 3)),
)
MEASURED = "#9a9a9a"
INK = "#222222"
DASHED: Dashes = (0, (5, 3))
# Of runs, none the colour of a law.  In greyscale three runs differ in luminance, the groups of three in dashes and
# marks.  From the tenth run on they repeat.
RUNS = ("#3B1A78", "#C03A58", "#A9B83A", "#4A2409", "#1F7F7F", "#D598BC", "#1E1E1E", "#8F6510", "#7FB0EA")
RUN_DASHES: tuple[Dashes, ...] = ("-", (0, (6, 3)), (0, (2, 2)))
RUN_MARKS: tuple[dict[str, Any], ...] = ({"marker": "o"}, {"marker": "o", "mfc": "none"}, {"marker": "|"})


def run_colour(number: int) -> str:
    return RUNS[(number - 1) % len(RUNS)]


def run_dash(number: int) -> Dashes:
    return RUN_DASHES[(number - 1) % len(RUNS) // 3]


def run_mark(number: int) -> dict[str, Any]:
    return RUN_MARKS[(number - 1) % len(RUNS) // 3]


def law_styles(laws: Iterable[int | str]) -> dict[int | str, dict[str, Any]]:
    styles: dict[int | str, dict[str, Any]] = {}
    names = 0
    for law in laws:
        if isinstance(law, int) and law in COLOURS:
            styles[law] = {"color": COLOURS[law], "ls": DASHES[law]}
        else:
            number = names % len(FORMULAS)
            styles[law] = {"color": FORMULAS[number], "ls": FORMULA_DASHES[number]}
            names += 1
    return styles
