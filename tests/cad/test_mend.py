"""Mending: any mistake a file makes about a solid is undone, and nothing else is touched."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cadcam.cad.edges import edge_table, feature_edges
from cadcam.cad.mend import mend
from cadcam.cad.mesh import Mesh, merge
from cadcam.cad.parts import machined_bracket
from cadcam.errors import DegenerateGeometry

from .solids import both, box, one_part, outward, prism, sheet, soup


def flipped(mesh: Mesh, which: np.ndarray) -> Mesh:
    faces = np.array(mesh.faces)
    faces[which] = faces[which][:, ::-1]
    return Mesh(mesh.vertices, faces, mesh.part, mesh.surface, mesh.part_names, mesh.part_colors)


@pytest.mark.parametrize("seed", range(5))
def test_a_scrambled_solid_comes_back_closed_and_outward(seed: int) -> None:
    rng = np.random.default_rng(seed)
    solid = prism(17)
    broken = soup(solid)
    noise = rng.normal(scale=1e-7, size=broken.vertices.shape)  # float32 rounding of a 30 mm part
    broken = Mesh.single(broken.vertices + noise, broken.faces[rng.permutation(broken.n_faces)])
    mended, repairs = mend(flipped(broken, rng.random(broken.n_faces) < 0.5))
    assert len(mended.vertices) == len(solid.vertices)
    assert repairs.open_edges == repairs.non_manifold_edges == 0
    assert outward(mended) == pytest.approx(outward(solid), rel=1e-6)
    assert repairs.turned_faces > 0


def test_a_sound_mesh_is_left_alone() -> None:
    mesh = prism(12)
    mended, repairs = mend(mesh)
    assert (mended.faces == mesh.faces).all()
    assert (mended.vertices == mesh.vertices).all()
    assert repairs.lines() == []


def test_a_cavity_keeps_pointing_into_itself_whichever_way_the_body_was_wound() -> None:
    shell, hole = box((0, 0, 0), (10, 10, 10)), flipped(box((3, 3, 3), (7, 7, 7)), np.arange(12))
    hollow = one_part(both(shell, hole))
    for candidate in (hollow, flipped(hollow, np.arange(24))):
        mended, _ = mend(candidate)
        assert outward(mended) == pytest.approx(1000 - 64)


def test_two_cubes_that_share_an_edge_are_two_closed_bodies() -> None:
    cubes = one_part(both(box((0, 0, 0), (1, 1, 1)), box((1, 1, 0), (2, 2, 1))))
    mended, repairs = mend(flipped(cubes, np.arange(12)))
    assert repairs.non_manifold_edges == 1
    assert outward(mended) == pytest.approx(2)


def test_a_box_painted_in_six_parts_is_still_wound_outwards() -> None:
    cube = box((0, 0, 0), (1, 1, 1))
    part = np.tile(np.arange(6), 2)
    names = tuple("abcdef")
    painted = Mesh(cube.vertices, cube.faces[:, ::-1], part, cube.surface, names, np.full((6, 3), np.nan, np.float32))
    mended, _ = mend(painted)
    assert outward(mended) == pytest.approx(1)
    assert mended.part_names == names


def test_an_open_sheet_keeps_the_sense_of_most_of_its_faces() -> None:
    strip = one_part(both(*(sheet(i, i + 1, 0, 1) for i in range(5))))
    mended, repairs = mend(flipped(strip, np.array([3, 6])))
    assert (mended.face_normals[:, 2] > 0).all()
    assert repairs.turned_faces == 2
    assert repairs.open_edges == 12


def test_a_moebius_strip_is_survived() -> None:
    n = 24
    t = 2 * np.pi * np.arange(n) / n
    w = np.array([-1.0, 1.0])[:, None]
    r = 5 + w * np.cos(t / 2)
    points = np.stack([r * np.cos(t), r * np.sin(t), w * np.sin(t / 2) + 0 * t], axis=-1).reshape(-1, 3)
    k = np.arange(n)
    after, twist = (k + 1) % n, np.where(k == n - 1, n, 0)
    a, b, c, d = k, k + n, (after + n + twist) % (2 * n), (after + twist) % (2 * n)
    mesh = Mesh.single(points, np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])]))
    mended, repairs = mend(mesh)
    assert mended.n_faces == 2 * n
    assert repairs.turned_faces == 0


def test_parts_that_touch_are_not_welded_together() -> None:
    mended, repairs = mend(both(box((0, 0, 0), (1, 1, 1)), box((1, 0, 0), (2, 1, 1))))
    assert len(mended.vertices) == 16
    assert repairs.welded_vertices == 0


def test_a_small_part_is_not_welded_away_by_the_size_of_a_large_one() -> None:
    pin = box((0, 0, 0), (0.05, 0.05, 0.05), "pin")
    mended, _ = mend(both(box((0, 0, 0), (200_000, 200_000, 200_000), "hull"), pin))
    assert mended.subset(["pin"]).n_faces == 12


def test_far_from_its_origin_a_part_keeps_its_features() -> None:
    """In a map's coordinates, 10 km off, points 2.5 mm apart were one, as if rounded to float32: holes and all."""
    bracket = machined_bracket(sides=48)
    far = replace(bracket, vertices=np.array([1e7, -1e7, 3e6]) + bracket.vertices)
    mended, repairs = mend(far)
    assert repairs.welded_vertices == mend(bracket)[1].welded_vertices
    assert len(edge_table(mended).count) == len(edge_table(bracket).count)
    assert len(feature_edges(far)) == len(feature_edges(bracket))


