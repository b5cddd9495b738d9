"""The mesh type: what it refuses, how it is moved, cut and joined."""

from __future__ import annotations

import numpy as np
import pytest

from cadcam.cad.mesh import Mesh, merge, unique_names
from cadcam.cad.topology import is_solid
from cadcam.errors import BadValue, DegenerateGeometry, UnknownName
from cadcam.geometry.rigid import Rigid

from .solids import both, box, outward, soup

EPS = np.finfo(float).eps


def test_a_box_has_its_size_area_and_outward_normals() -> None:
    mesh = box((-1, -2, -3), (9, 18, 27))
    assert mesh.size_mm.tolist() == [10, 20, 30]
    assert mesh.face_areas.sum() == pytest.approx(2200, rel=8 * EPS)
    centres = mesh.vertices[mesh.faces].mean(axis=1) - mesh.bounds.mean(axis=0)
    assert (np.einsum("ij,ij->i", mesh.face_normals, centres) > 0).all()
    assert outward(mesh) == pytest.approx(6000, rel=8 * EPS)


def test_a_solid_is_closed_and_wound_outwards_part_by_part() -> None:
    one, other = box((0, 0, 0), (1, 1, 1), "one"), box((3, 0, 0), (4, 1, 1), "other")
    assert is_solid(one)
    assert is_solid(soup(one))
    assert is_solid(merge([one, other]))
    flipped = Mesh.single(one.vertices, np.concatenate([one.faces[:1, ::-1], one.faces[1:]]))
    for mesh in (
        Mesh.single(one.vertices, one.faces[1:]),
        flipped,
        Mesh.single(one.vertices, one.faces[:, ::-1]),
        merge([Mesh.single(one.vertices, one.faces[:, ::-1]), box((3, 0, 0), (9, 9, 9), "larger")]),
    ):
        assert not is_solid(mesh)


def test_stray_vertices_do_not_count_in_the_size() -> None:
    mesh = box((0, 0, 0), (1, 1, 1))
    stray = Mesh.single(np.concatenate([mesh.vertices, [[100, 0, 0]]]), mesh.faces)
    assert stray.size_mm.tolist() == [1, 1, 1]


@pytest.mark.parametrize(
    ("faces", "words"),
    [([[0, 1, 8]], "8"), ([[0, -1, 2]], "-1"), ([[0.0, 1.0, 2.0]], "float"), ([[0, 1, 2**40]], str(2**40))],
)
def test_an_index_out_of_range_is_named_and_never_wraps(faces: list[list[int]], words: str) -> None:
    with pytest.raises(BadValue, match=words):
        Mesh.single(box((0, 0, 0), (1, 1, 1)).vertices, np.array(faces))


def test_a_coordinate_that_is_not_finite_is_named() -> None:
    vertices = np.zeros((3, 3))
    vertices[1, 2] = np.nan
    with pytest.raises(BadValue, match=r"\[1, 2\]"):
        Mesh.single(vertices, [[0, 1, 2]])


def test_parts_and_surfaces_must_be_as_many_as_faces() -> None:
    mesh = box((0, 0, 0), (1, 1, 1))
    with pytest.raises(BadValue, match="surface"):
        Mesh.single(mesh.vertices, mesh.faces, surface=[1, 2])


def test_the_arrays_of_a_mesh_cannot_be_written_to() -> None:
    mesh = box((0, 0, 0), (1, 1, 1))
    for values in (mesh.vertices, mesh.faces, mesh.part, mesh.surface, mesh.part_colors):
        with pytest.raises(ValueError, match="read-only"):
            values[0] = 0


def test_a_moved_mesh_moves_its_vertices_and_turns_its_normals(rng: np.random.Generator) -> None:
    mesh = box((0, 0, 0), (1, 2, 3))
    normals = np.repeat(mesh.face_normals[:, None], 3, axis=1)
    smooth = Mesh(mesh.vertices, mesh.faces, mesh.part, mesh.surface, ("a",), mesh.part_colors, normals)
    b_from_a = Rigid.exp(rng.normal(size=6))
    moved = smooth.transformed(b_from_a)
    assert np.allclose(moved.vertices, b_from_a @ mesh.vertices, rtol=0, atol=20 * EPS)
    assert moved.corner_normals is not None
    # float32 normals: half a unit in the last place for each of three products
    assert np.allclose(moved.corner_normals[:, 0], moved.face_normals, rtol=0, atol=4e-7)


def test_a_subset_keeps_its_parts_and_drops_the_vertices_of_others() -> None:
    mesh = both(box((0, 0, 0), (1, 1, 1), "a"), box((5, 0, 0), (6, 1, 1), "b"), box((9, 0, 0), (10, 1, 1), "c"))
    kept = mesh.subset(["c", 1])
    assert kept.part_names == ("b", "c")
    assert len(kept.vertices) == 16
    assert kept.bounds[:, 0].tolist() == [5, 10]
    with pytest.raises(UnknownName, match="'bb'"):
        mesh.subset(["bb"])
    with pytest.raises(BadValue, match="3"):
        mesh.subset([3])


def test_merging_keeps_surfaces_apart_and_names_distinct() -> None:
    one = box((0, 0, 0), (1, 1, 1), "bolt")
    numbered = Mesh.single(one.vertices, one.faces, name="bolt", surface=np.arange(12))
    merged = merge([numbered, one, numbered])
    assert merged.part_names == ("bolt", "bolt #2", "bolt #3")
    assert len(np.unique(merged.surface)) == 25  # twice twelve, and -1
    with pytest.raises(BadValue):
        merge([])


def test_names_stay_unique_even_beside_names_that_look_numbered() -> None:
    assert unique_names(["a #2", "a", "a"]) == ("a #2", "a", "a #3")


def test_a_mesh_without_faces_has_no_size() -> None:
    with pytest.raises(DegenerateGeometry):
        _ = Mesh.single(np.zeros((3, 3)), np.zeros((0, 3), int)).size_mm
