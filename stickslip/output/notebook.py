"""How a value looks in a notebook: small HTML tables, every text in them escaped."""

from collections.abc import Iterable, Sequence
from html import escape


def table(caption: str, rows: Iterable[Sequence[str]], header: Sequence[str] = ()) -> str:
    """Return a table as escaped HTML; the first cell of each row is its name."""
    parts = [f'<table><caption style="text-align: left"><b>{escape(caption)}</b></caption>']
    if header:
        parts.append(f"<tr>{''.join(_format_cell('th', name) for name in header)}</tr>")
    parts += [
        f"<tr>{_format_cell('th', row[0])}{''.join(_format_cell('td', cell) for cell in row[1:])}</tr>" for row in rows
    ]
    return "\n".join([*parts, "</table>"])


def _format_cell(kind: str, text: str) -> str:
    return f'<{kind} style="text-align: left">{escape(text)}</{kind}>'
