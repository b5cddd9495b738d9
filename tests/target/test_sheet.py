"""Sheets are at true scale: what SVG and PDF say, in mm on paper, is the board's ink."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest

from cadcam.errors import BadValue, UnknownName
from cadcam.target.boards.pattern import parse_pattern
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


def test_what_does_not_fit_or_is_not_known_is_refused(tmp_path: Path) -> None:
    pattern = parse_pattern("chessboard:9x6:40mm")
    with pytest.raises(BadValue, match="400 x 280 mm"):
        write_sheet(tmp_path / "b.pdf", pattern, page="a4")
    with pytest.raises(UnknownName, match="a4"):
        write_sheet(tmp_path / "b.pdf", pattern, page="a44")
    with pytest.raises(UnknownName, match=r"\.svg"):
        write_sheet(tmp_path / "b.png", pattern)
    assert not list(tmp_path.iterdir())
