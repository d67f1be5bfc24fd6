"""The atlas: which figures it has, the files and tables it writes, and its numbers against published ones."""

import math
from functools import cache

import pytest
from PIL import Image

from rig_sim.atlas.figure import Computed
from rig_sim.atlas.redraw import format_table, redraw, select_figures, sort_key
from rig_sim.atlas.registry import ENTRIES, NOT_REDRAWN
from rig_sim.atlas.statements import CHAPTERS as FOLDER
from rig_sim.atlas.statements import WORDS, check_row, compare, compute_drawing, read_tables
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


def test_a_printed_number_agrees_within_one_unit_of_its_last_digit():
    assert compare("", "-0.55", -0.5409, "rounded").agrees
    missed = compare("", "0.9475", 0.94796, "rounded")
    assert not missed.agrees
    assert missed.why == "rounded"
    assert "they agree" not in format_table([compare("velocity", "0.5", 0.7)])


@pytest.mark.parametrize(
    ("printed", "value"), [("2 pi", 2.0 * math.pi), ("pi/2", 0.5 * math.pi), ("3 pi/2", 1.5 * math.pi)]
)
def test_a_printed_multiple_of_pi_is_exact(printed, value):
    assert compare("", printed, value).agrees
    assert not compare("", printed, value + 1e-12).agrees
    assert compare("", printed, value + 0.1, within=0.2).agrees


def test_a_statement_in_words_holds_by_its_verdict_or_by_the_same_words():
    numbers = {"period": 6.35, "longer": True, "shorter": False, "unstable": True}
    longer = check_row(["stick lengthens the period", "yes", "period {period:.3f}", "longer", "why not"], numbers)
    assert (longer.computed, longer.agrees, longer.why) == ("period 6.350", True, "")
    shorter = check_row(["shortens the period", "yes", "period {period:.3f}", "shorter", "why not"], numbers)
    assert (shorter.agrees, shorter.why) == (False, "why not")
    assert check_row(["the fixed point is unstable", "yes", "{unstable}"], numbers).agrees
    assert not check_row(["the fixed point is unstable", "no", "{unstable}", "", "it is"], numbers).agrees


def test_words_that_name_no_computed_number_are_refused_with_the_nearest_one():
    with pytest.raises(InputError, match=r"figure 2.6 in chapter2.toml: no number 'x_max' .*did you mean 'x_mx'"):
        compute_drawing("chapter2.toml", "2.6", lambda: Computed((), {"comes_to": "rest", "x_mx": 1.5}))


@pytest.mark.parametrize("file", sorted(FOLDER.glob("*.toml")), ids=lambda file: file.stem)
def test_every_key_row_and_text_of_a_chapter_is_used(file):
    held = dict(read_tables(file.name))
    words = held.pop(WORDS, {})
    assert set(held) == {number for number in ENTRIES if number.split(".")[0] in file.stem}
    for number, figure in held.items():
        assert figure.keys() <= {"title", "shows", "choices", "says"}, number
        for row in figure.get("says", ()):
            texts = [part for part in row if isinstance(part, str)]
            assert 3 <= len(texts) <= (5 if "{" in row[2] else 4), row
            assert all(part.keys() == {"within"} for part in row if not isinstance(part, str)), row
    assert all(f"{{{name}}}" in file.read_text() for name in words)


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
