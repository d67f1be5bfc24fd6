"""The units in which people see lengths, in text and in pictures: mm, and m/s for speeds; counts as they are."""


def shown_length(unit: str) -> tuple[float, str]:
    """Return the factor and the unit in which lengths in ``unit`` ("m" or "count") are shown."""
    return (1e3, "mm") if unit == "m" else (1.0, "counts")


def shown_speed(unit: str) -> str:
    """Return the unit in which speeds of positions in ``unit`` are shown, with a factor of 1."""
    return "m/s" if unit == "m" else "counts/s"


def shown_range(low: float, high: float, unit: str) -> str:
    """Return a range of positions in ``unit`` in words."""
    factor, name = shown_length(unit)
    return f"{factor * low:.4g} to {factor * high:.4g} {name}"


def format_length(value: float, unit: str = "m") -> str:
    """Return one length in a unit that suits its size: um, mm or m; counts as they are."""
    if unit != "m":
        return f"{value:.3g} {shown_length(unit)[1]}"
    if abs(value) < 1e-3:
        return f"{value * 1e6:.3g} um"
    return f"{value * 1e3:.3g} mm" if abs(value) < 1 else f"{value:.3g} m"
