"""Charts as SVG text inside a page: axes with ticks, lines, bands, marks, and clouds as images.

Matplotlib took 4 s of CPU time for the ten pictures of a report, half of a whole `fit-friction`; these take 0.4 s.
"""

import base64
import html
import math
import struct
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from fitting.report.scale import AxisScale
from stickslip.compute.arrays import Array

FONT, SMALL = 11.0, 10.0  # sizes, px
THIN, BROAD = frozenset(" !'()*,-./:;I[]fijlrt|"), frozenset("%MWmw")
WIDTHS = 0.39, 0.63, 0.93  # of thin, other and broad characters over their size, in the broadest usual font (DejaVu)
LEFT, RIGHT, BOTTOM = 54.0, 8.0, 38.0  # px beside the axes: tick labels
TITLE, ROW, CLOSE = 19.0, 15.0, 4.0  # px above them: title, a row of the legend, nothing
GRID, FRAME = "#e3e3e3", "#444444"
DENSITY, FINER = 2, 2  # image pixels per px; points drawn per image pixel, whose mean smooths the edges
FAR = 4.0  # fields beyond the edge: there longer numbers help nobody
OPACITIES = 16  # steps of the opacity of an image
MOST_TICKS, PX_PER_TICK = 6, (62.0, 34.0)  # along x and y


