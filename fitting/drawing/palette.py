"""Colours, dashes and widths of the pictures."""

COLOURS = {1: "#56B4E9", 2: "#0072B2", 3: "#E69F00", 4: "#D55E00", 5: "#009E73", 6: "#CC79A7"}
MEASURED = "#9a9a9a"
INK = "#222222"
DASH = "5 3"
WIDE, NARROW = 930.0, 455.0  # px: of the page, and of half of it
