"""A plate with ribs and a block on it, photographed: small enough for many pictures, all its bodies apart."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
from scipy.ndimage import gaussian_filter

from cadcam.arrays import Array, Picture
from cadcam.cad.edges import NO_EDGES
from cadcam.cad.mesh import Mesh, merge
from cadcam.cad.parts.shape import box
from cadcam.camera.camera import Camera
from cadcam.geometry.rigid import Rigid
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.render import open_renderer
from cadcam.render.view import Channel, Look, Scene

CAMERA = Camera.from_focal((480, 360), 740.0)
POSE = Rigid.look_at((420.0, -620.0, 640.0), (10.0, 0.0, 10.0))
NOISE = 3.0 / 255


@cache
def plate() -> Mesh:
    """Return a plate of 300 x 200 mm with two ribs, a block and a bracket, in mm."""
    color = (0.55, 0.55, 0.6)
    return merge(
        [
            box((-150, -100, 0), (150, 100, 12), name="plate", color=color),
            box((-120, -60, 12), (40, -48, 52), name="rib 1", color=color),
            box((-120, 30, 12), (40, 42, 52), name="rib 2", color=color),
            box((70, -70, 12), (120, -10, 45), name="block", color=color),
            box((75, 30, 12), (125, 70, 40), name="bracket", color=color),
        ]
    )


@cache
def part() -> Part:
    out = Part.of(plate())
    _ = out.lines
    return out


def displaced(name: str, by: Array | None, mesh: Mesh | None = None) -> Mesh:
    """Return the plate with one of its bodies moved by a vector (3,) mm, or without it."""
    mesh = plate() if mesh is None else mesh
    mine = mesh.part == mesh.part_names.index(name)
    if by is None:
        return mesh.select(~mine)
    vertices = mesh.vertices.copy()
    vertices[np.unique(mesh.faces[mine])] += by
    return replace(mesh, vertices=vertices)


def photographed(mesh: Mesh, rng: np.random.Generator, pose: Rigid = POSE, camera: Camera = CAMERA) -> Picture:
    scene = Scene.of(mesh, edges=NO_EDGES)
    look = Look(supersampling=4, background=(0.9, 0.9, 0.9), back=0.35)
    gray = open_renderer(scene).render(camera, pose, channels=Channel.IMAGE, look=look).gray
    gray = gaussian_filter(gray, 0.5) + rng.normal(0, NOISE, gray.shape)
    return np.asarray(np.clip(np.round(gray * 255) / 255, 0, 1), np.float32)


def photo(mesh: Mesh, rng: np.random.Generator, pose: Rigid = POSE, *, name: str = "photo") -> Photo:
    """Return a photo whose world is the part's frame."""
    return Photo.of(photographed(mesh, rng, pose), CAMERA, pose, name=name)
