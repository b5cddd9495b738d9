"""The scenes of benchmarks/locate_scene.py: a part on a bench among clutter, path-traced by Mitsuba 3.

The picture is exact for any lens: rays leave through the camera's own inverse, one for each sample, not through a
pinhole whose picture is warped afterwards. A sample lies anywhere in its pixel (a sensor without gaps), shifted by a
normally distributed blur of the optics, so that edges look like those of a real camera.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import ndtri

from cadcam.arrays import Array
from cadcam.cad.mesh import Mesh
from cadcam.cad.parts.shape import tube
from cadcam.camera.camera import Camera
from cadcam.geometry.rigid import Rigid
from cadcam.geometry.rotation import exp
from render_peers import module

BLUR_PX = 0.45  # standard deviation of the optics' blur, before the pixel's own width
DEPTH = 4  # segments of a path
ELSEWHERE, AROUND_PX = 3, 40  # of the rounds, so many fewer farther than that from the part
LAMPS = (((-4, -3, 7), 1.3, 9.0), ((5, -2, 5), 0.8, 8.0), ((1, 6, 6), 1.0, 5.0), ((0, 0, 12), 9.0, 0.25))
_GOLDEN = np.array([0.7548776662466927, 0.5698402909980532])  # the R2 sequence of M. Roberts (2018)


@dataclass(frozen=True)
class Bench:
    """What stands around the part: the part's size scales it all. reach: mm, half the diagonal of the part.

    dressing: what lies on the part or under it, and how much light it throws back. lamps: place and half width in
    reaches, radiance. albedo: of part and bench top; roughness: of the part.
    """

    part: Mesh
    cables: tuple[Array, ...]
    reach: float
    seed: int
    dressing: tuple[tuple[Mesh, float], ...] = ()
    lamps: tuple[tuple[tuple[float, float, float], float, float], ...] = LAMPS
    albedo: tuple[float, float] = (0.52, 0.33)
    roughness: float = 0.25


def pictures(bench: Bench, camera: Camera, poses: Mapping[int, Rigid], rounds: int) -> Iterator[tuple[int, Array]]:
    """Yield number and radiance (H, W) of each view camera_from_part, a path for each lamp in `rounds` places a pixel.

    Farther than `AROUND_PX` from the part there are fewer. What a view looks like depends on its number and pose only.
    Light adds up: with one lamp burning at a time, none is drawn by chance, and pictures are several times less grainy.
    """
    mi = module("mitsuba")
    mi.set_variant("llvm_ad_mono")
    things = _things(mi, bench)
    scenes = [mi.load_dict({"type": "scene", "lamp": _lamp(mi, *lamp, bench.reach), **things}) for lamp in bench.lamps]
    integrator = mi.load_dict({"type": "path", "max_depth": DEPTH})
    grid = camera.pixel_grid()
    shift = np.random.default_rng(bench.seed).random(grid.shape)
    for i, pose in poses.items():
        total, places = np.zeros((2, camera.height, camera.width))
        for k in range(rounds):
            window = _around(bench.part, camera, pose) if k * ELSEWHERE >= rounds else np.s_[:, :]
            rays = camera.unproject(grid[window] + _spread((shift[window] + k * _GOLDEN) % 1.0)).reshape(-1, 3)
            places[window] += 1
            for j, scene in enumerate(scenes):
                seed = (i * rounds + k) * len(bench.lamps) + j
                total[window] += _radiance(mi, scene, integrator, rays, pose, seed=seed).reshape(places[window].shape)
        yield i, total / places


def _around(part: Mesh, camera: Camera, pose: Rigid) -> tuple[slice, slice]:
    """Return the rows and columns that show a part and what is near it."""
    q = camera.project(pose @ part.vertices)
    low = np.maximum(np.floor(q.min(axis=0)) - AROUND_PX, 0).astype(int)
    high = np.ceil(q.max(axis=0)).astype(int) + AROUND_PX
    return slice(low[1], high[1]), slice(low[0], high[0])


def _spread(u: Array) -> Array:
    """Return offsets (..., 2) px of uniform numbers: those of a box of one pixel plus the blur, by inversion.

    The distribution of their sum is tabulated, for each axis by itself.
    """
    x = np.linspace(-0.5 - 5 * BLUR_PX, 0.5 + 5 * BLUR_PX, 4001)
    nodes = ndtri((np.arange(2000) + 0.5) / 2000) * BLUR_PX
    cumulative = np.clip(x[:, None] - nodes + 0.5, 0, 1).mean(axis=1)
    return np.asarray(np.interp(u, cumulative, x))


def _radiance(mi: Any, scene: Any, integrator: Any, rays: Array, pose: Rigid, *, seed: int) -> Array:
    """Return the radiance (n,) of one path along each ray (n, 3) of the camera frame."""
    world = (rays @ pose.rotation).astype(np.float32)
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, len(world))
    origin = mi.Point3f(*(module("drjit").opaque(mi.Float, x) for x in pose.origin.tolist()))
    ray = mi.RayDifferential3f(mi.Ray3f(origin, mi.Vector3f(np.ascontiguousarray(world.T))))
    light = integrator.sample(scene, sampler, ray)[0]
    return np.array(light.x, dtype=np.float64)


def _things(mi: Any, bench: Bench) -> dict[str, Any]:
    """Return Mitsuba's description of bench top, part, clutter and cables."""
    rng = np.random.default_rng(bench.seed)
    s = bench.reach
    things: dict[str, Any] = {
        "part": _shape(mi, bench.part, _paint(mi, rng, bench.albedo[0], 0.10, bench.roughness), s),
        "top": {
            "type": "rectangle",
            "to_world": mi.ScalarTransform4f().scale([14 * s, 14 * s, 1]),
            "bsdf": _paint(mi, rng, bench.albedo[1], 0.16, 0.5, scratches=60),
        },
    }
    for k, cable in enumerate(bench.cables):
        mesh = tube(cable, _across(cable), (0.045 * s, 0.02 * s), 24, name="cable", color=(0, 0, 0))
        things[f"cable {k}"] = _shape(mi, mesh, _plain(mi, 0.07 + 0.5 * (k % 2)), s)
    for k, (mesh, albedo) in enumerate(bench.dressing):
        things[f"dressing {k}"] = _shape(mi, mesh, _plain(mi, albedo), s)
    for k, (matrix, kind) in enumerate(_clutter(rng, s)):
        things[f"clutter {k}"] = {
            "type": kind,
            "to_world": mi.ScalarTransform4f(matrix),
            "bsdf": _paint(mi, rng, rng.uniform(0.15, 0.7), 0.08, 0.4),
        }
    return things


