"""What a format allows and few writers use: comments, lists that are not corners, several libraries."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from cadcam.cad.read import read_model
from cadcam.errors import UnreadableFile

TRIANGLE = "v 0 0 0\nv 1 0 0\nv 0 1 0\n"


def test_comments_end_lines_of_an_obj_but_belong_to_its_names(tmp_path: Path) -> None:
    text = "o plate #2\n" + TRIANGLE.replace("v 0 0 0", "v 0 0 0 # the origin") + "f 1 2 3 # below\n"
    (tmp_path / "a.obj").write_text(text)
    mesh = read_model(tmp_path / "a.obj")
    assert mesh.part_names == ("plate #2",)
    assert mesh.n_faces == 1


def test_a_comment_of_an_obj_that_ends_in_a_backslash_takes_no_vertex_with_it(tmp_path: Path) -> None:
    """It was joined with the next line, as other lines are."""
    (tmp_path / "a.obj").write_text("# of C:\\parts\\\n" + TRIANGLE + "f 1 \\\n2 3\n")
    assert read_model(tmp_path / "a.obj").vertices.tolist() == [[0, 0, 0], [1, 0, 0], [0, 1, 0]]


def test_a_continued_line_of_an_obj_is_one_line_of_the_file_more(tmp_path: Path) -> None:
    (tmp_path / "a.obj").write_text(TRIANGLE + "f 1 \\\n2 3\nf 1 two 3\n")
    with pytest.raises(UnreadableFile, match="line 6: face '1 two 3'"):
        read_model(tmp_path / "a.obj")


def test_a_tab_before_the_name_of_an_obj_group_is_a_blank(tmp_path: Path) -> None:
    (tmp_path / "a.obj").write_text(TRIANGLE + "g\tleft side\nf 1 2 3\no\n\ng  right\nf 3 2 1\n")
    assert read_model(tmp_path / "a.obj").part_names == ("left side", "right")


@pytest.mark.parametrize("names", ["a.mtl b.mtl", "b.mtl", "with blanks.mtl", "none.mtl b.mtl"])
def test_an_obj_names_one_or_several_libraries(tmp_path: Path, names: str) -> None:
    (tmp_path / "a.mtl").write_text("newmtl other\nKd 0 0 1\n")
    for name in ("b.mtl", "with blanks.mtl"):
        (tmp_path / name).write_text("newmtl red\nKd 1 0 0\n")
    (tmp_path / "a.obj").write_text(f"mtllib {names}\n{TRIANGLE}usemtl red\nf 1 2 3\n")
    assert read_model(tmp_path / "a.obj").colors_of_faces.tolist() == [[1, 0, 0]]


HEADER = (
    "ply\nformat {} 1.0\ncomment the end_header is below\nelement vertex 4\n"
    "property float x\nproperty float y\nproperty float z\nelement face 2\n"
    "property list uchar float texcoord\nproperty list uchar int vertex_indices\nend_header\n"
)
CORNERS = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
NONE = float("nan")  # as of faces without a texture


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("lengths", [(2, 2), (2, 0)], ids=["even", "uneven"])
@pytest.mark.parametrize("form", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_texture_coordinates_of_a_ply_may_be_anything(tmp_path: Path, form: str, lengths: tuple[int, int]) -> None:
    """Some writers have NaN where a face has no texture; they were taken for numbers of vertices."""
    faces = [(0, 1, 2), (0, 2, 3)]
    if form == "ascii":
        lines = [*(" ".join(map(str, c)) for c in CORNERS.tolist())]
        lines += [f"{n} {'nan ' * n}3 {a} {b} {c}" for n, (a, b, c) in zip(lengths, faces, strict=True)]
        body = "\n".join(lines).encode()
    else:
        order = "<" if "little" in form else ">"
        body = CORNERS.astype(f"{order}f4").tobytes()
        for n, face in zip(lengths, faces, strict=True):
            body += struct.pack(f"{order}B{n}fB3i", n, *[NONE] * n, 3, *face)
    (tmp_path / "a.ply").write_bytes(HEADER.format(form).encode() + body)
    mesh = read_model(tmp_path / "a.ply")
    assert mesh.n_faces == 2
    assert mesh.face_areas.sum() == 1
