"""Sheets are at true scale: what SVG and PDF say, in mm on paper, is the board's ink."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest

from cadcam.errors import BadValue, UnknownName
from cadcam.target.boards.board import Pattern
from cadcam.target.boards.pattern import parse_pattern
from cadcam.target.marks.mark import MarkSheet, parse_mark
from cadcam.target.sheet import write_sheet

POINT = 25.4 / 72


def test_an_svg_s_shapes_are_the_ink_in_millimetres(tmp_path: Path) -> None:
    pattern = parse_pattern("chessboard:5x4:12.5mm")
    size = write_sheet(tmp_path / "board.svg", pattern)
    root = ET.parse(tmp_path / "board.svg").getroot()
    assert root.get("width") == f"{size[0]:g}mm"
    assert root.get("viewBox") == f"0 0 {size[0]:g} {size[1]:g}"
    path = root.find(".//{*}path")
    assert path is not None
    numbers = [[float(n) for n in re.findall(r"-?[\d.]+", part)] for part in path.get("d", "").split("Z") if part]
    drawn = np.array([[a, b, c, d] for a, b, c, d, _ in numbers])
    assert np.allclose(drawn, pattern.ink().rectangles, atol=1e-4)


def test_a_pdf_s_shapes_are_the_ink_in_points(tmp_path: Path) -> None:
    pattern = parse_pattern("circles:4x3:20mm:9mm")
    write_sheet(tmp_path / "board.pdf", pattern, page="a4")
    data = (tmp_path / "board.pdf").read_bytes()
    text = data.decode("latin-1")
    box = [float(n) * POINT for n in re.findall(r"MediaBox \[0 0 ([\d.]+) ([\d.]+)\]", text)[0]]
    assert np.allclose(box, [210, 297], atol=1e-3)
    k, x, y = (float(n) for n in re.findall(r"q ([\d.]+) 0 0 -[\d.]+ ([\d.]+) ([\d.]+) cm", text)[0])
    assert k * POINT == pytest.approx(1.0, abs=1e-6)  # a mm of the board is a mm on paper
    starts = np.array([[float(n) for n in m] for m in re.findall(r"(-?[\d.]+) (-?[\d.]+) m ", text)])
    assert np.allclose(starts - [4.5, 0], pattern.ink().discs[:, :2], atol=1e-5)
    middle = (x * POINT + 30.0, 297 - y * POINT + 20.0)
    assert np.allclose(middle, [105, 148.5], atol=1e-3)


def test_a_pdf_s_table_points_at_its_objects(tmp_path: Path) -> None:
    write_sheet(tmp_path / "board.pdf", parse_pattern("chessboard:9x6:25mm"))
    data = (tmp_path / "board.pdf").read_bytes()
    places = [int(n) for n in re.findall(rb"(\d{10}) 00000 n", data)]
    assert [data[p : p + 7] for p in places] == [b"%d 0 obj" % (i + 1) for i in range(5)]
    assert data[int(re.findall(rb"startxref\n(\d+)", data)[0]) :].startswith(b"xref")
    length = int(re.findall(rb"/Length (\d+)", data)[0])
    start = data.index(b"stream\n") + 7
    assert data[start + length :].startswith(b"\nendstream")


def test_a_page_is_turned_if_the_board_fits_only_so(tmp_path: Path) -> None:
    assert write_sheet(tmp_path / "b.pdf", parse_pattern("chessboard:9x6:25mm"), page="A4") == (297, 210)


@pytest.mark.parametrize(
    ("sheet", "page"),
    [
        (MarkSheet((parse_mark("dot:5mm"),), np.zeros((1, 2))), None),
        (MarkSheet.grid((parse_mark("dot-ring:12mm:18mm:24mm"),), 3, 5, 30.0), "a5"),
        (parse_pattern("charuco:8x11:15mm:11mm:5X5_100"), "a5"),
        (parse_pattern("chessboard:9x6:25mm"), "a4"),
    ],
)
def test_what_the_print_must_measure_is_written_within_the_sheet(
    sheet: Pattern | MarkSheet, page: str | None, tmp_path: Path
) -> None:
    """By the widths of Helvetica's own metrics, which PDF's viewers use; as large as there is room for."""
    pytest.importorskip("matplotlib")
    pytest.importorskip("cv2")
    width, _ = write_sheet(tmp_path / "b.pdf", sheet, page=page)
    write_sheet(tmp_path / "b.svg", sheet, page=page)
    text = (tmp_path / "b.pdf").read_bytes().decode("latin-1")
    ((points, left, label),) = re.findall(r"/F1 ([\d.]+) Tf ([\d.]+) [\d.]+ Td \((.*)\) Tj", text)
    assert "measures" in label
    drawn = sum(_helvetica()[c] for c in label) / 1000 * float(points) * POINT
    assert float(left) * POINT + drawn < width - 5
    assert float(points) * POINT > 2.0
    svg = ET.parse(tmp_path / "b.svg").getroot().find("{*}text")
    assert svg is not None
    assert float(svg.get("font-size", "")) == pytest.approx(float(points) * POINT, abs=0.001)


def _helvetica() -> dict[str, float]:
    """Return the widths of Helvetica's letters, in thousandths of its height."""
    import matplotlib

    path = Path(matplotlib.get_data_path()) / "fonts" / "pdfcorefonts" / "Helvetica.afm"
    found = re.findall(r"^C (\d+) ; WX (\d+) ;", path.read_text(encoding="latin-1"), re.MULTILINE)
    return {chr(int(code)): float(width) for code, width in found}


def test_what_does_not_fit_or_is_not_known_is_refused(tmp_path: Path) -> None:
    pattern = parse_pattern("chessboard:9x6:40mm")
    with pytest.raises(BadValue, match="400 x 280 mm"):
        write_sheet(tmp_path / "b.pdf", pattern, page="a4")
    with pytest.raises(BadValue, match="250 x 175 m; expected at most 5 m a side: are its lengths in mm, as 25mm"):
        write_sheet(tmp_path / "b.pdf", parse_pattern("chessboard:9x6:25m"))
    with pytest.raises(UnknownName, match="a4"):
        write_sheet(tmp_path / "b.pdf", pattern, page="a44")
    with pytest.raises(UnknownName, match=r"\.svg"):
        write_sheet(tmp_path / "b.png", pattern)
    assert not list(tmp_path.iterdir())
