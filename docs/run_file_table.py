"""Write the tables that docs/reference/run-file.md includes, from the trees that write and read the file."""

from pathlib import Path

from daq.runfile import schema
from daq.runfile.tree import Group, Tree
from fitting.report import stage
from processing import stage as smooth

TABLES = Path(__file__).parent / "reference" / "run-file-fields.inc"
TREES: dict[str, Tree] = {
    "Recording": (schema.ENTRY, *schema.TREE),
    "Written by process smooth": smooth.TREE,
    "Written by fit-friction": stage.TREE,
}


def documentation(tree: Tree) -> str:
    """Return a tree as a table in Markdown: one row a group or field, in the order of writing."""
    lines = ["| in /entry | type, unit | what it is |", "|---|---|---|"]
    for row in tree:
        optional = "?" if row.optional else ""
        if isinstance(row, Group):
            lines.append(f"| **{row.path or '/entry'}**{optional} | {row.nx_class} | |")
        elif row.text:
            unit = f", {row.unit}" if row.unit else ""
            text = f"hard link to {row.text}" if row.kind == "link" else row.text
            lines.append(f"| {row.name}{optional} | {row.kind}{unit} | {text} |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    TABLES.write_text("\n".join(f"### {title}\n\n{documentation(tree)}" for title, tree in TREES.items()))
