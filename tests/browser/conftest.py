"""The browser of these tests."""

import shutil

import pytest

from ..conftest import need


@pytest.fixture(scope="session")
def chromium() -> str:
    """Give the path of chromium."""
    path = shutil.which("chromium")
    need(path, "chromium is not installed")
    return str(path)
