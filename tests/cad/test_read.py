"""Loading: what each format holds comes back in millimetres, with its parts and their names."""

from __future__ import annotations

import json
import struct
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cadcam.cad.mesh import Mesh
from cadcam.cad.read import describe, read_model, read_model_with_report
from cadcam.cad.write import write_model
from cadcam.errors import BadValue, UnknownName, UnwritableFile

from .solids import both, box, outward, prism, soup

SIZE = (10.0, 20.0, 30.0)


@pytest.fixture
def pair() -> Mesh:
    colors = np.array([(0.2, 0.4, 0.6), (np.nan,) * 3], np.float32)
    mesh = both(box((0, 0, 0), (10, 20, 5), "plate"), box((0, 0, 5), (10, 20, 30), "block"))
    return Mesh(mesh.vertices, mesh.faces, mesh.part, mesh.surface, mesh.part_names, colors)


@pytest.mark.parametrize("suffix", [".stl", ".ply", ".obj", ".glb"])
def test_what_is_written_is_read_back(pair: Mesh, tmp_path: Path, suffix: str) -> None:
    write_model(tmp_path / f"pair{suffix}", pair)
    mesh, report = read_model_with_report(tmp_path / f"pair{suffix}")
    assert np.allclose(mesh.size_mm, SIZE, rtol=1e-7, atol=0)  # float32 coordinates
    assert mesh.n_faces == (24 if suffix in (".obj", ".glb") else 20)  # one part: the wall between the two goes
    assert outward(mesh) == pytest.approx(6000, rel=1e-6)
    assert report.unit_source == ("format" if suffix == ".glb" else "assumed")
    assert len(report.sha256) == 64
    if suffix in (".obj", ".glb"):
        assert mesh.part_names == ("plate", "block")
    if suffix == ".glb":
        assert np.allclose(mesh.part_colors[0], (0.2, 0.4, 0.6), atol=1e-5)  # six decimals of linear light
        assert np.isnan(mesh.part_colors[1]).all()


def test_a_glb_keeps_surfaces_and_normals(tmp_path: Path) -> None:
    solid = prism(16, surfaces=True)
    normals = np.repeat(solid.face_normals[:, None], 3, axis=1)
    solid = Mesh(solid.vertices, solid.faces, solid.part, solid.surface, ("a",), solid.part_colors, normals)
    write_model(tmp_path / "prism.glb", solid)
    back = read_model(tmp_path / "prism.glb")
    assert np.bincount(back.surface).tolist() == [32, 14, 14]
    assert back.corner_normals is not None
    assert np.allclose(back.corner_normals[:, 0], back.face_normals, atol=1e-6)


@pytest.mark.parametrize(
    ("unit", "mm"),
    [(None, 1), ("mm", 1), ("m", 1000), ("Metres", 1000), ("cm", 10), ("inch", 25.4), ("ft", 304.8), ("um", 1e-3)],
)
def test_the_unit_of_a_file_without_one_is_the_callers(tmp_path: Path, unit: str | None, mm: float) -> None:
    write_model(tmp_path / "box.ply", box((0, 0, 0), SIZE))
    mesh = read_model(tmp_path / "box.ply", unit=unit)
    assert np.allclose(mesh.size_mm, np.array(SIZE) * mm, rtol=1e-12)


def test_an_unknown_unit_is_answered_with_the_known_ones(tmp_path: Path) -> None:
    write_model(tmp_path / "box.ply", box((0, 0, 0), SIZE))
    with pytest.raises(UnknownName, match=r"'milimetre'; did you mean 'millimetre'"):
        read_model(tmp_path / "box.ply", unit="milimetre")


def test_an_implausible_size_is_doubted_aloud(tmp_path: Path) -> None:
    write_model(tmp_path / "cube.obj", box((0, 0, 0), (0.084, 0.084, 0.084)))
    _, report = read_model_with_report(tmp_path / "cube.obj")
    assert "--unit m" in report.warnings[0]
    assert read_model_with_report(tmp_path / "cube.obj", unit="m")[1].warnings == ()


