"""A pixels file says which view saw which point where; every fault is named with its place."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cadcam.errors import UnreadableFile
from cadcam.files.matrix import read_motion
from cadcam.files.pixels import read_pixels
from cadcam.geometry.rigid import Rigid

GOOD = "# two points\nname,view,x_px,y_px\nA,left,1,2\nB,left,3,4\nB,right,5,6.5\n"


def saved(folder: Path, text: str, name: str = "pixels.csv") -> Path:
    path = folder / name
    path.write_text(text)
    return path


@pytest.mark.parametrize(
    "text", [GOOD, GOOD.replace(",", "\t"), GOOD.replace("name,view", "id,camera"), GOOD.replace(",", "  ")]
)
def test_pixels_are_read_by_view_and_point(tmp_path: Path, text: str) -> None:
    pixels = read_pixels(saved(tmp_path, text))
    assert pixels.names == ("A", "B")
    assert pixels.views == ("left", "right")
    np.testing.assert_array_equal(pixels.q, [[[1, 2], [3, 4]], [[np.nan, np.nan], [5, 6.5]]])


def test_uv_is_row_and_column(tmp_path: Path) -> None:
    assert read_pixels(saved(tmp_path, GOOD.replace("x_px,y_px", "U,V"))).q[0, 0].tolist() == [2, 1]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (GOOD.replace("view", "eye"), "has no column for the view"),
        (GOOD.replace("name", "what"), "has no column for the point"),
        (GOOD.replace("x_px,y_px", "u,v"), "ambiguous"),
        (GOOD + "B,left,9,9\n", "line 6 gives point 'B' in view 'left' again, after line 4"),
        (GOOD + "C,left,9\n", "line 6 has 3 cells"),
        (GOOD + ",left,9,9\n", "line 6 names no point"),
        (GOOD + "C,left,nan,9\n", "line 6, column x_px"),
        ("name,view,x_px,y_px\n", "has a header but no pixels"),
        ("1,2,3,4\n", "should name the columns"),
    ],
)
def test_faults_are_named(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(UnreadableFile, match=message):
        read_pixels(saved(tmp_path, text))


def test_a_motion_file_says_its_direction_and_unit(tmp_path: Path) -> None:
    rows = "0 -1 0 0.1\n1 0 0 0.2\n0 0 1 0.3\n"
    motion = Rigid([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]], [100.0, 200, 300])
    assert read_motion(saved(tmp_path, "# new_from_old, m\n" + rows)).matrix == pytest.approx(motion.matrix)
    assert read_motion(saved(tmp_path, "# old_from_new, m\n" + rows)).matrix == pytest.approx(motion.inv.matrix)
    text = '{"new_from_old": {"rotation": [[0,-1,0],[1,0,0],[0,0,1]], "translation_mm": [100, 200, 300]}}'
    assert read_motion(saved(tmp_path, text, "motion.json")).matrix == pytest.approx(motion.matrix)
    for wrong in ("# camera_from_world, mm\n" + rows, rows, '{"camera_from_world": {}}'):
        with pytest.raises(UnreadableFile, match="new_from_old"):
            read_motion(saved(tmp_path, wrong))
