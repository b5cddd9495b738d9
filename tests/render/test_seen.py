"""The edges a view shows by its depth are those that hidden-line removal in space finds, to within a pixel."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from cadcam.arrays import Array
from cadcam.cad.edges import EdgeKind
from cadcam.cad.mesh import merge
from cadcam.cad.parts import machined_bracket
from cadcam.cad.parts.shape import box, circle, prism
from cadcam.camera.camera import Camera
from cadcam.camera.lens import BrownConrady, Lens
from cadcam.errors import MissingCore
from cadcam.geometry.rigid import Rigid
from cadcam.native import core
from cadcam.render.lines import seen
from cadcam.render.lines.seen import SeenEdges, seen_points
from cadcam.render.lines.visible import LineDrawer
from cadcam.render.lines.wireframe import LineOptions, Polylines
from cadcam.render.raster import RasterRenderer
from cadcam.render.view import Channel, Scene, View

try:
    core.library()
except MissingCore as error:
    pytest.skip(str(error), allow_module_level=True)

EYES = ([300, 260, 220], [-250, 200, 120], [200, -300, -150], [90, 130, 60])
MIDDLE = (60.0, 40.0, 30.0)
SEEN = Channel.DEPTH | Channel.NORMAL


def both(scene: Scene, camera: Camera, pose: Rigid) -> tuple[Polylines, Polylines]:
    """Return what the view shows, and what is visible in space."""
    view = RasterRenderer(scene, threads=1).render(camera, pose, channels=SEEN)
    exact = LineDrawer(scene).draw(camera, pose, options=LineOptions(margin_px=0.0)).visible
    return SeenEdges(scene).draw(view), exact


def astray(lines: Polylines, others: Polylines, camera: Camera, within: float) -> float:
    """Return the share of one's length, inside the picture, that is farther than `within` px from the others."""
    (q, *_), (p, *_) = lines.points_along(0.5), others.points_along(0.5)
    q = q[camera.crop(2, 2, (camera.width - 4, camera.height - 4)).sees(q - 2)]
    return float((cKDTree(p).query(q)[0] > within).mean())


@pytest.mark.parametrize("lens", [None, BrownConrady(-0.2, 0.05)], ids=["ideal", "lens"])
@pytest.mark.parametrize("eye", EYES, ids=str)
def test_a_view_shows_what_is_visible_in_space(lens: Lens | None, eye: list[float]) -> None:
    """Twice 0.5 px: the samples of the two stand anywhere in theirs. What is left of 1 % are ends near a silhouette."""
    camera = Camera.from_focal((320, 240), 300.0, fy=295.0, cx=150.0, cy=124.0, skew=1.0, lens=lens)
    scene = Scene.of(machined_bracket())
    shown, exact = both(scene, camera, Rigid.look_at(eye, MIDDLE))
    assert astray(exact, shown, camera, 1.0) < 0.01
    assert astray(shown, exact, camera, 1.0) < 0.01
    assert np.abs(camera.project(Rigid.look_at(eye, MIDDLE) @ shown.p) - shown.q).max() < 1e-6


def test_stretches_keep_the_number_of_their_edge(rng: np.random.Generator) -> None:
    scene = Scene.of(machined_bracket())
    shown, _ = both(scene, Camera.from_focal((320, 240), 300.0), Rigid.look_at(EYES[0], MIDDLE))
    ends = scene.mesh.vertices[scene.edges.vertices]
    for line in range(len(shown)):
        points = slice(shown.start[line], shown.start[line + 1])
        segment = shown.segment[points][0]
        if segment < 0:
            continue
        assert scene.edges.chain[segment] == shown.chain[line]
        a, b = ends[segment]
        off = np.cross(shown.p[points][0] - a, b - a) / np.linalg.norm(b - a)
        assert np.linalg.norm(off) < 1e-6 * np.linalg.norm(scene.mesh.size_mm)


def test_points_that_do_not_bend_a_line_are_left_out_and_it_stays_where_it_was() -> None:
    """0.02 px aside at most; a stretch's own ends and corners stay. A rim of 2,000 edges is drawn by far fewer."""
    rod = prism(circle((0.0, 0.0), 20.0, 2000), 0.0, 30.0, name="rod")
    scene, pose = Scene.of(rod), Rigid.look_at([60, 40, 90], [0, 0, 15])
    camera = Camera.from_focal((320, 240), 300.0)
    view = RasterRenderer(scene, threads=1).render(camera, pose, channels=SEEN)
    drawn = SeenEdges(scene).draw(view)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(seen, "_CHORD_PX", 0.0)
        every = SeenEdges(scene).draw(view)
    assert len(drawn.q) < 0.1 * len(every.q)
    assert drawn.length_px.sum() == pytest.approx(every.length_px.sum(), rel=1e-3)
    assert drawn.chain.tolist() == every.chain.tolist()
    for line in range(len(drawn)):
        points, dense = (of.q[of.start[line] : of.start[line + 1]] for of in (drawn, every))
        assert (points[[0, -1]] == dense[[0, -1]]).all()
        assert _aside(dense, points).max() <= 0.02 + 1e-9


