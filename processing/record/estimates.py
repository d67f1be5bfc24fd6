"""What is estimated once a record and then used in every block of it, so that no result depends on the blocks.

The first stretches smoothed, those that represent the record, leave their noise levels, thresholds and speeds here;
`RecordEstimates.close` ends that.  In a record that is smoothed in one go the same code estimates and uses them.
"""

from collections.abc import Callable
from typing import Any, TypeVar

Value = TypeVar("Value")


class RecordEstimates:
    """Values by name, each estimated by the first who asks for it."""

    def __init__(self) -> None:
        self._values: dict[str, Any] = {}
        self._parts: dict[str, RecordEstimates] = {}
        self.closed = False

    def once(self, name: str, estimate: Callable[[], Value]) -> Value:
        """Return the value of this name, from ``estimate`` when it is asked for the first time.

        After `close` a missing value is estimated each time: it is of one block and is not kept for the others.
        """
        if name in self._values:
            return self._values[name]  # type: ignore[no-any-return]
        value = estimate()
        if not self.closed:
            self._values[name] = value
        return value

    def known(self, name: str) -> bool:
        """Return whether a value of this name is kept."""
        return name in self._values

    def part(self, name: str) -> "RecordEstimates":
        """Return the estimates of one part of the work, whose names are its own."""
        if name not in self._parts:
            made = RecordEstimates()
            made.closed = self.closed
            self._parts[name] = made
        return self._parts[name]

    def has_part(self, name: str) -> bool:
        """Return whether the part of this name was asked for."""
        return name in self._parts

    def close(self) -> None:
        """Keep no further values."""
        self.closed = True
        for part in self._parts.values():
            part.close()
