"""What a campaign tries, and what it finds.

A campaign is a function that tries, measures and returns one `Result` per promise.  It asserts nothing: what went wrong
stands in ``faults``, each with what to run to see it again.  The same size gives the same trials: whatever is drawn by
chance comes from ``size.seed``.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class Result:
    """One row of the table.

    Attributes
    ----------
    promise : str
        What holds, in one sentence.
    tried : str
        What was done to it, with numbers.
    measured : str
        What came out, with numbers and units.
    faults : tuple of str
        What broke the promise, each with what to run to see it again.
    test : str
        A test that holds the promise besides the campaign; "" for none.
    """

    promise: str
    tried: str
    measured: str
    faults: tuple[str, ...] = ()
    test: str = ""


@dataclass(frozen=True)
class Size:
    """How long a campaign is: how much of what it counts, whether that is the full size, and the seed of its draws."""

    amount: int
    full: bool
    seed: int = 1