def _lamp(mi: Any, place: tuple[float, float, float], size: float, radiance: float, s: float) -> dict[str, Any]:
    """Return a square lamp that shines at the part; places and half widths in reaches."""
    origin, up = [s * x for x in place], [0, 0, 1] if any(place[:2]) else [0, 1, 0]
    look = mi.ScalarTransform4f().look_at(origin=origin, target=[0, 0, 0], up=up)
    emitter = {"type": "area", "radiance": radiance}
    return {"type": "rectangle", "to_world": look @ mi.ScalarTransform4f().scale(size * s), "emitter": emitter}


def _clutter(rng: np.random.Generator, s: float) -> Iterator[tuple[Array, str]]:
    """Yield placements (4, 4) of boxes, cylinders and of bars that lie parallel to one another, off the part."""
    for k in range(16):
        angle, far = rng.uniform(0, 2 * np.pi), rng.uniform(2.0, 4.2) * s
        size = s * rng.uniform(0.12, 0.45, 3)
        turn = exp(np.array([0, 0, rng.uniform(0, np.pi)]))
        centre = (far * np.cos(angle), far * np.sin(angle), size[2] if k % 4 else 0.0)
        if k % 4:
            yield _placed(turn, size, centre), "cube"
        else:
            yield _placed(np.eye(3), (size[0], size[0], 2 * size[2]), centre), "cylinder"
    turn = exp(np.array([0, 0, 0.4]))
    for k in range(5):
        centre = turn @ np.array([-1.9 * s, (-1.1 + 0.13 * k) * s, 0.03 * s])
        yield _placed(turn, (0.9 * s, 0.03 * s, 0.03 * s), centre), "cube"


def _placed(turn: Array, size: Sequence[float] | Array, centre: Sequence[float] | Array) -> Array:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = turn * np.asarray(size), centre
    return matrix


def _shape(mi: Any, mesh: Mesh, bsdf: dict[str, Any], s: float) -> Any:
    """Return the mesh for Mitsuba, every face with corners of its own, its paint laid on along the nearest axis."""
    corners = mesh.vertices[mesh.faces]
    n = np.abs(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))
    plane = np.array([(1, 2), (0, 2), (0, 1)])[n.argmax(axis=1)]
    uv = np.take_along_axis(corners, plane[:, None, :], axis=2) / (4 * s) + 0.31 * n.argmax(axis=1)[:, None, None]
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(bsdf)
    shape = mi.Mesh("mesh", 3 * len(corners), len(corners), has_vertex_texcoords=True, props=properties)
    parameters = mi.traverse(shape)
    parameters["vertex_positions"] = corners.astype(np.float32).ravel()
    parameters["vertex_texcoords"] = uv.astype(np.float32).ravel()
    parameters["faces"] = np.arange(3 * len(corners), dtype=np.uint32)
    parameters.update()
    return shape


def _plain(mi: Any, albedo: float) -> dict[str, Any]:
    return {"type": "twosided", "inner": {"type": "diffuse", "reflectance": {"type": "rgb", "value": albedo}}}


def _paint(
    mi: Any, rng: np.random.Generator, albedo: float, mottle: float, roughness: float, *, scratches: int = 12
) -> dict[str, Any]:
    """Return a slightly glossy surface, mottled at all scales and scratched."""
    n = 1024
    f = np.hypot(*np.meshgrid(np.fft.fftfreq(n), np.fft.rfftfreq(n), indexing="ij"))
    noise = np.fft.irfft2(np.fft.rfft2(rng.standard_normal((n, n))) / np.maximum(f, 4 / n) ** 1.1, s=(n, n))
    texture = 1 + mottle * noise / noise.std()
    for _ in range(scratches):
        start, angle, length = rng.random(2) * n, rng.uniform(0, np.pi), rng.uniform(20, 200)
        along = start + np.arange(length)[:, None] * (np.cos(angle), np.sin(angle))
        x, y = along.astype(int).T % n
        texture[y, x] *= rng.uniform(0.7, 1.5)
    values = np.clip(albedo * texture, 0.02, 0.9).astype(np.float32)[..., None]
    bitmap = {"type": "bitmap", "bitmap": mi.Bitmap(values), "raw": True, "wrap_mode": "repeat"}
    inner = {"type": "roughplastic", "diffuse_reflectance": bitmap, "alpha": roughness}
    return {"type": "twosided", "inner": inner}


def _across(line: Array) -> Array:
    """Return the unit normal (3,) of the plane that a line (M, 3) lies in."""
    return np.asarray(np.linalg.svd(line - line.mean(axis=0))[2][2])
