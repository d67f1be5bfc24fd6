"""The files of the page: our own, and uPlot's, which are in an installed package (`uplot-python`).

That package is located but not imported: its modules need IPython.
"""

from functools import cache
from importlib.util import find_spec
from pathlib import Path

from stickslip.errors import InputError

PAGE = Path(__file__).parent / "page"
KINDS = {
    "index.html": "text/html",
    "live.css": "text/css",
    "live.js": "text/javascript",
    "plots.js": "text/javascript",
    "record.js": "text/javascript",
    "uPlot.iife.js": "text/javascript",
    "uPlot.min.css": "text/css",
}


def check_installed() -> None:
    """Raise InputError if a package of the live view is missing."""
    missing = [name for name in ("starlette", "uvicorn", "uplot") if find_spec(name) is None]
    if missing:
        what = f"the live view needs packages that are not installed: {', '.join(missing)}"
        raise InputError(what, "command line", "install them with: pip install 'stickslip[live]'")


@cache
def read_content(name: str) -> bytes:
    """Return a file of the page, one of `KINDS`, without indentation and comment lines: a fifth smaller."""
    file = PAGE / name
    text = (file if file.exists() else _find_uplot() / name).read_text(encoding="utf-8")
    lines = (line.strip() for line in text.splitlines())
    return "\n".join(line for line in lines if line and not line.startswith("//")).encode()


def _find_uplot() -> Path:
    spec = find_spec("uplot")
    if spec is None or not spec.submodule_search_locations:
        raise FileNotFoundError("uplot-python is not installed")
    return Path(spec.submodule_search_locations[0]) / "static"
