"""What a campaign tries, and what it finds.

A campaign is a function that tries, measures and returns one `Result` per promise.  It asserts nothing: what went wrong
stands in ``faults``, each with what to run to see it again.  The same size gives the same trials: whatever is drawn by
chance comes from ``size.seed``.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class Result:
    """One row of the table."""

    promise: str  # what holds, in one sentence
    tried: str  # what was done to it, with numbers
    measured: str  # what came out, with numbers and units
    faults: tuple[str, ...] = ()  # what broke the promise, each with what to run to see it again
    test: str = ""  # one that holds the promise besides the campaign


@dataclass(frozen=True)
class Size:
    """How long a campaign is: how much of what it counts, whether that is the full size, and the seed of its draws."""

    amount: int
    full: bool
    seed: int = 1
