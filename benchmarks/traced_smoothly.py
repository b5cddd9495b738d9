"""The pictures of verify_traced.py: path-traced by few paths, whose light is shared by neighbours on a flat face.

A picture of a few paths a pixel is grainy. But what a face reflects, beside its texture, changes slowly along it: it is
gathered from all paths that begin within some millimetres on the same face, and seen again by many exact rays a pixel,
each with the texture where it ends. Edges stay as sharp as rays are, soft shadows too; what is left of the paths'
scatter are blotches some pixels wide, as denoised pictures have them.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from cadcam.arrays import Array, Longs
from cadcam.camera.camera import Camera
from cadcam.geometry.rigid import Rigid
from locate_traced import _GOLDEN, DEPTH, Bench, _lamp, _radiance, _spread, _things
from render_peers import module

PATHS, RAYS = 5, 13  # of each light, and in all, a pixel
CELL_MM = 4.0
BRIGHTEST = 0.9995  # quantile beyond which a path is a firefly
_OTHER = 100_003  # more than the faces of any shape
Lamp = tuple[tuple[float, float, float], float, float]


def picture(bench: Bench, camera: Camera, camera_from_bench: Rigid, lamp: Lamp, sky: float, *, seed: int) -> Array:
    """Return the radiance (H, W) of a scene under a lamp (as of `locate_traced`) and an even sky."""
    mi, dr = module("mitsuba"), module("drjit")
    mi.set_variant("llvm_ad_mono")
    things = _things(mi, bench)
    lights = [_lamp(mi, *lamp, bench.reach), {"type": "constant", "radiance": sky}]
    scenes = [mi.load_dict({"type": "scene", "light": light, **things}) for light in lights]
    integrator = mi.load_dict({"type": "path", "max_depth": DEPTH})
    grid = camera.pixel_grid()
    shift = np.random.default_rng(seed).random(grid.shape)
    hits, light = [], []
    for k in range(RAYS):
        rays = camera.unproject(grid + _spread((shift + k * _GOLDEN) % 1.0)).reshape(-1, 3)
        hits.append(_hits(mi, dr, scenes[0], rays, camera_from_bench))
        if k < PATHS:
            each = [
                _radiance(mi, scene, integrator, rays, camera_from_bench, seed=(seed * RAYS + k) * len(scenes) + j)
                for j, scene in enumerate(scenes)
            ]
            light.append(np.sum(each, axis=0))
    return _shaded([np.concatenate(of) for of in zip(*hits, strict=True)], np.concatenate(light)).reshape(
        grid.shape[:2]
    )


def _hits(mi: Any, dr: Any, scene: Any, rays: Array, camera_from_bench: Rigid) -> tuple[Array, Longs, Array, Array]:
    """Return where rays (n, 3) of the camera end: how much is reflected, number of the face, place, normal."""
    world = (rays @ camera_from_bench.rotation).astype(np.float32)
    origin = mi.Point3f(*(dr.opaque(mi.Float, x) for x in camera_from_bench.origin.tolist()))
    end = scene.ray_intersect(mi.Ray3f(origin, mi.Vector3f(np.ascontiguousarray(world.T))))
    reflected = end.bsdf().eval_diffuse_reflectance(end, end.is_valid())
    shape, face, valid = dr.reinterpret_array(mi.UInt32, end.shape), end.prim_index, end.is_valid()
    dr.eval(reflected, shape, face, valid, end.p, end.n)
    number = np.where(np.array(valid), np.array(shape).astype(np.int64) * _OTHER + np.array(face), -1)
    return np.maximum(np.array(reflected).reshape(-1), 1e-3), number, np.array(end.p).T, np.array(end.n).T


def _shaded(hits: list[Any], light: Array) -> Array:
    """Return the mean radiance (pixels,) of all hits, given that of the first of them, `light`."""
    reflected, face, p, n = hits
    at, weight = _cells(face, p, n)
    count = int(at.max()) + 1
    own = light / reflected[: len(light)]
    own = np.minimum(own, np.quantile(own, BRIGHTEST))
    gathered, known = np.zeros((2, count))
    for i, w in zip(at, weight, strict=True):
        gathered += np.bincount(i[: len(own)], w[: len(own)] * own, minlength=count)
        known += np.bincount(i[: len(own)], w[: len(own)], minlength=count)
    there, told = known > 0, np.where(known > 0, gathered / np.where(known > 0, known, 1.0), 0.0)
    total = sum(w * there[i] for i, w in zip(at, weight, strict=True))
    seen = sum(w * there[i] * told[i] for i, w in zip(at, weight, strict=True)) / np.maximum(total, 1e-12)
    return np.asarray((reflected * seen).reshape(RAYS, -1).mean(axis=0))


def _cells(face: Longs, p: Array, n: Array) -> tuple[Longs, Array]:
    """Return the four cells (4, hits) of its plane that a hit lies between, and their weights."""
    _, first, which = np.unique(face, return_index=True, return_inverse=True)
    normal, place = n[first].astype(np.float64), p[first].astype(np.float64)
    apart = np.floor((normal * place).sum(axis=1) + 0.377)  # mm; the odd number: planes rarely lie on a border
    plane = np.column_stack([face[first] // _OTHER, np.round(40 * normal), apart])
    _, number = np.unique(plane, axis=0, return_inverse=True)
    plane_of = number.reshape(-1)[which]
    axes = np.array([(1, 2), (0, 2), (0, 1)])[np.abs(normal).argmax(axis=1)][which]
    cell = np.where((face < 0)[:, None], 0.0, np.take_along_axis(p, axes, axis=1) / CELL_MM)
    low, high = np.full((2, int(plane_of.max()) + 1, 2), np.inf)
    high = -high
    for i in range(2):
        np.minimum.at(low[:, i], plane_of, cell[:, i])
        np.maximum.at(high[:, i], plane_of, cell[:, i])
    low = np.floor(low)
    size = (np.floor(high) - low + 2).astype(np.int64)
    begin = np.concatenate([[0], np.cumsum(size.prod(axis=1))])
    part = cell - low[plane_of]
    whole = np.floor(part).astype(np.int64)
    part -= whole
    at, weight = [], []
    for dx, dy in ((0, 0), (0, 1), (1, 0), (1, 1)):
        at.append(begin[plane_of] + (whole[:, 0] + dx) * size[plane_of, 1] + whole[:, 1] + dy)
        weight.append(np.abs(1 - dx - part[:, 0]) * np.abs(1 - dy - part[:, 1]) + 1e-6)
    return np.array(at), np.array(weight)
