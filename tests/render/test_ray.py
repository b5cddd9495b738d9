"""The ray caster: outlines, depth, ids and batches."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from scipy.ndimage import binary_dilation, binary_erosion
from scipy.spatial import ConvexHull, cKDTree

from cadcam.cad.mesh import Mesh
from cadcam.camera.camera import Camera
from cadcam.camera.lens import BrownConrady, Fisheye
from cadcam.errors import BadValue, UnknownName
from cadcam.geometry.rigid import Rigid
from cadcam.render import open_renderer, ray
from cadcam.render.ray import RayRenderer
from cadcam.render.view import Channel, Look, nothing_in_view

from .scenes import scene_of

SIZE = (480, 360)
CAMERAS = {
    "plain": Camera.from_focal(SIZE, 520.0),
    "skewed": Camera.from_focal(SIZE, 510.0, fy=556.0, cx=211.3, cy=197.8, skew=28.0),
    "distorted": Camera.from_focal(SIZE, 390.0, fy=382.0, cx=229.2, cy=188.9, lens=BrownConrady(k1=-0.28, k2=0.06)),
    "fisheye": Camera.from_focal(SIZE, 330.0, cx=247.4, cy=171.1, lens=Fisheye(k1=-0.02)),
}


def gem(rng: np.random.Generator, n: int = 14) -> Mesh:
    """A random convex polyhedron of about 400 mm, wound outwards."""
    p = rng.normal(size=(n, 3))
    p *= 200 / np.linalg.norm(p, axis=1)[:, None]
    hull = ConvexHull(p)
    faces = hull.simplices.copy()
    normal = np.cross(p[faces[:, 1]] - p[faces[:, 0]], p[faces[:, 2]] - p[faces[:, 0]])
    inward = np.einsum("ij,ij->i", normal, hull.equations[:, :3]) < 0
    faces[inward] = faces[inward][:, ::-1]
    return Mesh.single(p, faces)


def poses(rng: np.random.Generator, n: int) -> list[Rigid]:
    eyes = rng.normal(size=(n, 3))
    eyes *= 900 / np.linalg.norm(eyes, axis=1)[:, None]
    return [Rigid.look_at(eye, rng.normal(size=3) * 60, up=rng.normal(size=3)) for eye in eyes]


def outline(mesh: Mesh, camera: Camera, pose: Rigid) -> np.ndarray:
    """The image (edges, 1001, 2) of a convex mesh's silhouette: the exact projection, no renderer."""
    p = pose @ mesh.vertices
    front = np.einsum("ij,ij->i", mesh.face_normals @ pose.rotation.T, p[mesh.faces[:, 0]]) < 0
    seen: dict[tuple[int, int], bool] = {}
    edges = []
    for face, is_front in zip(mesh.faces, front, strict=True):
        for a, b in zip(face, np.roll(face, -1), strict=True):
            key = (min(a, b), max(a, b))
            if key in seen and seen[key] != is_front:
                edges.append(key)
            seen[key] = is_front
    s = np.linspace(0, 1, 1001)[:, None]
    return np.stack([camera.project(p[a] + s * (p[b] - p[a])) for a, b in edges])


