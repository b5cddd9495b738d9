"""The visible wireframe: against a float64 judge, and on shapes whose visible lines are known."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from scipy.spatial import cKDTree

from cadcam.cad.edges import EdgeKind, feature_edges
from cadcam.cad.mesh import Mesh, merge
from cadcam.cad.parts.shipblock import ship_block
from cadcam.cad.read import read_model
from cadcam.camera.camera import Camera
from cadcam.camera.lens import BrownConrady, Fisheye
from cadcam.errors import BadValue, NothingInView
from cadcam.geometry.rigid import Rigid
from cadcam.render.lines.visible import LineDrawer, edge_points, visible_wireframe
from cadcam.render.lines.wireframe import LineOptions, Polylines, Wireframe
from cadcam.render.view import Scene

BOTH = LineOptions(hidden=True, margin_px=0)
CORNERS = np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)], float)
QUADS = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]]
CUBE = [[q[i] for i in t] for q in QUADS for t in ((0, 1, 2), (0, 2, 3))]
LENS = BrownConrady(k1=-0.2, k2=0.05)


def box(low: list[float], high: list[float], name: str = "box") -> Mesh:
    return Mesh.single(np.array(low) + CORNERS * (np.array(high) - low), CUBE, name=name)


def camera_of(size: tuple[int, int] = (960, 720), focal: float = 900.0) -> Camera:
    """An asymmetric, skewed, distorted camera whose focal length goes with its size."""
    f = focal * size[0] / 960
    return Camera.from_focal(size, f, fy=0.98 * f, cx=0.47 * size[0], cy=0.52 * size[1], skew=0.003 * f, lens=LENS)


def reference() -> ModuleType:
    spec = importlib.util.spec_from_file_location("reference", Path(__file__).with_name("reference.py"))
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def drawn_at_random(lines: Polylines, n: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return points (n, 3) in space, evenly spread over the lines' length in the picture, and their lines (n,)."""
    line = lines.line_of_point
    step = np.flatnonzero(line[1:] == line[:-1])
    length = np.linalg.norm(lines.q[step + 1] - lines.q[step], axis=1)
    k = rng.choice(step, n, p=length / length.sum())
    return lines.p[k] + rng.random((n, 1)) * (lines.p[k + 1] - lines.p[k]), line[k]


def share_wrong(scene: Scene, camera: Camera, pose: Rigid, n: int, rng: np.random.Generator) -> float:
    """Return the share of n points, over visible and hidden lines alike, on which the float64 judge disagrees."""
    wireframe = LineDrawer(scene).draw(camera, pose, options=BOTH)
    lengths = [lines.length_px.sum() for lines in (wireframe.visible, wireframe.hidden)]
    diagonal = np.linalg.norm(scene.mesh.size_mm)
    wrong = 0
    for lines, drawn, length in zip((wireframe.visible, wireframe.hidden), (True, False), lengths, strict=True):
        p, line = drawn_at_random(lines, round(n * length / sum(lengths)), rng)
        contact = lines.kind[line] == EdgeKind.CONTACT
        tolerance = diagonal * np.where(contact, 1e-5, 1e-6)
        seen = reference().seen(scene.mesh.vertices, scene.mesh.faces, p, pose.origin, tolerance)
        wrong += int((seen != drawn).sum())
    return wrong / n


@pytest.mark.parametrize(
    ("size", "eye"),
    [
        ((640, 480), (6500.0, -5200.0, 3800.0)),
        ((1920, 1440), (-4000.0, -4500.0, 900.0)),
        pytest.param((640, 480), (-4000.0, -4500.0, 900.0), marks=pytest.mark.slow),
        pytest.param((1920, 1440), (6500.0, -5200.0, 3800.0), marks=pytest.mark.slow),
    ],
)
def test_the_ship_block_agrees_with_the_double_precision_judge(
    size: tuple[int, int], eye: tuple[float, float, float], rng: np.random.Generator
) -> None:
    mesh = ship_block(triangles=10_000)
    pose = Rigid.look_at(eye, mesh.bounds.mean(axis=0))
    assert share_wrong(Scene.of(mesh), camera_of(size), pose, 6000, rng) <= 0.001


