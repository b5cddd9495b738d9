"""Meshes of other packages: recognised by what they have, in the unit that they or the caller state."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from cadcam.cad.objects import mesh_of
from cadcam.errors import BadValue

BOX = np.array([[x, y, z] for x in (0, 1) for y in (0, 2) for z in (0, 3)], float)
QUADS = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
FACES = np.array([t for a, b, c, d in QUADS for t in ((a, b, c), (a, c, d))])


def test_anything_with_vertices_and_faces_or_triangles_is_a_mesh() -> None:
    for faces in ({"faces": FACES}, {"triangles": FACES.astype(np.int32)}):
        mesh = mesh_of(SimpleNamespace(vertices=BOX, **faces), unit="m", name="box")
        assert mesh.size_mm.tolist() == [1000, 2000, 3000]
        assert mesh.part_names == ("box",)
        assert mesh.n_faces == 12


def test_it_is_mended_as_a_loaded_one() -> None:
    inside_out = SimpleNamespace(vertices=BOX[FACES].reshape(-1, 3), faces=np.arange(36).reshape(-1, 3)[:, ::-1])
    mesh = mesh_of(inside_out, unit="mm")
    assert len(mesh.vertices) == 8
    outward = np.einsum("ij,ij->i", mesh.face_normals, mesh.vertices[mesh.faces].mean(axis=1) - [0.5, 1, 1.5])
    assert (outward > 0).all()


def test_a_unit_is_needed_and_must_not_contradict() -> None:
    bare, inches = (SimpleNamespace(vertices=BOX, faces=FACES, units=unit) for unit in (None, "inches"))
    with pytest.raises(BadValue, match=r'unit="mm"'):
        mesh_of(bare)
    assert mesh_of(inches).size_mm[0] == 25.4
    assert mesh_of(inches, unit="in").size_mm[0] == 25.4
    with pytest.raises(BadValue, match="expected in, which the object states itself"):
        mesh_of(inches, unit="mm")


def test_what_is_no_mesh_is_refused() -> None:
    with pytest.raises(BadValue, match="expected a mesh of trimesh"):
        mesh_of([1, 2, 3], unit="mm")
    with pytest.raises(BadValue, match="without triangles"):
        mesh_of(SimpleNamespace(vertices=BOX, faces=np.zeros((0, 3), int)), unit="mm")
    with pytest.raises(BadValue, match=r"of shape \(6, 4\)"):
        mesh_of(SimpleNamespace(vertices=BOX, faces=np.array(QUADS)), unit="mm")


def test_an_open_sheet_that_a_scene_mirrors_keeps_its_front() -> None:
    class Graph(dict[str, Any]):
        nodes_geometry = ("sheet", "mirrored")

    sheet = SimpleNamespace(vertices=np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), faces=np.array([[0, 1, 2]]))
    placed = Graph(sheet=(np.eye(4), "it"), mirrored=(np.diag([-1.0, 1, 1, 1]), "it"))
    mesh = mesh_of(SimpleNamespace(geometry={"it": sheet}, graph=placed), unit="mm")
    assert mesh.face_normals.tolist() == [[0, 0, 1], [0, 0, 1]]  # a mirror in x leaves what looks along z


def test_trimesh_meshes_and_scenes() -> None:
    trimesh: Any = pytest.importorskip("trimesh", reason="trimesh is a peer here, not a dependency")
    box = trimesh.creation.box((1, 2, 3))
    assert mesh_of(box, unit="cm").size_mm.tolist() == pytest.approx([10, 20, 30])
    box.units = "m"
    assert mesh_of(box).size_mm.tolist() == pytest.approx([1000, 2000, 3000])
    scene = trimesh.Scene()
    scene.add_geometry(trimesh.creation.box((1, 2, 3)), node_name="a", transform=np.diag([1.0, 1, 1, 1]))
    turned = trimesh.transformations.rotation_matrix(np.pi / 2, [0, 0, 1])
    turned[:3, 3] = [5, 0, 0]
    scene.add_geometry(trimesh.creation.box((1, 2, 3)), node_name="b", transform=turned)
    mesh = mesh_of(scene, unit="mm")
    assert mesh.part_names == ("a", "b")
    assert mesh.subset(["b"]).bounds.tolist() == [pytest.approx([4, -0.5, -1.5]), pytest.approx([6, 0.5, 1.5])]


@pytest.mark.parametrize("shape", ["Cube", "Sphere"])
def test_pyvista_surfaces(shape: str) -> None:
    pv: Any = pytest.importorskip("pyvista", reason="pyvista is a peer here, not a dependency")
    surface = getattr(pv, shape)()
    mesh = mesh_of(surface, unit="m")
    assert mesh.size_mm.tolist() == pytest.approx((1000 * np.ptp(np.asarray(surface.points), axis=0)).tolist())
    assert mesh.face_areas.sum() == pytest.approx(1e6 * surface.triangulate().area, rel=1e-5)


def test_pyvista_volumes_give_their_surface() -> None:
    pv: Any = pytest.importorskip("pyvista", reason="pyvista is a peer here, not a dependency")
    mesh = mesh_of(pv.ImageData(dimensions=(2, 3, 4)), unit="cm")
    assert mesh.size_mm.tolist() == [10, 20, 30]


def test_open3d_meshes_old_and_new() -> None:
    o3d: Any = pytest.importorskip("open3d", reason="Open3D is a peer here, not a dependency")
    for box in (o3d.geometry.TriangleMesh.create_box(1, 2, 3), o3d.t.geometry.TriangleMesh.create_box(1, 2, 3)):
        assert mesh_of(box, unit="in").size_mm.tolist() == pytest.approx([25.4, 50.8, 76.2])
