"""Marks are geometry: what they are named, where they are inked, and what is printed of them."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from cadcam.camera.camera import Camera
from cadcam.errors import BadValue, UnknownName
from cadcam.geometry.rigid import Rigid
from cadcam.target.marks.ideal import board_picture, marks_picture
from cadcam.target.marks.mark import (
    MarkSheet,
    angle_mark,
    bulls_eye,
    chess_mark,
    coded_ring,
    dot,
    dot_and_ring,
    inverted,
    parse_mark,
    ring,
    ring_numbers,
)
from cadcam.target.sheet import write_sheet

MARKS = [
    dot(30.0),
    ring(20.0, 30.0),
    dot_and_ring(30.0, 60.0, 90.0),
    bulls_eye(10.0, 20.0, 30.0, 40.0, 50.0),
    angle_mark(20.0, 40.0, 60.0),
    chess_mark(60.0),
    coded_ring(37, 30.0, 45.0, 60.0),
]


@pytest.mark.parametrize("mark", [*MARKS, *map(inverted, MARKS), coded_ring(37, 30.0001, 45.00001, 60.123456)], ids=str)
def test_a_mark_s_name_reads_back_as_the_mark(mark) -> None:
    again = parse_mark(str(mark))
    assert np.array_equal(again.sectors, mark.sectors)
    assert (again.light, again.number) == (mark.light, mark.number)


@pytest.mark.parametrize("mark", MARKS, ids=str)
def test_the_ink_of_a_mark_has_the_area_of_its_sectors(mark, rng: np.random.Generator) -> None:
    """40000 points: a share has a standard deviation of at most 0.0025, of which five are allowed."""
    p = mark.radius * rng.uniform(-1, 1, (40_000, 2))
    inner, outer, start, stop = mark.sectors.T
    area = np.sum((outer**2 - inner**2) * (stop - start) / 2) / (4 * mark.radius**2)
    assert mark.inked(p).mean() == pytest.approx(area, abs=0.0125)


def test_turns_are_those_that_look_the_same() -> None:
    assert [mark.turns for mark in MARKS] == [0, 0, 0, 0, 1, 2, 1]


def test_ring_numbers_are_the_aperiodic_necklaces() -> None:
    """Moreau's count of them: 1/n sum over divisors d of mu(d) 2^(n/d); 335 for 12 bits, 6 for 5."""
    assert len(ring_numbers(12)) == 335
    assert len(ring_numbers(5)) == 6
    with pytest.raises(BadValue, match="335"):
        coded_ring(3 << 3, 30.0, 45.0, 60.0)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("dot:30", "unit"),
        ("dot:30mm:40mm", "dot:30mm"),
        ("dot-ring:30mm:20mm:40mm", "larger"),
        ("bullseye:1mm:2mm", "odd"),
    ],
)
def test_a_wrong_text_says_what_would_be_right(text: str, said: str) -> None:
    with pytest.raises(BadValue, match=said):
        parse_mark(text)
    with pytest.raises(UnknownName, match="bullseye"):
        parse_mark("star:3mm")


def test_marks_that_overlap_are_no_plate() -> None:
    with pytest.raises(BadValue, match="into each other"):
        MarkSheet.grid((dot(30.0),), 2, 2, 29.0)


@pytest.mark.parametrize("light", [False, True])
def test_a_small_mark_beside_a_large_one_takes_nothing_of_its_ink(light: bool) -> None:
    marks = tuple(inverted(m) if light else m for m in (dot(100.0), dot(10.0), dot_and_ring(4.0, 6.0, 10.0)))
    sheet = MarkSheet(marks, np.array([[0.0, 0.0], [56.0, 0.0], [0.0, -56.0]]))
    sheet.check_apart()
    p = np.stack(np.meshgrid(np.arange(-60.0, 65.0), np.arange(-65.0, 60.0)), axis=-1)
    covered = np.any([m.inked(p - place) for m, place in zip(marks, sheet.places, strict=True)], axis=0)
    left, top, right, bottom = sheet.outline
    ground = (p >= [left, top]).all(axis=-1) & (p <= [right, bottom]).all(axis=-1)
    assert np.array_equal(sheet.black(p), ground & ~covered if light else covered)


