"""How a value looks in a notebook: small HTML tables, every text in them escaped."""

from collections.abc import Iterable, Sequence
from html import escape


def table(caption: str, rows: Iterable[Sequence[str]], header: Sequence[str] = ()) -> str:
    """Return a table as HTML; what comes from a file (titles, notes, names) may contain anything.

    caption: Stands above it.
    rows: Cells; the first of each row is its name.
    header: Names of the columns; left out when empty.
    """
    parts = [f'<table><caption style="text-align: left"><b>{escape(caption)}</b></caption>']
    if header:
        parts.append(f"<tr>{''.join(_cell('th', name) for name in header)}</tr>")
    parts += [f"<tr>{_cell('th', row[0])}{''.join(_cell('td', cell) for cell in row[1:])}</tr>" for row in rows]
    return "\n".join([*parts, "</table>"])


def _cell(kind: str, text: str) -> str:
    return f'<{kind} style="text-align: left">{escape(text)}</{kind}>'