def _aside(q: Array, line: Array) -> Array:
    """Return the distance of points (N, 2) from a polyline (M, 2)."""
    a, b = line[:-1], line[1:]
    along = ((q[:, None] - a) * (b - a)).sum(-1) / ((b - a) ** 2).sum(-1)
    return np.asarray(np.linalg.norm(q[:, None] - a - np.clip(along, 0, 1)[..., None] * (b - a), axis=-1).min(axis=1))


@pytest.mark.parametrize("eye", [*EYES, [75, 60, 45]], ids=str)
def test_a_lens_that_bends_nothing_changes_nothing(eye: list[float]) -> None:
    """Straight edges are walked along by the core, bent ones traced: the same stretches, but for samples at borders.

    From the last eye the part reaches behind the camera and beyond the picture.
    """
    scene, pose = Scene.of(machined_bracket()), Rigid.look_at(eye, MIDDLE)
    straight, lens = (Camera.from_focal((320, 240), 300.0, skew=1.0, lens=lens) for lens in (None, BrownConrady()))
    view = RasterRenderer(scene, threads=1).render(straight, pose, channels=SEEN)
    walked, traced = (SeenEdges(scene).draw(View(camera, pose, view.layers)) for camera in (straight, lens))
    assert walked.length_px.sum() == pytest.approx(traced.length_px.sum(), rel=0.005)
    assert astray(walked, traced, straight, 0.5) < 0.005
    assert astray(traced, walked, straight, 0.5) < 0.005
    assert set(walked.chain[walked.kind != EdgeKind.CONTOUR]) == set(traced.chain[traced.kind != EdgeKind.CONTOUR])


def test_a_view_with_more_lines_than_any_before_has_room_for_them() -> None:
    scene, camera, pose = (
        Scene.of(machined_bracket()),
        Camera.from_focal((320, 240), 300.0),
        Rigid.look_at(EYES[0], MIDDLE),
    )
    view = RasterRenderer(scene, threads=1).render(camera, pose, channels=SEEN)
    usual, short = SeenEdges(scene), SeenEdges(scene)
    short._edges._room = 3
    assert short.draw(view).q.tobytes() == usual.draw(view).q.tobytes()


def test_what_else_is_in_the_depth_hides_edges_to_a_pixel() -> None:
    """A plate before a cube, rendered into the depth alone: its border cuts the cube's edges at column 100."""
    scene = Scene.of(box((-50, -50, -50), (50, 50, 50), name="cube"))
    camera, pose = Camera.from_focal((200, 200), 200.0), Rigid.look_at([0, 0, 400], [0, 0, 0], up=[0, 1, 0])
    view = RasterRenderer(scene, threads=1).render(camera, pose, channels=SEEN)
    depth, normal = view.depth.copy(), view.normal.copy()
    depth[:, :100], normal[:, :100] = 200.0, (0, 0, -1)
    shown = SeenEdges(scene).draw(View(camera, pose, {"depth": depth, "normal": normal}))
    assert shown.q[:, 0].min() == pytest.approx(99.5, abs=1.0)
    assert SeenEdges(scene).draw(view).q[:, 0].min() < 80


def test_points_are_seen_or_not_at_faces_borders_and_beyond_the_picture() -> None:
    scene = Scene.of(merge([box((-50, -50, -5), (50, 50, 0), name="a"), box((-10, -10, 50), (10, 10, 60), name="b")]))
    camera, pose = Camera.from_focal((201, 201), 200.0), Rigid.look_at([0, 0, 400], [0, 0, 0], up=[0, 1, 0])
    view = RasterRenderer(scene, threads=1).render(camera, pose, channels=SEEN)
    p = np.array([[30.0, 0, 0], [0, 0, 0], [50, 50, 0], [-9, 9, 60], [0, 0, 0.001], [500, 0, 0]])
    q = camera.project(pose @ p)
    assert seen_points(view, pose @ p, q).tolist() == [True, False, True, True, False, False]
    nothing = np.full((1, 3), np.nan)
    assert seen_points(view, nothing, nothing[:, :2]).tolist() == [False]
