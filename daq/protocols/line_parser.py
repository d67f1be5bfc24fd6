"""The lines of one stream of text: each parsed by its columns, and similar ones together.

Lines are alike if they differ only in their digits, their signs and the width of their spaces.  The pattern of such
lines is made from one line, and it matches what the pattern of the columns matches:

- A value that counts has the pattern of its column; the digits of a fraction are as many as in that line.
- Other text stays as it is, but for digits and spaces.  Where columns have no labels, the line must have as many words
  as columns, so that each word is one column's; labels that are used hold no digits (`daq.protocols.columns`).

- From the separator before an xor on, which must be the last column, nothing but its digits differs.
- A measured number has the decimals of its column.  Without the point it is the count, sign included; so the points are
  taken out of such lines, and there are none but its own and that of the time.

Read one by one: text with a minus that is not a sign, an xor among labels or before other columns, and measured numbers
with other decimals, in powers of ten, or next to text with points.
"""

import re
from dataclasses import dataclass
from itertools import chain
from string import hexdigits

import numpy as np
from numpy.typing import NDArray

from daq.protocols.columns import LONGEST_LINE, MEASURED, TIMES, UNREAD, VALUES, Columns
from daq.protocols.lines import NoSample, Row

# Searches for lines like the last ones that may fail before a new shape is searched for: a search costs 0.7 us a line.
MOST_MISSED = 256
_SEPARATED = re.compile(rb"[ \t]*[,;][ \t]*|[ \t]+")
# Patterns of text that does not count: a number with a sign, digits, spaces, anything else.
_PIECE = re.compile(rb"((?<![\w.()\[\]/%-])-?\d{1,9})(?!\d)|(\d{1,9})(?!\d)|([ \t]{1,8})(?![ \t])|([^\d \t-])")
_NUMBER, _DIGITS, _SPACES, _OTHER = 1, 2, 3, 4
# The pattern of similar pieces, and their greatest length.
_LIKE = {_NUMBER: (rb"-?+\d{1,9}+", 10), _DIGITS: (rb"\d{1,9}+", 9), _SPACES: (rb"[ \t]{1,8}+", 8)}
_LIKE_VALUE = {name: pattern.replace("(", "(?:").encode() for name, pattern in VALUES.items()} | {"time": rb"\d{1,12}+"}
_LONGEST_VALUE = 12
_MOST_DIGITS = 18  # digits of a number without its point that fit 64 bits
_HEX_DIGIT = np.array([int(chr(byte), 16) if chr(byte) in hexdigits else 0 for byte in range(256)], dtype=np.uint8)
_DIGITS_AND_SIGNS = bytes(byte if byte in b"-0123456789" else 32 for byte in range(256))  # anything else: a space


