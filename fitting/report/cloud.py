"""Clouds of points and lines of many points as small images of one colour."""

import struct
import zlib

import numpy as np

from daq.base.compute.arrays import Array

LEVELS = 16  # of the opacity of an image


def along(px: Array, py: Array) -> tuple[Array, Array]:
    """Return points no further apart than one pixel along a line through points (n,)."""
    good = np.isfinite(px + py)
    px, py = px[good], py[good]
    steps = np.maximum(np.ceil(np.maximum(np.abs(np.diff(px)), np.abs(np.diff(py)))), 1).astype(np.int64)
    start = np.repeat(np.arange(steps.size), steps)
    part = (np.arange(start.size) - np.repeat(np.cumsum(steps) - steps, steps)) / steps[start]
    return px[start] + part * (px[start + 1] - px[start]), py[start] + part * (py[start + 1] - py[start])


def dots(px: Array, py: Array, shape: tuple[int, int], size: int, opacity: float) -> Array:
    """Return how far square dots cover an image of this shape, rows by columns."""
    rows, columns = shape
    x, y = np.floor(px).astype(np.int64), np.floor(py).astype(np.int64)
    inside = (x >= 0) & (x < columns) & (y >= 0) & (y < rows)
    count = np.bincount(y[inside] * columns + x[inside], minlength=rows * columns).reshape(shape).astype(np.float32)
    if opacity >= 1:
        count = np.minimum(count, 1)
    for axis in (0, 1):  # a square is a row of columns
        whole, count = count, count.copy()
        for shift in range(1, size):
            step = (shift + 1) // 2 * (1 if shift % 2 else -1)
            to, of = (slice(step, None), slice(None, -step)) if step > 0 else (slice(None, step), slice(-step, None))
            if axis == 0:
                count[to] += whole[of]
            else:
                count[:, to] += whole[:, of]
    return np.asarray(np.minimum(count, 1) if opacity >= 1 else 1 - (1 - opacity) ** count)


def png(cover: Array, colour: str) -> bytes:
    """Return an image of one colour as PNG; ``cover`` (rows, columns) is its opacity, 0 to 1, rounded to `LEVELS`."""
    rows, columns = cover.shape
    opacity = bytes(round(255 * n / (LEVELS - 1)) for n in range(LEVELS))
    data = np.zeros((rows, columns + 1), np.uint8)  # each row begins with the number of its filter
    data[:, 1:] = np.rint(np.clip(cover, 0, 1) * (LEVELS - 1))
    chunks = (
        (b"IHDR", struct.pack(">IIBBBBB", columns, rows, 8, 3, 0, 0, 0)),
        (b"PLTE", bytes.fromhex(colour[1:]) * LEVELS),
        (b"tRNS", opacity),
        (b"IDAT", zlib.compress(data.tobytes(), 6)),
        (b"IEND", b""),
    )
    parts = [
        struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body)) for kind, body in chunks
    ]
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)