@pytest.mark.parametrize(
    ("suffix", "mm", "unit", "doubt"),
    [
        (".glb", 2e6, None, "2000 m large: is the unit right? pass --unit mm if it is 2 m"),
        (".glb", 5e4, None, "50 m large: is the unit right? pass --unit mm if it is 50 mm, --unit m if it is"),
        (".glb", 5e4, "m", ""),
        (".glb", 9e3, None, ""),
        (".glb", 0.5, None, "0.5 mm large: is the unit right? check the scale of its export"),
        (".stl", 5e4, None, ""),
        (".stl", 2e5, None, "200 m large: is the unit right? pass --unit um if it is 200 mm"),
    ],
)
def test_a_doubted_size_comes_with_the_unit_that_makes_it_plausible(
    tmp_path: Path, suffix: str, mm: float, unit: str | None, doubt: str
) -> None:
    """glTF in millimetres, as many programs write it, is 1000 times too large; what is given is not advised again."""
    path = tmp_path / f"cube{suffix}"
    write_model(path, box((0, 0, 0), (mm, mm, mm)))
    assert read_model_with_report(path, unit=unit)[1].warnings == ((f"the model is {doubt}",) if doubt else ())


def test_a_doubted_size_in_the_unit_of_the_file_is_not_answered_with_an_option_that_is_refused(tmp_path: Path) -> None:
    write_3mf(tmp_path / "m.3mf", "micron")
    warning = read_model_with_report(tmp_path / "m.3mf")[1].warnings[0]
    assert warning.endswith("is the unit right? its file says um; export it again if not")


def test_the_report_says_the_size_first(tmp_path: Path) -> None:
    write_model(tmp_path / "plate.stl", box((0, 0, 0), (800, 450, 120)))
    mesh, report = read_model_with_report(tmp_path / "plate.stl")
    assert report.lines()[0] == "plate.stl: size 800.0 x 450.0 x 120.0 mm (unit mm: assumed, the format has none)"
    assert describe(mesh) == "size 800.0 x 450.0 x 120.0 mm, 1 part, 12 triangles"


def test_an_ascii_stl_keeps_its_solids(tmp_path: Path) -> None:
    lines = []
    for name, z in (("Left Plate", 0), ("right", 9)):
        mesh = box((0, 0, z), (1, 1, z + 1))
        lines.append(f"solid {name}")
        for triangle in mesh.vertices[mesh.faces]:
            lines += ["facet normal 0 0 0", "outer loop", *(f"vertex {x} {y} {z}" for x, y, z in triangle)]
            lines += ["endloop", "endfacet"]
        lines.append(f"endsolid {name}")
    (tmp_path / "two.stl").write_text("\r\n".join(lines).upper().replace("LEFT PLATE", "Left Plate"))
    mesh = read_model(tmp_path / "two.stl")
    assert mesh.part_names == ("Left Plate", "RIGHT")
    assert mesh.n_faces == 24


def test_a_binary_stl_that_begins_with_solid_is_binary(tmp_path: Path) -> None:
    write_model(tmp_path / "box.stl", box((0, 0, 0), SIZE))
    data = bytearray((tmp_path / "box.stl").read_bytes())
    data[:12] = b"solid facet "
    (tmp_path / "box.stl").write_bytes(data)
    assert read_model(tmp_path / "box.stl").n_faces == 12


OBJ = """\
mtllib colours.mtl
o frame
v 0 0 0
v 1 0 0
v 1 1 0 1.0
  v 0 1 0
vt 0 0
vn 0 0 1
usemtl red
f -4/1/1 -3/1/1 -2//1 -1
o arrow
v 0 0 5
v 4 0 5
v 4 4 5
v 2 1 5
v 0 4 5
f 5 6 7 \\
  8 9
l 1 2
"""


