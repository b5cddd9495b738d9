"""Smooth bodies of any fineness, and photos of them on a ground of patches and discs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter

from cadcam.arrays import Array, Picture
from cadcam.cad.mesh import Mesh
from cadcam.camera.camera import Camera
from cadcam.geometry.rigid import Rigid
from cadcam.locate.part import Part
from cadcam.render import open_renderer
from cadcam.render.view import PLAIN, Channel

CAMERA = Camera.from_focal((640, 480), 900.0)
_LOOK = replace(PLAIN, background=(0.0, 0.0, 0.0), supersampling=4)


def globe(level: int, axes: tuple[float, float, float] = (50.0, 50.0, 50.0)) -> Mesh:
    """Return an ellipsoid of 20 x 4^level facets about the origin."""
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=level)
    return Mesh.single(ball.vertices * axes, ball.faces)


def drop(n: int) -> Mesh:
    """Return a rounded cone, turned: n facets around, n along."""
    knots = np.array([(0, -40), (28, -36), (38, -22), (24, 10), (10, 36), (0, 42.0)])
    along = np.append(0, np.cumsum(np.hypot(*np.diff(knots, axis=0).T)))
    profile = CubicSpline(along, knots, bc_type=((1, (1.0, 0.0)), (1, (-1.0, 0.0))))
    r, z = profile(along[-1] * (1 - np.cos(np.pi * np.linspace(0, 1, n + 1)[1:-1])) / 2).T
    turn, k = 2 * np.pi * np.arange(n) / n, np.arange(n)
    rings = np.stack([r[:, None] * np.cos(turn), r[:, None] * np.sin(turn), np.repeat(z[:, None], n, 1)], axis=2)
    low, after, m = n * np.arange(n - 2)[:, None], (k + 1) % n, n * (n - 2)
    sides = [np.stack(np.broadcast_arrays(low + k, low + after, low + after + n), axis=2).reshape(-1, 3)]
    sides.append(np.stack(np.broadcast_arrays(low + k, low + after + n, low + k + n), axis=2).reshape(-1, 3))
    ends = [np.stack([after, k, 0 * k + m + n], 1), np.stack([m + k, m + after, 0 * k + m + n + 1], 1)]
    vertices = np.concatenate([rings.reshape(-1, 3), [[0, 0, -40], [0, 0, 42.0]]])
    return Mesh.single(vertices, np.concatenate([*sides, *ends]))


def posed(direction: tuple[float, float, float], *, away: float = 400.0) -> Rigid:
    """Return camera_from_part that looks at the part's origin from a direction, mm away."""
    d = np.asarray(direction) / np.linalg.norm(direction)
    return Rigid.look_at(away * d, np.zeros(3))


def pictured(body: Mesh, pose: Rigid, rng: np.random.Generator, *, noise: float) -> Picture:
    """Return the body as bright as the ground around it, on average, with noise."""
    view = open_renderer(Part.of(body).scene).render(CAMERA, pose, look=_LOOK, channels=Channel.IMAGE)
    gray = (1 - view.coverage) * _ground(rng) + 0.72 * view.gray
    gray = gaussian_filter(gray, 0.6) + noise * rng.normal(size=gray.shape)
    return np.asarray(np.round(np.clip(gray, 0, 1) * 255) / 255, np.float32)


def disc(pose: Rigid, rng: np.random.Generator, *, radius: float = 50.0) -> Picture:
    """Return a ball about the part's origin as an evenly bright disc, exactly, on even ground."""
    middle = pose @ np.zeros(3)
    x, y = (np.arange(n * 4) / 4 - 0.375 for n in CAMERA.size)
    rays = np.linalg.inv(CAMERA.K) @ np.stack([*(a.ravel() for a in np.meshgrid(x, y)), np.ones(len(x) * len(y))])
    along = middle @ rays / np.linalg.norm(rays, axis=0)
    inside = (middle @ middle - along**2 < radius**2).reshape(len(y) // 4, 4, len(x) // 4, 4).mean(axis=(1, 3))
    gray = gaussian_filter(0.3 + 0.4 * inside, 0.6) + 0.01 * rng.normal(size=inside.shape)
    return np.asarray(np.round(np.clip(gray, 0, 1) * 255) / 255, np.float32)


def _ground(rng: np.random.Generator) -> Array:
    width, height = CAMERA.size
    y, x = np.mgrid[:height, :width]
    gray = np.full((height, width), 0.45)
    for _ in range(14):
        at, turn, half = rng.uniform(0, 1, 2) * CAMERA.size, rng.uniform(0, np.pi), rng.uniform([10, 4], [90, 60])
        u, v = (
            (x - at[0]) * np.cos(turn) + (y - at[1]) * np.sin(turn),
            (y - at[1]) * np.cos(turn) - (x - at[0]) * np.sin(turn),
        )
        gray = np.where((np.abs(u) < half[0]) & (np.abs(v) < half[1]), gray + rng.uniform(-0.22, 0.22), gray)
    for _ in range(4):
        at, radius = rng.uniform(0, 1, 2) * CAMERA.size, rng.uniform(8, 45)
        gray = np.where(np.hypot(x - at[0], y - at[1]) < radius, gray + rng.uniform(-0.2, 0.2), gray)
    return gray