@pytest.mark.parametrize("number", [1, *(pytest.param(number, marks=pytest.mark.slow) for number in (3, 5))])
def test_step_parts_agree_with_the_double_precision_judge(
    number: int, shared: Callable[[str], Path], rng: np.random.Generator
) -> None:
    pytest.importorskip("cascadio")
    mesh = read_model(shared(f"data/cad_nist_ctc/nist_ctc_0{number}_asme1_ap242.stp"))
    scene, centre, diagonal = Scene.of(mesh), mesh.bounds.mean(axis=0), np.linalg.norm(mesh.size_mm)
    pose = Rigid.look_at(centre + diagonal * np.array([0.9, -1.1, 0.8]), centre)
    for size in ((640, 480), (1920, 1440)):
        assert share_wrong(scene, camera_of(size), pose, 6000, rng) <= 0.001


def test_the_judge_sees_a_wireframe_of_the_wrong_pose(rng: np.random.Generator) -> None:
    """Negative control: lines found from 0.3 m aside of the eye that judges them."""
    mesh = ship_block(triangles=10_000)
    scene, centre = Scene.of(mesh), mesh.bounds.mean(axis=0)
    wireframe = LineDrawer(scene).draw(camera_of(), Rigid.look_at([6500.0, -5200.0, 3800.0], centre), options=BOTH)
    p, _ = drawn_at_random(wireframe.visible, 3000, rng)
    seen = reference().seen(mesh.vertices, mesh.faces, p, np.array([6500.0, -4900.0, 3800.0]), np.full(3000, 5e-3))
    assert (~seen).mean() > 0.005


def in_space(lines: Polylines) -> float:
    """Return the length of all lines in mm."""
    line = lines.line_of_point
    same = line[1:] == line[:-1]
    return float(np.linalg.norm(np.diff(lines.p, axis=0), axis=1)[same].sum())


def cube_view(eye: tuple[float, float, float], mesh: Mesh | None = None) -> Wireframe:
    scene = Scene.of(mesh or box([0, 0, 0], [100, 100, 100]))
    return LineDrawer(scene).draw(camera_of(), Rigid.look_at(eye, [50.0, 50.0, 50.0]), options=BOTH)


@pytest.mark.parametrize(("eye", "edges"), [((400, 300, 350), 9), ((400, 300, 60), 7), ((420, 45, 60), 4)])
def test_a_cube_shows_nine_seven_or_four_of_its_edges(eye: tuple[float, float, float], edges: int) -> None:
    wireframe = cube_view(eye)
    assert in_space(wireframe.visible) == pytest.approx(100 * edges, rel=1e-12)
    assert in_space(wireframe.hidden) == pytest.approx(100 * (12 - edges), rel=1e-12)


def test_the_own_faces_of_a_solid_hide_an_edge_without_any_tolerance() -> None:
    """With a tolerance larger than the model no sight line is blocked: what is hidden, its own two faces hide."""
    blind = LineOptions(hidden=True, coincident_mm=1e4)
    outline = [[0, 0], [100, 0], [100, 20], [20, 20], [20, 100], [0, 100]]  # an angle bar; (20, 20) is concave
    vertices = [[x, y, z] for z in (0, 300) for x, y in outline]
    caps = [[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5]]
    sides = [t for i in range(6) for j in [(i + 1) % 6] for t in ([i, j, j + 6], [i, j + 6, i + 6])]
    bar = Mesh.single(vertices, [t[::-1] for t in caps] + [[i + 6 for i in t] for t in caps] + sides)
    for eye, seen in (((600, 500, 150), True), ((600, -500, 150), False), ((-500, 400, 150), False)):
        lines = LineDrawer(Scene.of(bar)).draw(camera_of(), Rigid.look_at(eye, [40, 40, 150]), options=blind).visible
        inner = (np.abs(lines.p[:, :2] - 20) < 1e-9).all(axis=1)
        line = lines.line_of_point
        assert (inner[1:] & inner[:-1] & (line[1:] == line[:-1])).any() == seen


def test_lines_do_not_depend_on_the_size_of_the_picture() -> None:
    mesh = ship_block(triangles=10_000)
    scene, pose = Scene.of(mesh), Rigid.look_at([6500.0, -5200.0, 3800.0], mesh.bounds.mean(axis=0))
    small, large = (LineDrawer(scene).draw(camera_of(size), pose) for size in ((320, 240), (5120, 3840)))
    assert len(small.visible) == len(large.visible)
    ends = [
        lines.p[np.concatenate([lines.start[:-1], lines.start[1:] - 1])] for lines in (small.visible, large.visible)
    ]
    assert np.abs(ends[0] - ends[1]).max() < 1e-6


