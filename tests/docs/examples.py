"""The examples of a page of the documentation: blocks of commands and of Python, and how a command is run and compared.

A ``console`` block holds commands after ``$``, each followed by lines of its output; ``...`` stands for anything, alone
for lines left out.  A comment of a command states an exit code other than 0: ``# exit code 6``.  A block below the
comment ``<!-- not run: REASON -->`` is not run.
"""

import contextlib
import importlib.util
import io
import os
import re
import shlex
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

from daq.cli.app import app as daq
from fitting.cli import app as fit_friction
from processing.cli import app as process
from rig_sim.cli.app import app as rig_sim
from stickslip.console import application
from stickslip.console.commands import app as stickslip

APPLICATIONS = {
    "stickslip": stickslip,
    "daq": daq,
    "process": process,
    "fit-friction": fit_friction,
    "rig-sim": rig_sim,
}
ROOT = Path(__file__).resolve().parents[2]
PAGES = [
    ROOT / "README.md",
    *(path for path in sorted((ROOT / "docs").rglob("*.md")) if not {"atlas", "commands"} & set(path.parts)),
]
BLOCK = re.compile(
    r"(?:<!-- not run: (?P<reason>[^>]*) -->\n)?^```(?P<kind>\w*)\n(?P<text>.*?)^```$", re.MULTILINE | re.DOTALL
)
EXIT_CODE = re.compile(r"#.*\bexit code (\d+)")


@dataclass(frozen=True)
class Block:
    """A fenced block: page and line where it stands, language, text, and why it is not run ("" where it is)."""

    page: str
    line: int
    kind: str
    text: str
    reason: str


@dataclass(frozen=True)
class Command:
    """A command as typed, the lines of its output that the page shows, and its exit code."""

    typed: str
    shown: tuple[str, ...]
    exit_code: int


def blocks(name: str, text: str, *kinds: str) -> list[Block]:
    """Return the blocks of a page that are of one of these languages, in their order."""
    return [
        Block(name, text.count("\n", 0, match.start()) + 1, match["kind"], match["text"], match["reason"] or "")
        for match in BLOCK.finditer(text)
        if match["kind"] in kinds
    ]


def help_pages() -> dict[str, str]:
    """Return the generated pages of the commands by their names."""
    spec = importlib.util.spec_from_file_location("command_pages", ROOT / "docs" / "command_pages.py")
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    return {f"{name} --help": script.page(name) for name in script.APPLICATIONS}


def commands(block: Block) -> list[Command]:
    """Return the commands of a console block."""
    found = []
    for part in re.split(r"^\$ ", block.text, flags=re.MULTILINE)[1:]:
        typed, _, shown = re.sub(r" *\\\n *", " ", part).partition("\n")
        code = EXIT_CODE.search(typed)
        found.append(Command(typed, tuple(shown.splitlines()), int(code[1]) if code else 0))
    return found


def run(command: Command, folder: Path) -> None:
    """Run a command in a folder; AssertionError when its exit code or its output is not what the page says."""
    words = shlex.shlex(command.typed, posix=True, punctuation_chars=True)
    words.whitespace_split = True
    first, *arguments = words
    in_a_shell = first not in APPLICATIONS or any(set(word) <= set("();<>|&") for word in arguments)
    code, said = _in_a_shell(command.typed, folder) if in_a_shell or "$(" in command.typed else _here(first, arguments)
    assert code == command.exit_code, f"$ {command.typed}\nexit code {code}\n{said}"
    lines = iter(" ".join(line.split()) for line in said.splitlines())
    for shown in (line for line in command.shown if line.strip(" .")):
        wanted = " *.*? *".join(re.escape(" ".join(part.split())) for part in shown.split("..."))
        found = any(re.fullmatch(wanted, line) for line in lines)
        assert found, f"$ {command.typed}\nthe page shows, in this order: {shown}\n{said}"


def _here(name: str, arguments: list[str]) -> tuple[int, str]:
    """Run a command in this process, whose current folder is the example's: a process would only import once more."""
    said = io.StringIO()
    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        patch.setenv("COLUMNS", "80")
        return application.run(APPLICATIONS[name], arguments), said.getvalue()


def _in_a_shell(typed: str, folder: Path) -> tuple[int, str]:
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    packages = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    environment = os.environ | {"PATH": path, "PYTHONPATH": packages.rstrip(os.pathsep), "COLUMNS": "80"}
    line, both = ["bash", "-c", typed], {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT}
    done = subprocess.run(line, cwd=folder, env=environment, text=True, check=False, **both)
    return done.returncode if done.returncode >= 0 else 128 - done.returncode, done.stdout  # as a shell says a signal
