"""The browser of these tests."""

import shutil
from collections.abc import Iterator
from importlib.util import find_spec
from typing import Any

import pytest

from ..conftest import need


@pytest.fixture(scope="session")
def chromium() -> str:
    """Give the path of chromium."""
    path = shutil.which("chromium")
    need(path, "chromium is not installed")
    return str(path)


@pytest.fixture(scope="module")
def browser(chromium: str) -> Iterator[Any]:
    """Give a browser that a test opens pages in."""
    need(find_spec("playwright"), "playwright is not installed")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as start:
        made = start.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        yield made
        made.close()