def test_every_point_is_the_exact_image_of_its_place_in_space() -> None:
    wireframe = cube_view((400, 300, 350))
    for lines in (wireframe.visible, wireframe.hidden):
        q = wireframe.camera.project(wireframe.camera_from_world @ lines.p)
        assert np.abs(q - lines.q).max() < 1e-9


@pytest.mark.parametrize("lens", [BrownConrady(k1=-0.3, k2=0.1, p1=0.002), BrownConrady(k1=0.2), Fisheye(k1=-0.02)])
def test_polylines_keep_to_the_bent_image_of_a_straight_edge(lens: BrownConrady | Fisheye) -> None:
    """Between two points of a polyline the true curve is nowhere farther than chord_px from the chord."""
    camera = Camera.from_focal((960, 720), 500.0, fy=520.0, cx=430.0, lens=lens)
    scene, pose = Scene.of(box([0, 0, 0], [100, 100, 100])), Rigid.look_at([150.0, 140.0, 160.0], [50.0, 50.0, 50.0])
    for chord in (0.3, 0.02):
        lines = LineDrawer(scene).draw(camera, pose, options=LineOptions(chord_px=chord)).visible
        line = lines.line_of_point
        i = np.flatnonzero(line[1:] == line[:-1])
        a, b = lines.q[i], lines.q[i + 1]
        across = np.stack([a[:, 1] - b[:, 1], b[:, 0] - a[:, 0]], axis=1) / np.linalg.norm(b - a, axis=1)[:, None]
        worst = 0.0
        for t in np.linspace(0.05, 0.95, 19):
            q = camera.project(pose @ (lines.p[i] + t * (lines.p[i + 1] - lines.p[i])))
            worst = max(worst, float(np.abs(np.sum((q - a) * across, axis=1)).max()))
        assert chord / 30 < worst <= chord


def test_a_crossing_edge_ends_where_the_nearer_plate_begins() -> None:
    """The end of a half hidden edge projects onto the outline of what hides it, to rounding."""
    far, near = box([-300, 0, 0], [300, 10, 10], "far"), box([-40, -300, -300], [40, -280, 300], "near")
    wireframe = LineDrawer(Scene.of(merge([far, near]))).draw(camera_of(), Rigid.look_at([15, -1500, 40], [0, 0, 0]))
    lines, camera, pose = wireframe.visible, wireframe.camera, wireframe.camera_from_world
    ends = lines.p[np.concatenate([lines.start[:-1], lines.start[1:] - 1])]
    cut = ends[(np.abs(ends[:, 0]) < 299) & (ends[:, 1] >= 0)]
    assert len(cut) == 6  # three of its four long edges face the eye, each with a gap
    u = pose @ cut
    side = pose @ np.array([[x, y, z] for x in (-40.0, 40.0) for y in (-300.0, -280.0) for z in (-300.0, 300.0)])
    columns = [side[i : i + 2, :2] / side[i : i + 2, 2:] for i in range(0, 8, 2)]
    u = u[:, :2] / u[:, 2:]
    distances = []
    for a, b in columns:
        along = (b - a) / np.linalg.norm(b - a)
        distances.append(np.abs((u - a) @ np.array([along[1], -along[0]])))
    assert np.min(distances, axis=0).max() * camera.fx < 1e-6


def plate_with_stiffener() -> Mesh:
    return merge([box([0, 0, 0], [400, 300, 10], "plate"), box([100, 145, 10], [300, 155, 80], "stiffener")])


def length_of(lines: Polylines, part: int, z: float) -> float:
    """Return the length in mm of a part's lines in the plane z."""
    line = lines.line_of_point
    same = (line[1:] == line[:-1]) & (lines.part[line[1:]] == part)
    same &= (np.abs(lines.p[1:, 2] - z) < 1e-9) & (np.abs(lines.p[:-1, 2] - z) < 1e-9)
    return float(np.linalg.norm(np.diff(lines.p, axis=0), axis=1)[same].sum())


