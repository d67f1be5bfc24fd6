"""The live view in a real browser: a recording in real time, and a finished run; each thing that the page offers."""

import json
import re
import shutil
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest

import daq
from daq.runfile import journal, store
from daq.runfile.rig import Rig

from ..conftest import need

pytestmark = pytest.mark.slow
SAMPLES = Path(__file__).resolve().parents[2] / "data_samples"
DURATION_S = 14
# What the browser itself says of a connection that a test cuts, and of a page that is not there.
EXPECTED = "ERR_INTERNET_DISCONNECTED|ERR_CONNECTION_REFUSED|ERR_INCOMPLETE_CHUNKED_ENCODING|404"
# Each is looked at in its own theme and in the other one.
SIZES = ((1400, 900, "dark"), (1200, 860, "light"), (768, 1024, "dark"), (390, 844, "light"))


@pytest.fixture(autouse=True, scope="module")
def live_view():
    for name in ("starlette", "uvicorn", "uplot"):
        need(find_spec(name), f"{name} is not installed")


@contextmanager
def command(*arguments, cwd):
    """Start `daq` and yield it with the URL of its page."""
    line = [sys.executable, "-m", "daq.cli.app", *arguments, "--no-browser"]
    with subprocess.Popen(line, cwd=cwd, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        stream = process.stdout if arguments[0] == "watch" else process.stderr
        assert stream is not None
        try:
            yield process, next(text.strip() for text in iter(stream.readline, "") if text.startswith("http"))
        finally:
            process.send_signal(signal.SIGINT)
            try:
                process.communicate(timeout=20)
            except ValueError:  # the test has read its output
                process.wait(20)
            except subprocess.TimeoutExpired:
                process.kill()
                raise


@contextmanager
def opened(browser, url, width=1400, height=900, **context):
    """Open a page; afterwards nothing was wrong with it, and it has asked nobody else for anything."""
    page = browser.new_page(viewport={"width": width, "height": height}, **context)
    said: list[str] = []
    asked: list[str] = []
    page.on("console", lambda message: said.append(message.text))
    page.on("pageerror", lambda error: said.append(str(error)))
    page.on("request", lambda request: asked.append(request.url))
    page.goto(url)
    yield page
    page.close()
    assert [words for words in said if not re.search(EXPECTED, words)] == []
    assert [one for one in asked if not one.startswith((url, "data:"))] == []


def until(page, expression, timeout_s=30.0):
    """Wait until an expression holds; playwright's own way needs eval, which the page's policy forbids."""
    end = time.monotonic() + timeout_s
    while not page.evaluate(expression):
        assert time.monotonic() < end, f"never: {expression}"
        page.wait_for_timeout(50)


def text(page, id):
    return str(page.evaluate(f"document.getElementById('{id}').textContent"))


def says(page, id, words, timeout_s=30.0):
    until(page, f"document.getElementById('{id}').textContent.includes({json.dumps(words)})", timeout_s)


def numbers(words):
    return [float(found) for found in re.findall(r"-?\d+\.?\d*(?:e-?\d+)?", words)]


def coloured(page, id, folder, colour):
    """Return how many pixels of a picture have a colour of the theme."""
    picture = folder / "part.png"
    page.locator(f"#{id}").screenshot(path=picture)
    rgb = np.array([float(part) for part in re.findall(r"[\d.]+", page.evaluate(f"colours.{colour}"))[:3]]) / 255
    return int((np.abs(matplotlib.image.imread(picture)[..., :3] - rgb).max(axis=2) < 0.06).sum())


# ---- a finished run ------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    folder = tmp_path_factory.mktemp("finished")
    shutil.copy(SAMPLES / "law5.h5", folder / "run.h5")
    done = [sys.executable, "-m", "daq.cli.app", "note", "run.h5", "--mark", "3", "a hand"]
    subprocess.run(done, cwd=folder, check=True, capture_output=True)
    with command("watch", "run.h5", cwd=folder) as (_, url):
        yield url


@pytest.fixture
def run_page(browser, finished):
    with opened(browser, finished) as page:
        says(page, "state", "finished run")
        until(page, "shown.rows && shown.rows.last > 100 && summary.cycles > 4")
        yield page


def test_a_finished_run_is_shown_with_its_cycles_belt_spring_and_friction(run_page, tmp_path):
    run = daq.load(SAMPLES / "law5.h5")
    assert text(run_page, "title").startswith("run.h5: ")
    assert text(run_page, "samples") == str(run.time.size)
    assert text(run_page, "cycles") == "6 cycles"
    assert "enough for a verdict" in text(run_page, "advice")
    assert numbers(text(run_page, "belt"))[0] == pytest.approx(0.22, rel=0.005)
    assert numbers(text(run_page, "k_over_m"))[0] == pytest.approx(35.18, rel=0.01)
    rows = run_page.evaluate("[...document.querySelectorAll('#statistics tr')].map(row => row.innerText)")
    assert [re.split(r"\t| \(", row)[0] for row in rows] == ["stick", "slip", "drop", "break-away"]
    assert all(len(numbers(row)) == 5 for row in rows)
    for picture, colour in (("trace", "x"), ("trace", "v"), ("portrait", "x"), ("friction", "f"), ("friction", "v")):
        assert coloured(run_page, picture, tmp_path, colour) > 50, (picture, colour)
    # The report's sign.
    assert run_page.evaluate("friction.axes[0].label") == "relative speed (m/s)"
    assert run_page.evaluate("Math.min(...summary.friction.speed) > 0 && Math.min(...summary.friction.F) > 0")
    assert run_page.evaluate("markers.map(marker => [marker.t, marker.text])") == [
        [pytest.approx(3.0, abs=0.01), "a hand"]
    ]
    for hidden in ("stop", "pause", "mark"):
        assert not run_page.locator(f"#{hidden}").is_visible()


def test_the_cursor_tells_the_sample_under_it_in_all_three_pictures(run_page):
    run = daq.load(SAMPLES / "law5.h5")
    box = run_page.locator("#trace .u-over").bounding_box()
    run_page.mouse.move(box["x"] + 0.55 * box["width"], box["y"] + 20)
    until(run_page, "document.getElementById('trace-at').textContent !== ''")
    t, x, v, w, f = numbers(re.sub(r"[a-zA-Z/]+(?= )|x0", " ", text(run_page, "trace-at")))
    at = int(np.abs(run.time - t).argmin())
    assert t == pytest.approx(run.time[at], abs=1e-3)
    assert x == pytest.approx(1e3 * run.position[at], abs=0.05)
    assert w == pytest.approx(v - 0.22, abs=2e-3)
    assert 0 < f < 2
    assert run_page.evaluate("[...document.querySelectorAll('.dot')].every(dot => !dot.hidden)")
    for key, step in ((".", 1), (".", 2), (",", 1)):
        run_page.keyboard.press(key)
        until(run_page, f"Math.abs(held - {run.time[at + step]}) < 1e-5")
        moved = numbers(text(run_page, "trace-at"))[0]
        assert moved == pytest.approx(run.time[at + step], abs=1e-3)
    portrait = run_page.locator("#portrait .u-over").bounding_box()
    run_page.mouse.move(portrait["x"] + portrait["width"] / 2, portrait["y"] + portrait["height"] / 2)
    until(run_page, "document.getElementById('portrait-at').textContent.startsWith('x ')")
    assert text(run_page, "trace-at") == ""


def test_zoom_and_scroll_by_mouse_keys_buttons_and_slider(run_page):
    shown = "[view.from, view.to]"
    whole = run_page.evaluate(shown)
    box = run_page.locator("#trace .u-over").bounding_box()
    run_page.mouse.move(box["x"] + 0.3 * box["width"], box["y"] + 50)
    run_page.mouse.down()
    run_page.mouse.move(box["x"] + 0.4 * box["width"], box["y"] + 60, steps=5)
    run_page.mouse.up()
    until(run_page, "view.to - view.from < 2")
    begin, end = run_page.evaluate(shown)
    assert (begin, end) == pytest.approx((0.3 * whole[1], 0.4 * whole[1]), abs=0.1)
    until(run_page, "past && past.exact && shown.rows.last - shown.rows.first > 500")  # every sample of it
    run_page.keyboard.press("ArrowRight")
    assert run_page.evaluate(shown) == pytest.approx([begin + (end - begin) / 4, end + (end - begin) / 4])
    run_page.keyboard.press("ArrowLeft")
    run_page.keyboard.press("+")
    assert run_page.evaluate("view.to - view.from") == pytest.approx((end - begin) / 2)
    run_page.click("#out")
    run_page.click("#back")
    assert run_page.evaluate(shown) == pytest.approx([begin - (end - begin) / 4, end - (end - begin) / 4])
    run_page.mouse.move(box["x"] + box["width"] / 2, box["y"] + 50)
    run_page.mouse.wheel(0, -100)
    until(run_page, f"view.to - view.from < {0.81 * (end - begin)}")
    run_page.keyboard.press("Home")
    assert run_page.evaluate("view.from") == 0
    run_page.keyboard.press("End")
    assert run_page.evaluate("view.to") == pytest.approx(whole[1])
    run_page.locator("#scroll").focus()
    before = run_page.evaluate("view.from")
    run_page.locator("#scroll").evaluate("slider => { slider.value = 4; slider.dispatchEvent(new Event('input')); }")
    assert run_page.evaluate("view.from") == pytest.approx(4.0) != before
    assert "s of" in run_page.locator("#scroll").get_attribute("aria-valuetext")
    run_page.keyboard.press("Escape")
    assert run_page.evaluate(shown) == pytest.approx(whole)
    run_page.select_option("#window", "2")
    assert run_page.evaluate("view.to - view.from") == pytest.approx(2.0)


@pytest.mark.parametrize("key", ["click", "d"])
def test_two_marks_show_their_difference_until_escape(run_page, key):
    box = run_page.locator("#trace .u-over").bounding_box()
    for share in (0.3, 0.55):
        run_page.mouse.move(box["x"] + share * box["width"], box["y"] + 60)
        if key == "click":
            run_page.mouse.down()
            run_page.mouse.up()
        else:
            run_page.keyboard.press(key)
    (t0, x0), (t1, x1) = run_page.evaluate("marked.map(({ t, x }) => [t, x])")
    assert t1 - t0 == pytest.approx(0.25 * run_page.evaluate("view.to - view.from"), rel=0.01)
    run_page.mouse.move(box["x"] + 0.8 * box["width"], box["y"] + 60)  # the second mark stays
    dt, dx, rate = numbers(re.sub("1/Δt", "", text(run_page, "difference")))
    assert (dt, dx, rate) == pytest.approx((t1 - t0, 1e3 * (x1 - x0), 1 / (t1 - t0)), rel=1e-3, abs=0.06)
    run_page.keyboard.press("Escape")
    until(run_page, "document.getElementById('difference').textContent === ''")


def test_position_is_drawn_above_velocity(run_page):
    lowest, highest = run_page.evaluate(
        """[trace.valToPos(Math.min(...trace.data[1].filter(Number.isFinite)), "y"),
        trace.valToPos(Math.max(...trace.data[2].filter(Number.isFinite)), "w")]"""
    )
    assert lowest < run_page.evaluate("trace.over.clientHeight") / 2 < highest


def test_the_first_curve_is_on_the_first_screen_of_a_phone(browser, finished):
    with opened(browser, finished, 390, 844) as page:
        until(page, "shown.rows && shown.rows.last > 100 && summary.cycles > 4")
        assert page.evaluate("document.getElementById('trace').getBoundingClientRect().bottom") < 844


def test_break_aways_lie_over_one_another(run_page, tmp_path):
    run_page.keyboard.press("t")
    says(run_page, "trace-title", "break-away 6 of 6")
    assert run_page.evaluate("trace.axes[0].label") == "time since the break-away (s)"
    times = [one[0] for one in run_page.evaluate("breakAways")]
    assert run_page.evaluate("shown.origin") == pytest.approx(times[-1])
    until(run_page, "shown.earlier.length === 5")
    assert coloured(run_page, "trace", tmp_path, "old") > 200
    run_page.keyboard.press("ArrowLeft")
    says(run_page, "trace-title", "break-away 5 of 6")
    assert run_page.locator("#scroll").get_attribute("aria-valuetext") == "break-away 5 of 6"
    # The mass goes with the belt until the break-away, and not after it.
    part = run_page.evaluate("({ t: Array.from(shown.rows.t), v: Array.from(shown.rows.v) })")
    t, v = np.array(part["t"]) - times[4], np.array(part["v"], float)
    np.testing.assert_allclose(v[(t > -0.5) & (t < -0.05)], 0.22, atol=0.01)
    assert v[(t > 0.1) & (t < 0.3)].max() < 0.2


@pytest.mark.parametrize(("width", "height", "theme"), SIZES)
def test_everything_fits_and_can_be_read(browser, finished, width, height, theme):
    with opened(browser, finished, width, height, color_scheme=theme) as page:
        says(page, "state", "finished run")
        until(page, "summary.cycles > 4")
        check_layout(page, width)
        check_contrast(page)
        paper = page.evaluate("getComputedStyle(document.body).backgroundColor")
        assert (np.mean(numbers(paper)[:3]) < 60) == (theme == "dark")
        other = "light" if theme == "dark" else "dark"
        page.select_option("#theme", other)
        assert page.evaluate("getComputedStyle(document.body).backgroundColor") != paper
        check_contrast(page)
        page.select_option("#theme", "")
        assert page.evaluate("getComputedStyle(document.body).backgroundColor") == paper


def check_layout(page, width):
    """Nothing is wider than the page or its box, nothing lies on another, and everything has a name."""
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    clipped = """[...document.querySelectorAll('h1, p, dd, dt, th, td, button, label, figcaption, select, section')]
        .filter(one => one.offsetParent && getComputedStyle(one).display !== 'inline')
        .filter(one => one.scrollWidth > one.clientWidth + 1).map(one => one.id || one.textContent)"""
    assert page.evaluate(clipped) == []
    boxes = page.evaluate(
        """[...document.querySelectorAll('header > *, #facts > *, #controls > *, figure, section, footer')]
        .filter(one => one.offsetParent).map(one => { const box = one.getBoundingClientRect();
        return [one.id || one.tagName + one.textContent.slice(0, 20), box.left, box.top, box.right, box.bottom]; })"""
    )
    for k, (name, left, top, right, bottom) in enumerate(boxes):
        assert right <= width + 0.5, name
        for other, *box in boxes[k + 1 :]:
            assert right <= box[0] + 0.5 or box[2] <= left + 0.5 or bottom <= box[1] + 0.5 or box[3] <= top + 0.5, (
                name,
                other,
            )
    unnamed = """[...document.querySelectorAll('button, select, input')]
        .filter(one => !(one.textContent.trim() || one.getAttribute('aria-label') || one.closest('label')))
        .map(one => one.id)"""
    assert page.evaluate(unnamed) == []


def check_contrast(page):
    """Text is told from the paper by 4.5, and curves by 3, as WCAG 2 asks."""
    names = ["h1", "#state", "dt", "dd", "figcaption", "#controls label", "#save", "footer", "kbd"]
    names += ["#panel p", "#panel dt", "th", "td"]
    found = page.evaluate(
        """names => { readColours();
        const of = (name) => document.querySelector(name), style = (one) => getComputedStyle(one);
        const paper = (one) => style(one.closest('#panel') || document.body).backgroundColor;
        const text = names.map((name) => [name, style(of(name)).color, paper(of(name))]);
        const drawn = Object.entries(colours).filter(([name]) => !["line", "paper"].includes(name));
        return { text, curves: drawn.map(([name, colour]) => [name, colour, paper(document.body)]) }; }""",
        names,
    )
    for name, colour, paper in found["text"]:
        assert contrast(colour, paper) >= 4.5, name
    for name, colour, paper in found["curves"]:
        assert contrast(colour, paper) >= (1.5 if name == "old" else 4.5), name  # earlier break-aways lie in the back


def contrast(one, other):
    def luminance(colour):
        rgb = np.array(numbers(colour)[:3]) / 255
        return float(np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4) @ [0.2126, 0.7152, 0.0722])

    dark, light = sorted((luminance(one), luminance(other)))
    return (light + 0.05) / (dark + 0.05)


