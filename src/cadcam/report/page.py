"""A report as one HTML page, and its pieces: sections, and tables whose rows become cards on a narrow screen."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

_STYLE = """
:root{color-scheme:light;--ink:#1c1c1c;--soft:#5a5a5a;--line:#d9d9d9;--bg:#f6f6f4}
*{box-sizing:border-box}
body{margin:0;background:var(--bg);color:var(--ink);font:16px/1.45 system-ui,"DejaVu Sans",sans-serif}
main{max-width:1180px;margin:0 auto;padding:16px;overflow-wrap:break-word}
h1{font-size:1.15rem;margin:0 0 .2rem}h2{font-size:1.15rem;margin:1.2rem 0 .5rem}h3{font-size:1rem;margin:.8rem 0 .3rem}
header{color:#fff;padding:18px 20px;border-radius:10px}
header .verdict{font-size:2.3rem;font-weight:700;letter-spacing:.02em;line-height:1.1}
header p{margin:.4rem 0 0;overflow-wrap:anywhere}
section{background:#fff;border:1px solid var(--line);border-radius:10px;padding:4px 16px 16px;margin-top:16px}
svg{width:100%;height:auto;display:block}svg text{font-family:system-ui,"DejaVu Sans",sans-serif}
table{border-collapse:collapse;width:100%;font-size:.92rem;font-variant-numeric:tabular-nums}
th{text-align:left;color:var(--soft);font-weight:600;border-bottom:2px solid var(--line);padding:6px 10px 6px 0}
td{padding:7px 10px 7px 0;border-bottom:1px solid var(--line);vertical-align:top}
.tag{font-weight:700;white-space:nowrap}.soft{color:var(--soft);font-size:.9rem}
.name{overflow-wrap:anywhere;unicode-bidi:isolate}td .name{display:inline-block;min-width:7em}
.two{display:grid;grid-template-columns:minmax(0,1fr) minmax(0,1fr);gap:16px}
.legend{display:flex;flex-wrap:wrap;gap:6px 16px;align-items:center;font-size:.9rem;color:var(--soft)}
.legend i{display:inline-block;margin-right:6px;vertical-align:middle}
summary{cursor:pointer;font-weight:600;padding:.5rem 0 .2rem}code{overflow-wrap:anywhere;font-size:.82rem}
@media(max-width:720px){
main{padding:8px}header .verdict{font-size:1.9rem}section{padding:2px 12px 12px}
.two{grid-template-columns:minmax(0,1fr)}
table.cards thead{display:none}
table.cards tr{display:block;border-bottom:2px solid var(--line);padding:8px 0}
table.cards td{display:flex;gap:10px;border:0;padding:2px 0;white-space:normal;overflow-wrap:anywhere}
table.cards td::before{content:attr(data-head);flex:0 0 96px;color:var(--soft)}
table.cards td:empty{display:none}
}
"""
# On paper (A4, US letter): small enough for every column, nothing to scroll; tables run over pages, rows and figures
# stay whole. A page's own rules stand before these.
_PRINT = """
@media print{
html,body{font-size:11px}body{background:#fff}main{max-width:none;padding:0}
header,.legend,.scale{-webkit-print-color-adjust:exact;print-color-adjust:exact}
h1,h2,h3{break-after:avoid}tr,p,li,svg,img,header,.two>*,section:not(:has(tr)){break-inside:avoid}thead{display:table-header-group}
.wide{overflow:visible}th,td{padding-right:7px;overflow-wrap:normal}
svg,img{max-height:220mm}img{object-fit:contain}svg.bar{width:110px;height:20px}td:last-child{min-width:8em}
table:not(.cards) td:last-child{min-width:0}
}
"""


def page(title: str, style: str, parts: Sequence[str]) -> str:
    """Return a whole document of HTML parts, without empty ones; style: its own CSS. The page loads nothing else."""
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(title)}</title><style>{_STYLE}{style}{_PRINT}</style></head>\n<body><main>\n"
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


def named(text: str) -> str:
    """Return a name out of CAD as HTML: however long it is, and without any blank, it leaves room for the rest."""
    return f'<span class="name">{escape(text)}</span>'


def row(heads: Sequence[str], cells: Sequence[str]) -> str:
    """Return a row of HTML cells, each with its column's head as an attribute: a card shows it beside the cell."""
    pairs = zip(heads, cells, strict=True)
    return "<tr>" + "".join(f'<td data-head="{escape(h)}">{c}</td>' for h, c in pairs) + "</tr>"