@dataclass(frozen=True)
class LineShape:
    pattern: re.Pattern[bytes]  # of any number of whole lines
    form: Columns  # their columns
    numbers: int  # how many numbers are in a line
    # index of the number of each column, with the whole part and the fraction of the time as ``time`` and ``fraction``
    place: dict[str, int]
    # (k,) the number for each value of a row (the lower of two levels), and its bits; 0 for a value that the line lacks
    taken: NDArray[np.intp]
    masks: NDArray[np.int64]
    fraction_digits: int  # digits of the time's fraction
    pointless: bool  # the points are taken out before the numbers are read
    # bytes of a line from the end of the part that its xor covers, and from the xor's digits; 0 without an xor
    unguarded: int
    xor: int

    def read(self, lines: bytes) -> NDArray[np.int64]:
        """Return the values in n lines, (n, k), up to the first line with a value out of range.

        A short read takes 20 lines, so the number of array operations matters here, not the work per line.
        """
        lines, xor_wrong = self._check_xor(lines) if self.xor else (lines, None)
        points = b"." if self.pointless else b""
        numbers = np.fromstring(lines.translate(_DIGITS_AND_SIGNS, points), np.int64, sep=" ").reshape(-1, self.numbers)
        rows = numbers.take(self.taken, axis=1)
        unit = self.form.us_per_unit
        fraction = None
        if self.fraction_digits and self.pointless:
            rows[:, 0], fraction = np.divmod(rows[:, 0], 10**self.fraction_digits)
        elif self.fraction_digits:
            fraction = numbers[:, self.place["fraction"]]
        if unit != 1:
            rows[:, 0] *= unit
        if fraction is not None:
            micro = fraction * 10 ** max(6 - self.fraction_digits, 0)
            micro //= 10 ** max(self.fraction_digits - 6, 0)  # digits beyond the microsecond are cut off
            rows[:, 0] += micro * unit // 1_000_000
        if "b" in self.place:
            rows[:, 3] |= numbers[:, self.place["b"]] << 1
        limit, counts = 1 << self.form.bits, rows[:, 1 : 2 if self.form.net else 3]
        outside = counts >= (limit if self.form.decimals is None else limit // 2)
        if self.form.net:
            outside |= counts < -limit // 2
        if xor_wrong is not None:
            outside[:, 0] |= xor_wrong
        if np.count_nonzero(outside):
            rows = rows[: outside.any(axis=1).argmax()]
        rows &= self.masks
        return rows

    def _check_xor(self, lines: bytes) -> tuple[bytes, NDArray[np.bool_]]:
        """Return n lines with spaces in place of their xor, and for each whether its xor is wrong, (n,)."""
        text = np.frombuffer(bytearray(lines), np.uint8)
        end = np.flatnonzero(text == ord("\n"))
        start = np.concatenate((np.zeros(1, dtype=np.int64), end[:-1] + 1))
        computed = np.bitwise_xor.reduceat(text, np.column_stack((start, end - self.unguarded)).ravel())[::2]
        high, low = end - self.xor, end - self.xor + 1
        stated = _HEX_DIGIT[text[high]] << 4 | _HEX_DIGIT[text[low]]
        text[high] = text[low] = ord(" ")
        return text.tobytes(), computed != stated


def find_shape(form: Columns, match: re.Match[bytes]) -> LineShape | None:
    """Return the shape of a line that matches the pattern of its columns; None: similar lines are not searched for."""
    line = match.string
    cells = _SEPARATED.split(line.strip(b" \t\r"))
    if not (form.labels or (len(cells) == len(form.names) and all(cells))):
        return None
    guarded, xor = len(line), len(line)
    if "xor" in form.names:
        if form.labels or form.names[-1] != "xor":
            return None
        guarded, xor = len(form.take_guarded(match)), match.start(form.checks[-1])
    pattern, place, numbers, longest, position = b"", {}, 0, 0, 0
    parts = chain.from_iterable(
        ("time", "fraction") if name in TIMES else (name,) for name in form.names if name not in UNREAD
    )
    spans = [(name, *match.span(group)) for group, name in enumerate(parts, start=1)]
    digits = next((end - start for name, start, end in spans if name == "fraction"), 0)
    pointless = bool(form.decimals)
    if form.decimals is not None:
        number = match[form.counts[2]]
        if not re.fullmatch(_measured_pattern(form.decimals), number):
            return None
        points = [start - 1 for name, start, end in spans if name == "fraction" and start < end]
        if pointless and (line.count(b".") != 1 + len(points) or _LONGEST_VALUE + digits > _MOST_DIGITS):
            return None
    for name, start, end in [*spans, ("", len(line), len(line))]:
        if name == "fraction" and start == end:
            continue
        while position < start:
            piece = _PIECE.match(line, position, start)
            if piece is None:
                return None
            piece_kind = piece.lastindex or 0
            if "seq" in form.names and piece_kind == _NUMBER and not piece[0].startswith(b"-"):
                piece_kind = _DIGITS  # a number of a line has no sign
            like, length = (
                _LIKE[piece_kind]
                if piece_kind in _LIKE and position < guarded
                else (re.escape(piece[0]), len(piece[0]))
            )
            pattern, longest = pattern + like, longest + length
            numbers += piece_kind in (_NUMBER, _DIGITS)
            position = piece.end()
        if name == "xor":
            pattern, position = pattern + b"[0-9A-Fa-f]{2}", end
        elif name:
            like = _measured_pattern(form.decimals or 0) if name in MEASURED else _LIKE_VALUE.get(name, b"")
            pattern += rb"\d{%d}" % (end - start) if name == "fraction" else like
            longest, position = longest + _LONGEST_VALUE + (form.decimals or 0 if name in MEASURED else 0), end
            if name != "fraction" or not pointless:
                place[name], numbers = numbers, numbers + 1
    if longest > LONGEST_LINE:
        return None  # a line like it could be too long
    values = ["time", *form.counters, *(("a", "illegal") if form.checks else ())]
    taken = np.array([place.get(name, 0) for name in values])
    bits = (32, form.bits, form.bits, 2, 16)
    masks = np.array([(1 << b) - 1 if name in place else 0 for name, b in zip(values, bits, strict=False)])
    compiled = re.compile(rb"(?>%b\n)++" % pattern)
    unguarded, unchecked = len(line) - guarded, len(line) - xor
    return LineShape(compiled, form, numbers, place, taken, masks, digits, pointless, unguarded, unchecked)


def _measured_pattern(decimals: int) -> bytes:
    return rb"[+-]?+\d{1,9}+" + (rb"\.\d{%d}" % decimals if decimals else b"")


class LineParser:
    """Parse the lines of one stream; after two lines in a row with the same labels, other labels are damage.

    alike: See `daq.protocols.lines.Parser`.
    """

    def __init__(self, form: Columns) -> None:
        self.alike: re.Pattern[bytes] | None = None
        self._declared = self._form = form
        self._last: Columns | None = None
        self._shape: LineShape | None = None
        self._missed = MOST_MISSED

    def read(self, line: bytes) -> Row | NoSample:
        match = self._form.pattern.fullmatch(line)
        if match is not None:
            if self._missed >= MOST_MISSED:
                self._use_shape(find_shape(self._form, match))
            return self._form.read_row(match)
        if line.startswith(b"#") or not line.rstrip(b"\r"):
            return NoSample.REMARK
        form = self._declared.match_labels(line) if self._form is self._declared else self._declared
        match = form.pattern.fullmatch(line) if form is not None else None
        if form is None or match is None:
            return NoSample.DAMAGED
        if form == self._last:
            self._form = form
            self._use_shape(find_shape(form, match))
        self._last = form
        return form.read_row(match)

    def read_alike(self, lines: bytes) -> NDArray[np.int64]:
        """Return the values in lines that match `alike`, up to the first one with a value out of range."""
        return self._shape.read(lines) if self._shape is not None else np.empty((0, 1), dtype=np.int64)

    def count_miss(self) -> None:
        """Count a search that found no similar lines."""
        self._missed += 1

    def _use_shape(self, shape: LineShape | None) -> None:
        self._shape, self._missed = shape, 0
        self.alike = None if shape is None else shape.pattern