def test_the_foot_of_a_stiffener_is_seen_from_its_side_and_not_through_the_plate() -> None:
    scene = Scene.of(plate_with_stiffener())
    above = LineDrawer(scene).draw(camera_of(), Rigid.look_at([150, -700, 500], [200, 150, 0]), options=BOTH)
    below = LineDrawer(scene).draw(camera_of(), Rigid.look_at([150, -700, -500], [200, 150, 0]), options=BOTH)
    assert length_of(above.visible, 1, 10) == pytest.approx(200, abs=1e-9)  # the side turned to the eye
    assert length_of(below.visible, 1, 10) == 0


def test_coincident_faces_do_not_hide_lines_lying_in_them() -> None:
    """A doubler of no visible height: its outline lies in the plate's face, its own face on it."""
    scene = Scene.of(merge([box([0, 0, 0], [400, 300, 10]), box([100, 100, 2], [300, 200, 10], "flush")]))
    drawer = LineDrawer(Scene.of(scene.mesh, edges=feature_edges(scene.mesh, contacts=False)))
    wireframe = drawer.draw(camera_of(), Rigid.look_at([150, -600, 900], [200, 150, 0]))
    assert length_of(wireframe.visible, 1, 10) == pytest.approx(600, abs=1e-9)


@pytest.mark.parametrize(("depth", "seen"), [(0.1, True), (10.0, False)])
def test_a_line_counts_as_lying_in_a_face_within_a_millionth_of_the_diagonal(depth: float, seen: bool) -> None:
    """A doubler sunk into its plate by a tenth of the tolerance is drawn, by ten times the tolerance it is hidden."""
    top = 10 - depth * 1e-6 * float(np.linalg.norm([400, 300, 10]))
    mesh = merge([box([0, 0, 0], [400, 300, 10]), box([100, 100, 2], [300, 200, top], "sunk")])
    drawer = LineDrawer(Scene.of(mesh, edges=feature_edges(mesh, contacts=False)))
    wireframe = drawer.draw(camera_of(), Rigid.look_at([150, -600, 900], [200, 150, 0]))
    assert length_of(wireframe.visible, 1, top) == pytest.approx(600 if seen else 0, abs=1e-9)


@pytest.mark.parametrize("backwards", [False, True])
def test_a_pipe_through_a_plate_without_a_hole_is_hidden_from_where_it_enters(backwards: bool) -> None:
    """Nearer to its one end than to the other: a place counted from the wrong end would show."""
    mesh = merge([box([0, 0, 0], [400, 10, 300]), box([190, -200, 140], [210, 400, 160], "rod")])
    edges = feature_edges(mesh, contacts=False)
    if backwards:
        edges = edges.select(np.arange(len(edges))[::-1])
        edges = replace(edges, vertices=edges.vertices[:, ::-1])
    wireframe = LineDrawer(Scene.of(mesh, edges=edges)).draw(
        camera_of(), Rigid.look_at([700, -900, 500], [200, 0, 150])
    )
    rod = wireframe.visible.p[wireframe.visible.part[wireframe.visible.line_of_point] == 1]
    assert rod[:, 1].max() == pytest.approx(0, abs=1e-9)


def test_an_open_sheet_is_seen_from_both_sides_with_its_fold() -> None:
    v = [[0, 0, 0], [100, 0, 0], [100, 100, 0], [0, 100, 0], [100, 0, 80], [0, 0, 80]]
    sheet = Mesh.single(v, [[0, 1, 2], [0, 2, 3], [0, 4, 1], [0, 5, 4]])
    for eye in ((260, 300, 300), (-200, -300, -250)):
        wireframe = LineDrawer(Scene.of(sheet)).draw(camera_of(), Rigid.look_at(eye, [50, 50, 0]), options=BOTH)
        assert in_space(wireframe.visible) == pytest.approx(6 * 100 + 2 * 80 - 100, abs=1e-9)


def test_a_camera_inside_a_closed_room_sees_its_edges() -> None:
    scene = Scene.of(box([0, 0, 0], [4000, 3000, 2500]))
    wireframe = LineDrawer(scene).draw(camera_of(focal=500), Rigid.look_at([400, 500, 1300], [3900, 2500, 1200]))
    assert in_space(wireframe.visible) > 5000
    assert np.isfinite(wireframe.visible.q).all()