def test_imports_without_calibration_and_runs_in_counts_are_shown(browser, tmp_path):
    run = daq.load(SAMPLES / "law5.h5")
    assert run.count is not None
    bare = replace(run, rig=Rig(), position=run.count.astype(np.float64))
    store.write(tmp_path / "counts.h5", bare)
    line = [sys.executable, "-m", "daq.cli.app", "import", str(SAMPLES / "camera.csv"), "-o", "mm.h5"]
    subprocess.run(line, cwd=tmp_path, capture_output=True, check=True)
    for unit in ("mm", "counts"):
        with command("watch", f"{unit}.h5", cwd=tmp_path) as (_, url), opened(browser, url) as page:
            says(page, "state", "finished run")
            until(page, "summary.cycles > 4 && shown.rows")
            assert f"({unit})" in page.evaluate("trace.axes[1].label")
            assert "calibration" not in text(page, "belt")
            assert "constant" in page.evaluate("friction.axes[1].label")
            assert page.locator("#x0").is_visible()
            assert numbers(text(page, "k_over_m"))[0] == pytest.approx(35.18, rel=0.02)
            check_layout(page, 1400)


# ---- a recording ---------------------------------------------------------------------------------------------------


def test_a_recording_is_drawn_marked_and_left_whole(browser, tmp_path):
    with command("record", "--live", "--duration", str(DURATION_S), "--json", cwd=tmp_path) as (process, url):
        with opened(browser, url, 1200, 860) as page:
            until(page, "Number(document.body.dataset.frames) > 20")
            page.fill("#words", "a hand")
            page.keyboard.press("Enter")
            until(page, "document.getElementById('words').value === ''")
            for picture, colour, least in (("trace", "x", 300), ("trace", "v", 300), ("portrait", "x", 100)):
                assert coloured(page, picture, tmp_path, colour) > least, (picture, colour)

            page.click("#title")  # out of the text field, where a space is a space
            page.keyboard.press(" ")
            page.wait_for_timeout(200)
            frames = page.evaluate("document.body.dataset.frames")
            page.wait_for_timeout(500)
            assert page.evaluate("document.body.dataset.frames") == frames, "paused, and it goes on drawing"
            assert text(page, "pause") == "Resume"
            end = page.evaluate("view.to")
            page.keyboard.press("Home")  # scrolling back while it is paused
            until(page, "view.from === 0 && shown.rows.t[shown.rows.first] < 0.1")
            assert page.evaluate("lastTime()") > end
            page.keyboard.press(" ")
            until(page, f"document.body.dataset.frames > {frames} && !view.paused")

            # A page that loses its connection connects again, and has every sample.
            page.context.set_offline(True)
            page.wait_for_timeout(500)
            page.context.set_offline(False)
            page.set_viewport_size({"width": 390, "height": 844})
            page.wait_for_timeout(200)
            assert page.evaluate("document.documentElement.scrollWidth <= window.innerWidth"), (
                "wider than a phone's screen"
            )
            says(page, "state", "Recording complete", 60.0)
            says(page, "result", "14,000 samples, 14.0 s, no gaps.  Next: fit-friction")
            assert str(tmp_path / "run.h5") in text(page, "result")
            drawn = page.evaluate("({ t: samples.t, x: samples.x, markers })")
            assert page.locator("#stop").is_disabled()
            until(page, "whole !== null")  # all of it can still be looked at
            page.keyboard.press("Home")
            until(page, "view.from === 0")
        output, _ = process.communicate(timeout=60)
    found = json.loads(output)
    assert (process.returncode, found["samples"], found["lost"]) == (0, DURATION_S * 1000, 0)
    run = store.load(tmp_path / "run.h5")
    times, x = np.array(drawn["t"]), np.array(drawn["x"])
    first, last = np.searchsorted(run.time, (times[0], times[-1]))
    assert first < 30
    assert last > run.time.size - 100
    np.testing.assert_allclose(times[: last - first], run.time[first:last], rtol=0, atol=1e-6)
    np.testing.assert_allclose(x[: last - first], run.position[first:last], rtol=1e-6)
    at = run.event_kind.index("marker")
    assert run.event_note[at] == drawn["markers"][0]["text"] == "a hand"
    assert run.time[run.event_sample[at]] == pytest.approx(drawn["markers"][0]["t"], abs=1e-6)


