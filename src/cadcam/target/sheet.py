"""Boards and marks to print: SVG and PDF at true scale, with a line of text that states what the print must measure."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Protocol, TypeAlias

import numpy as np

from cadcam.arrays import Array
from cadcam.errors import BadValue, UnknownName
from cadcam.target.boards.board import Ink
from cadcam.whole import write_whole

PAGES: dict[str, tuple[float, float]] = {
    "a5": (148, 210),
    "a4": (210, 297),
    "a3": (297, 420),
    "a2": (420, 594),
    "a1": (594, 841),
    "a0": (841, 1189),
}
PAGES |= {"letter": (215.9, 279.4), "tabloid": (279.4, 431.8)}
_MOST_MM = 5000.0  # of what is printed, a side: more was meant in another unit
_TEXT_MM = 3.0  # height of the text; less where a page is too narrow for it
_LEAST_MARGIN_MM = 8.0  # room for the text, and for the margin that printers cannot reach
_NARROW, _BROAD = "fijlrt .,:;|()[]'", "mwMW"  # letters of 0.28 to 0.33 and 0.72 to 0.94 of the height of the text
_POINTS_PER_MM = 72 / 25.4
_ARC = 4 / 3 * (np.sqrt(2) - 1)  # of the radius: handles of a quarter circle as a Bezier curve, 0.03 % off


class Sheet(Protocol):
    """What can be printed: a calibration board, a plate with marks."""

    @property
    def outline(self) -> tuple[float, float, float, float]:
        """Return (left, top, right, bottom) of all ink in mm."""

    @property
    def size_mm(self) -> tuple[float, float]:
        """Return width and height of the ink in mm."""

    @property
    def cell_mm(self) -> float:
        """Return the white margin around the ink where no page is given, mm."""

    def ink(self) -> Ink:
        """Return what is printed."""


def write_sheet(path: str | os.PathLike[str], pattern: Sheet, *, page: str | None = None) -> tuple[float, float]:
    """Write a board, or a plate with marks, as .svg or .pdf at true scale and return the sheet's (width, height) in mm.

    page: a paper size (a4, letter ...), rotated if need be, with the board in its middle; None: the board with a white
    margin of one cell, wider if the text below it is. Raises `UnknownName` for another suffix or page, `BadValue` if
    the board does not fit, or is larger than 5 m, which nobody prints.
    """
    writers: dict[str, Callable[[Sheet, tuple[float, float]], bytes]] = {".svg": _svg, ".pdf": _pdf}
    suffix = Path(path).suffix.lower()
    if suffix not in writers:
        raise UnknownName("suffix of a sheet", suffix, writers)
    size = sheet_size(pattern, page)
    write_whole(path, writers[suffix](pattern, size))
    return size


def sheet_size(pattern: Sheet, page: str | None) -> tuple[float, float]:
    """Return the sheet's (width, height) in mm."""
    width, height = (float(n) for n in pattern.size_mm)
    if max(width, height) > _MOST_MM:
        at_most = f"at most {_MOST_MM / 1000:g} m a side: are its lengths in mm, as 25mm?"
        raise BadValue("board to print", f"{width / 1000:.4g} x {height / 1000:.4g} m", at_most)
    if page is None:
        margin = max(pattern.cell_mm, _LEAST_MARGIN_MM)
        text = _TEXT_MM * _text_width(_label(pattern)) + 2 * _LEAST_MARGIN_MM
        return max(width + 2 * margin, text), height + 2 * margin
    if page.lower() not in PAGES:
        raise UnknownName("page", page, PAGES)
    short, long = PAGES[page.lower()]
    for size in ((short, long), (long, short)):
        if width + 2 * _LEAST_MARGIN_MM <= size[0] and height + 2 * _LEAST_MARGIN_MM <= size[1]:
            return float(size[0]), float(size[1])
    raise BadValue(
        "board", f"{width:.4g} x {height:.4g} mm", f"one that fits on {page} ({short:g} x {long:g} mm) with a margin"
    )