def distance_to(curves: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Return the distance (N,) of points q (N, 2) from curves (edges, n, 2) given every half pixel or closer."""
    n = curves.shape[1]
    nearest = cKDTree(curves.reshape(-1, 2)).query(q)[1]
    best = np.full(len(q), np.inf)
    for side in (-1, 0):
        k = np.clip(nearest % n + side, 0, n - 2)
        a, b = curves[nearest // n, k], curves[nearest // n, k + 1]
        t = np.clip(np.sum((q - a) * (b - a), axis=1) / np.sum((b - a) ** 2, axis=1), 0, 1)
        best = np.minimum(best, np.linalg.norm(a + t[:, None] * (b - a) - q, axis=1))
    return best


@cache
def pixel_rays(camera: Camera) -> np.ndarray:
    return camera.unproject(camera.pixel_grid()).reshape(-1, 3)


def inside_convex(mesh: Mesh, camera: Camera, pose: Rigid) -> np.ndarray:
    """Return which pixel centres see the convex mesh: their rays clipped by its planes, in float64."""
    d = pixel_rays(camera) @ pose.rotation
    height = np.einsum("ij,ij->i", mesh.face_normals, mesh.vertices[mesh.faces[:, 0]] - pose.origin)
    near, far = np.zeros(len(d)), np.full(len(d), np.inf)
    for normal, h in zip(mesh.face_normals, height, strict=True):
        slope = d @ normal
        near = np.where(slope < 0, np.maximum(near, h / slope), near)
        far = np.where(slope > 0, np.minimum(far, h / slope), far)
    return (near < far).reshape(camera.height, camera.width)


def misplaced(rendering: Camera, camera: Camera, n: int) -> tuple[float, int]:
    """Return how far (px) the worst pixel centre on the wrong side lies from the true outline, over n views of a gem.

    Also how many centres lie within 0.02 px of it: so many places where the outline is measured that closely.
    """
    rng = np.random.default_rng(5)
    mesh = gem(rng)
    renderer, worst, close = RayRenderer(scene_of(mesh)), 0.0, 0
    for pose in poses(rng, n):
        mask = renderer.render(rendering, pose, channels=Channel.FACE).mask
        truth, curves = inside_convex(mesh, camera, pose), outline(mesh, camera, pose)
        wrong = np.argwhere(mask != truth)[:, ::-1]
        worst = max(worst, float(distance_to(curves, wrong).max(initial=0.0)))
        border = np.argwhere(binary_dilation(truth) != binary_erosion(truth))[:, ::-1]
        close += int((distance_to(curves, border) < 0.02).sum())
    return worst, close


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] * (name == "skewed")) for name in CAMERAS]
)
def test_silhouettes_lie_on_the_analytic_projection(name: str) -> None:
    """A pixel centre tells on which side of it the outline runs, so centres close to it measure it closely.

    A hundred and more centres lie within 0.02 px of the outline: moved by that much it would leave half of them on the
    wrong side. Rays in float32 from beside the model are off by 1e-7 of its diagonal, 6e-5 px here: 0.002 px is ample.
    """
    worst, close = misplaced(CAMERAS[name], CAMERAS[name], 8)
    assert close > 100
    assert worst < 0.002


@pytest.mark.parametrize("name", CAMERAS)
@pytest.mark.parametrize("shift", [(0.5, 0.0), (0.0, -0.5), (0.03, 0.0)])
def test_a_planted_shift_is_seen_by_the_silhouette_test(name: str, shift: tuple[float, float]) -> None:
    camera = CAMERAS[name]
    K = camera.K.copy()
    K[:2, 2] += shift
    assert misplaced(Camera(camera.size, K, camera.lens), camera, 3)[0] > 0.02


@pytest.mark.parametrize("name", CAMERAS)
def test_a_sphere_has_the_area_of_its_tangent_cone(name: str) -> None:
    """Independent of any mesh edge: centres within the cone of half-angle asin(r/d) about the ball's direction see it.

    The 81 920 faces lie at most 5e-5 r inside the sphere, 0.005 px here.
    """
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=6, radius=150.0)
    camera, pose = CAMERAS[name], Rigid.look_at([500.0, 620.0, 380.0], [20.0, 30.0, -10.0])
    mask = (
        RayRenderer(scene_of(Mesh.single(ball.vertices, ball.faces))).render(camera, pose, channels=Channel.FACE).mask
    )
    centre = pose.translation
    distance = np.linalg.norm(centre)
    cosine = (pixel_rays(camera) @ (centre / distance)).reshape(mask.shape)
    off_px = (np.arccos(np.clip(cosine, -1, 1)) - np.arcsin(150 / distance)) * 520  # px per rad, at most
    assert not mask[off_px > 0.002].any()
    assert mask[off_px < -0.02].all()


def test_depth_normal_part_and_face_are_those_of_the_face_that_brute_force_finds(rng: np.random.Generator) -> None:
    gems = [gem(rng) for _ in range(2)]
    vertices = np.concatenate([gems[0].vertices, gems[1].vertices + np.array([150.0, 40.0, 0.0])])
    faces = np.concatenate([gems[0].faces, gems[1].faces + len(gems[0].vertices)])
    part = np.repeat([0, 1], [len(g.faces) for g in gems])
    mesh = Mesh(vertices, faces, part, np.full(len(faces), -1), ("a", "b"), np.full((2, 3), np.nan))
    camera, pose = CAMERAS["distorted"].resize((160, 120)), poses(rng, 1)[0]
    view = RayRenderer(scene_of(mesh)).render(camera, pose)
    d = camera.unproject(camera.pixel_grid()).reshape(-1, 3)
    a, b, c = np.moveaxis((pose @ mesh.vertices)[mesh.faces], 1, 0)
    t = np.full((len(d), len(a)), np.inf)
    for k in range(len(a)):  # Cramer's rule on s d = a + u (b - a) + v (c - a)
        M = np.linalg.inv(np.stack([a[k] - b[k], a[k] - c[k]], axis=1).T @ np.stack([a[k] - b[k], a[k] - c[k]], axis=1))
        n = np.cross(b[k] - a[k], c[k] - a[k])
        s = (n @ a[k]) / (d @ n)
        w = s[:, None] * d - a[k]
        uv = (w @ np.stack([b[k] - a[k], c[k] - a[k]], axis=1)) @ M
        t[:, k] = np.where((uv >= 0).all(axis=1) & (uv.sum(axis=1) <= 1) & (s > 0), s, np.inf)
    face, s = t.argmin(axis=1), t.min(axis=1)
    hit = np.isfinite(s)
    assert np.array_equal(view.mask.ravel(), hit)
    assert np.array_equal(view.face.ravel()[hit], face[hit])
    assert np.array_equal(view.part.ravel()[hit], mesh.part[face[hit]])
    z = s[hit] * d[hit, 2]
    assert np.abs(view.depth.ravel()[hit] / z - 1).max() < 2**-23  # one rounding to float32
    assert np.isinf(view.depth.ravel()[~hit]).all()
    normal = mesh.face_normals[face[hit]] @ pose.rotation.T
    assert np.abs(view.normal.reshape(-1, 3)[hit] - normal).max() < 1e-6
    assert np.einsum("ij,ij->i", view.normal.reshape(-1, 3)[hit], d[hit]).max() <= 0


def test_far_cameras_keep_their_precision(rng: np.random.Generator) -> None:
    """From 2 km off, float32 rays from the eye would be 0.1 mm (0.2 px) off; rays started beside the model are not."""
    mesh, camera = gem(rng), Camera.from_focal(SIZE, 2.0e6)
    pose = Rigid.look_at([1.2e6, 1.6e6, 2.0e5], [0.0, 0.0, 0.0])
    view = RayRenderer(scene_of(mesh)).render(camera, pose, channels=Channel.FACE)
    wrong = np.argwhere(view.mask != inside_convex(mesh, camera, pose))[:, ::-1]
    assert distance_to(outline(mesh, camera, pose), wrong).max(initial=0.0) < 0.002


def test_bands_and_crops_are_cut_from_the_same_picture(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    renderer, camera, pose = RayRenderer(scene_of(gem(rng))), CAMERAS["distorted"], poses(rng, 1)[0]
    whole = renderer.render(camera, pose, look=Look(supersampling=2))
    monkeypatch.setattr(ray, "_BAND", 7 * camera.width)
    monkeypatch.setattr(ray, "_KEPT", 0)
    renderer._rays.clear()
    banded = renderer.render(camera, pose, look=Look(supersampling=2))
    crop = renderer.render(camera.crop(150, 100, (150, 100)), pose)
    assert np.array_equal(whole.face, banded.face)
    assert np.abs(whole.image - banded.image).max() < 1e-6
    assert (whole.face[100:200, 150:300] != crop.face).mean() < 1e-3  # rays differ by rounding


def test_pixels_beyond_the_lens_are_background() -> None:
    camera = Camera.from_focal(SIZE, 150.0, lens=BrownConrady(k1=-0.3))
    assert np.isnan(camera.unproject(np.array([0.0, 0.0]))).any()
    wall = Mesh.single([[-1e4, -1e4, 500.0], [1e4, -1e4, 500.0], [0.0, 2e4, 500.0]], [[0, 2, 1]])
    view = RayRenderer(scene_of(wall)).render(camera, Rigid())
    assert view.face[180, 240] == 0
    assert view.face[0, 0] == -1
    assert np.isinf(view.depth[0, 0])


def test_coverage_counts_the_share_of_samples(rng: np.random.Generator) -> None:
    renderer, camera, pose = RayRenderer(scene_of(gem(rng))), CAMERAS["plain"], poses(rng, 1)[0]
    fine = renderer.render(camera.resize((1440, 1080)), pose, channels=Channel.FACE).mask
    coverage = renderer.render(camera, pose, look=Look(supersampling=3), channels=Channel.IMAGE).coverage
    expected = fine.reshape(360, 3, 480, 3).mean(axis=(1, 3))
    assert (np.abs(coverage - expected) > 1e-6).mean() < 1e-4  # what 1e-3 px of extrapolation turns


def test_a_batch_gives_what_single_renders_give_and_keeps_empty_views(rng: np.random.Generator) -> None:
    renderer, camera = open_renderer(scene_of(gem(rng))), CAMERAS["skewed"]
    away = Rigid.look_at([0.0, 0.0, 900.0], [0.0, 0.0, 2000.0], up=[0.0, 1.0, 0.0])
    batch = [poses(rng, 1)[0], away]
    views = list(renderer.render_batch(camera, batch, channels=Channel.DEPTH))
    assert np.array_equal(views[0].depth, renderer.render(camera, batch[0], channels=Channel.DEPTH).depth)
    assert not views[1].mask.any()


def test_channels_that_were_not_asked_for_are_refused_by_name(rng: np.random.Generator) -> None:
    view = RayRenderer(scene_of(gem(rng))).render(CAMERAS["plain"], poses(rng, 1)[0], channels=Channel.DEPTH)
    assert view.depth.shape == (360, 480)
    with pytest.raises(BadValue, match=r"channel normal .* Channel.NORMAL"):
        _ = view.normal


def test_unknown_renderers_are_refused(rng: np.random.Generator) -> None:
    with pytest.raises(UnknownName, match="did you mean 'ray'"):
        open_renderer(scene_of(gem(rng)), "rays")


def test_an_empty_view_is_explained_with_the_box_in_camera_and_picture(rng: np.random.Generator) -> None:
    mesh = gem(rng)
    behind = nothing_in_view(mesh, CAMERAS["plain"], Rigid(np.eye(3), [0.0, 0.0, -900.0]))
    beside = nothing_in_view(mesh, CAMERAS["plain"], Rigid(np.eye(3), [9000.0, 0.0, 900.0]))
    assert "behind the camera" in str(behind)
    assert "projects to x [" in str(beside)
