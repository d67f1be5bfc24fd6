"""Settings of the documentation: Markdown by MyST, the API from docstrings, the commands from their help."""

import re
import subprocess
import sys
from importlib.metadata import version as installed_version
from pathlib import Path
from typing import Any

project = "stickslip"
author = "The stickslip developers"
version = release = installed_version("stickslip")
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
source_suffix = {".md": "markdown"}
html_theme = "furo"
html_show_copyright = False
html_static_path, html_css_files = ["_static"], ["tables.css"]
smartquotes = False  # flags begin with two hyphens
html_title = f"stickslip {version}"
exclude_patterns = ["_build", "architecture.md", "decisions", "reference/constants.md"]  # for developers
myst_heading_anchors = 3
myst_enable_extensions = ["deflist"]
autodoc_typehints = "signature"
autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
napoleon_use_ivar = True


def one_name_each(app: Any, what: str, name: str, obj: object, options: object, lines: list[str]) -> None:
    """Write the entry ``x, v : ndarray`` of a docstring once for each name: napoleon takes it for one name."""
    text = re.sub(
        r"^(\w+(?:, \w+)+)((?: : .*)?\n(?: +.*\n)+)",
        lambda entry: "".join(name + entry[2] for name in entry[1].split(", ")),
        "\n".join(lines) + "\n",
        flags=re.MULTILINE,
    )
    lines[:] = text.split("\n")


def write_pages(app: Any) -> None:
    """Write what is made from the source, each in a process of its own: usage lines name the program that runs."""
    for script in ("command_pages.py", "run_file_table.py"):
        subprocess.run([sys.executable, Path(__file__).with_name(script)], check=True)


def setup(app: Any) -> None:
    """Write what is made from the source before Sphinx reads the sources, and prepare docstrings before napoleon."""
    app.connect("builder-inited", write_pages)
    app.connect("autodoc-process-docstring", one_name_each, priority=400)
