"""Inputs that are almost right: bytes and numbers of valid ones, changed by chance."""

import random
import re
from collections.abc import Sequence

NUMBERS = (
    *b"0 -0 -1 1e300 -1e300 1e-310 1e400 nan inf -inf 0x7f 1_0 1. .5 127 128 255 256 32767 32768 65535 65536".split(),
    *b"2147483647 2147483648 4294967295 4294967296 9223372036854775807 9223372036854775808 1e12".split(),
    *(b"9" * 400, b"9" * 5000),
)
TOKENS = (b"", b"\0", b"\xff", b"\xef\xbb\xbf", *(bytes([each]) for each in b"\r\n\f\x85\"'\\=[{,;"))
_NUMBER = re.compile(rb"[-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")


def bytewise(draw: random.Random, content: bytes, others: Sequence[bytes] = ()) -> bytes:
    """Return content with one to four changes of single bytes and of pieces; now and then with a piece of another."""
    made = bytearray(content)
    for _ in range(draw.choice((1, 1, 1, 2, 4))):
        at = draw.randrange(len(made) + 1)
        end = min(len(made), at + draw.choice((1, 1, 2, 4, 8, 64)))
        match draw.randrange(8):
            case 0 | 1 if at < len(made):
                made[at] ^= 1 << draw.randrange(8)
            case 2 if at < len(made):
                made[at] = draw.choice((0, 1, 127, 128, 255, draw.randrange(256)))
            case 3:
                del made[at:end]
            case 4:
                made[at:at] = made[at:end] * draw.choice((1, 2, 50))
            case 5:
                made[at:end] = draw.randbytes(end - at)
            case 6 if others:
                other = draw.choice(others)
                begin = draw.randrange(len(other) + 1)
                made[at:end] = other[begin : begin + 64]
            case 7 if draw.random() < 0.3:
                del made[at:]
    return bytes(made)


def textual(draw: random.Random, content: bytes, others: Sequence[bytes] = ()) -> bytes:
    """Return text with a number or a piece replaced by an awkward one, a line repeated or moved; or `bytewise`."""
    kind = draw.randrange(5)
    if kind == 0:
        return bytewise(draw, content, others)
    if kind == 1:
        at = draw.randrange(len(content) + 1)
        end = at + draw.choice((0, 0, 1, 3))
        return content[:at] + draw.choice(TOKENS) * draw.choice((1, 1, 1, 2, 3000)) + content[end:]
    if kind == 2:
        lines = content.split(b"\n")
        at = draw.randrange(len(lines))
        lines.insert(draw.randrange(len(lines)), lines[at])
        if draw.random() < 0.5:
            del lines[at]
        return b"\n".join(lines)
    found = list(_NUMBER.finditer(content))
    if not found:
        return bytewise(draw, content, others)
    number = draw.choice(found)
    return content[: number.start()] + draw.choice(NUMBERS) + content[number.end() :]