@dataclass(eq=False)
class Axes:
    """Axes of one picture and their contents; lengths in px, x to the right and y down."""

    left: float  # of all, title and labels included
    top: float
    width: float
    height: float
    x: AxisScale
    y: AxisScale
    title: str = ""
    xlabel: str = ""
    ylabel: str = ""
    rows: int = 1  # rows that the legend may take
    margin: float = LEFT  # left of the field
    over: bool = False  # whether other axes of the same x stand close below and bear its labels
    _drawn: list[str] = field(default_factory=list)
    _legend: list[tuple[str, str]] = field(default_factory=list)

    @property
    def frame(self) -> tuple[float, float, float, float]:
        """Left, top, right and bottom of the field, px."""
        top = self.top + (TITLE if self.title else CLOSE) + ROW * self.rows
        return self.left + self.margin, top, self.left + self.width - RIGHT, self.top + self.height - self.foot

    @property
    def foot(self) -> float:
        return CLOSE if self.over else BOTTOM

    def _at(self, x: Array, y: Array) -> tuple[Array, Array]:
        left, top, right, bottom = self.frame
        px = np.clip(self.x.place(np.asarray(x, float)), -FAR, FAR)
        py = np.clip(self.y.place(np.asarray(y, float)), -FAR, FAR)
        return left + (right - left) * px, bottom - (bottom - top) * py

    def key(self, label: str, colour: str, dash: str = "") -> None:
        """Add a line to a legend elsewhere."""
        self._key(label, f'<path {_stroke(colour, 0.8, dash)} d="M0,0h18"/>')

    def _key(self, label: str | None, sign: str) -> None:
        if label:
            self._legend.append((label, sign))

    def line(
        self, x: Array, y: Array, colour: str, *, width: float = 1.2, dash: str = "", label: str | None = None
    ) -> None:
        """Draw a line through points (n,), interrupted where one is not finite."""
        px, py = self._at(x, y)
        style = _stroke(colour, width, dash)
        self._drawn.append(f'<path {style} stroke-linejoin="round" d="{_path(px, py)}"/>')
        self._key(label, f'<path {style} d="M0,0h18"/>')

    def level(
        self, value: float, colour: str, *, dash: str = "", upright: bool = False, label: str | None = None
    ) -> None:
        """Draw a line across the field at a value of y, or of x where ``upright``."""
        ends = np.array([self.x.low, self.x.high] if not upright else [self.y.low, self.y.high])
        same = np.full(2, value)
        x, y = (same, ends) if upright else (ends, same)
        self.line(x, y, colour, width=0.8, dash=dash, label=label)

    def band(self, x: Array, low: Array, high: Array, colour: str, *, opacity: float, label: str | None = None) -> None:
        """Fill between two curves (n,)."""
        px, py = self._at(np.concatenate((x, x[::-1])), np.concatenate((low, high[::-1])))
        style = f'fill="{colour}" fill-opacity="{opacity:g}"'
        self._drawn.append(f'<path {style} d="{_path(px, py)}Z"/>')
        self._key(label, f'<rect {style} y="-5" width="18" height="10"/>')

    def marks(
        self, x: Array, y: Array, colour: str, *, sign: str = "o", size: float = 3.0, label: str | None = None
    ) -> None:
        """Draw marks at points (n,): ``o`` a disc, ``c`` a circle, ``|`` a stroke."""
        px, py = self._at(x, y)
        if sign == "|":
            style, shape = f'stroke="{colour}" stroke-width="1.1"', f"m0,{-size:g}v{2 * size:g}"
        else:
            inner = "#fff" if sign == "c" else colour
            half = f"a{size:g},{size:g} 0 1 0 "
            shape = f"m{-size:g},0{half}{2 * size:g},0{half}{-2 * size:g},0"
            style = f'fill="{inner}" stroke="{colour}" stroke-width="{1.1 if sign == "c" else 0:g}"'
        path = "".join(f"M{a:.1f},{b:.1f}{shape}" for a, b in zip(px, py, strict=True) if math.isfinite(a + b))
        self._drawn.append(f'<path {style} d="{path}"/>')
        self._key(label, f'<path {style} d="M9,0{shape}"/>')

    def bars(self, low: Array, high: Array, size: Array, colour: str) -> None:
        """Draw upright bars from 0 to ``size`` between ``low`` and ``high``, (n,) each."""
        for a, b, y in zip(low, high, size, strict=True):
            px, py = self._at(np.array([a, a, b, b]), np.array([0.0, y, y, 0.0]))
            self._drawn.append(f'<path fill="{colour}" fill-opacity="0.55" stroke="#fff" d="{_path(px, py)}Z"/>')

    def text(self, x: float, y: float, words: str, shift: tuple[float, float] = (4.0, 3.5)) -> None:
        """Write words next to a point; ``shift`` is in px."""
        px, py = self._at(np.array([x]), np.array([y]))
        self._drawn.append(_text(float(px[0]) + shift[0], float(py[0]) + shift[1], words, SMALL))

    def cloud(
        self, x: Array, y: Array, colour: str, *, size: float = 1.4, opacity: float = 0.5, label: str | None = None
    ) -> None:
        """Draw many dots (n,) as an image, darker where they overlap."""
        self._image(lambda shape, fine: _dots(*self._fine(x, y, fine), shape, round(size * fine), opacity), colour)
        self._key(label, f'<circle cx="9" r="3" fill="{colour}"/>')

    def trace(
        self,
        parts: Sequence[tuple[Array, Array]],
        colour: str,
        *,
        width: float = 1.0,
        opacity: float = 1.0,
        dash: str = "",
        label: str | None = None,
    ) -> None:
        """Draw many lines of many points, (n,) each, as an image; ``dash`` as of a path, px along the line."""

        def drawn(shape: tuple[int, int], fine: float) -> Array:
            points = [_dashed(*_along(*self._fine(x, y, fine)), dash, fine) for x, y in parts if x.size > 1]
            px, py = (np.concatenate(one) for one in zip(*points, strict=True)) if points else np.empty((2, 0))
            return opacity * np.minimum(_dots(px, py, shape, max(round(width * fine), 1), 1.0), 1.0)

        self._image(drawn, colour)
        style = _stroke(colour, max(width, 1.2), dash)
        self._key(label, f'<path {style} stroke-opacity="{opacity:g}" d="M0,0h18"/>')

    def _fine(self, x: Array, y: Array, fine: float) -> tuple[Array, Array]:
        left, top, _, _ = self.frame
        px, py = self._at(x, y)
        return (px - left) * fine, (py - top) * fine

    def _image(self, drawn: Callable[[tuple[int, int], float], Array], colour: str) -> None:
        left, top, right, bottom = self.frame
        fine = DENSITY * FINER
        rows, columns = math.ceil((bottom - top) * DENSITY), math.ceil((right - left) * DENSITY)
        cover = drawn((rows * FINER, columns * FINER), fine).reshape(rows, FINER, columns, FINER).mean(axis=(1, 3))
        data = base64.b64encode(_png(cover, colour)).decode()
        size = f'x="{left:.1f}" y="{top:.1f}" width="{columns / DENSITY:g}" height="{rows / DENSITY:g}"'
        self._drawn.append(f'<image {size} preserveAspectRatio="none" href="data:image/png;base64,{data}"/>')

    def svg(self, name: str) -> str:
        """Return the axes as SVG; ``name`` must be unique on the page."""
        left, top, right, bottom = self.frame
        lines, words = [], []
        most = [
            max(2, min(MOST_TICKS, int(size / px)))
            for size, px in zip((right - left, bottom - top), PX_PER_TICK, strict=True)
        ]
        for value, label in self.x.ticks(most[0]):
            at = left + (right - left) * float(self.x.place(np.array(value)))
            lines.append(f"M{at:.1f},{top:.1f}V{bottom:.1f}")
            words.append("" if self.over else _text(at, bottom + 13, label, SMALL, "middle"))
        for value, label in self.y.ticks(most[1]):
            at = bottom - (bottom - top) * float(self.y.place(np.array(value)))
            if not self.y.names:
                lines.append(f"M{left:.1f},{at:.1f}H{right:.1f}")
            words.append(_text(left - 5, at + 3.5, label, SMALL, "end"))
        middle = 0.5 * (top + bottom)
        words.append(_text(0.5 * (left + right), bottom + 30, self.xlabel, FONT, "middle"))
        turned = f' transform="rotate(-90 {self.left + 11:.1f} {middle:.1f})"'
        words.append(_text(self.left + 11, middle, self.ylabel, FONT, "middle", turned) if self.ylabel else "")
        words.append(_text(left, self.top + 12, self.title, FONT, more=' font-weight="600"') if self.title else "")
        size = f'x="{left:.1f}" y="{top:.1f}" width="{right - left:.1f}" height="{bottom - top:.1f}"'
        corner = f"M{left:.1f},{top:.1f}V{bottom:.1f}H{right:.1f}"
        return "".join(
            (
                f'<clipPath id="{name}"><rect {size}/></clipPath>',
                f'<path stroke="{GRID}" stroke-width="0.7" d="{"".join(lines)}"/>',
                f'<g clip-path="url(#{name})">{"".join(self._drawn)}</g>',
                f'<path stroke="{FRAME}" stroke-width="0.8" fill="none" d="{corner}"/>',
                *words,
                *self._legend_rows(),
            )
        )

    def _legend_rows(self) -> list[str]:
        """Return the legend above the field, from left to right, in rows."""
        left, top, right, _ = self.frame
        first, drawn = top - ROW * self.rows + 7.0, []
        places = _legend_places([label for label, _ in self._legend], right - left)
        for (label, sign), (x, row) in zip(self._legend, places, strict=True):
            at = f"{left + x:.1f} {first + ROW * row:.1f}"
            drawn.append(f'<g transform="translate({at})">{sign}{_text(22, 3.5, label, SMALL)}</g>')
        return drawn


