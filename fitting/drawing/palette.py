"""Colours, dashes and widths of the pictures."""

from collections.abc import Iterable, Mapping, Sequence

COLOURS = {1: "#56B4E9", 2: "#0072B2", 3: "#E69F00", 4: "#D55E00", 5: "#009E73", 6: "#CC79A7"}
# Of laws given as formulas, in the order of the ranking; from the sixth on they repeat.
FORMULAS = ("#A03070", "#6B4226", "#5B6BBF", "#808000", "#1F7A7A")
# Of the six laws, so that they are told apart without colours; and of formulas, as above.
DASHES = {1: "1.5 3", 2: "3 2", 3: "8 3", 4: "8 3 2 3", 5: "", 6: "14 3 3 3"}
FORMULA_DASHES = ("5 2 1 2 1 2", "10 2 2 2 2 2", "4 4", "1 2", "16 4")
MEASURED = "#9a9a9a"
INK = "#222222"
DASH = "5 3"
WIDE, NARROW = 930.0, 455.0  # px: of the page, and of half of it
# Of runs fitted jointly: none is the colour of a law.  In greyscale the three runs of a group differ in luminance, and
# the groups in dashes and marks.  From the tenth run on they repeat.
RUNS = ("#3B1A78", "#C03A58", "#A9B83A", "#4A2409", "#1F7F7F", "#D598BC", "#1E1E1E", "#8F6510", "#7FB0EA")
RUN_DASHES = ("", "12 6", "4 5")
RUN_MARKS = ("o", "c", "|")


def run_colour(number: int) -> str:
    return RUNS[(number - 1) % len(RUNS)]


def run_dash(number: int) -> str:
    return RUN_DASHES[(number - 1) % len(RUNS) // 3]


def run_mark(number: int) -> str:
    return RUN_MARKS[(number - 1) % len(RUNS) // 3]


def law_colours(laws: Iterable[int | str]) -> dict[int | str, str]:
    """Return the colour of each law: the six by number, formulas in order."""
    return _by_law(laws, COLOURS, FORMULAS)


def law_dashes(laws: Iterable[int | str]) -> dict[int | str, str]:
    return _by_law(laws, DASHES, FORMULA_DASHES)


def _by_law(laws: Iterable[int | str], six: Mapping[int, str], formulas: Sequence[str]) -> dict[int | str, str]:
    by_law: dict[int | str, str] = {}
    names = 0
    for law in laws:
        if isinstance(law, int) and law in six:
            by_law[law] = six[law]
        else:
            by_law[law] = formulas[names % len(formulas)]
            names += 1
    return by_law