def tube(r: float, length: float, n: int) -> Mesh:
    t = np.arange(n) / n * 2 * np.pi
    ring = np.stack([r * np.cos(t), r * np.sin(t), 0 * t], axis=1)
    i, j = np.arange(n), (np.arange(n) + 1) % n
    side = np.concatenate([np.stack([i, j, j + n], axis=1), np.stack([i, j + n, i + n], axis=1)])
    caps = np.concatenate([np.stack([j, i, 0 * i + 2 * n], 1), np.stack([i + n, j + n, 0 * i + 2 * n + 1], 1)])
    vertices = np.concatenate([ring, ring + np.array([0, 0, length]), [[0, 0, 0], [0, 0, length]]])
    return Mesh.single(vertices, np.concatenate([side, caps]), surface=np.repeat([0, 1, 2], [2 * n, n, n]))


def test_contours_of_a_cylinder_are_its_two_tangent_lines() -> None:
    """The analytic tangents through the eye; the facets' edges lie within one facet of them."""
    n, eye = 720, np.array([900.0, 300.0, 260.0])
    wireframe = LineDrawer(Scene.of(tube(100, 400, n))).draw(camera_of(), Rigid.look_at(eye, [0, 0, 200]))
    contours = wireframe.visible.select(wireframe.visible.kind == EdgeKind.CONTOUR)
    assert len(contours) == 2
    assert in_space(contours) == pytest.approx(800, abs=0.1)
    half, middle = np.arccos(100 / np.hypot(*eye[:2])), np.arctan2(eye[1], eye[0])
    found = np.arctan2(contours.p[:, 1], contours.p[:, 0])
    off = np.minimum(np.abs(found - middle - half), np.abs(found - middle + half))
    assert off.max() <= 2 * np.pi / n


def test_contours_on_the_inner_side_of_a_ring_are_hidden_and_on_the_outer_drawn() -> None:
    import trimesh

    ring = trimesh.creation.torus(major_radius=200.0, minor_radius=60.0, major_sections=96, minor_sections=48)
    scene = Scene.of(Mesh.single(ring.vertices, ring.faces, surface=np.zeros(len(ring.faces), np.int32)))
    eye = np.array([0.0, -900.0, 350.0])
    wireframe = LineDrawer(scene).draw(camera_of(), Rigid.look_at(eye, [0, 0, 0]), options=BOTH)
    rng = np.random.default_rng(1)
    for lines, drawn in ((wireframe.visible, True), (wireframe.hidden, False)):
        p, _ = drawn_at_random(lines, 500, rng)
        seen = reference().seen(scene.mesh.vertices, scene.mesh.faces, p, eye, np.full(500, 1e-9))
        assert np.array_equal(seen, np.full(500, drawn))


def test_the_contour_of_a_faceted_ball_is_one_line_around_it_with_the_ball_on_its_left() -> None:
    """However its segments zigzag in space; in the picture, which has y downwards, that is clockwise in numbers."""
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=4, radius=200.0)
    scene = Scene.of(Mesh.single(ball.vertices, ball.faces, surface=np.zeros(len(ball.faces), np.int32)))
    for eye in ([0.0, -900.0, 350.0], [500.0, 300.0, 650.0]):
        pose = Rigid.look_at(eye, [0, 0, 0])
        lines = LineDrawer(scene).draw(camera_of(), pose).visible
        assert len(lines) == 1
        assert lines.q[0] == pytest.approx(lines.q[-1], abs=1e-6)
        outward = lines.q[:-1] - camera_of().project((pose @ np.zeros(3))[None])
        step = np.diff(lines.q, axis=0)
        assert (outward[:, 0] * step[:, 1] - outward[:, 1] * step[:, 0]).sum() < 0


@pytest.mark.parametrize("margin", [0.0, 40.0])
def test_lines_reach_all_four_borders_of_the_picture_and_its_margin(margin: float) -> None:
    camera = Camera.from_focal((960, 720), 900.0, fy=880.0, cx=450.0, cy=375.0)
    cross = merge([box([-900, -5, 0], [900, 5, 10], "across"), box([-5, -900, 20], [5, 900, 30], "along")])
    pose = Rigid.look_at([15.0, -20.0, 1000.0], [0.0, 0.0, 0.0], up=[0.1, 1.0, 0.0])
    q = LineDrawer(Scene.of(cross)).draw(camera, pose, options=LineOptions(margin_px=margin)).visible.q
    assert q.min(axis=0) == pytest.approx([-0.5 - margin, -0.5 - margin], abs=1e-9)
    assert q.max(axis=0) == pytest.approx([959.5 + margin, 719.5 + margin], abs=1e-9)


