"""What tests of protocols share."""

import random

import pytest


@pytest.fixture(scope="session")
def damaged():
    """Return a function that damages lines at random."""
    return _damaged


def _damaged(lines, seed, share=0.1):
    """Return lines of which a share, not among the first four, is damaged, and which are.

    Damage is a flipped bit, a lost or an inserted byte, or a burst of eight.
    """
    draw = random.Random(seed)
    changed = set()
    lines = list(lines)
    for k, line in enumerate(lines):
        if draw.random() < share and k > 3:
            piece = bytearray(line)
            at = draw.randrange(len(piece))
            kind = draw.randrange(4)
            if kind == 0:
                piece[at] ^= 1 << draw.randrange(8)
            elif kind == 1:
                del piece[at]
            elif kind == 2:
                piece.insert(at, draw.randrange(256))
            else:
                piece[at : at + 8] = draw.randbytes(len(piece[at : at + 8]))
            lines[k] = bytes(piece)
            changed.add(k)
    return lines, changed