def text_width(words: str, size: float) -> float:
    """Return the approximate width of a text in the broadest usual font, px."""
    thin, other, broad = WIDTHS
    return size * sum(thin if letter in THIN else broad if letter in BROAD else other for letter in words)


def legend_rows(labels: Sequence[str], width: float) -> int:
    """Return the number of legend rows above axes of this ``width``, px."""
    return 1 + max((row for _, row in _legend_places(labels, width - LEFT - RIGHT)), default=0)


def _legend_places(labels: Sequence[str], width: float) -> list[tuple[float, int]]:
    """Return left end, px, and row of each label of a legend over a field of this ``width``."""
    x, row, places = 0.0, 0, []
    for label in labels:
        taken = 30.0 + text_width(label, SMALL)
        if x + taken > width + 12.0 and x > 0:
            x, row = 0.0, row + 1
        places.append((x, row))
        x += taken + 4.0
    return places


def picture(name: str, width: float, height: float, axes: Sequence[Axes], about: str) -> str:
    """Return axes as an ``<svg>`` element with a unique ``name``; ``about`` is the text alternative."""
    inner = "".join(one.svg(f"{name}-{number}") for number, one in enumerate(axes))
    named = f'role="img" aria-label="{html.escape(about)}"'
    head = f'<svg viewBox="0 0 {width:g} {height:g}" {named} font-family="sans-serif" fill="#222222"'
    return f'{head} style="width:100%;height:auto;max-width:{1.35 * width:g}px">{inner}</svg>'


