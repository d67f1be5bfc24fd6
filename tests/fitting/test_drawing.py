"""What a ranking shows of itself in Python: a short text, tables, and the friction curve."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import daq
import fitting
import processing
from stickslip.errors import DataError

SAMPLES = Path(__file__).resolve().parents[2] / "data_samples"
SLOPE = 9.6  # gamma of the scene, s/m


@pytest.fixture(scope="module")
def ranking():
    return fitting.rank(processing.smooth(daq.load(SAMPLES / "law5.h5")), laws=[5])


def drawn(figure):
    """Return the lines of the picture of all speeds by their names."""
    return {line.get_label(): line.get_xydata() for line in figure.axes[0].lines}


def test_the_text_is_the_verdict_and_the_parameters_with_their_intervals(ranking):
    """It used to be 191,822 characters of arrays; those of the measured curve were most of them."""
    text = repr(ranking)
    assert len(repr(ranking.adequacy)) < 3000
    assert len(text.splitlines()) <= 3
    assert len(text) < 400
    stiffness = ranking.best.parameters["k/m"]
    assert ranking.verdict in text
    assert f"k/m = {stiffness.value:.5f} [{stiffness.lo:.5f}, {stiffness.hi:.5f}] s^-2" in text
    assert repr(replace(ranking, rows=(), verdict="none")) == "<Ranking: none>"


def test_an_interval_that_is_withheld_is_not_in_text_or_table(ranking):
    parameters = {name: replace(item, trusted=False) for name, item in ranking.best.parameters.items()}
    untrusted = replace(ranking, rows=(replace(ranking.best, parameters=parameters),))
    assert "gamma = 9.613 s/m (interval withheld)" in repr(untrusted)
    assert untrusted.to_dataframe()["gamma lo"].isna().all()


def test_what_a_file_says_is_escaped_in_the_table(ranking):
    table = replace(ranking, warnings=("<script>.h5: k & c",))._repr_html_()
    assert "<script" not in table
    assert "&lt;script&gt;.h5: k &amp; c" in table
    assert "hyperbolic" in table


def test_the_data_frame_has_a_row_a_law_with_its_parameters(ranking):
    rows = ranking.to_dataframe()
    assert rows["law"].tolist() == [row.law for row in (*ranking.rows, *ranking.unfitted)]
    assert rows["law"][0] == 5
    assert rows["gamma hi"][0] == ranking.best.parameters["gamma"].hi
    assert rows.attrs["units"]["gamma"] == "s/m"
    unfitted = replace(ranking, rows=()).to_dataframe()
    assert unfitted["law"].tolist() == [row.law for row in ranking.unfitted]
    assert replace(ranking, rows=(), unfitted=()).to_dataframe().empty


def test_the_curve_is_drawn_where_it_was_measured_and_the_law_in_its_band(ranking):
    measured = ranking.adequacy.curve
    lines = drawn(ranking.plot())
    np.testing.assert_array_equal(lines["model-free estimate"], np.c_[measured.speed, measured.friction])
    speed, force = lines["law 5 (hyperbolic)"].T
    np.testing.assert_allclose(force, force[0] / (1 + SLOPE * (speed - speed[0])), rtol=0.01)
    seen = np.interp(measured.speed, speed, force)
    assert ((seen > measured.lo) & (seen < measured.hi)).all()


def test_without_a_measured_curve_the_force_balance_is_drawn_beside_the_law(ranking):
    lines = drawn(replace(ranking, adequacy=replace(ranking.adequacy, curve=None)).plot())
    speed, force = lines["measured"].T
    slip = speed > 0.01
    expected = np.interp(speed[slip], *lines["law 5 (hyperbolic)"].T)
    assert slip.sum() > 1000
    assert np.median(np.abs(force[slip] / expected - 1)) < 0.05


def test_a_ranking_without_laws_says_that_there_is_no_curve(ranking):
    with pytest.raises(DataError, match="no law fits this record even roughly"):
        replace(ranking, rows=()).plot()


def test_a_belt_that_runs_backwards_gives_the_same_picture(ranking):
    mirrored = replace(ranking, motion=replace(ranking.motion, sign=-1.0))
    for change in ({}, {"adequacy": replace(ranking.adequacy, curve=None)}):
        one, other = drawn(replace(ranking, **change).plot()), drawn(replace(mirrored, **change).plot())
        assert one.keys() == other.keys()
        for name, points in one.items():
            np.testing.assert_allclose(other[name], points, rtol=1e-12)
