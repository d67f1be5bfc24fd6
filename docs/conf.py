"""Settings of the documentation: Markdown by MyST, the API from docstrings, the commands from their help."""

import sys
from importlib.metadata import version as installed_version
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent))

project = "stickslip"
author = "The stickslip developers"
version = release = installed_version("stickslip")
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
source_suffix = {".md": "markdown"}
html_theme = "furo"
html_title = f"stickslip {version}"
exclude_patterns = ["_build"]
myst_heading_anchors = 3
myst_enable_extensions = ["deflist", "dollarmath"]
autodoc_typehints = "signature"
autodoc_member_order = "bysource"
autodoc_type_aliases = {"Array": "ndarray", "Mask": "ndarray"}
napoleon_use_ivar = True


def setup(app: Any) -> None:
    """Write the pages of the commands before Sphinx reads the sources."""
    import command_pages

    app.connect("builder-inited", lambda _: command_pages.write())