def _text(x: float, y: float, words: str, size: float, anchor: str = "start", more: str = "") -> str:
    place = f'x="{x:.1f}" y="{y:.1f}" font-size="{size:g}" text-anchor="{anchor}"'
    return f"<text {place}{more}>{html.escape(words)}</text>" if words else ""


def _stroke(colour: str, width: float, dash: str) -> str:
    more = f' stroke-dasharray="{dash}"' if dash else ""
    return f'fill="none" stroke="{colour}" stroke-width="{width:g}"{more}'


def _path(px: Array, py: Array) -> str:
    """Return a path through points (n,), without repeated ones."""
    parts, before, down = [], "", False
    for a, b in zip(px.tolist(), py.tolist(), strict=True):
        if not math.isfinite(a + b):
            down = False
            continue
        point = f"{a:.1f},{b:.1f}"
        if not down or point != before:
            parts.append(("L" if down else "M") + point)
        before, down = point, True
    return "".join(parts)


def _along(px: Array, py: Array) -> tuple[Array, Array]:
    """Return points at most one pixel apart along a line through points (n,)."""
    good = np.isfinite(px + py)
    px, py = px[good], py[good]
    steps = np.maximum(np.ceil(np.maximum(np.abs(np.diff(px)), np.abs(np.diff(py)))), 1).astype(np.int64)
    start = np.repeat(np.arange(steps.size), steps)
    part = (np.arange(start.size) - np.repeat(np.cumsum(steps) - steps, steps)) / steps[start]
    return px[start] + part * (px[start + 1] - px[start]), py[start] + part * (py[start + 1] - py[start])


def _dashed(px: Array, py: Array, dash: str, fine: float) -> tuple[Array, Array]:
    """Return the points of a line within its dashes; ``fine`` is the number of image pixels per px."""
    if not dash or not px.size:
        return px, py
    ends = fine * np.cumsum([float(length) for length in dash.split()])
    along = np.concatenate(([0.0], np.cumsum(np.hypot(np.diff(px), np.diff(py))))) % ends[-1]
    shown = np.searchsorted(ends, along, side="right") % 2 == 0
    return px[shown], py[shown]


def _dots(px: Array, py: Array, shape: tuple[int, int], size: int, opacity: float) -> Array:
    """Return the coverage of an image of this shape (rows, columns) by square dots."""
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


def _png(cover: Array, colour: str) -> bytes:
    """Return an image of one colour as PNG; ``cover`` (rows, columns) is its opacity, 0 to 1, in `OPACITIES` steps."""
    rows, columns = cover.shape
    opacity = bytes(round(255 * n / (OPACITIES - 1)) for n in range(OPACITIES))
    data = np.zeros((rows, columns + 1), np.uint8)  # each row begins with the number of its filter
    data[:, 1:] = np.rint(np.clip(cover, 0, 1) * (OPACITIES - 1))
    chunks = (
        (b"IHDR", struct.pack(">IIBBBBB", columns, rows, 8, 3, 0, 0, 0)),
        (b"PLTE", bytes.fromhex(colour[1:]) * OPACITIES),
        (b"tRNS", opacity),
        (b"IDAT", zlib.compress(data.tobytes(), 6)),
        (b"IEND", b""),
    )
    parts = [
        struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body)) for kind, body in chunks
    ]
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)