def test_an_obj_of_polygons_groups_and_relative_numbers_is_understood(tmp_path: Path) -> None:
    (tmp_path / "colours.mtl").write_text("newmtl red\nKd 0.8 0.1 0.2\n")
    (tmp_path / "m.obj").write_text(OBJ)
    mesh = read_model(tmp_path / "m.obj")
    assert mesh.part_names == ("frame", "arrow")
    assert np.allclose(mesh.part_colors[0], (0.8, 0.1, 0.2))
    areas = [float(mesh.subset([name]).face_areas.sum()) for name in mesh.part_names]
    assert areas == pytest.approx([1, 10])  # the arrow is concave: a fan would give 16 - 6 and overlap
    assert (mesh.face_normals[:, 2] > 0.99).all()


def test_a_name_of_two_lines_stays_one_line_of_an_obj(tmp_path: Path) -> None:
    mesh = replace(box((0, 0, 0), (1, 2, 3)), part_names=("one\nf 1 2 99",))
    write_model(tmp_path / "a.obj", mesh)
    assert read_model(tmp_path / "a.obj").part_names == ("one f 1 2 99",)


def test_materials_name_the_parts_of_an_obj_without_groups(tmp_path: Path) -> None:
    text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nusemtl steel\nf 1 3 2\nusemtl brass\nf 1 2 4\nusemtl steel\nf 1 4 3\n"
    (tmp_path / "m.obj").write_text(text)
    mesh = read_model(tmp_path / "m.obj")
    assert mesh.part_names == ("steel", "brass")
    assert np.bincount(mesh.part).tolist() == [2, 1]


def test_an_off_file_with_comments_is_read(tmp_path: Path) -> None:
    (tmp_path / "m.off").write_text("OFF # header\n4 2 0\n\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n3 0 1 2 255 0 0\n3 0 2 3\n")
    assert read_model(tmp_path / "m.off").face_areas.sum() == pytest.approx(1)


PLY_HEAD = (
    "ply\nformat {} 1.0\ncomment made by hand\nelement vertex 4\nproperty float x\nproperty float y\n"
    "property float z\nproperty uchar red\nelement face {}\nproperty uchar flag\nproperty list uchar int vertex_index\n"
    "end_header\n"
)


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("polygons", [[(0, 1, 2), (0, 2, 3)], [(0, 1, 2, 3)], [(0, 1, 2), (0, 2, 3), (0, 1, 3, 2)]])
def test_a_binary_ply_of_either_order_and_of_mixed_polygons_is_read(
    tmp_path: Path, order: str, polygons: list[tuple[int, ...]]
) -> None:
    name = {"<": "binary_little_endian", ">": "binary_big_endian"}[order]
    data = PLY_HEAD.format(name, len(polygons)).encode()
    for x, y in ((0, 0), (1, 0), (1, 1), (0, 1)):
        data += struct.pack(f"{order}fffB", x, y, 0, 7)
    for polygon in polygons:
        data += struct.pack(f"{order}BB{len(polygon)}i", 1, len(polygon), *polygon)
    (tmp_path / "m.ply").write_bytes(data)
    assert read_model(tmp_path / "m.ply").size_mm.tolist() == [1, 1, 0]


def test_an_ascii_ply_is_read(tmp_path: Path) -> None:
    body = "0 0 0 1\n1 0 0 1\n1 1 0 1\n0 1 0 1\n5 4 0 1 2 3\n"
    (tmp_path / "m.ply").write_text(PLY_HEAD.format("ascii", 1) + body)
    assert read_model(tmp_path / "m.ply").face_areas.sum() == pytest.approx(1)


def gltf(nodes: list[dict[str, object]]) -> dict[str, object]:
    """A unit square in metres as the only mesh, in an external buffer."""
    return {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": nodes,
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5121, "count": 6, "type": "SCALAR"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": 48},
            {"buffer": 0, "byteOffset": 48, "byteLength": 6},
        ],
        "buffers": [{"byteLength": 54, "uri": "square.bin"}],
    }


