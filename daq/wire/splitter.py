"""A byte stream cut into lines at its delimiter, however the bytes arrive, for every protocol."""


class Splitter:
    """Cut a byte stream into lines, in bounded memory.

    A line longer than any of the protocol is returned as soon as it is too long, with what has arrived of it; the
    caller sees its length and counts it as damaged.  The rest of it, up to its delimiter, is dropped.

    delimiter: One byte; it ends a line and is not part of it.
    longest: Bytes of the longest line.
    """

    def __init__(self, delimiter: bytes, longest: int) -> None:
        self._delimiter = delimiter
        self._longest = longest
        self._tail = b""
        self._dropping = False

    @property
    def pending_bytes(self) -> int:
        return len(self._tail)

    def feed(self, data: bytes) -> list[bytes]:
        """Return the lines that the bytes complete, in order, empty ones too, without delimiters."""
        joined = self._tail + data
        end = joined.rfind(self._delimiter) + 1
        block, self._tail = joined[:end], joined[end:]
        if self._dropping and block:
            _, _, block = block.partition(self._delimiter)
            self._dropping = False
        if self._dropping:
            self._tail = b""
        elif len(self._tail) > self._longest:
            block += self._tail + self._delimiter
            self._tail = b""
            self._dropping = True
        lines = block.split(self._delimiter)
        lines.pop()
        return lines
