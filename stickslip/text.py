r"""Text from boards, files, paths and people, as a file can hold it and as a terminal may show it.

A control character in such text could move the cursor, change colours or the window's title, or hide what was printed
before.  `printable` writes these as ``\x1b``; `storable` writes as ``\x00`` and ``\xff`` the little that HDF5 and UTF-8
cannot hold: NUL, and the bytes of a path that are no UTF-8, which Python keeps as halves of surrogate pairs.  The
escaped forms are for reading: a backslash that was there already stays as it is.
"""

import codecs
import re

_NOT_STORABLE = re.compile("[\0\ud800-\udfff]")
# C0 without tab and line feed, DEL, C1; line and paragraph separators; embeddings, overrides and isolates of text from
# right to left, which reorder what stands beside them (the marks U+200E and U+200F do not, and belong to such text).
_NOT_PRINTABLE = re.compile("[\0-\x08\x0b-\x1f\x7f-\x9f\u2028-\u202e\u2066-\u2069\ud800-\udfff]")
# How characters that the commands print are spelled where an encoding lacks them.
_SPELLED = {"…": "...", "±": "+-", "−": "-", "–": "-", "×": "x", "°": " deg", "µ": "u", "μ": "u"}
SPELLED = "stickslip-spelled"  # the name of the error handler, for streams


def storable(text: str) -> str:
    """Return a text that HDF5 and UTF-8 can hold; one that they can hold already is returned as it is."""
    return _NOT_STORABLE.sub(_escaped, text)


def printable(text: str, encoding: str | None = None) -> str:
    """Return a text that does nothing to a terminal but stand there.

    text: Line feeds and tabs stay.
    encoding: That of the stream: characters that it lacks are spelled in ASCII (``...``, ``+-``), or escaped.
    """
    shown = _NOT_PRINTABLE.sub(_escaped, text)
    return shown if encoding is None else shown.encode(encoding, SPELLED).decode(encoding)


def _escaped(character: "re.Match[str]") -> str:
    code = ord(character[0])
    if 0xDC80 <= code <= 0xDCFF:
        code -= 0xDC00  # a byte that was no UTF-8
    return f"\\x{code:02x}" if code < 0x100 else f"\\u{code:04x}"


def _spelled(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    lacking = error.object[error.start : error.end]
    words = (_SPELLED.get(letter) or letter.encode("ascii", "backslashreplace").decode() for letter in lacking)
    return "".join(words), error.end


codecs.register_error(SPELLED, _spelled)