def test_the_stop_button_asks_once_and_ends_the_recording_cleanly(browser, tmp_path):
    with command("record", "--live", "--duration", "600", "--json", cwd=tmp_path) as (process, url):
        with opened(browser, url) as page:
            until(page, "Number(document.body.dataset.frames) > 20")
            page.click("#stop")
            page.keyboard.press("Escape")  # not yet
            page.click("#stop")
            page.keyboard.press("Enter")  # the first button resumes recording
            page.wait_for_timeout(1500)
            assert not journal.stop_path(tmp_path / "run.h5").exists()
            assert text(page, "state") in ("stick", "slip", "moving")
            page.click("#stop")
            page.click("#stop-it")
            says(page, "state", "stopped by the user", 20.0)
        output, errors = process.communicate(timeout=60)
    found = json.loads(output)
    assert (process.returncode, found["ended"], found["lost"]) == (0, "stopped", 0)
    assert "Traceback" not in errors
    assert store.load(tmp_path / "run.h5").time.size == found["samples"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["run.h5"]


def test_losses_a_vanished_journal_and_a_viewer_that_is_gone_are_said_in_the_page(browser, tmp_path):
    gaps = ["--set", "gaps.rate=1", "--set", "gaps.duration=0.2"]
    recorder = [sys.executable, "-m", "daq.cli.app", "record", "--realtime", "--duration", "60", *gaps]
    with subprocess.Popen(recorder, cwd=tmp_path, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as recording:
        part = tmp_path / "run.h5.part"
        with command("watch", part.name, "--wait", "30", cwd=tmp_path) as (viewer, url), opened(browser, url) as page:
            says(page, "trouble", "the board loses samples")
            until(page, "Number(document.getElementById('lost').textContent) > 100")
            assert page.locator("#lost").evaluate("field => field.classList.contains('wrong')")
            viewer.kill()
            says(page, "trouble", "The viewer does not respond. The recording continues without it.", 20.0)
            says(page, "state", "no connection")
        with command("watch", part.name, cwd=tmp_path) as (_, url), opened(browser, url) as page:
            until(page, "Number(document.body.dataset.frames) > 5")
            (tmp_path / "sub").mkdir()
            part.rename(tmp_path / "sub" / part.name)
            says(page, "state", "has been moved or removed", 10.0)
        recording.send_signal(signal.SIGINT)
        recording.wait(30)
