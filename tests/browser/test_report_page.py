"""The report in a real browser: it draws, and asks nothing of the network."""

import re
import shutil
from pathlib import Path

import matplotlib.image
import pytest

from fitting.cli import app
from stickslip.console import application

from ..conftest import compete_alone

pytestmark = pytest.mark.slow
SAMPLES = Path(__file__).resolve().parents[2] / "data_samples"


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    folder = tmp_path_factory.mktemp("report")
    shutil.copy(SAMPLES / "law5.h5", folder / "run.h5")
    with pytest.MonkeyPatch.context() as patch:
        compete_alone(patch)
        assert application.run(app, [str(folder / "run.h5"), "--json"]) in (0, 5)
    return folder / "run.report.html"


FIRST_SCREEN = ("h1.verdict", ".badge", ".curve", ".headline", ".top figure:nth-of-type(1) svg")


@pytest.mark.parametrize(("width", "height"), [(1400, 900), (1280, 800), (390, 844)])
def test_the_first_screen_answers_which_law_which_numbers_and_how_sure(report, browser, width, height):
    """The parameters used to begin at 2295 px and the friction curve stood below them."""
    shown = FIRST_SCREEN if width < 1000 else (*FIRST_SCREEN, ".top figure:nth-of-type(2) svg", "table.laws tr.in")
    page = browser.new_page(viewport={"width": width, "height": height})
    page.goto(report.as_uri())
    lowest = {name: page.locator(name).first.bounding_box() for name in shown}
    titles = page.locator("svg[aria-label^=Phase] text", has_text=re.compile("^(constant|linear|hyperbolic)")).count()
    wide = page.evaluate("document.documentElement.scrollWidth")
    pictures = page.evaluate(
        "[...document.querySelectorAll('.wide svg')].map(svg => svg.clientWidth).filter(width => width)"
    )
    page.close()
    assert titles == 6
    assert min(pictures) >= 600, "a picture of several panels has shrunk"  # to 360 px on a phone
    assert wide <= width
    for name, box in lowest.items():
        assert box["y"] + box["height"] <= height, name


OUTSIDE = """() => [...document.querySelectorAll(".pair > *, .columns > *, .top > *, body > *")].flatMap(part =>
    [...part.querySelectorAll("td, th, dd, figcaption, svg, p")].filter(one =>
        one.getBoundingClientRect().right > part.getBoundingClientRect().right + 1).map(one => one.outerHTML))"""
MM = 96 / 25.4  # px


def test_nothing_overlaps_on_paper_and_dark_is_dark(report, browser):
    """Tables used to run into the column beside them in print."""
    page = browser.new_page(color_scheme="dark")
    page.goto(report.as_uri())
    paper = "getComputedStyle(document.body).backgroundColor.match(/\\d+/g).map(Number)"
    assert max(page.evaluate(paper)) < 40
    page.emulate_media(media="print")
    assert min(page.evaluate(paper)) == 255  # on paper it is light all the same
    for width in (210, 216):  # A4 and Letter, less the margins
        page.set_viewport_size({"width": round((width - 30) * MM), "height": 1000})
        assert page.evaluate(OUTSIDE) == [], width
    page.close()


def test_the_report_draws_in_a_browser_and_names_the_law_in_words(report, browser):
    page = browser.new_page(viewport={"width": 1100, "height": 2400})
    page.goto(report.as_uri())
    picture = report.with_suffix(".png")
    page.screenshot(path=picture)
    pixels = matplotlib.image.imread(picture)
    assert pixels.shape[:2] == (2400, 1100)
    dark = (pixels[..., :3].mean(axis=2) < 0.6).mean()
    assert dark > 0.005  # text and curves, not an empty page
    assert "law 5" in page.content().lower()
    assert page.content().count("<svg") >= 3
    page.close()
