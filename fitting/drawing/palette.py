"""Colours, dashes and widths of the pictures."""

from collections.abc import Iterable

COLOURS = {1: "#56B4E9", 2: "#0072B2", 3: "#E69F00", 4: "#D55E00", 5: "#009E73", 6: "#CC79A7"}
# Of laws given as formulas, in the order of the ranking; from the sixth on they repeat.
FORMULAS = ("#A03070", "#6B4226", "#5B6BBF", "#808000", "#1F7A7A")
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
    found: dict[int | str, str] = {}
    names = 0
    for law in laws:
        if isinstance(law, int):
            found[law] = COLOURS[law]
        else:
            found[law] = FORMULAS[names % len(FORMULAS)]
            names += 1
    return found
