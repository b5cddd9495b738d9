"""OpenGL: edges shared by two faces, smooth images, tiles, batches, threads, closing, refusals.

On a machine without a GPU this runs on Mesa's software renderer (Debian: libegl1, libgl1); without EGL it is skipped.
"""

from __future__ import annotations

import gc
import threading

import numpy as np
import pytest

from cadcam.cad.mesh import Mesh
from cadcam.cad.parts import machined_bracket, ship_block
from cadcam.camera.camera import Camera
from cadcam.camera.lens import BrownConrady, Fisheye, Ideal, Lens
from cadcam.errors import BadValue, DegenerateGeometry, NotEnoughMemory
from cadcam.geometry.rigid import Rigid
from cadcam.render.gl import context as gl_context
from cadcam.render.gl import scene as gl_scene
from cadcam.render.gl.renderer import GlRenderer
from cadcam.render.ray import RayRenderer
from cadcam.render.view import Channel, Look

from .agreement import Truth, bound_of, check
from .scenes import scene_of, views_of

needs_gl = pytest.mark.skipif(
    not gl_context.probe().available, reason=f"OpenGL on EGL does not answer: {gl_context.probe().reason}"
)
pytestmark = needs_gl

SIZE = (400, 300)
CAMERAS = {
    "plain": Camera.from_focal(SIZE, 420.0),
    "skewed": Camera.from_focal(SIZE, 410.0, fy=456.0, cx=171.3, cy=177.8, skew=28.0),
    "Brown-Conrady": Camera.from_focal(SIZE, 310.0, fy=302.0, cx=189.2, cy=158.9, lens=BrownConrady(-0.28, 0.06, 2e-3)),
    "fisheye": Camera.from_focal(SIZE, 150.0, cx=207.4, cy=141.1, lens=Fisheye(k1=-0.02)),
    "fisheye past its circle": Camera.from_focal(SIZE, 85.0, cx=207.4, cy=141.1, lens=Fisheye(k1=-0.02)),
}


@pytest.fixture(scope="module")
def bracket() -> tuple[GlRenderer, RayRenderer]:
    scene = scene_of(machined_bracket())
    return GlRenderer(scene), RayRenderer(scene)


@pytest.mark.parametrize("lens", [BrownConrady(), BrownConrady(k1=-0.2), Fisheye()], ids=["none", "barrel", "fisheye"])
def test_pixel_centres_on_a_common_edge_belong_to_one_of_its_faces(lens: Lens, rng: np.random.Generator) -> None:
    """A plane tiled with triangles of either winding; without distortion many edges pass exactly through centres."""
    camera = Camera.from_focal((64, 64), 64.0, cx=0.0, cy=0.0, lens=lens)
    lines = np.array([-2000.0, 8, 16, 32, 2000])
    x, y = np.meshgrid(lines, lines)
    p = np.stack([x, y, np.full_like(x, 64.0)], axis=-1).reshape(-1, 3)
    i = np.array([5 * j + k for j in range(4) for k in range(4)])
    faces = np.concatenate([np.stack([i, i + 1, i + 6], 1), np.stack([i, i + 6, i + 5], 1)])
    hits = np.zeros((64, 64), int)
    for face in faces:
        with GlRenderer(scene_of(Mesh.single(p, face[None, :: rng.choice([1, -1])]))) as renderer:
            hits += renderer.render(camera, Rigid(), channels=Channel.FACE).face == 0
    sees = np.isfinite(camera.unproject(camera.pixel_grid())).all(axis=-1)  # the barrel folds before the last corner
    assert np.array_equal(hits, sees)


@pytest.mark.parametrize("name", ["skewed", pytest.param("Brown-Conrady", marks=pytest.mark.slow), "fisheye"])
def test_smooth_images_are_those_of_rays_and_leave_ids_and_depth_alone(
    name: str, bracket: tuple[GlRenderer, RayRenderer]
) -> None:
    fast, exact = bracket
    camera, pose, look = CAMERAS[name], views_of(fast.scene.mesh)[0], Look(supersampling=3, background=(0.1, 0.2, 0.3))
    plain, smooth = fast.render(camera, pose), fast.render(camera, pose, look=look)
    rays = exact.render(camera, pose, look=look)
    for layer in ("face", "part", "depth", "normal"):
        assert np.array_equal(getattr(plain, layer), getattr(smooth, layer))
    assert np.mean(np.abs(smooth.coverage - rays.coverage) > 1e-6) < 2e-3
    assert np.abs(smooth.image - rays.image).mean() < 2e-4
    assert 0 < np.mean((smooth.coverage > 0) & (smooth.coverage < 1)) < 0.1


@pytest.mark.parametrize("name", ["skewed", "Brown-Conrady"])
def test_a_picture_in_tiles_is_the_whole_picture(
    name: str, bracket: tuple[GlRenderer, RayRenderer], monkeypatch: pytest.MonkeyPatch
) -> None:
    fast, _ = bracket
    camera, pose, look = CAMERAS[name], views_of(fast.scene.mesh)[0], Look(supersampling=2)
    whole = fast.render(camera, pose, look=look)
    monkeypatch.setattr(gl_scene, "TILE_SIDE", 150)
    monkeypatch.setattr(gl_scene, "TILE_PIXELS", 9_001)
    tiled = fast.render(camera, pose, look=look)
    plain = fast.render(camera, pose)
    fast._gpu._tables.release()
    truth = Truth.of(fast.scene, camera, pose)
    check(plain, truth, bound_of("gl", truth))
    if name == "Brown-Conrady":  # no grid of OpenGL's in it: equal, not only close
        for layer in whole.layers:
            assert np.array_equal(whole.layers[layer], tiled.layers[layer]), layer
    assert np.mean(whole.face != tiled.face) < 1e-3


