"""The pictures of benchmarks/locate_battery.py: a part on a table in light, among things, as a lens sees it.

Every pixel is the mean of renderings from single points of its area and of the lamps, as in `cadcam.render.photograph`;
but surfaces here are grained, painted in patches, glossy or of metal, and light from all around is shut off where
things stand close. What is seen, and how bright, is decided at each point in space, so borders are where they are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from cadcam.arrays import Array, Mask, Picture
from cadcam.cad.edges import NO_EDGES
from cadcam.cad.mesh import Mesh, merge
from cadcam.camera.camera import Camera
from cadcam.geometry.rigid import Rigid
from cadcam.render import open_renderer
from cadcam.render.caster import Caster
from cadcam.render.light import Lamp
from cadcam.render.samples import sample_points
from cadcam.render.view import Channel, Renderer, Scene
from render_peers import module

BLUR_PX = 0.45  # of the lens, beside the pixel's own area
_CLEAR = 1e-4  # of the scene's size: how far above its face a ray starts
_GRID = 48  # cells of the noise that surfaces are painted with
_NEAR = 0.25  # of the part's size: what stands nearer shuts off light from around
_AROUND_PX = 30  # farther from the part fewer samples are taken
_SEEN = Channel.DEPTH | Channel.NORMAL | Channel.FACE
_MANY = 4  # times the picture that another renderer draws, to be averaged


@dataclass(frozen=True)
class Surface:
    """How a thing looks: its reflectance, how much that varies (relative sd), and over how many mm.

    patches: reflectance of painted patches, relative; gloss: strength of highlights; metal: share of the light that it
    mirrors.
    """

    albedo: tuple[float, float, float]
    mottle: float = 0.05
    grain_mm: float = 10.0
    patches: float = 1.0
    gloss: float = 0.0
    metal: float = 0.0


@dataclass(frozen=True)
class Stage:
    """Things with their surfaces, in the world (mm), and light.

    size: of the part, mm; sky: brightness behind it all; around (N, 3): what is looked at.
    """

    things: Sequence[tuple[Mesh, Surface]]
    lamps: tuple[Lamp, ...]
    ambient: float
    size: float
    sky: float
    seed: int
    around: Array

    @cached_property
    def mesh(self) -> Mesh:
        """All things as one."""
        return merge([mesh for mesh, _ in self.things])

    @cached_property
    def thing_of_face(self) -> Array:
        """Return the number (F,) of the thing that each face is of."""
        return np.repeat(np.arange(len(self.things)), [mesh.n_faces for mesh, _ in self.things])

    @cached_property
    def renderer(self) -> Renderer:
        """What tells where each thing is seen."""
        return open_renderer(Scene.of(self.mesh, edges=NO_EDGES))

    @cached_property
    def caster(self) -> Caster:
        """What tells which light is shut off."""
        return Caster(self.mesh)

    @cached_property
    def noise(self) -> Array:
        """Even noise on a grid of cells, for all surfaces."""
        return np.random.default_rng(self.seed).uniform(-1, 1, (_GRID, _GRID, _GRID)).astype(np.float32)


def radiance(stage: Stage, camera: Camera, camera_from_world: Rigid, *, samples: int = 16) -> Picture:
    """Return the linear radiance (H, W, 3) on the pixels; of a quarter of the samples away from the part."""
    total = _averaged(stage, camera, camera_from_world, samples // 4)
    p = camera_from_world @ stage.around
    q = camera.project(p[p[:, 2] > 0])
    low = np.clip(np.floor(np.nanmin(q, axis=0)) - _AROUND_PX, 0, camera.size).astype(int)
    high = np.clip(np.ceil(np.nanmax(q, axis=0)) + _AROUND_PX, 0, camera.size).astype(int)
    if (high - low).min() > 0:
        near = camera.crop(int(low[0]), int(low[1]), (int(high[0] - low[0]), int(high[1] - low[1])))
        total[low[1] : high[1], low[0] : high[0]] = _averaged(stage, near, camera_from_world, samples)
    return total


def _averaged(stage: Stage, camera: Camera, camera_from_world: Rigid, samples: int) -> Picture:
    points = sample_points(samples, BLUR_PX)
    total = np.zeros((camera.height, camera.width, 3), np.float32)
    rng = np.random.default_rng(stage.seed)
    R = camera_from_world.rotation.astype(np.float32)
    for pixel, lamp in zip(points.pixel, points.lamp, strict=True):
        K = camera.K.copy()
        K[:2, 2] -= pixel
        shifted = Camera(camera.size, K, camera.lens)
        view = stage.renderer.render(shifted, camera_from_world, channels=_SEEN)
        at = np.nonzero(view.mask)
        rays = shifted.unproject(np.stack([at[1], at[0]], axis=1).astype(float)).astype(np.float32)
        p = (rays * (view.depth[at] / rays[:, 2])[:, None]) @ R + camera_from_world.origin.astype(np.float32)
        seen = np.full(total.shape, stage.sky, np.float32)
        seen[at] = _lit(stage, p, view.normal[at] @ R, -rays @ R, stage.thing_of_face[view.face[at]], lamp, rng)
        total += seen
    return total / np.float32(len(points))


def _lit(
    stage: Stage, p: Picture, n: Picture, to_eye: Picture, thing: Array, lamp: Array, rng: np.random.Generator
) -> Picture:
    """Return the light (N, 3) that points p (N, 3) of normals n (N, 3) send along to_eye (N, 3)."""
    surfaces = [surface for _, surface in stage.things]
    reflectance = np.zeros((len(p), 3), np.float32)
    for k in np.unique(thing):
        own = thing == k
        reflectance[own] = _paint(stage, surfaces[k], p[own])
    gloss, metal = (np.array([getattr(s, name) for s in surfaces], np.float32)[thing] for name in ("gloss", "metal"))
    somewhere = rng.standard_normal(p.shape, np.float32)
    somewhere = n + somewhere / np.linalg.norm(somewhere, axis=1, keepdims=True)  # by the cosine
    somewhere /= np.linalg.norm(somewhere, axis=1, keepdims=True)
    open_to = ~_met(stage, p, n, somewhere, _NEAR * stage.size)
    diffuse, shine = stage.ambient * np.where(open_to, np.float32(1), np.float32(0.35)), np.zeros(len(p), np.float32)
    for each in stage.lamps:
        towards = each.direction(*lamp).astype(np.float32)
        cosine = np.clip(n @ towards, 0, None)
        lit = cosine > 0
        lit[lit] = ~_met(stage, p[lit], n[lit], np.broadcast_to(towards, (int(lit.sum()), 3)), 8 * stage.size)
        half = to_eye + towards
        half /= np.linalg.norm(half, axis=1, keepdims=True)
        diffuse += each.strength * np.where(lit, cosine, 0)
        shine += each.strength * np.where(lit, np.clip(np.einsum("ij,ij->i", n, half), 0, 1) ** 60, 0)
    mirrored = 2 * np.einsum("ij,ij->i", n, to_eye)[:, None] * n - to_eye
    matt = (1 - metal) * diffuse
    return np.asarray(reflectance * (matt + metal * _around(stage, mirrored))[:, None] + (gloss * shine)[:, None])


def _around(stage: Stage, towards: Picture) -> Picture:
    """Return how bright the hall is that a mirror shows (N,): a dark floor, brighter above, with windows and lamps."""
    x, y, z = towards.T
    windows = 1 / (1 + np.exp(-40 * (np.sin(3 * np.arctan2(y, x)) - 0.5))) * np.exp(-(((z - 0.35) / 0.2) ** 2))
    return np.asarray(0.25 + 0.5 * (1 + z) * stage.ambient + 1.2 * windows)


def _paint(stage: Stage, surface: Surface, p: Array | Picture) -> Picture:
    from scipy.ndimage import map_coordinates

    at = p.T / surface.grain_mm

    def noise(scale: float) -> Array:
        where = np.float32(scale) * at
        return np.asarray(map_coordinates(stage.noise, where, np.float32, order=1, mode="grid-wrap", prefilter=False))

    level = 1 + surface.mottle * (noise(1.0) + 0.7 * noise(2.7) + 0.5 * noise(7.1))
    if surface.patches != 1.0:
        level *= np.where(noise(0.31) + 0.4 * noise(0.9) > 0.25, np.float32(surface.patches), np.float32(1))
    return np.asarray(np.clip(np.array(surface.albedo, np.float32) * level[:, None], 0.01, 0.95))


def _met(stage: Stage, p: Picture, n: Picture, towards: Picture, reach: float) -> Mask:
    """Return which points have something before them on the way towards a direction within `reach` mm."""
    start = p + np.float32(_CLEAR * stage.size) * n
    origins, directions = (np.asarray(a, np.float32).view(np.ndarray) for a in (start, towards))
    return np.asarray(stage.caster.first_hit(origins, directions, np.full(len(p), reach)) >= 0)


def by_pyrender(stage: Stage, camera: Camera, camera_from_world: Rigid) -> Picture:
    """Return the radiance (H, W, 3) that pyrender draws, by its own light: pinhole cameras without skew only."""
    import os

    os.environ["PYOPENGL_PLATFORM"] = "egl"
    pyrender, trimesh = module("pyrender"), module("trimesh")
    scene = pyrender.Scene(ambient_light=[0.25 * stage.ambient] * 3, bg_color=[stage.sky] * 3)
    for mesh, surface in stage.things:
        corners = mesh.vertices[mesh.faces].reshape(-1, 3)
        level = np.clip(_paint(stage, surface, corners), 0, 1)
        body = trimesh.Trimesh(corners, np.arange(len(corners)).reshape(-1, 3), vertex_colors=level, process=False)
        matter = pyrender.MetallicRoughnessMaterial(
            baseColorFactor=[1, 1, 1, 1], metallicFactor=surface.metal, roughnessFactor=0.7 - 0.4 * surface.gloss
        )
        scene.add(pyrender.Mesh.from_trimesh(body, material=matter, smooth=False))
    for lamp in stage.lamps:
        to_lamp = np.array(lamp.towards) / np.linalg.norm(lamp.towards)
        pose = Rigid.look_at(4 * stage.size * to_lamp, np.zeros(3)).inv.matrix @ np.diag([1.0, -1, -1, 1])
        scene.add(pyrender.DirectionalLight(intensity=4 * lamp.strength), pose=pose)
    fine = camera.resize((_MANY * camera.width, _MANY * camera.height))
    far = float(np.linalg.norm(camera_from_world.origin))
    cx, cy = fine.principal_point + 0.5
    eye = pyrender.IntrinsicsCamera(fine.fx, fine.fy, cx, cy, znear=far / 20, zfar=20 * far)
    scene.add(eye, pose=camera_from_world.inv.matrix @ np.diag([1.0, -1, -1, 1]))
    window = pyrender.OffscreenRenderer(*fine.size)
    image = np.asarray(window.render(scene, flags=pyrender.RenderFlags.NONE)[0], float) / 255
    window.delete()
    blocks = image.reshape(camera.height, _MANY, camera.width, _MANY, 3).mean(axis=(1, 3))
    return np.asarray(blocks, np.float32)