@pytest.mark.parametrize("mark", [MARKS[2], MARKS[4], inverted(MARKS[0])], ids=str)
def test_marks_on_their_own_paper_look_as_on_a_plate(mark) -> None:
    """The two ways of drawing agree where there is paper: exactly, both average the same ink at the same places."""
    camera = Camera.from_focal((80, 80), 100.0)
    pose = Rigid([[1, 0, 0], [0, 0.8, -0.6], [0, 0.6, 0.8]], [1.0, 2.0, 200.0])
    alone = marks_picture([mark], camera, [pose], background=0.9)
    plate = board_picture(MarkSheet((mark,), np.zeros((1, 2))), camera, pose, background=0.9)
    assert np.allclose(alone, plate, atol=1e-6)


def test_near_marks_hide_far_ones() -> None:
    camera = Camera.from_focal((40, 40), 100.0)
    near, far = (Rigid(np.eye(3), [0, 0, z]) for z in (100.0, 300.0))
    both = marks_picture([dot(4.0), dot(30.0)], camera, [near, far], margin_mm=20.0)
    assert np.array_equal(both, marks_picture([dot(4.0)], camera, [near], margin_mm=20.0))


def _area(path: str, width: int) -> float:
    """Return the area that the closed lines of a path enclose, by their points, holes counted as such."""
    total = 0.0
    for border in path.split("Z"):
        points = [
            [float(v) for v in re.findall(r"-?[\d.]+(?:e-?\d+)?", part)][-2:] for part in re.split("[MLC]", border)
        ]
        q = np.array([p for p in points if len(p) == 2])
        if len(q):
            total += 0.5 * (q[:, 0] @ np.roll(q[:, 1], -1) - q[:, 1] @ np.roll(q[:, 0], -1))
    return total / width


def test_a_printed_mark_has_true_scale(tmp_path: Path) -> None:
    """The dot's outermost points lie a radius from its centre, and the sheet is as many mm as it says."""
    width, height = write_sheet(tmp_path / "mark.svg", MarkSheet((dot(40.0),), np.zeros((1, 2))), page="a5")
    text = (tmp_path / "mark.svg").read_text()
    assert f'width="{width:g}mm"' in text
    assert (width, height) == (148, 210)
    path = re.search(r'fill-rule="evenodd" d="([^"]+)"', text)
    assert path is not None
    ends = [[float(v) for v in part.split()[-2:]] for part in re.findall(r"C([-\d. e]+)", path.group(1))]
    assert np.allclose(np.hypot(*np.array(ends).T), 20.0, atol=1e-4)


def test_a_light_mark_is_a_hole_in_black_ground(tmp_path: Path) -> None:
    write_sheet(tmp_path / "mark.pdf", MarkSheet((inverted(dot(40.0)),), np.zeros((1, 2))))
    text = (tmp_path / "mark.pdf").read_bytes().decode("latin-1")
    assert re.search(r"-40\.0+ -40\.0+ 80\.0+ 80\.0+ re", text)
    assert "f* Q" in text


def test_a_sector_s_border_closes_at_its_corners(tmp_path: Path) -> None:
    mark = chess_mark(60.0)
    write_sheet(tmp_path / "mark.svg", MarkSheet((mark,), np.zeros((1, 2))))
    path = re.search(r'fill-rule="evenodd" d="([^"]+)"', (tmp_path / "mark.svg").read_text())
    assert path is not None
    # 5 points of a 16-sided circle's quarter and the centre: sin(22.5 deg)/2 * 4 triangles of radius^2, twice
    assert abs(_area(path.group(1), 1)) == pytest.approx(2 * 4 * 0.5 * np.sin(np.pi / 8) * 30**2, rel=1e-4)
