"""The pictures of a page: legends have room, numbers are as matplotlib wrote them, runs and laws are told apart."""

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from fitting import drawing
from fitting.palette import RUNS, run_colour, run_dash, run_mark
from fitting.report import pictures


@pytest.mark.parametrize("picture", pictures.PICTURES, ids=lambda picture: picture.__name__)
def test_a_legend_stays_inside_its_picture_in_a_broad_font(picture, ranked):
    """Where the browser had no font narrower than DejaVu Sans the labels of a legend overlapped."""
    with drawing.look():
        drawn, _ = picture(ranked(law=5))
        renderer = FigureCanvasAgg(drawn).get_renderer()
        for legend in drawn.legends:
            box = legend.get_window_extent(renderer)
            assert box.x1 <= drawn.bbox.x1 + 1
            assert all(box.y0 >= axes.title.get_window_extent(renderer).y0 for axes in drawn.axes)


def test_coordinates_are_shortened_and_words_are_not():
    """Ticks at 0.025 and 0.05 once read 0.03 and 0.05."""
    with drawing.look():
        drawn = Figure(figsize=(3, 2))
        drawn.subplots().plot([0.0, 0.05], [0, 1 / 3])
        drawn.axes[0].set(xticks=[0, 0.025, 0.05], title="a < b")
        text = pictures.embed(drawn, "x & y", "one")
    assert ">0.025</text>" in text
    assert ">a &lt; b</text>" in text
    assert 'aria-label="x &amp; y"' in text
    assert len(text) < 8000


def test_a_line_of_each_law_is_told_apart_without_its_colour(ranked):
    ranking = ranked(law=5)
    with drawing.look():
        drawn, _ = pictures.laws(ranking)
    lines = {line.get_label(): line for line in drawn.axes[0].lines}
    names = [row.name for row in ranking.rows if isinstance(row.law, int)]
    assert len({str(lines[name]._dash_pattern) for name in names}) == len(names) == 6


def test_the_fit_is_never_above_the_belts_speed(ranked):
    """The phase portraits had curls above the belt's speed, and velocities of one-sided differences at break-aways."""
    row = ranked(law=5).best
    _, _, velocity = pictures.fitted_motion(row, row.motion.sign)
    assert np.nanmax(velocity) < 1.001 * row.fit.values.v_dr


def test_a_typeset_label_is_plain_in_the_table_of_a_figure():
    drawn = Figure()
    drawn.subplots().plot([1.0, 2.0], [3.0, np.nan], label=r"$v_\mathrm{dr}$")
    drawn.axes[0].set(xlabel="slip speed $s$ (m/s)", ylabel="a,b")
    assert pictures.as_csv(drawn).splitlines()[1:] == [',v_dr,slip speed s (m/s),"a,b",1,3']


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
