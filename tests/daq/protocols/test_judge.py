"""Lines are judged piece by piece as they come: the pieces make together what one piece is."""

import random
from dataclasses import fields
from itertools import pairwise

import numpy as np
import pytest

from daq import protocols
from daq.protocols.session import decode_whole

# Header, interval in us, and a line of a time in us and a count.
FORMS = {
    "net": ({"protocol": "text", "columns": "t_us,count"}, 1000, lambda t, c: b"%d,%d\n" % (t % 2**32, c)),
    "odd rate": ({"protocol": "text", "columns": "t_us,count"}, 1e6 / 3000, lambda t, c: b"%d,%d\n" % (t % 2**32, c)),
    "two": (
        {"protocol": "text", "columns": "t_us,up:16,down:16"},
        2000,
        lambda t, c: b"%d,%d,%d\r\n" % (t % 2**32, max(c, 0) % 2**16, max(-c, 0) % 2**16),
    ),
    "coarse": ({"protocol": "text", "columns": "t_ms,count"}, 1000, lambda t, c: b"%d,%d\n" % (t // 1000 % 2**32, c)),
    "labelled": ({"protocol": "text", "columns": None}, 5000, lambda t, c: b"t=%d, pos=%d\n" % (t % 2**32, c)),
    "qsb": (
        {"protocol": "qsb"},
        1e6 / 512,
        lambda t, c: b"s0E%08X%08X!\n" % (c % 2**32, round(t / (1e6 / 512)) % 2**32),
    ),
}


def reads_of(form, damaged, n):
    """Return the reads of n lines: with late ones, gaps, starts, an endless line, a roll-over, and 5 % damaged."""
    _, period, line = FORMS[form]
    draw = random.Random(form)
    time, count, speed, lines = 2**32 - 300 * period, -300, 7, []
    for k in range(n):
        time += period * draw.choices((1, 3, 40, 70_000), (500, 5, 5, 1))[0]
        if k in (n // 3, n // 2):
            time, count = 3 * period, 0
            lines.append(b"QSB-S  0E!\n" if form == "qsb" else b"# hello\n")
        if k == n // 4:
            lines.append(b"7" * 700 + b"\n")
        speed += draw.randrange(-9, 10)
        count += speed + draw.choices((0, 3000), (300, 1))[0]
        late = draw.choices((0, draw.random() * period * 1.2), (9, 1))[0]
        lines.append(line(int(time + late), count))
    lines, _ = damaged(lines, 5, 0.05)
    lines[100:100] = [line(2**31, 5)] * 100  # lines out of order for longer than any judgement looks ahead
    data = b"".join(lines)
    cuts = sorted({0, len(data), *(draw.randrange(len(data)) for _ in range(len(data) // 90))})
    return [(1000 * a, data[a:b]) for a, b in pairwise(cuts)]


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("piece", [1, 900])
def test_the_pieces_of_lines_make_no_difference(form, piece, damaged):
    header, period, _ = FORMS[form]
    header = header | {"rate_hz": 1e6 / period}
    backend = protocols.load(header["protocol"])
    reads = reads_of(form, damaged, 600)
    whole = decode_whole(backend, reads, header)
    assert len(whole.n) > 400
    assert len(whole.crc_frame) > 20
    assert len(whole.idents) >= 2
    pieces = list(backend.decode_pieces(reads, header, piece))
    assert len(pieces) > 3
    before = np.cumsum([0, *(len(piece.n) for piece in pieces)])
    for field in fields(whole):
        expected, found = getattr(whole, field.name), [getattr(piece, field.name) for piece in pieces]
        if field.name in ("first", "idents", "crc_frame"):
            found = [values + k for k, values in zip(before, found, strict=False)]
        if isinstance(expected, np.ndarray):
            assert expected.dtype == found[0].dtype, field.name
            assert np.array_equal(expected, np.concatenate(found)), field.name
        elif field.name == "crc_errors":
            assert expected == sum(found), field.name
        else:
            assert all(value == expected for value in found), field.name
