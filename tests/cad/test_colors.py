"""Colours of faces: read from every format that has them, kept through mending, and written again."""

from __future__ import annotations

import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cadcam.cad.mesh import Mesh, merge
from cadcam.cad.needles import without_needles
from cadcam.cad.read import read_model
from cadcam.cad.write import write_model
from cadcam.errors import BadValue

from .solids import prism

CORNERS = [(0, 0, 0), (9, 0, 0), (9, 5, 0), (0, 5, 0)]
RED, GREEN, BLUE = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
SHEET = Mesh.single(CORNERS, [(0, 1, 2), (0, 2, 3)])
NOTHING = (np.nan,) * 3


def ply(vertex: str, face: str, kinds: tuple[str, str]) -> str:
    """Return a sheet of two triangles; `vertex` and `face` end each line, `kinds` are the properties they hold."""
    lines = ["ply", "format ascii 1.0", "element vertex 4", *(f"property float {k}" for k in "xyz"), kinds[0]]
    lines += ["element face 2", "property list uchar int vertex_indices", kinds[1], "end_header"]
    lines += [f"{x} {y} {z} {word}" for (x, y, z), word in zip(CORNERS, vertex.split(","), strict=True)]
    lines += [f"3 {a} {b} {c} {word}" for (a, b, c), word in zip(SHEET.faces, face.split(","), strict=True)]
    return "\n".join(line for line in lines if line) + "\n"


BYTES = "\n".join(f"property uchar {name}" for name in ("red", "green", "blue"))


def test_ply_colours_of_faces_are_read(tmp_path: Path) -> None:
    (tmp_path / "m.ply").write_text(ply(",,,", "255 0 0,0 0 255", ("", BYTES)))
    assert read_model(tmp_path / "m.ply").colors_of_faces.tolist() == [[*RED], [*BLUE]]


def test_ply_colours_of_vertices_give_a_face_their_mean(tmp_path: Path) -> None:
    (tmp_path / "m.ply").write_text(ply("255 0 0,0 255 0,0 0 255,255 0 0", ",", (BYTES, "")))
    colors = read_model(tmp_path / "m.ply").colors_of_faces
    assert np.allclose(colors, np.array([[1, 1, 1], [2, 0, 1]]) / 3, atol=1e-7)


def test_faces_of_one_part_keep_the_colours_of_their_materials_in_obj(tmp_path: Path) -> None:
    (tmp_path / "c.mtl").write_text("newmtl r\nKd 1 0 0\nnewmtl b\nKd 0 0 1\n")
    vertices = "".join(f"v {x} {y} {z}\n" for x, y, z in CORNERS)
    (tmp_path / "m.obj").write_text(f"mtllib c.mtl\no plate\n{vertices}usemtl r\nf 1 2 3\nusemtl b\nf 1 3 4\n")
    mesh = read_model(tmp_path / "m.obj")
    assert mesh.part_names == ("plate",)
    assert mesh.colors_of_faces.tolist() == [[*RED], [*BLUE]]


def test_obj_colours_behind_the_positions_are_read(tmp_path: Path) -> None:
    vertices = "".join(f"v {x} {y} {z} 0 1 0\n" for x, y, z in CORNERS)
    (tmp_path / "m.obj").write_text(f"{vertices}f 1 2 3\nf 1 3 4\n")
    mesh = read_model(tmp_path / "m.obj")
    assert mesh.part_colors.tolist() == [[*GREEN]]  # all alike: the part's
    assert mesh.face_colors is None


def test_triangles_of_a_3mf_take_colours_from_their_group_or_their_object(tmp_path: Path) -> None:
    core, extra = (f"http://schemas.microsoft.com/3dmanufacturing/{x}/2015/02" for x in ("core", "material"))
    vertices = "".join(f'<vertex x="{x}" y="{y}" z="{z}"/>' for x, y, z in CORNERS)
    text = (
        f'<model unit="millimeter" xmlns="{core}" xmlns:m="{extra}"><resources>'
        '<basematerials id="7"><base name="red" displaycolor="#FF0000FF"/></basematerials>'
        '<m:colorgroup id="8"><m:color color="#00FF00"/><m:color color="#0000FF"/></m:colorgroup>'
        f'<object id="1" name="sheet" pid="7" pindex="0"><mesh><vertices>{vertices}</vertices><triangles>'
        '<triangle v1="0" v2="1" v3="2"/><triangle v1="0" v2="2" v3="3" pid="8" p1="1"/>'
        '</triangles></mesh></object></resources><build><item objectid="1"/></build></model>'
    )
    with zipfile.ZipFile(tmp_path / "m.3mf", "w") as archive:
        archive.writestr("3D/3dmodel.model", text)
    assert read_model(tmp_path / "m.3mf").colors_of_faces.tolist() == [[*RED], [*BLUE]]


@pytest.mark.parametrize("surfaces", [True, False])
def test_a_glb_gives_the_colours_of_faces_back(tmp_path: Path, surfaces: bool) -> None:
    mesh = prism(16, surfaces=True)
    paint = np.where(np.arange(mesh.n_faces)[:, None] % 3 == 0, np.float32(RED), np.float32(np.nan))
    mesh = replace(mesh, face_colors=paint, part_colors=np.tile(np.float32(BLUE), (len(mesh.part_names), 1)))
    if not surfaces:
        mesh = replace(mesh, surface=np.full(mesh.n_faces, -1), corner_normals=None)
    write_model(tmp_path / "m.glb", mesh)
    back = read_model(tmp_path / "m.glb")
    red = (back.colors_of_faces == RED).all(axis=1)
    blue = (back.colors_of_faces == BLUE).all(axis=1)
    assert (red | blue).all()
    area = mesh.face_areas[::3].sum()
    assert back.face_areas[red].sum() == pytest.approx(area, rel=1e-6)  # float32 coordinates


def test_a_split_face_keeps_its_colour() -> None:
    corners = [*CORNERS, (4.5, 2.5, 0)]  # the last in the middle of the diagonal, on one side only
    faces = [(0, 1, 2), (0, 4, 3), (4, 2, 3), (0, 2, 4)]
    mesh = replace(Mesh.single(corners, faces), face_colors=np.float32([RED, BLUE, BLUE, GREEN]))
    mended = without_needles(mesh)
    area = {color: mended.face_areas[(mended.colors_of_faces == color).all(axis=1)].sum() for color in (RED, BLUE)}
    assert area == pytest.approx({RED: 22.5, BLUE: 22.5})
    assert not (mended.colors_of_faces == GREEN).all(axis=1).any()


def test_merged_and_selected_meshes_keep_colours_of_faces() -> None:
    painted = replace(SHEET, face_colors=np.float32([RED, NOTHING]))
    both = merge([SHEET, painted])
    assert np.array_equal(both.colors_of_faces, np.float32([NOTHING, NOTHING, RED, NOTHING]), equal_nan=True)
    assert both.select(np.array([2])).colors_of_faces.tolist() == [[*RED]]


def test_colours_of_another_number_of_faces_are_refused() -> None:
    with pytest.raises(BadValue, match=r"face_colors.*1 long.*2 faces"):
        replace(SHEET, face_colors=np.float32([RED]))
