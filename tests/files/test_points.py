"""A points file says what its columns are, in which unit, and every fault is named with its place and remedy."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cadcam.camera.observations import Observations
from cadcam.errors import BadValue, CadcamError, UnknownName, UnreadableFile
from cadcam.files.points import read_points, write_points

GOOD = "# two points\nname,X,Y,Z,x_px,y_px\nA,1,2,3,10.5,20.25\n\nB,4,5,6,11,21  \n"


def saved(folder: Path, text: str | bytes) -> Path:
    path = folder / "points.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


@pytest.mark.parametrize(
    "separated", [GOOD, GOOD.replace(",", "\t"), GOOD.replace(",", " ; "), GOOD.replace(",", "   "), "\ufeff" + GOOD]
)
def test_commas_tabs_semicolons_and_blanks_mean_the_same(tmp_path: Path, separated: str) -> None:
    points = read_points(saved(tmp_path, separated))
    assert points.names == ("A", "B")
    np.testing.assert_array_equal(points.p_world, [[1, 2, 3], [4, 5, 6]])
    np.testing.assert_array_equal(points.q, [[10.5, 20.25], [11, 21]])


def test_windows_line_ends_and_utf16_are_read(tmp_path: Path) -> None:
    for data in (GOOD.replace("\n", "\r\n").encode(), GOOD.encode("utf-16")):
        assert len(read_points(saved(tmp_path, data))) == 2


def test_uv_is_row_and_column(tmp_path: Path) -> None:
    points = read_points(saved(tmp_path, "X,Y,Z,U,V\n0,0,0,187,159\n"))
    np.testing.assert_array_equal(points.q, [[159, 187]])


@pytest.mark.parametrize(
    ("header", "mm"), [("X_m,Y_m,Z_m", 1000), ("X [in],Y [in],Z [in]", 25.4), ("x_mm,y_mm,z_mm", 1)]
)
def test_the_header_names_the_unit(tmp_path: Path, header: str, mm: float) -> None:
    points = read_points(saved(tmp_path, f"{header},x_px,y_px\n1,2,3,4,5\n"))
    np.testing.assert_array_equal(points.p_world, np.array([[1, 2, 3]]) * mm)


def test_the_unit_may_be_an_argument_but_not_contradict_the_header(tmp_path: Path) -> None:
    path = saved(tmp_path, "X,Y,Z,x_px,y_px\n1,2,3,4,5\n")
    np.testing.assert_array_equal(read_points(path, unit="m").p_world, [[1000, 2000, 3000]])
    with pytest.raises(UnknownName, match=r"'mn'.*did you mean"):
        read_points(path, unit="mn")
    with pytest.raises(UnreadableFile, match="names the world point's columns in m; ask for no other unit, not for mm"):
        read_points(saved(tmp_path, "X_m,Y_m,Z_m,x_px,y_px\n1,2,3,4,5\n"), unit="mm")
    with pytest.raises(UnreadableFile, match="in m and mm at once"):
        read_points(saved(tmp_path, "X_m,Y_mm,Z_m,x_px,y_px\n1,2,3,4,5\n"))
    with pytest.raises(UnreadableFile, match="unknown unit 'furlong'"):
        read_points(saved(tmp_path, "X_furlong,Y,Z,x_px,y_px\n1,2,3,4,5\n"))


def test_lowercase_uv_is_refused_with_the_reason(tmp_path: Path) -> None:
    with pytest.raises(UnreadableFile, match="OpenCV's u is the column, the dissertation's U the row; rename"):
        read_points(saved(tmp_path, "X,Y,Z,u,v\n1,2,3,4,5\n"))


def test_several_pairs_of_image_columns_need_a_choice(tmp_path: Path) -> None:
    path = saved(tmp_path, "X,Y,Z,U1,V1,U2,V2\n1,2,3,4,5,6,7\n")
    with pytest.raises(UnreadableFile, match=r"U1, V1, U2, V2.*--columns U1,V1 or U2,V2"):
        read_points(path)
    np.testing.assert_array_equal(read_points(path, columns=("U2", "V2")).q, [[7, 6]])
    with pytest.raises(UnknownName, match="U3"):
        read_points(path, columns=("U3", "V3"))
    with pytest.raises(BadValue, match="expected U1,V1 or U2,V2"):
        read_points(path, columns=("U1", "V2"))


def test_a_file_without_header_takes_the_names_given(tmp_path: Path) -> None:
    path = saved(tmp_path, "1 2 3 4 5\n6 7 8 9 10\n")
    with pytest.raises(UnreadableFile, match=r"line 1 should name the columns but holds 5 numbers.*--header"):
        read_points(path)
    points = read_points(path, header=("X", "Y", "Z", "U", "V"))
    np.testing.assert_array_equal(points.q, [[5, 4], [10, 9]])


@pytest.mark.parametrize(
    ("text", "place"),
    [
        (GOOD.replace("20.25", "abc"), "line 3, column y_px is 'abc', not a number"),
        (GOOD.replace("20.25", "nan"), "line 3, column y_px is 'nan'; give a finite number"),
        (GOOD.replace("20.25", "-1e300"), "line 3, column y_px is '-1e300'; give a finite number, at most 1e.30"),
        (GOOD.replace("20.25", ""), "line 3, column y_px is empty"),
        (GOOD.replace("20.25", "1e999"), "line 3, column y_px is '1e999'"),
        (GOOD.replace(",20.25", ""), "line 3 has 5 cells, the header 6"),
        (GOOD.replace("B,4", "A,4"), "line 5 has the name 'A' of line 3"),
        (GOOD.replace("B,4", ",4"), "line 5 has no name"),
        (GOOD.replace("4,5,6,11,21", "1,2,3,10.5,20.25"), "line 5 repeats the point of line 3"),
        (GOOD.replace("Z,", "W,"), r"has no column for Z \(columns: name, X, Y, W, x_px, y_px\)"),
        (GOOD.replace("x_px", "col"), "has no image point"),
        (GOOD.replace("name", "X"), "column 'X' stands twice"),
        (GOOD.replace("name", "sigma_x"), "column 'sigma_x' is not understood; name it sigma_px"),
        ("X,Y,Z,x_px,y_px\n", "has a header but no points"),
        ("# nothing\n", "holds only comments"),
        (" \n", "is empty"),
        (b"\x89PNG\r\n\x1a\n\x00\x00", "is not text"),
        (b"X\x00Y", "zero bytes"),
        ("X;Y;Z;x_px;y_px\n1,5;2;3;4;5\n", "write a decimal point, not a comma"),
        ("X,Y,Z,x_px,y_px\n1,5,2,3,4,5\n", "line 2 has 6 cells, the header 5 .* with a point, not a comma"),
    ],
)
def test_a_fault_is_named_with_file_line_column_value_and_remedy(tmp_path: Path, text: str | bytes, place: str) -> None:
    path = saved(tmp_path, text)
    with pytest.raises(UnreadableFile, match=place) as caught:
        read_points(path)
    assert str(caught.value).startswith(str(path))
    assert caught.value.remedy


def test_a_missing_file_and_a_folder_are_named(tmp_path: Path) -> None:
    with pytest.raises(UnreadableFile, match="no such file"):
        read_points(tmp_path / "none.csv")
    with pytest.raises(UnreadableFile, match="is a folder"):
        read_points(tmp_path)


def test_sigma_is_one_number_for_all_points(tmp_path: Path) -> None:
    path = saved(tmp_path, "X,Y,Z,x_px,y_px,sigma_px\n1,2,3,4,5,0.3\n6,7,8,9,10,0.3\n")
    assert read_points(path).sigma_px == 0.3
    with pytest.raises(UnreadableFile, match=r"different sigma_px: 0\.2, 0\.3"):
        read_points(path, sigma_px=0.2)
    with pytest.raises(UnreadableFile, match="line 2, column sigma_px is 0; give a positive"):
        read_points(saved(tmp_path, "X,Y,Z,x_px,y_px,sigma_px\n1,2,3,4,5,0\n"))
    assert read_points(saved(tmp_path, GOOD), sigma_px=0.5).sigma_px == 0.5


@pytest.mark.parametrize("sigma", [None, 0.1])
def test_writing_and_reading_keeps_every_bit(tmp_path: Path, rng: np.random.Generator, sigma: float | None) -> None:
    names = ("#1", "with, comma", 'with "quotes"', "-")  # a # in front would make a comment of the line
    points = Observations(rng.normal(size=(4, 3)) * 1e5, rng.normal(size=(4, 2)), names, sigma_px=sigma)
    write_points(tmp_path / "out.csv", points)
    back = read_points(tmp_path / "out.csv")
    np.testing.assert_array_equal(back.p_world, points.p_world)
    np.testing.assert_array_equal(back.q, points.q)
    assert back.names == names
    assert back.sigma_px == sigma


def test_a_sigma_of_numpy_is_written_as_a_number(tmp_path: Path, rng: np.random.Generator) -> None:
    """NumPy 2 prints its own as "np.float64(0.25)", which no reader takes for one."""
    for kind in (np.float64, np.float32, int):
        given = Observations(rng.normal(size=(3, 3)), rng.normal(size=(3, 2)), sigma_px=kind(2))
        write_points(tmp_path / "p.csv", given)
        assert read_points(tmp_path / "p.csv").sigma_px == 2


@pytest.mark.parametrize("name", ["two\nlines", " blank", "tab\t", ""])
def test_a_name_that_would_not_come_back_is_not_written(tmp_path: Path, name: str) -> None:
    with pytest.raises(BadValue, match=r"^name is"):
        write_points(tmp_path / "out.csv", Observations(np.ones((1, 3)), np.ones((1, 2)), (name,)))
    assert not (tmp_path / "out.csv").exists()


@pytest.mark.parametrize(
    ("table", "columns", "count"), [("2_3", None, 16), ("2_7", "U2,V2", 16), ("3_10", None, 11), ("3_13", None, 7)]
)
def test_the_dissertations_tables_are_read_as_they_are(
    shared: Callable[[str], Path], table: str, columns: str | None, count: int
) -> None:
    path = shared(f"thesis/tables/table_{table}.csv")
    points = read_points(path, columns=columns.split(",") if columns else None)
    assert len(points) == count
    assert points.source == str(path)
    assert len(points.sha256) == 64


def test_every_refusal_is_a_cadcam_error() -> None:
    assert issubclass(UnreadableFile, CadcamError)
