"""A report as one HTML page, and its pieces: sections, and tables whose rows become cards on a narrow screen."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape


def page(title: str, style: str, parts: Sequence[str]) -> str:
    """Return a whole document of HTML parts, empty ones left out; style: CSS. Nothing in it is fetched."""
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(title)}</title><style>{style}</style></head>\n<body><main>\n"
        + "\n".join(part for part in parts if part)
        + "\n</main></body></html>\n"
    )


def section(title: str, body: str) -> str:
    """Return a section with a heading, or none where the title is empty; body: HTML."""
    head = f"<h2>{escape(title)}</h2>" if title else ""
    return f"<section>{head}{body}</section>"


def cards(heads: Sequence[str], rows: str) -> str:
    """Return a table of `row`s under column heads."""
    head = "".join(f"<th>{escape(h)}</th>" for h in heads)
    return f'<table class="cards"><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table>'


def row(heads: Sequence[str], cells: Sequence[str]) -> str:
    """Return a row of HTML cells, each of which knows its column's head: a card shows it beside the cell."""
    pairs = zip(heads, cells, strict=True)
    return "<tr>" + "".join(f'<td data-head="{escape(h)}">{c}</td>' for h, c in pairs) + "</tr>"
