"""The rasteriser: coverage of degenerate triangles at every pixel centre, depth, threads, batches, bad input."""

from __future__ import annotations

import gc

import numpy as np
import pytest

from cadcam.cad.mesh import Mesh
from cadcam.cad.parts import ship_block
from cadcam.cad.parts.shape import box
from cadcam.camera.camera import Camera
from cadcam.camera.lens import BrownConrady, Division, DoubleSphere, Fisheye, InverseBrownConrady, TiltedBrownConrady
from cadcam.errors import BadValue, DegenerateGeometry, MissingCore, NotEnoughMemory
from cadcam.geometry.rigid import Rigid
from cadcam.native import core
from cadcam.render import memory
from cadcam.render.caster import Caster
from cadcam.render.lens_tables import plane_points, subdivided
from cadcam.render.lines.occlusion import OccludingFaces
from cadcam.render.raster import RasterRenderer
from cadcam.render.ray import RayRenderer
from cadcam.render.view import Channel, Look, Scene

from .coverage import brute_force
from .scenes import scene_of, views_of

try:
    core.library()
except MissingCore as error:
    pytest.skip(str(error), allow_module_level=True)

SMALL = (83, 61)
CAMERAS = {
    "plain": Camera.from_focal(SMALL, 90.0),
    "skewed, off centre": Camera.from_focal(SMALL, 95.0, fy=80.0, cx=31.7, cy=60.2, skew=7.5),
    "long focal length": Camera.from_focal(SMALL, 9000.0, fy=9100.0, cx=11.0, cy=90.0, skew=40.0),
    "Brown-Conrady": Camera.from_focal(SMALL, 70.0, skew=1.0, lens=BrownConrady(-0.28, 0.06, 1e-3, -2e-3)),
    "division": Camera.from_focal(SMALL, 60.0, cx=40.2, lens=Division(-0.35)),
    "fisheye past its circle": Camera.from_focal(SMALL, 26.0, cx=55.3, cy=35.1, lens=Fisheye(0.01, -0.003)),
    "Scheimpflug": Camera.from_focal(SMALL, 70.0, lens=TiltedBrownConrady(-0.2, tau_x=0.2, tau_y=-0.15)),
    "photogrammetric": Camera.from_focal(SMALL, 70.0, lens=InverseBrownConrady(0.25, -0.05, 1e-3, -2e-3)),
    "double sphere": Camera.from_focal(SMALL, 22.0, cx=30.1, lens=DoubleSphere(-0.2, 0.6)),
}
HERE = Rigid()
FLOAT = 2.0**-23  # one step of float32, relative


def raster(vertices: np.ndarray, faces: np.ndarray, *, threads: int = 2) -> RasterRenderer:
    return RasterRenderer(scene_of(Mesh.single(vertices, faces)), threads=threads)


def some_pose(rng: np.random.Generator) -> Rigid:
    return Rigid.exp(np.concatenate([rng.normal(size=3) * 5, rng.normal(size=3)]))


