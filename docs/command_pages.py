"""Write docs/reference/commands/ from the help of the commands (Sphinx does so before it builds)."""

import re
from pathlib import Path

from daq.cli.app import app as daq
from fitting.cli import app as fit_friction
from processing.cli import app as process
from rig_sim.cli.app import app as rig_sim
from stickslip.console.commands import app as stickslip
from stickslip.console.log import FLAGS

FOLDER = Path(__file__).parent / "reference" / "commands"
APPLICATIONS = {
    "daq": daq,
    "process": process,
    "fit-friction": fit_friction,
    "rig-sim": rig_sim,
    "stickslip": stickslip,  # after those whose help it shortens
}
LEFT_OUT = (
    r"^## Table of Contents\n.*?(?=^\*\*)",
    r"^## \S+ --install-completion\n.*?(?=^## |\Z)",
    r"^\* \[`--install-completion`\].*?\n",
    r"^\*\*Commands\*\*:\s+(?=\*\*)",  # an application without subcommands
)
EXAMPLE = re.compile(r"^Example: (.*(?:\n(?!\n).*)*)", re.MULTILINE)


def page(name: str) -> str:
    """Return the page of a command in Markdown: usage, description, examples and flags of it and of its subcommands.

    The subcommands of `stickslip` are described on the pages of the others.
    """
    text = APPLICATIONS[name].generate_docs()
    if name == "stickslip":
        text = re.sub(r"\[(`[^`]*`)\]\(#[^)]*\)", r"\1", text[: text.index("\n## stickslip record")])
    for pattern in LEFT_OUT:
        text = re.sub(pattern, "", text, flags=re.MULTILINE | re.DOTALL)
    text = f"{text.rstrip()}\n\n{FLAGS}\n"
    return EXAMPLE.sub(lambda found: f"```console\n$ {' '.join(found[1].split())}\n```", text)


def write() -> None:
    """Write the page of every command into `FOLDER`."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    for name in APPLICATIONS:
        (FOLDER / f"{name}.md").write_text(page(name))


if __name__ == "__main__":
    write()
