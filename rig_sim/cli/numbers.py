"""Numbers as the commands print them."""

import math


def with_error(value: float, stderr: float) -> str:
    """Return a value with the digits that its standard error, given to two, leaves: "0.865 +- 0.013"."""
    if not (math.isfinite(stderr) and stderr > 0.0):
        return f"{value:.8g} +- {stderr:.2g}"
    decimals = max(0, 1 - math.floor(math.log10(stderr)))
    return f"{value:.{decimals}f} +- {stderr:.2g}"
