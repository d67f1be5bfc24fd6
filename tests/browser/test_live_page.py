"""The live view in a real browser, while a recording runs in real time."""

import json
import re
import subprocess
import sys
import time
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import matplotlib.image
import numpy as np
import pytest

from daq.runfile import store

from ..conftest import need

pytestmark = pytest.mark.slow
DURATION_S = 14


@pytest.fixture(scope="module")
def chromium(chromium: str) -> str:
    for name in ("playwright", "starlette", "uvicorn", "uplot"):
        need(find_spec(name), f"{name} is not installed")
    return chromium


@pytest.fixture
def recording(tmp_path: Path) -> Iterator[subprocess.Popen[str]]:
    line = [sys.executable, "-m", "daq.cli.app", "record", "--live", "--no-browser", "--duration", str(DURATION_S)]
    with subprocess.Popen(
        [*line, "--json"], cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        yield process
        process.kill()


def until(page: Any, expression: str, timeout_s: float = 30.0) -> None:
    """Wait until an expression holds; playwright's own way needs eval, which the page's policy forbids."""
    end = time.monotonic() + timeout_s
    while not page.evaluate(expression):
        assert time.monotonic() < end, f"never: {expression}"
        page.wait_for_timeout(50)


def test_a_recording_is_drawn_marked_and_left_whole(
    recording: subprocess.Popen[str], chromium: str, tmp_path: Path
) -> None:
    from playwright.sync_api import sync_playwright

    assert recording.stderr is not None
    url = next(text.strip() for text in iter(recording.stderr.readline, "") if text.startswith("http"))
    said: list[str] = []
    asked: list[str] = []
    with sync_playwright() as start:
        browser = start.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": 1200, "height": 860})
        page.on("console", lambda message: said.append(message.text))
        page.on("pageerror", lambda error: said.append(str(error)))
        page.on("request", lambda request: asked.append(request.url))
        page.goto(url)
        until(page, "Number(document.body.dataset.frames) > 20")
        page.fill("#words", "a hand")
        page.keyboard.press("Enter")
        until(page, "document.getElementById('words').value === ''")
        picture = tmp_path / "wide.png"
        page.screenshot(path=picture)
        pixels = matplotlib.image.imread(picture)[..., :3]
        blue = np.abs(pixels - np.array([0, 0x72, 0xB2]) / 255).max(axis=2) < 0.05
        assert blue[130:360].sum() > 300, "no position is drawn"
        assert blue[460:720, 80:580].sum() > 100, "no phase portrait is drawn"

        page.click("#title")  # out of the text field, where a space is a space
        page.keyboard.press(" ")
        frames = page.evaluate("document.body.dataset.frames")
        page.wait_for_timeout(500)
        assert page.evaluate("document.body.dataset.frames") == frames, "paused, and it goes on drawing"
        page.keyboard.press(" ")
        until(page, f"document.body.dataset.frames > {frames}")

        # A page that loses its connection connects again, and has every sample.
        page.context.set_offline(True)
        page.wait_for_timeout(500)
        page.context.set_offline(False)
        page.set_viewport_size({"width": 390, "height": 844})
        page.wait_for_timeout(200)
        assert page.evaluate("document.documentElement.scrollWidth <= window.innerWidth"), "wider than a phone's screen"
        until(page, "document.getElementById('state').textContent.includes('ended')", 60.0)
        drawn = page.evaluate("({ t: samples.t, x: samples.x, markers })")
        browser.close()
    output, _ = recording.communicate(timeout=60)
    found = json.loads(output)
    assert (recording.returncode, found["samples"], found["lost"]) == (0, DURATION_S * 1000, 0)
    run = store.load(tmp_path / "run.h5")
    own = run.position[10:-10]
    np.testing.assert_allclose(drawn["t"][: own.size], run.time[10:-10], rtol=0, atol=1e-6)
    np.testing.assert_allclose(drawn["x"][: own.size], own, rtol=0, atol=3e-5)  # the noise of the positions
    at = run.event_kind.index("marker")
    assert run.event_note[at] == drawn["markers"][0]["text"] == "a hand"
    assert abs(run.time[run.event_sample[at]] - drawn["markers"][0]["t"]) < 1.0
    assert [words for words in said if not re.search("ERR_INTERNET_DISCONNECTED|ERR_CONNECTION_REFUSED", words)] == []
    assert [one for one in asked if not one.startswith((url, "data:"))] == []