def test_gltf_nodes_place_and_name_their_meshes_and_mirrors_keep_them_outward(tmp_path: Path) -> None:
    corners = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], "<f4")
    (tmp_path / "square.bin").write_bytes(corners.tobytes() + bytes([0, 1, 2, 0, 2, 3]))
    half = np.sqrt(0.5)
    nodes: list[dict[str, object]] = [
        {"name": "root", "translation": [0, 0, 2], "children": [1, 2]},
        {"name": "upright", "mesh": 0, "rotation": [half, 0, 0, half]},
        {"name": "mirrored", "mesh": 0, "matrix": [-1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]},
    ]
    (tmp_path / "m.gltf").write_text(json.dumps(gltf(nodes)))
    mesh = read_model(tmp_path / "m.gltf")
    assert mesh.part_names == ("upright", "mirrored")
    upright, mirrored = mesh.subset([0]), mesh.subset([1])
    assert np.allclose(upright.bounds, [(0, 0, 2000), (1000, 0, 3000)], atol=1e-3)
    assert np.allclose(upright.face_normals, (0, -1, 0), atol=1e-6)
    assert np.allclose(mirrored.bounds, [(-1000, 0, 2000), (0, 1000, 2000)], atol=1e-3)
    assert np.allclose(mirrored.face_normals, (0, 0, 1), atol=1e-6)


def test_a_unit_given_for_a_glb_overrides_its_rule_and_is_said(tmp_path: Path) -> None:
    write_model(tmp_path / "box.glb", box((0, 0, 0), SIZE))
    mesh, report = read_model_with_report(tmp_path / "box.glb", unit="mm")
    assert np.allclose(mesh.size_mm, np.array(SIZE) / 1000)
    assert any("by its rule" in warning for warning in report.warnings)


def write_3mf(path: Path, unit: str, model: str | None = None) -> None:
    cube = box((0, 0, 0), (1, 2, 3))
    vertices = "".join(f'<vertex x="{x}" y="{y}" z="{z}"/>' for x, y, z in cube.vertices)
    triangles = "".join(f'<triangle v1="{a}" v2="{b}" v3="{c}"/>' for a, b, c in cube.faces)
    text = model or (
        f'<model unit="{unit}" xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02"><resources>'
        '<basematerials id="7"><base name="red" displaycolor="#FF0000FF"/></basematerials>'
        f'<object id="1" name="cube" pid="7" pindex="0"><mesh><vertices>{vertices}</vertices>'
        f"<triangles>{triangles}</triangles></mesh></object>"
        '<object id="2"><components><component objectid="1" transform="1 0 0 0 1 0 0 0 1 10 0 0"/></components>'
        '</object></resources><build><item objectid="1"/>'
        '<item objectid="2" transform="0 1 0 -1 0 0 0 0 1 0 0 5"/></build></model>'
    )
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("3D/3dmodel.model", text)


def test_a_3mf_is_read_in_its_own_unit_with_components_in_place(tmp_path: Path) -> None:
    write_3mf(tmp_path / "m.3mf", "inch")
    mesh, report = read_model_with_report(tmp_path / "m.3mf")
    assert (report.unit, report.unit_source) == ("in", "file")
    assert mesh.part_names == ("cube", "cube #2")
    assert mesh.part_colors[0].tolist() == [1, 0, 0]
    assert np.allclose(mesh.subset(["cube"]).size_mm, np.array([1, 2, 3]) * 25.4)
    # x -> y, y -> -x, then up by 5, applied to a cube moved by 10 along x
    assert np.allclose(mesh.subset(["cube #2"]).bounds, np.array([(-2, 10, 5), (0, 11, 8)]) * 25.4)


def test_a_3mf_that_names_no_unit_is_in_mm_by_its_rule_unless_another_is_given(tmp_path: Path) -> None:
    write_3mf(tmp_path / "m.3mf", "mm")
    with zipfile.ZipFile(tmp_path / "m.3mf") as archive:
        text = archive.read("3D/3dmodel.model").decode().replace('unit="mm" ', "")
    write_3mf(tmp_path / "m.3mf", "", model=text)
    report = read_model_with_report(tmp_path / "m.3mf")[1]
    assert (report.unit, report.unit_source) == ("mm", "format")
    inches = read_model_with_report(tmp_path / "m.3mf", unit="in")[1]
    assert (inches.unit, inches.unit_source) == ("in", "argument")
    assert inches.size_mm == pytest.approx([x * 25.4 for x in report.size_mm])