def test_repeated_and_collapsed_faces_go_and_are_counted() -> None:
    cube = box((0, 0, 0), (1, 1, 1))
    faces = np.concatenate([cube.faces, cube.faces[:3], cube.faces[5:6, ::-1], [[0, 0, 1]]])
    mended, repairs = mend(Mesh.single(cube.vertices, faces))
    assert mended.n_faces == 12
    assert (repairs.duplicate_faces, repairs.degenerate_faces) == (4, 1)


def test_a_part_that_stands_where_another_does_goes_and_no_other() -> None:
    """Written with other corners first, and rounded otherwise; one that is shifted, longer or mirrored stays."""
    plate, pin = box((0, 0, 0), (40, 30, 2)), box((5, 5, 2), (8, 8, 12))
    again = replace(plate, vertices=plate.vertices + 1e-6, faces=np.roll(plate.faces[::-1], 1, axis=1))
    beside = replace(pin, vertices=np.add(pin.vertices, (0.01, 0.0, 0.0)))
    longer = box((5, 5, 2), (8, 8, 12.01))
    feet = one_part(merge([box((0, 0, -9), (2, 2, 0)), box((8, 8, -9), (10, 10, 0))]))
    mirrored = one_part(merge([box((8, 0, -9), (10, 2, 0)), box((0, 8, -9), (2, 10, 0))]))
    others = [beside, longer, feet, mirrored]
    mended, repairs = mend(merge([plate, pin, again, pin, *others]))
    assert repairs.duplicate_parts == 2
    assert len(mended.part_names) == 6
    assert len(feature_edges(mended)) == len(feature_edges(mend(merge([plate, pin, *others]))[0]))
    assert "2 parts removed where others are" in repairs.lines()


def test_a_face_without_height_gives_way_and_leaves_no_gap() -> None:
    # one side of the edge 0-1 is split at 4, the other is not: a mesher bridges that with the flat face (0, 4, 1)
    points = [(0, 0, 0), (2, 0, 0), (1, 1, 0), (1, -1, 0), (1, 0, 0)]
    mesh = Mesh.single(points, [(0, 4, 2), (4, 1, 2), (0, 1, 4), (1, 0, 3)])
    mended, repairs = mend(mesh)
    assert repairs.degenerate_faces == 1
    assert mended.face_areas.min() > 0.4
    table = edge_table(mended)
    assert (table.count == 1).sum() == 4  # the outline only
    assert mended.face_areas.sum() == pytest.approx(2)


def test_a_mesh_without_any_area_is_refused() -> None:
    with pytest.raises(DegenerateGeometry, match="zero area"):
        mend(Mesh.single([(0, 0, 0), (1, 1, 1), (2, 2, 2)], [(0, 1, 2), (1, 2, 0)]))


