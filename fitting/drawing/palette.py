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
# Of runs fitted jointly: none is the colour of a law.  From the tenth run on they repeat.
RUNS = ("#6A4FC0", "#C8325A", "#5E9C1F", "#B89B1E", "#2AA0A0", "#8C4A1F", "#666666", "#9DB4E8", "#D080B0")


def run_colour(number: int) -> str:
    """Return the colour of a run, counted from 1."""
    return RUNS[(number - 1) % len(RUNS)]


def law_colours(laws: Iterable[int | str]) -> dict[int | str, str]:
    """Return the colour of each law: those of the six by their numbers, those of formulas in their order."""
    return _by_law(laws, COLOURS, FORMULAS)


def law_dashes(laws: Iterable[int | str]) -> dict[int | str, str]:
    """Return the dashes of each law's line, as `law_colours` the colours."""
    return _by_law(laws, DASHES, FORMULA_DASHES)


def _by_law(laws: Iterable[int | str], six: Mapping[int, str], formulas: Sequence[str]) -> dict[int | str, str]:
    by_law: dict[int | str, str] = {}
    names = 0
    for law in laws:
        if isinstance(law, int):
            by_law[law] = six[law]
        else:
            by_law[law] = formulas[names % len(formulas)]
            names += 1
    return by_law
