"""Pieces of a report's HTML page: sections, and tables whose rows become cards where the screen is narrow."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape


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