@pytest.mark.parametrize("lens", [Ideal(), BrownConrady(k1=-0.02)], ids=["plain", "lens"])
def test_a_picture_larger_than_any_viewport_is_exact_in_its_corners(lens: Lens) -> None:
    camera = Camera.from_focal((20_000, 60), 20_000.0, lens=lens)
    p = np.array([[-1e5, -1e5, 500.0], [1e5, -1e5, 700.0], [0, 2e5, 900.0]])
    with GlRenderer(scene_of(Mesh.single(p, np.array([[0, 1, 2]])))) as renderer:
        view = renderer.render(camera, Rigid(), channels=Channel.DEPTH | Channel.FACE)
    assert (view.face == 0).all()
    n = np.cross(p[1] - p[0], p[2] - p[0])
    for x, y in [(0, 0), (19_999, 0), (0, 59), (19_999, 59), (8192, 30)]:
        ray = camera.unproject([x, y])
        assert view.depth[y, x] == pytest.approx(n @ p[0] / (n @ ray) * ray[2], rel=2**-22)


@pytest.mark.parametrize("name", CAMERAS)
def test_a_batch_is_its_views_and_only_what_was_asked_for_is_there(
    name: str, bracket: tuple[GlRenderer, RayRenderer]
) -> None:
    fast, _ = bracket
    poses = views_of(fast.scene.mesh) * 2
    batch = list(fast.render_batch(CAMERAS[name], poses, channels=Channel.NORMAL | Channel.PART))
    assert len(batch) == len(poses)
    for pose, view in zip(poses, batch, strict=True):
        assert set(view.layers) == {"normal", "part"}
        full = fast.render(CAMERAS[name], pose)
        assert np.array_equal(full.normal, view.normal)
        assert np.array_equal(full.part, view.part)
    assert list(fast.render_batch(CAMERAS[name], [])) == []


@pytest.mark.parametrize("name", CAMERAS)
def test_a_model_behind_or_beside_the_camera_gives_an_empty_view(
    name: str, bracket: tuple[GlRenderer, RayRenderer]
) -> None:
    fast, _ = bracket
    pose = views_of(fast.scene.mesh)[0]
    turned = Rigid(np.diag([-1.0, 1.0, -1.0])) @ pose
    beside = Rigid(translation=[1e7, 0, 1000.0]) @ pose
    for empty in (fast.render(CAMERAS[name], turned), fast.render(CAMERAS[name], beside, look=Look(supersampling=2))):
        assert not empty.mask.any()
        assert (empty.image == 1).all()
        assert not empty.coverage.any()
        assert np.isinf(empty.depth).all()
        assert (empty.part == -1).all()


@pytest.mark.parametrize("name", ["plain", "fisheye"])
@pytest.mark.parametrize("size", [1e-6, 1e9])
def test_tiny_and_huge_scenes_far_from_the_origin_look_alike(size: float, name: str) -> None:
    mesh = machined_bracket()
    pose, shift = views_of(mesh)[0], np.array([3e4, -2e4, 1e4])
    other = Mesh.single((mesh.vertices + shift) * size, mesh.faces)
    moved = Rigid(pose.rotation, (pose.translation - pose.rotation @ shift) * size)
    with GlRenderer(scene_of(Mesh.single(mesh.vertices, mesh.faces))) as a, GlRenderer(scene_of(other)) as b:
        one, two = a.render(CAMERAS[name], pose), b.render(CAMERAS[name], moved)
    assert np.mean(one.face != two.face) < 1e-4
    same = (one.face == two.face) & (one.face >= 0)
    assert np.abs(two.depth[same] / size / one.depth[same] - 1).max() < 1e-5


def test_any_thread_may_render_and_all_share_one_context(bracket: tuple[GlRenderer, RayRenderer]) -> None:
    fast, _ = bracket
    pose, seen = views_of(fast.scene.mesh)[0], []
    thread = threading.Thread(target=lambda: seen.append(fast.render(CAMERAS["plain"], pose)))
    thread.start()
    thread.join()
    assert np.array_equal(seen[0].face, fast.render(CAMERAS["plain"], pose).face)
    with GlRenderer(fast.scene) as other:
        assert other._thread is fast._thread


def test_a_closed_renderer_says_so_and_closing_again_does_no_harm(bracket: tuple[GlRenderer, RayRenderer]) -> None:
    renderer = GlRenderer(bracket[0].scene)
    renderer.close()
    renderer.close()
    with pytest.raises(BadValue, match="renderer is closed"):
        renderer.render(CAMERAS["plain"], Rigid())
    GlRenderer(bracket[0].scene)  # dropped without closing
    gc.collect()
    assert bracket[0]._thread.submit(lambda: len(bracket[0]._thread.discarded)).result() == 0


def test_meshes_that_cannot_be_drawn_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(DegenerateGeometry, match="without faces"):
        GlRenderer(scene_of(Mesh.single(np.zeros((0, 3)), np.zeros((0, 3), int))))
    thread = gl_context.open_gl()
    monkeypatch.setitem(thread.context.info, "GL_MAX_SHADER_STORAGE_BLOCK_SIZE", 1 << 16)
    with pytest.raises(NotEnoughMemory, match="use the renderer 'auto'"):
        GlRenderer(scene_of(ship_block(triangles=8_000)))
