"""First hits of rays, by Embree and by the C core: asking every triangle, along edges, without Embree."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from cadcam.cad.mesh import Mesh
from cadcam.cad.parts import machined_bracket, ship_block
from cadcam.camera.camera import Camera
from cadcam.errors import DegenerateGeometry
from cadcam.native.rays import NativeRays
from cadcam.render.caster import Caster
from cadcam.render.embree import EmbreeRays
from cadcam.render.lines.visible import LineDrawer

from .scenes import scene_of, views_of

UNIT = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]], float)
QUADS = [(0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)]
CUBE = np.array([face for a, b, c, d in QUADS for face in ((a, b, c), (a, c, d))], np.int32)


@pytest.fixture
def no_embree(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [n for n in sys.modules if n.split(".")[0] == "embreex"] + ["embreex"]:
        monkeypatch.setitem(sys.modules, name, None)


def brute(corners: np.ndarray, origin: np.ndarray, direction: np.ndarray, reach: float) -> tuple[int, float]:
    """Return the face (of corners (F, 3, 3)) met first and how far away; -1 (T. Moeller and B. Trumbore, 1997)."""
    a, b, c = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    p = np.cross(direction, c)
    with np.errstate(divide="ignore", invalid="ignore"):
        whole = np.sum(b * p, axis=1)
        u = np.sum((origin - a) * p, axis=1) / whole
        q = np.cross(origin - a, b)
        v, t = q @ direction / whole, np.sum(c * q, axis=1) / whole
        hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (t >= 0) & (t < reach)
    t = np.where(hit, t, np.inf)
    return (int(np.argmin(t)), float(t.min())) if hit.any() else (-1, np.inf)


@pytest.mark.parametrize("shift", [0.0, 3e5])
def test_the_core_finds_what_asking_every_triangle_finds(shift: float, rng: np.random.Generator) -> None:
    mesh = ship_block(triangles=8_000)
    vertices = mesh.vertices + shift
    corners, rays = vertices[mesh.faces], NativeRays(vertices, mesh.faces)
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    o = rng.uniform(low - 500, high + 500, size=(400, 3))
    d = rng.uniform(low, high, size=(400, 3)) - o
    d[:40] = np.eye(3)[rng.integers(3, size=40)] * rng.choice([-1.0, 1.0], size=(40, 1))  # along the axes
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    reach = np.where(rng.random(400) < 0.5, 1e4, 800.0)
    found = rays.first_hit(o, d, reach)
    true = [brute(corners, *ray) for ray in zip(o, d, reach, strict=True)]
    differ = np.flatnonzero(found != [face for face, _ in true])
    for k in differ:  # two faces meet there: as far away, to rounding
        _, t = brute(corners[found[k]][None], o[k], d[k] * (1 + 1e-12), 2 * reach[k])
        assert t == pytest.approx(true[k][1], rel=1e-9)
    assert len(differ) < 8
    assert 0.2 < np.mean(found >= 0) < 1


@pytest.mark.parametrize("kind", [NativeRays, EmbreeRays])
def test_a_closed_surface_has_no_gap_along_edges_and_at_corners(kind: type, rng: np.random.Generator) -> None:
    """From inside a ray meets a face wherever it goes, exactly through edges and corners too."""
    if kind is EmbreeRays:
        pytest.importorskip("embreex", reason="Embree has no wheels here")
    rays = kind(UNIT, CUBE)
    targets = np.concatenate([UNIT, (UNIT[CUBE] + np.roll(UNIT[CUBE], 1, axis=1)).reshape(-1, 3) / 2])
    origin = np.repeat(rng.integers(1, 16, size=(50, 3)) / 16, len(targets), axis=0)
    d = np.tile(targets, (50, 1)) - origin
    assert (rays.first_hit(origin, d / np.linalg.norm(d, axis=1, keepdims=True), np.full(len(d), 9.0)) >= 0).all()


def test_rays_in_the_plane_of_a_box_are_not_lost() -> None:
    """0 * infinity is no reason to leave a box out: along x, in the sides of boxes and along their edges."""
    rays = NativeRays(UNIT, CUBE)
    y, z = (grid.ravel() for grid in np.meshgrid([0.0, 0.5, 1.0], [0.0, 0.5, 1.0]))
    for sign, minus in ((1.0, 0.0), (-1.0, -0.0)):
        origin = np.column_stack([np.full(9, 0.5 - 2 * sign), y, z])
        found = rays.first_hit(origin, np.tile([sign, minus, minus], (9, 1)), np.full(9, 9.0))
        assert (found >= 0).all()
        assert (np.ptp(UNIT[CUBE[found]][..., 0], axis=1)[4] == 0).all()  # the middle one meets a face across x


def test_what_is_no_ray_meets_nothing_and_reach_ends_it() -> None:
    rays, start = NativeRays(UNIT, CUBE), np.array([0.5, 0.4, -1.0])
    d = np.array([[0.0, 0, 1], [np.nan, 0, 1], [0, 0, 0], [0, 0, 1], [0, 0, 1], [0, 0, 1], [0, 0, -1]])
    origin = np.tile(start, (7, 1))
    origin[3, 1] = np.nan
    reach = np.array([5.0, 5, 5, 5, np.nan, 0.9, 5])
    assert rays.first_hit(origin, d, reach).tolist() == [1, -1, -1, -1, -1, -1, -1]
    assert rays.first_hit(origin[:1], d[-1:], np.array([np.inf])).tolist() == [-1]
    assert rays.first_hit(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0)).shape == (0,)


def test_of_many_triangles_at_one_place_one_is_met(rng: np.random.Generator) -> None:
    """Two hundred cubes at one place, which no cut tells apart, their faces in any order."""
    which = rng.permutation(np.repeat(np.arange(len(CUBE)), 200))
    n = 300
    origin = rng.uniform(-3, 3, size=(n, 3)) + 9 * np.eye(3)[rng.integers(3, size=n)]
    d, reach = rng.uniform(0, 1, size=(n, 3)) - origin, np.full(n, 9.0)
    found = NativeRays(UNIT, CUBE[which]).first_hit(origin, d, reach)
    assert (found >= 0).all()
    assert np.array_equal(which[found], NativeRays(UNIT, CUBE).first_hit(origin, d, reach))


def test_without_embree_the_core_casts_the_rays_and_lines_are_the_same(request: pytest.FixtureRequest) -> None:
    pytest.importorskip("embreex", reason="Embree has no wheels here")
    scene, camera = scene_of(machined_bracket()), Camera.from_focal((400, 300), 420.0)
    poses = views_of(scene.mesh)
    with_embree = [LineDrawer(scene).draw(camera, pose) for pose in poses]
    request.getfixturevalue("no_embree")
    assert isinstance(Caster(scene.mesh)._rays, NativeRays)
    for pose, expected in zip(poses, with_embree, strict=True):
        lines = LineDrawer(scene).draw(camera, pose).visible
        assert np.array_equal(lines.start, expected.visible.start)
        assert np.abs(lines.q - expected.visible.q).max() < 1e-3  # px; occlusion is confirmed in float64


def test_a_mesh_without_faces_is_refused() -> None:
    with pytest.raises(DegenerateGeometry, match="without faces"):
        Caster(Mesh.single(np.zeros((0, 3)), np.zeros((0, 3), int)))
