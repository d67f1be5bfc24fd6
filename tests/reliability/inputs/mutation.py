"""Inputs that are almost right: bytes and numbers of valid ones, changed by chance."""

import random
import re
from collections.abc import Sequence

NUMBERS = (
    *(
        b"0",
        b"-0",
        b"-1",
        b"1e300",
        b"-1e300",
        b"1e-310",
        b"1e400",
        b"nan",
        b"inf",
        b"-inf",
        b"0x7f",
        b"1_0",
        b"1.",
        b".5",
    ),
    *(b"127", b"128", b"255", b"256", b"32767", b"32768", b"65535", b"65536", b"2147483647", b"2147483648"),
    *(b"4294967295", b"4294967296", b"9223372036854775807", b"9223372036854775808", b"1e12", b"9" * 400, b"9" * 5000),
)
TOKENS = (
    b"",
    b"\0",
    b"\xff",
    b"\xef\xbb\xbf",
    b"\r",
    b"\n",
    b"\f",
    b"\x85",
    b'"',
    b"'",
    b"\\",
    b"=",
    b"[",
    b"{",
    b",",
    b";",
)
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
