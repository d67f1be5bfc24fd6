"""Draw docs/pictures/architecture.png from the imports of the source: `python docs/draw_architecture.py`.

A box is a folder, or a module beside the folders; it stands above everything that it imports, with its number of files
and lines.  An arrow points from the importer to the imported.  Imports inside functions count, those for the type
checker alone do not.
"""

import ast
from functools import cache
from pathlib import Path

import matplotlib.pyplot as plt
from matplotlib.patches import FancyArrowPatch, FancyBboxPatch

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("stickslip", "daq", "rig_sim", "processing", "fitting")
SHARED = "stickslip"  # by all others, box by box
Node = tuple[str, str]  # package, folder or module


def node_of(module: str) -> Node | None:
    """Return the box of a dotted module name; None outside the packages and for a package's own __init__."""
    parts = module.split(".")
    if parts[0] not in PACKAGES or len(parts) < 2:
        return None
    place = ROOT / parts[0] / parts[1]
    return (parts[0], parts[1]) if place.is_dir() or place.with_suffix(".py").is_file() else None


def imported_names(path: Path, *, for_types: bool = False) -> set[str]:
    """Return the dotted names that a file imports, at any depth; those for the type checker alone on request."""
    names: set[str] = set()
    tree = ast.parse(path.read_text())
    checks = [node for node in ast.walk(tree) if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"]
    left_out = set() if for_types else {inner for check in checks for inner in ast.walk(check)}
    for statement in set(ast.walk(tree)) - left_out:
        if isinstance(statement, ast.Import):
            names |= {alias.name for alias in statement.names}
        elif isinstance(statement, ast.ImportFrom) and statement.module:
            names |= {statement.module, *(f"{statement.module}.{alias.name}" for alias in statement.names)}
    return names


def imports_of(path: Path) -> set[Node]:
    """Return the boxes that a file imports."""
    return {node for name in imported_names(path) if (node := node_of(name)) is not None}


def read() -> tuple[dict[Node, tuple[int, int]], dict[Node, set[Node]]]:
    """Return each box's number of files and lines, and the boxes that it imports."""
    sizes: dict[Node, tuple[int, int]] = {}
    arrows: dict[Node, set[Node]] = {}
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*.py")):
            inside = path.relative_to(ROOT / package)
            node = (package, inside.parts[0] if len(inside.parts) > 1 else inside.stem)
            if node[1] == "__init__":
                continue
            files, lines = sizes.get(node, (0, 0))
            lines += len(path.read_text().splitlines())
            sizes[node] = (files + (path.name != "__init__.py"), lines)
            arrows.setdefault(node, set()).update(imports_of(path) - {node})
    return sizes, arrows


def floors(arrows: dict[Node, set[Node]]) -> dict[Node, int]:
    """Return how high each box stands within its package: one above the highest that it imports there.

    Raises
    ------
    ValueError
        Where folders import each other in a circle.
    """
    under: list[Node] = []

    @cache
    def floor(node: Node) -> int:
        if node in under:
            raise ValueError(f"imports form a circle: {' -> '.join(name for _, name in [*under, node])}")
        under.append(node)
        height = 1 + max((floor(other) for other in arrows[node] if other[0] == node[0]), default=-1)
        under.pop()
        return height

    return {node: floor(node) for node in arrows}


def draw(path: Path) -> None:
    """Write the picture."""
    sizes, arrows = read()
    height = floors(arrows)
    rows = {package: [n for n in sizes if n[0] == package] for package in PACKAGES}
    widest = {p: max(sum(height[n] == f for n in nodes) for f in range(12)) for p, nodes in rows.items()}
    top = 1.6 * max(height.values())
    figure, axes = plt.subplots(figsize=(25, 0.58 * (top + 3.7)))  # a floor has room for a name and its lines
    left, place = 0.0, {}
    for package, nodes in rows.items():
        for floor in sorted({height[n] for n in nodes}):
            here = sorted(n for n in nodes if height[n] == floor)
            for number, node in enumerate(here):
                x = left + (number + 0.5) * widest[package] / len(here)
                place[node] = (x, 1.6 * floor + (0.25 if number % 2 else -0.1))
        others = sorted({other for n in nodes for other in arrows[n] if other[0] != package})
        taken = "\n".join(
            f"imports {p}" if p == SHARED else f"imports {p}: {', '.join(name for q, name in others if q == p)}"
            for p in PACKAGES
            if p in {q for q, _ in others}
        )
        middle = left + widest[package] / 2
        axes.text(middle, top + 0.9, package, ha="center", fontsize=17, weight="bold")
        axes.text(middle, -1.0, taken or "imports no other package", ha="center", va="top", fontsize=9, wrap=True)
        left += widest[package] + 0.7
    for node, others in arrows.items():
        for other in others:
            if other[0] == node[0]:
                arrow = FancyArrowPatch(
                    place[node], place[other], arrowstyle="-|>", mutation_scale=9, shrinkA=15, shrinkB=15,
                    color="0.6", linewidth=0.7, zorder=1,
                    connectionstyle=f"arc3,rad={0.04 + 0.05 * (height[node] - height[other] - 1)}",
                )  # fmt: skip
                axes.add_patch(arrow)
    for node, (x, y) in place.items():
        files, lines = sizes[node]
        folder = (ROOT / node[0] / node[1]).is_dir()
        box = FancyBboxPatch(
            (x - 0.44, y - 0.26), 0.88, 0.52, boxstyle="round,pad=0.02", zorder=2,
            facecolor="#dce9f5" if folder else "#fdf3dc", edgecolor="0.3",
        )  # fmt: skip
        axes.add_patch(box)
        size = 8.5 if len(node[1]) < 12 else 7.5  # a long name keeps within its box
        axes.text(x, y + 0.1, node[1], ha="center", va="center", fontsize=size, weight="bold", zorder=3)
        note = f"{files} files, {lines}" if folder else f"{lines} lines"
        axes.text(x, y - 0.13, note, ha="center", va="center", fontsize=7, color="0.3", zorder=3)
    axes.set_xlim(-0.3, left - 0.4)
    axes.set_ylim(-2.4, top + 1.3)
    axes.axis("off")
    figure.savefig(path, dpi=80, bbox_inches="tight")


if __name__ == "__main__":
    draw(Path(__file__).with_name("pictures") / "architecture.png")
