"""Scales, paths and images of the charts."""

import base64
import io
import re

import numpy as np
import pytest
from matplotlib.font_manager import FontProperties, findfont
from matplotlib.ft2font import FT2Font
from PIL import Image

from fitting.drawing.palette import RUNS, run_colour, run_dash, run_mark
from fitting.report.chart import Axes, picture, text_width
from fitting.report.scale import AxisScale


@pytest.mark.parametrize(
    ("scale", "labels"),
    [
        (AxisScale(-0.31, 0.52), ["−0.2", "0", "0.2", "0.4"]),
        (AxisScale(1234.0, 1236.1), ["1234", "1234.5", "1235", "1235.5", "1236"]),
        (AxisScale(0.9, 1.1e4, log=True), ["1", "10", "100", "1000", "10000"]),
        (AxisScale(1.7, 9.2, log=True), ["2", "3", "5"]),
        (AxisScale(-0.6, 1.4, names=("law 1", "law 2")), ["law 1", "law 2"]),
    ],
)
def test_ticks_are_round_and_not_too_many(scale, labels):
    assert [label for _, label in scale.ticks(6)] == labels


def test_a_scale_holds_all_finite_values_and_equal_ones():
    scale = AxisScale.around(np.array([3.0, np.nan, 7.0]))
    assert 0 < scale.place(np.array(3.0)) < scale.place(np.array(7.0)) < 1
    assert AxisScale.around(np.array([5.0, 5.0])).place(np.array(5.0)) == pytest.approx(0.5)
    assert AxisScale.around(np.array([0.0, 1.0, 100.0]), log=True).low > 0


def test_a_line_breaks_where_a_value_is_missing_and_words_are_escaped():
    axes = Axes(0, 0, 200, 150, AxisScale(0.0, 3.0), AxisScale(0.0, 1.0), title="a < b")
    axes.line(np.arange(4.0), np.array([0.0, 1.0, np.nan, 0.5]), "#123456", label="x & y")
    drawn = picture("one", 200, 150, [axes], "a < b")
    path = re.search('stroke="#123456"[^>]* d="([^"]+)"', drawn)[1]
    assert (path.count("M"), path.count("L")) == (2, 1)
    assert "a &lt; b" in drawn
    assert "x &amp; y" in drawn


def test_dots_and_traces_lie_where_their_values_are():
    axes = Axes(0, 0, 200, 150, AxisScale(0.0, 1.0), AxisScale(0.0, 1.0))
    axes.cloud(np.array([0.25, 7.0]), np.array([0.75, 0.5]), "#ff0000", opacity=1.0)
    axes.trace([(np.array([0.0, 1.0]), np.array([0.5, 0.5]))], "#0000ff", opacity=0.5)
    found = re.findall('base64,([^"]+)"', picture("one", 200, 150, [axes], "a < b"))
    cloud, trace = (np.asarray(Image.open(io.BytesIO(base64.b64decode(one))).convert("RGBA")) for one in found)
    rows, columns = cloud.shape[:2]
    y, x = np.nonzero(cloud[:, :, 3])
    assert np.mean(x) / columns == pytest.approx(0.25, abs=0.02)
    assert np.mean(y) / rows == pytest.approx(0.25, abs=0.02)
    assert x.size < 20
    seen = trace[:, :, 3] > 0
    assert seen.any(axis=0).mean() > 0.98  # from one side to the other
    assert np.mean(np.nonzero(seen)[0]) / rows == pytest.approx(0.5, abs=0.02)
    assert int(trace[:, :, 3].max()) == pytest.approx(128, abs=10)


def test_a_legend_leaves_each_label_its_width_in_a_broad_font():
    # The labels of a legend overlapped where the browser had no font narrower than DejaVu Sans.
    font = FT2Font(findfont(FontProperties(family="DejaVu Sans")))
    font.set_size(10.0, 72.0)
    for words in ("model minus measurement", "noise, ±2 sd", "measured, without a law", "belt speed", "law 5, fitted"):
        font.set_text(words)
        # Behind each label 8 px are free and 4 px lie between two.
        assert font.get_width_height()[0] / 64.0 < text_width(words, 10.0) + 12.0, words
        assert text_width(words, 10.0) < 1.25 * font.get_width_height()[0] / 64.0, words


def test_a_dashed_trace_is_drawn_in_its_dashes():
    axes = Axes(0, 0, 200, 150, AxisScale(0.0, 1.0), AxisScale(0.0, 1.0))
    line = [(np.array([0.0, 1.0]), np.array([0.5, 0.5]))]
    axes.trace(line, "#0000ff", dash="12 6", label="dashed")
    drawn = picture("one", 200, 150, [axes], "a dashed line")
    found = Image.open(io.BytesIO(base64.b64decode(re.search('base64,([^"]+)"', drawn)[1])))
    columns = (np.asarray(found.convert("RGBA"))[:, :, 3] > 0).any(axis=0)
    left, _, right, _ = axes.frame
    assert np.count_nonzero(np.diff(columns.astype(int)) == -1) == pytest.approx((right - left) / 18, abs=1)
    dashes = np.ceil((right - left) / 18)
    assert columns.mean() == pytest.approx(12 * dashes / (right - left), abs=0.06)  # each is a dot's width longer
    assert 'stroke-dasharray="12 6"' in drawn  # in the legend too


def lightness(colour):
    """Return L* of a colour (CIE 1976), 0 for black and 100 for white."""
    parts = np.array([int(colour[at : at + 2], 16) for at in (1, 3, 5)]) / 255
    linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
    luminance = float(linear @ [0.2126, 0.7152, 0.0722])
    return 116 * luminance ** (1 / 3) - 16 if luminance > 0.008856 else 903.3 * luminance


def test_runs_of_a_joint_fit_differ_in_greyscale():
    """They differed in hue alone: the lightnesses of the first, the second and the seventh were 42, 46 and 43."""
    numbers = range(1, len(RUNS) + 1)
    for one in numbers:
        assert lightness(run_colour(one)) < 75, "too pale on white"
        for other in range(1, one):
            apart = abs(lightness(run_colour(one)) - lightness(run_colour(other)))
            drawn_alike = run_dash(one) == run_dash(other)
            assert drawn_alike == (run_mark(one) == run_mark(other))
            assert apart > 20 or not drawn_alike, (one, other)
