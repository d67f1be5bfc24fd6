"""A byte stream cut into lines at its delimiter, however the bytes arrive: the one splitter behind every protocol."""


class Splitter:
    """Cut a byte stream into lines; a line longer than any the protocol has is held in no memory.

    Such a line is returned as soon as it is too long, with what has come of it; the caller sees its length and counts
    it as damage.  The rest of it, up to its delimiter, is dropped.

    Parameters
    ----------
    delimiter : bytes
        One byte; it ends a line and is not part of it.
    longest : int
        Bytes of the longest line.

    Attributes
    ----------
    dropped_bytes : int
        Bytes of endless lines that were dropped after the line had been returned.
    """

    def __init__(self, delimiter: bytes, longest: int) -> None:
        self.dropped_bytes = 0
        self._delimiter = delimiter
        self._longest = longest
        self._tail = b""
        self._dropping = False

    @property
    def pending_bytes(self) -> int:
        """Bytes of the line that has begun and not ended."""
        return len(self._tail)

    def feed(self, data: bytes) -> list[bytes]:
        """Take bytes as they came and return the lines they complete, in order, empty ones too."""
        *lines, self._tail = (self._tail + data).split(self._delimiter)
        if self._dropping and lines:
            self.dropped_bytes += len(lines.pop(0))
            self._dropping = False
        if self._dropping:
            self.dropped_bytes += len(self._tail)
            self._tail = b""
        elif len(self._tail) > self._longest:
            lines.append(self._tail)
            self._tail = b""
            self._dropping = True
        return lines
