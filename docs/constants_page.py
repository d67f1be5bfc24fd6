"""Write docs/reference/constants.md, a page for developers, from the source: the tuning constants.

They are the module constants of `processing` and `fitting` with a number in them, but those of drawings and reports,
which decide nothing.
"""

import ast
import tokenize
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "reference" / "constants.md"
PACKAGES = ("processing", "fitting")
DRAWN = {"drawing", "palette", "plot", "report"}  # folders and modules whose constants are sizes and colours
HEAD = """# Tuning constants

Each is physics, learned from the record, or chosen; its comment says what it counts, in which unit, and why.  This page
is made from the source: {count} numbers.
"""


class Constant(NamedTuple):
    """A constant of a module: where it stands, its name, its expression, and what its comment says."""

    module: str
    name: str
    value: str
    comment: str


def constants(path: Path) -> Iterator[Constant]:
    """Yield a module's constants that hold a number."""
    with tokenize.open(path) as source:
        lines = source.read().split("\n")
    for node in ast.parse("\n".join(lines)).body:
        match node:
            case ast.Assign(targets=[ast.Name(id=name)], value=value) if name.isupper():
                pass
            case ast.AnnAssign(target=ast.Name(id=name), value=ast.expr() as value) if name.isupper():
                pass
            case _:
                continue
        if made_of_numbers(value):
            yield Constant(path.relative_to(ROOT).as_posix(), name, ast.unparse(value), comment_of(lines, node))


def made_of_numbers(value: ast.expr) -> bool:
    """Return whether an expression holds a number, and nothing but numbers, names of them and functions of them."""
    parts = list(ast.walk(value))
    called = {ast.unparse(part.func).partition(".")[0] for part in parts if isinstance(part, ast.Call)}
    constants = [part.value for part in parts if isinstance(part, ast.Constant)]
    numbers = all(type(constant) in (int, float) for constant in constants)
    return bool(constants) and numbers and called <= {"math", "np", "range", "tuple"}


def comment_of(lines: list[str], node: ast.stmt) -> str:
    """Return the comment beside a statement or within it, or the one above it."""
    text = "\n".join(lines[node.lineno - 1 : node.end_lineno])
    tokens = tokenize.generate_tokens(iter(f"{text}\n".splitlines(keepends=True)).__next__)
    within = [token.string.lstrip("# ") for token in tokens if token.type == tokenize.COMMENT]
    if within:
        return " ".join(within)
    above: list[str] = []
    for line in reversed(lines[: node.lineno - 1]):
        if not line.startswith("#"):
            break
        above.insert(0, line.lstrip("# "))
    return " ".join(above)


def all_constants() -> list[Constant]:
    """Return the constants of every module that decides something, by module."""
    files = (path for package in PACKAGES for path in sorted((ROOT / package).rglob("*.py")))
    return [row for path in files if not DRAWN & {*path.relative_to(ROOT).parts, path.stem} for row in constants(path)]


def page() -> str:
    """Return the page in Markdown, with one table a module."""
    rows, lines, module = all_constants(), [], ""
    for row in rows:
        if row.module != module:
            module = row.module
            lines += ["", f"## {module}", "", "| name | value | |", "|---|---|---|"]
        value, comment = (text.replace("|", "\\|") for text in (row.value, row.comment))
        lines.append(f"| `{row.name}` | `{value}` | {comment} |")
    return HEAD.format(count=len(rows)) + "\n".join(lines) + "\n"


if __name__ == "__main__":
    PAGE.write_text(page())