def test_corner_normals_follow_the_face_they_belong_to() -> None:
    cube = flipped(box((0, 0, 0), (1, 1, 1)), np.arange(12))
    normals = np.repeat(cube.face_normals[:, None], 3, axis=1)
    wrong = Mesh(cube.vertices, cube.faces, cube.part, cube.surface, ("a",), cube.part_colors, normals)
    mended, _ = mend(wrong)
    assert mended.corner_normals is not None
    assert np.allclose(mended.corner_normals[:, 0], mended.face_normals, rtol=0, atol=1e-6)


def test_bodies_of_one_part_that_touch_face_to_face_become_one() -> None:
    stack = one_part(both(box((0, 0, 0), (1, 1, 1)), box((0, 0, 1), (1, 1, 3))))
    mended, repairs = mend(stack)
    assert mended.n_faces == 20
    assert repairs.open_edges == repairs.non_manifold_edges == 0
    assert outward(mended) == pytest.approx(3)


def test_a_sheet_given_from_both_sides_stays_a_sheet() -> None:
    flat = sheet(0, 2, 0, 1)
    double = Mesh.single(flat.vertices, np.concatenate([flat.faces, flat.faces[:, ::-1]]))
    mended, repairs = mend(double)
    assert mended.n_faces == 2
    assert repairs.open_edges == 4
    assert (mended.face_normals[:, 2] > 0).all()


@pytest.mark.parametrize(("gap_mm", "vertices"), [(0.6e-3, 4), (3e-3, 6)])
def test_points_are_one_within_a_millionth_of_the_part(gap_mm: float, vertices: int) -> None:
    one, other = sheet(0, 500, 0, 866), sheet(500 + gap_mm, 1000, 0, 866)  # a diagonal of 1.3 m: welded at 1.3 µm
    mended, _ = mend(one_part(both(one, other)))
    assert len(mended.vertices) == vertices + 2


@pytest.mark.parametrize(("apart", "vertices"), [(1, 4), (6, 6)])
def test_far_from_the_origin_points_are_one_within_the_rounding_of_single_precision(apart: int, vertices: int) -> None:
    """A 1 m part at ship coordinates, 100 m out: its numbers come in steps of 7.6 µm, its own millionth is 1.4 µm."""
    step = float(np.spacing(np.float32(1e5)))
    one, other = sheet(1e5, 1e5 + 500, 0, 866), sheet(1e5 + 500 + apart * step, 1e5 + 1000, 0, 866)
    mended, _ = mend(one_part(both(one, other)))
    assert len(mended.vertices) == vertices + 2


@pytest.mark.parametrize("share", [3e-6, 3e-5])
def test_a_solid_whose_triangles_were_placed_one_by_one_is_sewn(share: float, rng: np.random.Generator) -> None:
    """Up to a photo's tenth of a pixel, and told; the corners come to lie in the middle of what was one."""
    solid = prism(17)
    broken, size = soup(solid), float(np.linalg.norm(solid.size_mm))
    apart = share * size
    broken = Mesh.single(broken.vertices + rng.uniform(-0.5, 0.5, broken.vertices.shape) * apart, broken.faces)
    mended, repairs = mend(broken)
    assert len(mended.vertices) == len(solid.vertices)
    assert repairs.open_edges == 0
    assert repairs.sewn_vertices > 0
    assert 0.5 * apart < repairs.widest_seam_mm < np.sqrt(3) * apart
    assert any("sewn" in line for line in repairs.lines())
    assert outward(mended) == pytest.approx(outward(solid), rel=20 * share)


def test_sheets_that_end_near_each_other_are_not_sewn_but_a_crack_is() -> None:
    one, other = sheet(0, 500, 0, 866), sheet(500.1, 1000, 0, 866)
    mended, repairs = mend(one_part(both(one, other)))
    assert repairs.sewn_vertices == 0
    assert len(mended.vertices) == 8
    cracked = soup(box((0, 0, 0), (1000, 500, 866)))
    cracked.vertices.flags.writeable = True
    cracked.vertices[:3] += [0, 0, 0.1]
    mended, repairs = mend(cracked)
    assert repairs.sewn_vertices == 3
    assert repairs.open_edges == 0


def test_parts_are_never_sewn_to_each_other() -> None:
    one, other = sheet(0, 500, 0, 866), sheet(500.1, 1000, 0, 866)
    assert mend(both(one, other))[1].sewn_vertices == 0
