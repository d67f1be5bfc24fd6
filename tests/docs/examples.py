"""The examples of a page of the documentation: blocks of commands and of Python, and how a command is run and compared.

A ``console`` block holds commands after ``$``, each followed by lines of its output; ``...`` stands for anything, alone
for lines left out.  A comment of a command states an exit code other than 0: ``# exit code 6``.  A block below the
comment ``<!-- not run: REASON -->`` is not run.
"""

import importlib.util
import os
import re
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

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
    """Return the generated pages of the four commands by their names."""
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
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    packages = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    environment = os.environ | {"PATH": path, "PYTHONPATH": packages.rstrip(os.pathsep), "COLUMNS": "80"}
    done = subprocess.run(
        ["bash", "-c", command.typed],
        cwd=folder,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
    )
    code = done.returncode if done.returncode >= 0 else 128 - done.returncode  # killed by a signal: as a shell says it
    assert code == command.exit_code, f"$ {command.typed}\nexit code {code}\n{done.stdout}"
    lines = iter(" ".join(line.split()) for line in done.stdout.splitlines())
    for shown in (line for line in command.shown if line.strip(" .")):
        wanted = " *.*? *".join(re.escape(" ".join(part.split())) for part in shown.split("..."))
        found = any(re.fullmatch(wanted, line) for line in lines)
        assert found, f"$ {command.typed}\nthe page shows, in this order: {shown}\n{done.stdout}"