def soup(rng: np.random.Generator, kind: str, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Triangles in the camera frame, scaled so that any focal length sees many of them."""
    n = 60
    wide = np.array([60.0 / camera.fx, 60.0 / camera.fy, 0.0]) * 100
    centre = rng.uniform(-1, 1, (n, 1, 3)) * wide + np.array([0, 0, 100.0])
    spread = {"large": 1.0, "small": 0.05, "slivers": 1.0, "through the camera": 4.0}[kind]
    p = centre + rng.uniform(-1, 1, (n, 3, 3)) * (wide * spread + np.array([0, 0, 30.0 * spread]))
    if kind == "slivers":
        along = rng.uniform(-1, 2, (n, 1))
        p[:, 2] = p[:, 0] + along * (p[:, 1] - p[:, 0]) + rng.normal(size=(n, 3)) * wide * 10.0 ** -rng.uniform(2, 6)
    return p.reshape(-1, 3), np.arange(3 * n).reshape(-1, 3)


@pytest.mark.parametrize("kind", ["large", "small", "slivers", "through the camera"])
@pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS.keys())
def test_every_pixel_centre_sees_what_brute_force_sees(camera: Camera, kind: str, rng: np.random.Generator) -> None:
    for _ in range(2):
        p, faces = soup(rng, kind, camera)
        pose = some_pose(rng)
        p = pose.inv @ p
        view = raster(p, faces).render(camera, pose)
        face, near, second = brute_force(p, faces, camera, pose)
        assert np.array_equal(view.face >= 0, face >= 0), "coverage: no tolerance"
        apart = near - second > 4 * FLOAT * near  # faces closer than float32 tells may change places
        assert np.array_equal(view.face[apart], face[apart])
        seen = face >= 0
        # 1/z and z are each rounded once; a sliver's own plane is known to (rounding / its width)
        limit = 4 * FLOAT if kind != "slivers" else 1e-5
        assert np.abs(view.depth[seen] * near[seen].astype(float) - 1).max(initial=0) < limit
        assert np.isinf(view.depth[~seen]).all()


@pytest.mark.parametrize("name", ["plain", "division"])
def test_edges_a_billionth_of_a_pixel_beside_the_centres_are_decided_right(name: str, rng: np.random.Generator) -> None:
    """Far closer than float can tell, far wider than the rounding of the corners (1e-13 px)."""
    camera = CAMERAS[name]
    corners = rng.integers([2, 2], [80, 58], (300, 3, 2)).astype(float)
    u, v = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    corners = corners[np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]) > 20]
    at = plane_points(camera)[corners[..., 1].astype(int), corners[..., 0].astype(int)]
    at += rng.uniform(-1e-9, 1e-9, (len(at), 1, 2)) / camera.fx
    z = rng.uniform(50, 100, (len(at), 1, 1))
    p = np.concatenate([at * z, np.broadcast_to(z, (len(at), 3, 1))], axis=-1)
    for k in range(0, len(p), 6):  # few at a time: hidden edges show nothing
        some = p[k : k + 6].reshape(-1, 3)
        faces = np.arange(len(some)).reshape(-1, 3)
        view = raster(some, faces).render(camera, HERE)
        face, _, _ = brute_force(some, faces, camera, HERE)
        assert np.array_equal(view.face, face)


@pytest.mark.parametrize("camera", [CAMERAS["plain"], CAMERAS["fisheye past its circle"]], ids=["plain", "fisheye"])
def test_a_tiled_plane_is_covered_once_everywhere(camera: Camera, rng: np.random.Generator) -> None:
    n = 9
    x, y = np.meshgrid(np.linspace(-3000, 3000, n + 1), np.linspace(-2500, 2500, n + 1))
    p = np.stack([x, y, 100 + 20 * np.sin(x) * np.cos(y)], axis=-1).reshape(-1, 3)
    p[:, :2] += rng.normal(size=(len(p), 2)) * 30
    i = np.arange(n * n) + np.arange(n * n) // n
    faces = np.concatenate([np.stack([i, i + 1, i + n + 2], 1), np.stack([i, i + n + 2, i + n + 1], 1)])
    hits = np.zeros((camera.height, camera.width), int)
    for f in faces:
        hits += raster(p, f[None], threads=1).render(camera, HERE, channels=Channel.FACE).face >= 0
    sees = np.isfinite(plane_points(camera)).all(axis=-1)
    inner = np.abs(np.nan_to_num(plane_points(camera))).max(axis=-1) < 15
    assert (hits[sees & inner] == 1).all()
    assert not hits[~sees].any()


def test_pixel_centres_on_an_edge_belong_to_the_left_and_top_edges() -> None:
    camera = Camera.from_focal((64, 64), 64.0, cx=0.0, cy=0.0)
    p = np.array([[8, 8, 64], [24, 8, 64], [24, 40, 64], [8, 40, 64]], float)  # corners on pixel centres, exactly
    expected = np.zeros((64, 64), bool)
    expected[8:40, 8:24] = True
    for faces in ([[0, 1, 2], [0, 2, 3]], [[0, 2, 1], [0, 2, 3]], [[1, 2, 3], [0, 1, 3]]):
        assert np.array_equal(raster(p, np.array(faces)).render(camera, HERE).mask, expected)
        each = [raster(p, np.array([f])).render(camera, HERE).mask for f in faces]
        assert not (each[0] & each[1]).any()


@pytest.fixture(scope="module")
def block() -> Mesh:
    return ship_block(triangles=8_000)


BLOCK_CAMERAS = {
    "plain": Camera.from_focal((320, 240), 300.0),
    "skewed": Camera.from_focal((320, 240), 300.0, fy=260.0, cx=120.3, cy=140.9, skew=25.0),
    "Brown-Conrady": Camera.from_focal((320, 240), 250.0, lens=BrownConrady(-0.25, 0.05, 1e-3, -1e-3)),
    "fisheye": Camera.from_focal((320, 240), 100.0, lens=Fisheye(0.03, -0.008)),
}


@pytest.mark.parametrize("samples", [1, 2])
@pytest.mark.parametrize("width", [320, 317])
@pytest.mark.parametrize("maker", [RasterRenderer, RayRenderer])
def test_rgb_is_the_image_rounded_to_bytes(maker: type, width: int, samples: int, block: Mesh) -> None:
    renderer, pose, look = maker(scene_of(block)), views_of(block)[0], Look(supersampling=samples)
    camera = Camera.from_focal((width, 240), 300.0)
    both = renderer.render(camera, pose, channels=Channel.IMAGE | Channel.RGB, look=look)
    assert both.rgb.dtype == np.uint8
    assert np.array_equal(both.rgb, np.floor(both.image * np.float32(255) + np.float32(0.5)))
    alone = renderer.render(camera, pose, channels=Channel.RGB, look=look)
    assert np.array_equal(alone.rgb, both.rgb)
    assert set(alone.layers) == {"rgb"}
    with pytest.raises(BadValue, match=r"Channel\.RGB among"):
        _ = renderer.render(camera, pose, channels=Channel.DEPTH).rgb


def test_an_antialiased_image_is_that_of_rays_and_leaves_ids_and_depth_alone(block: Mesh) -> None:
    camera, pose, fine = BLOCK_CAMERAS["Brown-Conrady"], views_of(block)[0], Look(supersampling=3)
    scene = scene_of(block)
    plain = RasterRenderer(scene).render(camera, pose)
    smooth = RasterRenderer(scene).render(camera, pose, look=fine)
    rays = RayRenderer(scene).render(camera, pose, look=fine)
    for name in ("face", "part", "depth", "normal"):
        assert np.array_equal(getattr(plain, name), getattr(smooth, name))
    assert np.mean(np.abs(smooth.coverage - rays.coverage) > 1e-6) < 1e-3
    assert np.abs(smooth.image - rays.image).mean() < 1e-4
    assert 0 < np.mean((smooth.coverage > 0) & (smooth.coverage < 1)) < 0.1


@pytest.mark.parametrize("samples", [2, 3])
@pytest.mark.parametrize("camera", BLOCK_CAMERAS.values(), ids=BLOCK_CAMERAS.keys())
def test_centres_and_samples_drawn_together_are_those_drawn_alone(camera: Camera, samples: int, block: Mesh) -> None:
    renderer, look = RasterRenderer(scene_of(block)), Look(supersampling=samples, background=(0.1, 0.2, 0.3))
    for pose in views_of(block):
        together = renderer.render(camera, pose, look=look)
        colors = renderer.render(camera, pose, look=look, channels=Channel.IMAGE)
        centres = renderer.render(camera, pose, channels=Channel.ALL & ~Channel.IMAGE)
        for name, layer in together.layers.items():
            alone = colors if name in ("image", "coverage") else centres
            assert np.array_equal(layer, alone.layers[name]), name


@pytest.mark.parametrize("camera", [BLOCK_CAMERAS["plain"], BLOCK_CAMERAS["skewed"]])
@pytest.mark.parametrize("samples", [2, 3])
def test_samples_are_the_centres_of_a_finer_picture(camera: Camera, samples: int, block: Mesh) -> None:
    """Each decided in double in a plane of its own: only a sample within 1e-12 px of an edge could differ."""
    renderer, (pose, _) = RasterRenderer(scene_of(block)), views_of(block)
    view = renderer.render(camera, pose, look=Look(supersampling=samples))
    fine = renderer.render(camera.resize((samples * camera.width, samples * camera.height)), pose)
    cells = (camera.height, samples, camera.width, samples)
    assert np.abs(view.coverage - fine.mask.reshape(cells).mean(axis=(1, 3))).max() <= FLOAT
    assert np.abs(view.image - fine.image.reshape(*cells, 3).mean(axis=(1, 3))).max() <= 16 * FLOAT


@pytest.mark.parametrize("camera", BLOCK_CAMERAS.values(), ids=BLOCK_CAMERAS.keys())
def test_a_solid_without_its_backs_looks_the_same_from_outside(camera: Camera, block: Mesh) -> None:
    """But where front and back meet at a silhouette as near as float tells depths apart: none of these pixels."""
    scene, look = scene_of(block), Look(supersampling=2)
    solid = RasterRenderer(scene, backs=False)
    for pose in views_of(block):
        whole, fronts = (r.render(camera, pose, look=look) for r in (RasterRenderer(scene), solid))
        for name in ("face", "part", "depth", "normal", "coverage"):
            assert np.array_equal(whole.layers[name], fronts.layers[name]), name
        assert np.mean(np.abs(whole.image - fronts.image).max(axis=-1) > 4 * FLOAT) < 1e-4


@pytest.mark.parametrize("why", ["open", "inside out", "from inside"])
def test_backs_that_can_be_seen_are_not_left_out(why: str) -> None:
    cube = box((-10, -10, -10), (10, 10, 10), name="cube")
    faces = {"open": cube.faces[2:], "inside out": cube.faces[:, ::-1]}.get(why, cube.faces)
    scene = scene_of(Mesh.single(cube.vertices, faces))
    camera = Camera.from_focal(SMALL, 60.0)
    pose = Rigid.look_at([3, 2, 1] if why == "from inside" else [35, 25, 30], [0, 0, 0])
    whole, fronts = (RasterRenderer(scene, backs=backs).render(camera, pose) for backs in (True, False))
    assert np.array_equal(whole.face, fronts.face)
    assert whole.mask.any()


def test_coverage_of_a_half_covered_pixel_is_a_half() -> None:
    camera = Camera.from_focal((32, 32), 32.0, cx=0.0, cy=0.0)
    p = np.array([[-99, -99, 32], [10, -99, 32], [10, 99, 32], [-99, 99, 32]], float)  # the edge at x = 10.0
    view = raster(p, np.array([[0, 1, 2], [0, 2, 3]])).render(camera, HERE, look=Look(supersampling=4))
    assert (view.coverage[:, :10] == 1).all()
    assert (view.coverage[:, 10] == 0.5).all()
    assert (view.coverage[:, 11:] == 0).all()


@pytest.mark.parametrize("camera", BLOCK_CAMERAS.values(), ids=BLOCK_CAMERAS.keys())
def test_pictures_do_not_depend_on_threads_nor_on_batches(camera: Camera, block: Mesh) -> None:
    scene, poses = scene_of(block), views_of(block) * 2
    one, three = RasterRenderer(scene, threads=1), RasterRenderer(scene, threads=3)
    batch = list(three.render_batch(camera, poses, look=Look(supersampling=2)))
    assert len(batch) == len(poses)
    for pose, view in zip(poses, batch, strict=True):
        for single in (one, three):
            other = single.render(camera, pose, look=Look(supersampling=2))
            for name in view.layers:
                assert np.array_equal(view.layers[name], other.layers[name]), name
    assert list(one.render_batch(camera, [])) == []


def test_threads_that_look_for_triangles_together_miss_none() -> None:
    """Enough of them that several threads look; each twice, so that ties show who came first."""
    rng = np.random.default_rng(7)
    corners = rng.uniform([-60, -40, 80], [60, 40, 200], (140_000, 1, 3)) + rng.normal(size=(140_000, 3, 3)) * 0.3
    faces = np.tile(np.arange(420_000).reshape(-1, 3), (2, 1))
    scene = scene_of(Mesh.single(corners.reshape(-1, 3), faces))
    one, three = RasterRenderer(scene, threads=1), RasterRenderer(scene, threads=3)
    for name in ("plain", "Brown-Conrady"):
        for pose in (HERE, Rigid.exp([0.0, 0, -120, 0, 0.3, 0])):
            first, *others = (
                r.render(CAMERAS[name], pose, channels=Channel.FACE | Channel.DEPTH) for r in (one, *[three] * 10)
            )
            assert first.face.max() < 140_000
            for other in others:
                assert np.array_equal(first.face, other.face)
                assert np.array_equal(first.depth, other.depth)


def test_a_view_keeps_its_numbers_while_others_are_rendered(block: Mesh) -> None:
    """Buffers are used again; not while any slice of them is alive."""
    renderer, camera = RasterRenderer(scene_of(block)), BLOCK_CAMERAS["plain"]
    first, second = views_of(block)
    piece = renderer.render(camera, first).depth[40:90, 30:]
    copy = piece.copy()
    for _ in range(5):
        gc.collect()
        renderer.render(camera, second)
    assert np.array_equal(piece, copy)


def test_a_picture_of_fifty_megapixels_is_exact_in_its_corners() -> None:
    camera = Camera.from_focal((8200, 6200), 8000.0)
    p = np.array([[-1e5, -1e5, 500.0], [1e5, -1e5, 700.0], [0, 2e5, 900.0]])
    view = raster(p, np.array([[0, 1, 2]])).render(camera, HERE, channels=Channel.DEPTH)
    n = np.cross(p[1] - p[0], p[2] - p[0])
    for x, y in [(0, 0), (8199, 0), (0, 6199), (8199, 6199), (4100, 3100)]:
        ray = camera.unproject([x, y])
        assert view.depth[y, x] == pytest.approx(n @ p[0] / (n @ ray) * ray[2], rel=4 * FLOAT)


@pytest.mark.parametrize("shift", [0.0, 1e7])
@pytest.mark.parametrize("size", [1e-6, 1e12])
def test_tiny_and_huge_scenes_look_alike(size: float, shift: float, rng: np.random.Generator) -> None:
    """Scaling all lengths, and moving the world's origin away, changes at most what rounding of the input changes."""
    camera = CAMERAS["skewed, off centre"]
    p, faces = soup(rng, "large", camera)
    plain = raster(p, faces).render(camera, HERE)
    moved = raster(p * size + shift * size, faces).render(camera, Rigid(translation=np.full(3, -shift * size)))
    assert np.mean(moved.face != plain.face) < (1e-3 if shift else 1e-9)
    same = (moved.face == plain.face) & (plain.face >= 0)
    assert np.abs(moved.depth[same] / size / plain.depth[same] - 1).max() < 1e-6


def test_a_plate_seen_exactly_edge_on_shows_nothing() -> None:
    p = np.array([[0, -50, 100.0], [0, 50, 100.0], [0, 0, 300.0]])
    assert not raster(p, np.array([[0, 1, 2]])).render(CAMERAS["plain"], HERE).mask.any()


def test_a_model_behind_the_camera_gives_an_empty_view() -> None:
    p = np.array([[-50, -50, -100.0], [50, -50, -100.0], [0, 50, -100.0]])
    view = raster(p, np.array([[0, 1, 2]])).render(CAMERAS["plain"], HERE)
    assert not view.mask.any()
    assert (view.image == 1).all()
    assert not view.normal.any()


def test_samples_beside_the_centre_follow_the_lens() -> None:
    """Linear extrapolation from the centres is within 2e-3 px of a strong lens on 320 px, and less on more."""
    camera = BLOCK_CAMERAS["Brown-Conrady"]
    n = 3
    fine = camera.resize((camera.width * n, camera.height * n))
    error = (subdivided(plane_points(camera), n) - plane_points(fine)) * camera.fx
    assert np.abs(error[n:-n, n:-n]).max() < 2e-3


@pytest.mark.parametrize("renderer", [RasterRenderer, RayRenderer])
def test_samples_at_the_rim_of_a_fisheye_see_what_centres_of_a_finer_picture_see(renderer: type) -> None:
    """There x/z runs away to infinity within a pixel: extrapolated in it, a fifth of the rim's samples looked wrong."""
    camera = Camera.from_focal((150, 150), 150 / np.pi, lens=Fisheye())
    room = renderer(Scene.of(box([0, 0, 0], [3000, 2000, 1500], name="room")))
    pose = Rigid.look_at([1400, 900, 700], [3000, 1900, 1000])
    view = room.render(camera, pose, look=Look(supersampling=3))
    fine = room.render(camera.resize((450, 450)), pose)
    image, coverage, face = (
        getattr(fine, name).reshape(150, 3, 150, 3, -1).swapaxes(1, 2).reshape(150, 150, 9, -1)
        for name in ("image", "coverage", "face")
    )
    seen = view.face >= 0
    flat = seen & (face == face[:, :, :1]).all(axis=(2, 3))
    assert (flat & ~np.roll(seen, 1, axis=1)).any(), "some of them are at the rim"
    assert np.abs(view.image - image.mean(axis=2))[flat].max() < 1e-3
    one_sample = 1 / 9 + 8 * FLOAT  # of those exactly 90 degrees away, to rounding
    assert np.abs(view.coverage - coverage.mean(axis=2)[..., 0])[seen].max() < one_sample


def test_an_empty_mesh_and_impossible_arguments_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(DegenerateGeometry, match="without faces"):
        raster(np.zeros((0, 3)), np.zeros((0, 3), int))
    triangle = np.eye(3) + np.array([0, 0, 5])
    with pytest.raises(BadValue, match="threads is 0"):
        raster(triangle, np.array([[0, 1, 2]]), threads=0)
    renderer = raster(triangle, np.array([[0, 1, 2]]))
    with pytest.raises(BadValue, match="at most 65535 px"):
        renderer.render(Camera.from_focal((10_000, 10), 50.0), HERE, look=Look(supersampling=8))
    monkeypatch.setattr(memory, "available_bytes", lambda: 2**20)
    with pytest.raises(NotEnoughMemory, match=r"800 x 600 px needs 0\.0 GiB .* smaller picture"):
        renderer.render(Camera.from_focal((800, 600), 50.0), HERE)


def test_what_hides_a_point_in_space_is_what_rays_find(rng: np.random.Generator) -> None:
    """Corners, middles of faces and places in the air, from eyes all round and within: to the last one."""
    scene = Scene.of(ship_block(triangles=5000))
    mesh, caster = scene.mesh, Caster(scene.mesh)
    renderer, rays = RasterRenderer(scene), OccludingFaces(mesh, caster)
    middles = mesh.vertices[mesh.faces[rng.integers(mesh.n_faces, size=200)]].mean(axis=1)
    corners = mesh.vertices[rng.integers(len(mesh.vertices), size=200)]
    points = np.concatenate([corners, middles, caster.center + caster.radius * rng.uniform(-1, 1, (200, 3))])
    tolerance, hidden = 2e-6 * caster.radius, 0
    for away in (0.1, 0.5, 1.5, 4.0):
        eye = caster.center + away * caster.radius * rng.normal(size=3)
        found = renderer.hides(points, eye, tolerance=tolerance)
        assert (found == rays.hidden(points, eye, np.full(len(points), tolerance))).all()
        hidden += int(found.sum())
    assert 0.2 < hidden / (4 * len(points)) < 0.95


def test_the_side_that_two_faces_share_hides_what_is_behind_it() -> None:
    """And a point on a face, or within the tolerance of its plane, is not hidden by it, from either side."""
    renderer = RasterRenderer(scene_of(box([0, 0, 0], [1, 1, 1], name="box", color=(1, 1, 1))))
    eye = np.array([0.5, 0.5, 9.0])  # straight above the diagonal of the lid
    points = np.array([[0.5, 0.5, 1.0], [0.5, 0.5, 0.9], [0.5, 0.5, 0.9999], [0.25, 0.25, 0.5], [0.5, 0.5, 1.5]])
    assert renderer.hides(points, eye, tolerance=1e-3).tolist() == [False, True, False, True, False]
    assert renderer.hides(points, eye, tolerance=0.0).tolist() == [False, True, True, True, False]
    assert renderer.hides(points[:1], np.array([0.5, 0.5, 0.5]), tolerance=0.0).tolist() == [False]
