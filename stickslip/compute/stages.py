"""What a long analysis reports while it works: its stage, and how much of that stage is done."""

from collections.abc import Callable, Iterator

Stages = Callable[[str, float, float], None]  # called with the name of the stage, what is done of it, and its whole

# Applications of a map between two reports, some 10 ms: 100 would add a tenth to the time of a cheap map.
PART = 1000


def silent(stage: str, done: float, whole: float) -> None:
    """Report nothing."""


def parts(stage: str, whole: int, progress: Stages, size: int = PART) -> Iterator[tuple[int, int]]:
    """Yield begin and end of each part of a stage, up to ``size`` long, and report each when the next is asked for."""
    progress(stage, 0.0, whole)
    for begin in range(0, whole, size):
        end = min(begin + size, whole)
        yield begin, end
        progress(stage, end, whole)
