"""Feature edges: what is drawn of solids whose edges are known beforehand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cadcam.cad.edges import EdgeKind, FeatureEdges, edge_table, feature_edges
from cadcam.cad.mesh import Mesh
from cadcam.errors import BadValue

from .solids import both, box, one_part, prism, sheet, soup


def length(edges: FeatureEdges, mesh: Mesh, *kinds: EdgeKind) -> float:
    chosen = edges.of_kind(*kinds) if kinds else edges
    return float(chosen.lengths(mesh).sum())


def test_every_edge_of_a_box_is_found_once_with_its_angle_and_sense() -> None:
    table = edge_table(box((0, 0, 0), (1, 2, 3)))
    assert len(table.count) == 18
    assert (table.count == 2).all()
    right = np.isclose(table.angle, np.pi / 2)
    assert right.sum() == 12
    assert table.convex[right].all()
    assert np.allclose(table.angle[~right], 0)


def test_the_inner_edge_of_an_l_is_concave() -> None:
    outline = np.array([(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)], float)
    n = len(outline)
    k, after = np.arange(n), (np.arange(n) + 1) % n
    walls = np.concatenate([np.column_stack([k, after, after + n]), np.column_stack([k, after + n, k + n])])
    points = np.concatenate([np.column_stack([outline, np.full(n, z)]) for z in (0.0, 1.0)])
    table = edge_table(Mesh.single(points, walls))
    concave = (table.count == 2) & (table.angle > 1) & ~table.convex
    assert concave.sum() == 1
    assert np.allclose(points[table.vertices[concave][0], :2], (1, 1))


@pytest.mark.parametrize("make", [box, lambda a, b: soup(box(a, b))], ids=["shared", "soup"])
def test_a_box_is_drawn_with_its_twelve_edges(make) -> None:
    mesh = make((0, 0, 0), (10, 20, 30))
    edges = feature_edges(mesh)
    assert len(edges) == 12
    assert (edges.kind == EdgeKind.CREASE).all()
    assert length(edges, mesh) == pytest.approx(4 * 60)
    assert len(edges.polylines(mesh)) == 12


@pytest.mark.parametrize(("n", "generators"), [(6, 6), (8, 8), (9, 0), (12, 0), (40, 0)])
def test_a_coarse_cylinder_is_round_and_a_prism_is_not(n: int, generators: int) -> None:
    mesh = prism(n)
    edges = feature_edges(mesh)
    along = np.abs(np.diff(mesh.vertices[edges.vertices][:, :, 2], axis=1)).ravel() > 1
    assert along.sum() == generators
    assert len(edges) == 2 * n + generators


def test_a_chamfer_of_thirty_five_degrees_keeps_its_edges() -> None:
    t = np.radians([0, 35, 70])
    outline = np.array([(0, 0), (5, 0)])
    for angle in t:
        outline = np.vstack([outline, outline[-1] + 5 * np.array([-np.sin(angle), np.cos(angle)])])
    outline = np.vstack([outline, (-20, outline[-1, 1]), (-20, 0)])
    n = len(outline)
    k, after = np.arange(n), (np.arange(n) + 1) % n
    walls = np.concatenate([np.column_stack([k, after, after + n]), np.column_stack([k, after + n, k + n])])
    mesh = Mesh.single(np.concatenate([np.column_stack([outline, np.full(n, z)]) for z in (0.0, 9.0)]), walls)
    bends = edge_table(mesh)
    soft = (bends.angle > np.radians(30)) & (bends.angle < np.radians(41))
    assert soft.sum() >= 2
    assert len(feature_edges(mesh).of_kind(EdgeKind.CREASE)) == (bends.angle > np.radians(30)).sum()


def folded(*bends_deg: float) -> Mesh:
    """Return a strip of one facet more than there are bends, each 5 mm long."""
    heading = np.radians(np.cumsum([0.0, *bends_deg]))
    line = np.cumsum([(0.0, 0.0), *(5 * np.stack([np.cos(heading), np.sin(heading)], axis=1))], axis=0)
    n = len(line)
    k = np.arange(n - 1)
    faces = np.concatenate([np.column_stack([k, k + 1, k + 1 + n]), np.column_stack([k, k + 1 + n, k + n])])
    return Mesh.single(np.concatenate([np.column_stack([line, np.full(n, z)]) for z in (0.0, 30.0)]), faces)


@pytest.mark.parametrize(
    ("bends", "creases"),
    [
        ([35] * 3, 3),  # three chamfers
        ([35] * 4, 0),  # nearly half a round
        ([35, -35] * 3, 6),  # corrugated
        ([32, 40] * 3, 0),
        ([20, 40] * 3, 6),  # unequal: a prism
        ([35, 0.3] * 4, 0),  # facets that are flat to the rounding of a file
        ([35, 2.0] * 4, 4),
    ],
)
def test_a_run_of_four_equal_bends_is_a_rounded_surface(bends: list[float], creases: int) -> None:
    assert len(feature_edges(folded(*bends), crease_angle_deg=15.0).of_kind(EdgeKind.CREASE)) == creases


@pytest.mark.parametrize(("half_angle_deg", "generators"), [(25.0, 0), (45.0, 10)])
def test_a_coarse_slender_cone_is_round_and_a_pyramid_is_not(half_angle_deg: float, generators: int) -> None:
    """Ten facets, whose edges are 15 degrees apart in the first and 25 in the second."""
    at = 2 * np.pi * np.arange(10) / 10
    ring = np.column_stack([np.cos(at), np.sin(at), np.zeros(10)])
    apex = np.array([[0, 0, 1 / np.tan(np.radians(half_angle_deg))]])
    k = np.arange(10)
    mesh = Mesh.single(10 * np.concatenate([ring, apex]), np.column_stack([k, (k + 1) % 10, np.full(10, 10)]))
    assert len(feature_edges(mesh, crease_angle_deg=15.0).of_kind(EdgeKind.CREASE)) == generators


def test_no_edge_is_drawn_inside_a_surface_however_coarse() -> None:
    mesh = prism(5, surfaces=True)  # 72 degrees from facet to facet
    edges = feature_edges(mesh)
    assert (edges.kind == EdgeKind.BREP).all()
    assert len(edges) == 10
    assert (mesh.surface[edges.faces[:, 0]] != mesh.surface[edges.faces[:, 1]]).all()


def rounded_slab(n: int, *, normals: bool) -> Mesh:
    """Return a sheet bent by a quarter circle between two planes: surfaces 0, 1 (round), 2."""
    t = np.radians(np.linspace(0, 90, n + 1))
    line = [(-20.0, 0.0), *zip(10 * np.sin(t), 10 * np.cos(t) - 10, strict=True), (10.0, -30.0)]
    m = len(line)
    points = np.array([(x, y, z) for y in (0.0, 50.0) for x, z in line])
    k = np.arange(m - 1)
    faces = np.concatenate([np.column_stack([k, k + 1, k + 1 + m]), np.column_stack([k, k + 1 + m, k + m])])
    surface = np.tile([0, *[1] * n, 2], 2)
    mesh = Mesh.single(points, faces, surface=surface)
    if not normals:
        return mesh
    true = np.array([(0, 0, 1.0), *((np.sin(a), 0, np.cos(a)) for a in t), (1.0, 0, 0)])
    corner = np.tile(true, (2, 1))[faces]
    corner[surface == 0], corner[surface == 2] = (0, 0, 1), (1, 0, 0)
    return Mesh(mesh.vertices, mesh.faces, mesh.part, mesh.surface, ("a",), mesh.part_colors, corner)


@pytest.mark.parametrize("normals", [True, False])
@pytest.mark.parametrize("n", [3, 8])
def test_tangent_seams_are_left_out_unless_asked_for(n: int, normals: bool) -> None:
    mesh = rounded_slab(n, normals=normals)
    assert len(feature_edges(mesh).of_kind(EdgeKind.BREP)) == 0
    seams = feature_edges(mesh, smooth_seams=True).of_kind(EdgeKind.BREP)
    assert len(seams) == 2
    assert length(seams, mesh) == pytest.approx(100)


def test_the_rim_of_a_cylinder_is_one_closed_polyline() -> None:
    mesh = prism(36, surfaces=True)
    lines = feature_edges(mesh).polylines(mesh)
    assert [len(line) for line in lines] == [37, 37]
    assert all((line[0] == line[-1]).all() for line in lines)


def test_chains_run_head_to_tail_and_end_at_corners() -> None:
    mesh = sheet(0, 3, 0, 2)
    edges = feature_edges(mesh)
    assert (edges.kind == EdgeKind.BOUNDARY).all()
    assert len(edges.polylines(mesh)) == 4
    mesh = prism(20, surfaces=True)
    edges = feature_edges(mesh)
    inside = np.flatnonzero(np.diff(edges.chain) == 0)
    assert (edges.vertices[inside, 1] == edges.vertices[inside + 1, 0]).all()
    assert (np.diff(edges.chain) >= 0).all()


def test_an_edge_of_three_faces_is_a_crease() -> None:
    points = [(0, 0, 0), (0, 0, 1), (1, 0, 0), (-1, 1, 0), (-1, -1, 0)]
    mesh = Mesh.single(points, [(0, 1, 2), (0, 1, 3), (0, 1, 4)])
    edges = feature_edges(mesh)
    assert (edges.kind == EdgeKind.CREASE).sum() == 1
    assert (edges.kind == EdgeKind.BOUNDARY).sum() == 6


def test_a_smooth_sphere_has_no_feature_edge() -> None:
    n = 24
    lat, lon = np.meshgrid(np.linspace(0, np.pi, n + 1), 2 * np.pi * np.arange(2 * n) / (2 * n), indexing="ij")
    points = np.stack([np.sin(lat) * np.cos(lon), np.sin(lat) * np.sin(lon), np.cos(lat)], axis=-1).reshape(-1, 3)
    i, k = (a.ravel() for a in np.meshgrid(np.arange(n), np.arange(2 * n), indexing="ij"))
    after = (k + 1) % (2 * n)
    a, b, c, d = i * 2 * n + k, i * 2 * n + after, (i + 1) * 2 * n + after, (i + 1) * 2 * n + k
    from cadcam.cad.mend import mend

    mesh, _ = mend(Mesh.single(points, np.concatenate([np.column_stack([a, d, c]), np.column_stack([a, c, b])])))
    assert len(feature_edges(mesh)) == 0


def test_an_angle_beyond_its_range_is_refused() -> None:
    with pytest.raises(BadValue, match="crease_angle_deg"):
        feature_edges(box((0, 0, 0), (1, 1, 1)), crease_angle_deg=180)


@pytest.mark.parametrize("normals", [False, True])
@pytest.mark.parametrize(("degrees", "seam"), [(0.5, 0.0), (2.0, 50.0)])
def test_two_surfaces_that_meet_at_more_than_a_degree_show_their_edge(
    degrees: float, seam: float, normals: bool
) -> None:
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    points = [
        (0, 0, 0),
        (100, 0, 0),
        (100, 50, 0),
        (0, 50, 0),
        (100 + 100 * c, 0, 100 * s),
        (100 + 100 * c, 50, 100 * s),
    ]
    faces = [(0, 1, 2), (0, 2, 3), (1, 4, 5), (1, 5, 2)]
    mesh = Mesh.single(np.array(points, float), faces, surface=np.array([0, 0, 1, 1]))
    if normals:
        mesh = replace(mesh, corner_normals=np.repeat(mesh.face_normals[:, None], 3, axis=1))
    assert length(feature_edges(mesh), mesh, EdgeKind.BREP) == pytest.approx(seam)


# Contacts. A plate of 100 x 50 x 10 has edges of 640 mm in all.


def test_flush_plates_are_drawn_as_one() -> None:
    plates = both(box((0, 0, 0), (100, 50, 10), "a"), box((100, 0, 0), (200, 50, 10), "b"))
    edges = feature_edges(plates)
    assert length(edges, plates) == pytest.approx(4 * (200 + 50 + 10))
    kept = feature_edges(plates, flush_seams=True)
    assert length(kept, plates, EdgeKind.CONTACT) == pytest.approx(2 * (50 + 10))


def test_flush_plates_of_two_colours_keep_their_seam() -> None:
    plates = both(box((0, 0, 0), (100, 50, 10), "a"), box((100, 0, 0), (200, 50, 10), "b"))
    colors = np.array([(1, 0, 0), (0, 0, 1)], np.float32)
    painted = Mesh(plates.vertices, plates.faces, plates.part, plates.surface, plates.part_names, colors)
    assert length(feature_edges(painted), painted, EdgeKind.CONTACT) == pytest.approx(2 * (50 + 10))


@pytest.mark.parametrize("merged", [False, True], ids=["two parts", "one part"])
def test_a_stiffener_on_a_plate_meets_it_in_contact_lines(merged: bool) -> None:
    pair = both(box((0, 0, 0), (100, 50, 10), "plate"), box((40, 10, 10), (50, 40, 60), "stiffener"))
    mesh = one_part(pair) if merged else pair
    edges = feature_edges(mesh)
    assert length(edges, mesh, EdgeKind.CONTACT) == pytest.approx(2 * (10 + 30))
    assert length(edges, mesh) == pytest.approx(640 + 4 * (10 + 30 + 50))


def test_an_edge_that_is_partly_covered_stays_whole() -> None:
    mesh = both(box((0, 0, 0), (100, 50, 10), "plate"), box((40, 0, 10), (50, 50, 60), "web"))
    edges = feature_edges(mesh)
    # of the web's foot, the two ends lie flush in the sides of the plate; the plate keeps its long upper edges
    assert length(edges, mesh) == pytest.approx(640 + 4 * (10 + 50 + 50) - 2 * 10)


def test_an_edge_that_is_flush_along_a_part_of_it_only_stays_a_contact() -> None:
    plate = box((0, 0, 0), (100, 50, 10), "plate")
    mesh = both(plate, box((0, 0, 10), (60, 50, 20), "flush"), box((60, -10, 10), (100, 50, 20), "overhanging"))
    edges = feature_edges(mesh)
    ends = mesh.vertices[edges.vertices]
    along = (ends[:, :, 1] == 0).all(axis=1) & (ends[:, :, 2] == 10).all(axis=1)
    whole = np.abs(np.diff(ends[along][:, :, 0], axis=1))[:, 0] == 100
    assert edges.kind[along][whole].tolist() == [EdgeKind.CONTACT]


def test_parts_apart_do_not_touch() -> None:
    mesh = both(box((0, 0, 0), (100, 50, 10), "a"), box((100.5, 0, 0), (200, 50, 10), "b"))
    edges = feature_edges(mesh)
    assert (edges.kind == EdgeKind.CREASE).all()
    near = feature_edges(mesh, contact_tolerance_mm=0.6)
    assert (near.kind == EdgeKind.CONTACT).any() or length(near, mesh) < length(edges, mesh)


@pytest.mark.parametrize("merged", [False, True], ids=["parts", "one part"])
def test_a_t_junction_in_a_flat_area_is_no_edge(merged: bool) -> None:
    mesh = both(sheet(0, 100, 0, 100, name="a"), sheet(100, 200, 0, 50, name="b"), sheet(100, 200, 50, 100, name="c"))
    mesh = one_part(mesh) if merged else mesh
    assert length(feature_edges(mesh), mesh) == pytest.approx(600)


def test_a_sheet_that_stands_on_another_of_its_part_meets_it_in_a_crease() -> None:
    web = [(50, 20, 0), (50, 80, 0), (50, 80, 40), (50, 20, 40)]
    mesh = one_part(both(sheet(0, 100, 0, 100), Mesh.single(web, [(0, 1, 2), (0, 2, 3)])))
    edges = feature_edges(mesh)
    assert length(edges, mesh, EdgeKind.CREASE) == pytest.approx(60)
    assert length(edges, mesh, EdgeKind.BOUNDARY) == pytest.approx(400 + 60 + 2 * 40)


def test_contacts_can_be_switched_off() -> None:
    plates = both(box((0, 0, 0), (100, 50, 10), "a"), box((100, 0, 0), (200, 50, 10), "b"))
    assert length(feature_edges(plates, contacts=False), plates) == pytest.approx(2 * 640)


@pytest.mark.parametrize(("scale", "tolerance"), [(1.0, 1e-5 * np.hypot(100, 50)), (1000.0, 0.5)])
@pytest.mark.parametrize(("share", "touching"), [(0.5, True), (2.0, False)])
def test_parts_touch_within_a_hundred_thousandth_of_the_model_and_half_a_millimetre(
    scale: float, tolerance: float, share: float, touching: bool
) -> None:
    """Two thin plates over one another, with a gap of half the tolerance and of twice as much."""
    gap, thick = share * tolerance, 0.05 * scale
    mesh = both(
        box((0, 0, -thick), (100 * scale, 50 * scale, 0), "plate"),
        box((40 * scale, 10 * scale, gap), (50 * scale, 40 * scale, gap + thick), "doubler"),
    )
    edges = feature_edges(mesh)
    assert length(edges, mesh, EdgeKind.CONTACT) == pytest.approx(2 * (10 + 30) * scale if touching else 0)


@pytest.mark.parametrize(("degrees", "seam"), [(1.0, 0.0), (4.0, 50.0)])
def test_plates_that_meet_at_more_than_two_degrees_show_their_seam(degrees: float, seam: float) -> None:
    rise = 100 * np.tan(np.radians(degrees))
    flat, bent = sheet(0, 100, 0, 50, name="flat"), sheet(100, 200, 0, 50, name="bent")
    vertices = bent.vertices.copy()
    vertices[vertices[:, 0] == 200, 2] = rise
    mesh = both(flat, replace(bent, vertices=vertices))
    assert length(feature_edges(mesh), mesh, EdgeKind.CONTACT) == pytest.approx(seam)