def test_lines_are_cut_at_the_focal_plane_and_at_the_lens_limit() -> None:
    """A 40 m floor from above its middle: half of it lies behind, and k1 = -0.3 ends at tan(angle) = 1.05."""
    camera = Camera.from_focal((960, 720), 500.0, lens=BrownConrady(k1=-0.3))
    floor = box([-20000, -20000, -10], [20000, 20000, 0])
    wireframe = LineDrawer(Scene.of(floor)).draw(camera, Rigid.look_at([0, 0, 1500], [15000, 3000, 0]))
    p = wireframe.camera_from_world @ wireframe.visible.p
    assert len(p)
    assert (p[:, 2] > 0).all()
    assert (np.hypot(p[:, 0], p[:, 1]) / p[:, 2]).max() < camera.lens.valid_radius
    assert np.isfinite(wireframe.visible.q).all()


def test_segments_name_their_feature_edge() -> None:
    scene = Scene.of(plate_with_stiffener())
    lines = LineDrawer(scene).draw(camera_of(), Rigid.look_at([150, -700, 500], [200, 150, 0])).visible
    for k in range(len(lines.q) - 1):
        if lines.line_of_point[k] == lines.line_of_point[k + 1]:
            a, b = scene.mesh.vertices[scene.edges.vertices[lines.segment[k]]]
            for p in lines.p[k : k + 2]:
                assert np.linalg.norm(np.cross(p - a, b - a)) / np.linalg.norm(b - a) < 1e-9


@pytest.mark.parametrize("target", [(-900.0, -800.0, -900.0), (0.0, 0.0, 5000.0)])
def test_a_model_out_of_view_is_refused_with_numbers_and_tolerated_by_the_drawer(
    target: tuple[float, float, float],
) -> None:
    scene, pose = (
        Scene.of(box([1000, 1000, 1000], [1100, 1100, 1100])),
        Rigid.look_at([0.0, 0.0, 0.0], target, up=[0, 1, 0]),
    )
    with pytest.raises(NothingInView, match=r"\[.*\] mm in the camera frame"):
        visible_wireframe(scene, camera_of(), pose)
    assert LineDrawer(scene).draw(camera_of(), pose).empty


def straight(camera: Camera, *ends: tuple[float, float]) -> Wireframe:
    """Return a wireframe of one line through these pixels."""
    q, none = np.array(ends), np.zeros(1, np.int32)
    line = Polylines(q, np.zeros((len(q), 3)), np.zeros(len(q) - 1, np.int32), np.array([0, len(q)]), none, none, none)
    return Wireframe(camera, Rigid(), line, line)


def test_a_line_runs_through_the_picture_or_past_it_however_long_it_is() -> None:
    """Both ends are outside; sampled along its length, the longest would fill the memory."""
    camera = camera_of((960, 720))
    for far in (1e3, 1e6, 1e12, 1e25):
        assert not straight(camera, (-far, -far), (far, far)).empty
        assert not straight(camera, (-far, 719.4), (far, 719.4)).empty
        assert straight(camera, (-far, 719.6), (far, 719.6)).empty
        assert straight(camera, (-far, -1.0), (-1.0, -far)).empty
        assert straight(camera, (960.0, 300.0), (far + 960, 300.0)).empty
        assert not straight(camera, (-far, -far), (0.0, -far), (0.0, far)).empty


def test_options_are_checked() -> None:
    with pytest.raises(BadValue, match="chord_px"):
        LineOptions(chord_px=0.0)


def test_points_lie_densely_on_all_edges_however_near_the_camera_is() -> None:
    scene = Scene.of(ship_block())
    camera, centre = camera_of(), scene.mesh.bounds.mean(axis=0)
    for away in (0.2, 2.0):
        pose = Rigid.look_at(centre + away * np.linalg.norm(scene.mesh.size_mm) * np.array([0.3, -0.7, 0.6]), centre)
        points = edge_points(scene, camera, pose, apart_px=3.0)
        options = LineOptions(hidden=True, margin_px=0, contours=False)
        drawn = LineDrawer(scene).draw(camera, pose, options=options)
        q = np.concatenate([lines.q for lines in (drawn.visible, drawn.hidden)])
        assert len(q) > 100
        apart, _ = cKDTree(points).query(q)
        assert apart.max() < 3.0