def _label(pattern: Sheet) -> str:
    width, height = pattern.size_mm
    return f"{pattern}   the black area measures {width:.2f} x {height:.2f} mm: check it with a ruler"


def _text_width(text: str) -> float:
    """Return the width of a text over its height, no less than Helvetica and Arial need for it."""
    return sum(0.34 if c in _NARROW else 0.95 if c in _BROAD else 0.78 if c.isupper() else 0.56 for c in text)


def _text_mm(text: str, width: float) -> float:
    """Return the height at which a text fits on a sheet of this width, mm."""
    return min(_TEXT_MM, (width - 2 * _LEAST_MARGIN_MM) / _text_width(text))


def _shift(pattern: Sheet, size: tuple[float, float]) -> Array:
    """Return the board's origin on the sheet, mm from its upper left."""
    left, top, right, bottom = pattern.outline
    return np.array([(size[0] - left - right) / 2, (size[1] - top - bottom) / 2])


def _svg(pattern: Sheet, size: tuple[float, float]) -> bytes:
    x, y = _shift(pattern, size)
    ink = pattern.ink()
    path = "".join(f"M{a:.6g} {b:.6g}H{c:.6g}V{d:.6g}H{a:.6g}Z" for a, b, c, d in ink.rectangles.tolist())
    discs = "".join(f'<circle cx="{a:.6g}" cy="{b:.6g}" r="{r:.6g}"/>' for a, b, r in ink.discs.tolist())
    holes = "".join(f"M{a:.6g} {b:.6g}H{c:.6g}V{d:.6g}H{a:.6g}Z" for a, b, c, d in ink.ground.tolist())
    holes += "".join(_svg_path(path) for sector in ink.sectors.tolist() for path in _borders(*sector))
    width, height = size
    label = _label(pattern)
    text = f'<text x="{width / 2:g}" y="{height - 2:g}" font-size="{_text_mm(label, width):.4g}" text-anchor="middle" '
    text += f'font-family="Helvetica, Arial, sans-serif">{label}</text>'
    shapes = (f'<path d="{path}"/>' if path else "") + discs
    shapes += f'<path fill-rule="evenodd" d="{holes}"/>' if holes else ""
    return (
        f'<?xml version="1.0" encoding="UTF-8"?>\n<svg xmlns="http://www.w3.org/2000/svg" width="{width:g}mm" '
        f'height="{height:g}mm" viewBox="0 0 {width:g} {height:g}">\n<rect width="100%" height="100%" fill="white"/>\n'
        f'<g transform="translate({x:.6g} {y:.6g})">{shapes}</g>\n{text}\n</svg>\n'
    ).encode()


def _pdf(pattern: Sheet, size: tuple[float, float]) -> bytes:
    """Return a PDF 1.4 of one page (ISO 32000-1, 7.5 and 8.5): coordinates in mm, y flipped down by one matrix."""
    width, height = (v * _POINTS_PER_MM for v in size)
    x, y = _shift(pattern, size)
    k = _POINTS_PER_MM
    ink = pattern.ink()
    lines = [f"q {k:.8f} 0 0 {-k:.8f} {k * x:.5f} {height - k * y:.5f} cm 0 g"]
    lines += [f"{a:.6f} {b:.6f} {c - a:.6f} {d - b:.6f} re" for a, b, c, d in ink.rectangles.tolist()]
    lines += [_circle(*disc) for disc in ink.discs.tolist()]
    lines += [f"{a:.6f} {b:.6f} {c - a:.6f} {d - b:.6f} re" for a, b, c, d in ink.ground.tolist()]
    lines += [_pdf_path(path) for sector in ink.sectors.tolist() for path in _borders(*sector)]
    label = _label(pattern)
    place = f"{k * _LEAST_MARGIN_MM:.3f} {k * 2:.3f}"
    lines += ["f* Q", f"BT /F1 {k * _text_mm(label, size[0]):.3f} Tf {place} Td ({label}) Tj ET"]
    stream = "\n".join(lines).encode()
    objects = [
        b"<< /Type /Catalog /Pages 2 0 R >>",
        b"<< /Type /Pages /Kids [3 0 R] /Count 1 >>",
        f"<< /Type /Page /Parent 2 0 R /MediaBox [0 0 {width:.5f} {height:.5f}] /Contents 4 0 R "
        "/Resources << /Font << /F1 5 0 R >> >> >>".encode(),
        b"<< /Length %d >>\nstream\n%s\nendstream" % (len(stream), stream),
        b"<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica >>",
    ]
    return _numbered(objects)


