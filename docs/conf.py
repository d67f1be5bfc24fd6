"""Settings of the documentation: Markdown pages built by Sphinx with MyST."""

from importlib.metadata import version as installed_version

project = "stickslip"
author = "The stickslip developers"
version = release = installed_version("stickslip")
extensions = ["myst_parser"]
source_suffix = {".md": "markdown"}
html_theme = "alabaster"
exclude_patterns = ["_build"]
myst_heading_anchors = 3
myst_enable_extensions = ["deflist"]
