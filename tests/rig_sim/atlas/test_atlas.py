"""The atlas: which figures it has, the files and tables it writes, and its numbers against published ones."""

from functools import cache

import pytest
from PIL import Image

from rig_sim.atlas.figure import Computed
from rig_sim.atlas.redraw import redraw, select_figures, sort_key
from rig_sim.atlas.registry import ENTRIES, NOT_REDRAWN
from rig_sim.atlas.statements import compute_drawing
from stickslip.errors import InputError

from ..shared import CHAPTERS, LIMIT_CYCLES, answer


@cache
def draw_once(figure):
    return ENTRIES[figure]().table


SHAKER = CHAPTERS["chapter6"]["phase_shift_control"]
LAWS = {case["params"]["law"]: case for case in LIMIT_CYCLES["cases"] if case["params"].keys() == {"law"}}
PUBLISHED = [  # figure, its first numbers by quantity: published value and tolerance
    ("2.15", {"smallest velocity": (float(LAWS[4]["v_min"]), 1e-12)}),
    ("2.18", {"duration of the later sticks": (float(LAWS[5]["t_stick"]), 1e-12)}),
    ("2.21", {"largest velocity on the cycle, above the belt's": (float(LAWS[6]["v_max"]), 1e-12)}),
    (
        "6.10",
        {
            "least amplification at phi = pi": (SHAKER["phi_pi"]["S=0.3 delta=0"], SHAKER["tol"]),
            "optimum phase (pi), at a = 0.5": (SHAKER["optimum_phi_over_pi"]["a=0.5"], 5e-5),
        },
    ),
]
SLOW = [
    ("6.3", {"period in break-aways at omega = 0.3": (1.0, 0.0)}),
    ("6.4", {"period in break-aways at omega = 0.41": (2.0, 0.0)}),
]
AGREEING = [  # figure, whether each of its statements agrees with the thesis
    ("3.20", [True, True]),
    ("3.22", [True]),
    ("5.5", [True, False]),
    ("6.5", [False]),
    ("6.7", [True, True]),
    ("6.13", [True, True, False, True]),
    ("6.16", [True, True, False, True]),
]


def test_figures_are_asked_for_by_number_or_chapter_in_the_order_of_the_thesis():
    assert select_figures(["2.10", "2.9"]) == ["2.9", "2.10"]
    assert select_figures(["2", "2.7"])[:3] == ["2.6", "2.7", "2.8"]
    assert select_figures(None) == sorted({*ENTRIES, *NOT_REDRAWN}, key=sort_key)


def test_words_that_name_no_computed_number_are_refused_with_the_nearest_one():
    with pytest.raises(InputError, match=r"figure 2.6 in chapter2.toml: no number 'x_max' .*did you mean 'x_mx'"):
        compute_drawing("chapter2.toml", "2.6", lambda: Computed((), {"comes_to": "rest", "x_mx": 1.5}))


def test_a_figure_is_a_picture_and_a_page_with_its_table(tmp_path):
    (done,) = redraw(["2.7"], tmp_path / "atlas")
    with Image.open(done.file) as picture:
        assert picture.width == 720
        assert len(picture.getcolors()) > 10
    text = (tmp_path / "atlas" / "atlas.md").read_text()
    assert "## Figure 2.7" in text
    assert "| displacement where slip begins | 1.0 | 1 | they agree |" in text


def test_the_command_reports_tables_and_refuses_what_exists(tmp_path):
    found = answer("atlas 2.13 -o", tmp_path)
    assert [entry["figure"] for entry in found["figures"]] == ["2.13"]
    assert found["figures"][0]["table"][0]["agrees"]
    for figure in ("2.13", "2.99"):
        assert answer(f"atlas {figure} -o", tmp_path, code=2)["error"]["do"]


@pytest.mark.parametrize(
    ("figure", "numbers"), [*PUBLISHED, *(pytest.param(*row, marks=pytest.mark.slow) for row in SLOW)]
)
def test_numbers_of_a_figure_are_the_published_ones(figure, numbers):
    drawn = {row.quantity: row.value for row in draw_once(figure)}
    for quantity, (value, within) in numbers.items():
        assert drawn[quantity] == pytest.approx(value, abs=within)


@pytest.mark.slow
@pytest.mark.parametrize(("figure", "agrees"), AGREEING)
def test_statements_of_a_figure_agree_or_not_with_the_thesis(figure, agrees):
    assert [row.agrees for row in draw_once(figure)] == agrees
    if figure == "6.5":
        assert "quasi-periodic" in draw_once(figure)[0].computed