# a closed line: (x, y) a straight line there, (x1, y1, x2, y2, x, y) a curve
Border: TypeAlias = list[tuple[float, ...]]


def _borders(x: float, y: float, inner: float, outer: float, start: float, stop: float) -> list[Border]:
    """Return the closed borders of a sector of a ring: one, or two for a full ring."""
    if stop - start < 2 * np.pi - 1e-9:
        return [[*_arc(x, y, outer, start, stop), *_arc(x, y, inner, stop, start)]]
    return [_arc(x, y, r, start, stop) for r in (inner, outer) if r > 0]


def _arc(x: float, y: float, r: float, start: float, stop: float) -> Border:
    """Return an arc, from its first point, as Bezier curves of at most 22.5 degrees: within 1e-8 of the radius."""
    if r == 0:
        return [(x, y)]
    count = int(np.ceil(abs(stop - start) / (np.pi / 8) - 1e-9))
    angles = np.linspace(start, stop, count + 1)
    h = 4 / 3 * np.tan((angles[1] - angles[0]) / 4) * r
    at = np.column_stack([x + r * np.cos(angles), y + r * np.sin(angles)])
    ahead = h * np.column_stack([-np.sin(angles), np.cos(angles)])
    curves = np.hstack([at[:-1] + ahead[:-1], at[1:] - ahead[1:], at[1:]])
    return [tuple(at[0].tolist()), *(tuple(curve) for curve in curves.tolist())]


def _svg_path(border: Border) -> str:
    first, *rest = border
    parts = "".join(("L" if len(p) == 2 else "C") + " ".join(f"{v:.6g}" for v in p) for p in rest)
    return f"M{first[0]:.6g} {first[1]:.6g}{parts}Z"


def _pdf_path(border: Border) -> str:
    first, *rest = border
    parts = [" ".join(f"{v:.6f}" for v in p) + (" l" if len(p) == 2 else " c") for p in rest]
    return "\n".join([f"{first[0]:.6f} {first[1]:.6f} m", *parts, "h"])


def _circle(x: float, y: float, r: float) -> str:
    h = _ARC * r
    return (
        f"{x + r:.6f} {y:.6f} m {x + r:.6f} {y + h:.6f} {x + h:.6f} {y + r:.6f} {x:.6f} {y + r:.6f} c "
        f"{x - h:.6f} {y + r:.6f} {x - r:.6f} {y + h:.6f} {x - r:.6f} {y:.6f} c "
        f"{x - r:.6f} {y - h:.6f} {x - h:.6f} {y - r:.6f} {x:.6f} {y - r:.6f} c "
        f"{x + h:.6f} {y - r:.6f} {x + r:.6f} {y - h:.6f} {x + r:.6f} {y:.6f} c h"
    )


def _numbered(objects: list[bytes]) -> bytes:
    """Return a file of these objects with its cross-reference table."""
    out, places = b"%PDF-1.4\n", []
    for number, body in enumerate(objects, 1):
        places.append(len(out))
        out += b"%d 0 obj\n%s\nendobj\n" % (number, body)
    table = b"".join(b"%010d 00000 n \n" % place for place in places)
    count = len(objects) + 1
    return out + b"xref\n0 %d\n0000000000 65535 f \n%strailer\n<< /Size %d /Root 1 0 R >>\nstartxref\n%d\n%%%%EOF\n" % (
        count,
        table,
        count,
        len(out),
    )