def test_a_unit_against_the_files_own_is_refused(tmp_path: Path) -> None:
    write_3mf(tmp_path / "m.3mf", "inch")
    assert read_model(tmp_path / "m.3mf", unit="in").n_faces == 24
    with pytest.raises(BadValue, match=r"m\.3mf is mm; expected in, which the file names itself"):
        read_model(tmp_path / "m.3mf", unit="mm")


def test_writing_leaves_the_old_file_until_the_new_one_is_whole(tmp_path: Path, monkeypatch) -> None:
    target = tmp_path / "box.stl"
    target.write_bytes(b"old")

    def full(half: str, target: str) -> None:
        assert Path(half).stat().st_size > 84 + 12 * 50 - 1, "all of it is there before it takes the old file's place"
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.replace", full)
    with pytest.raises(UnwritableFile, match="No space left"):
        write_model(target, box((0, 0, 0), SIZE))
    assert target.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [target]


@pytest.mark.parametrize("away", [1e6, 5e8])
def test_a_part_in_the_coordinates_of_a_map_is_written_whole_or_refused(tmp_path: Path, away: float) -> None:
    part = box((0, 0, 0), (10, 20, 30))
    far = replace(part, vertices=part.vertices + away + 1 / 3)
    for suffix in (".ply", ".obj"):
        write_model(tmp_path / f"a{suffix}", far)
        back = read_model(tmp_path / f"a{suffix}").vertices
        assert np.abs(np.sort(back, axis=0) - np.sort(far.vertices, axis=0)).max() <= np.spacing(away)
    for suffix in (".stl", ".glb"):
        with pytest.raises(BadValue, match=rf"nearer to it, as {suffix} has steps of .* mm out there"):
            write_model(tmp_path / f"a{suffix}", far)
        assert not (tmp_path / f"a{suffix}").exists()


def test_a_format_that_is_not_written_is_named(tmp_path: Path) -> None:
    with pytest.raises(UnknownName, match="step"):
        write_model(tmp_path / "box.step", box((0, 0, 0), SIZE))


@pytest.mark.parametrize(
    ("name", "size", "faces"),
    [
        ("visp_mbt_cube/cube.obj", (84, 84, 84), 12),
        ("visp_teabox/teabox.obj", (165, 68, 80), 12),
        ("m3t_triangle/body/triangle.obj", (57.457, 66.462, 12), 8),
        ("shipblock_clean/model.obj", (600, 400, 312), 202),
        ("ocx_ship_blocks_a/TR03_TC11_cadhu_approx.obj", (20200, 2200, 1000), 472),
    ],
)
def test_real_models_in_metres_have_their_true_size(
    shared: Callable[[str], Path], name: str, size: tuple[float, ...], faces: int
) -> None:
    mesh, report = read_model_with_report(shared(f"data/{name}"), unit="m")
    assert np.allclose(mesh.size_mm, size, atol=5e-3)
    assert mesh.n_faces == faces
    assert report.repairs.open_edges == 0
    assert outward(mesh) > 0


def test_triangles_that_nowhere_meet_are_told(tmp_path: Path, rng: np.random.Generator) -> None:
    """Each side would be drawn as a line of the part; nothing would be found, and nobody would know why."""
    broken = soup(box((0, 0, 0), (100, 80, 60)))
    torn = Mesh.single(broken.vertices + rng.normal(scale=1.0, size=broken.vertices.shape), broken.faces)
    write_model(tmp_path / "torn.stl", torn)
    warnings = read_model_with_report(tmp_path / "torn.stl")[1].warnings
    assert any("triangles do not meet: 36 of 36 sides are open" in warning for warning in warnings)
