"""Scenes and views that the renderers' tests share."""

from __future__ import annotations

from cadcam.cad.edges import NO_EDGES
from cadcam.cad.mesh import Mesh
from cadcam.geometry.rigid import Rigid
from cadcam.render.view import Scene


def scene_of(mesh: Mesh) -> Scene:
    """Return the scene of a mesh without feature edges: nobody draws lines here, and finding them takes time."""
    return Scene.of(mesh, edges=NO_EDGES)


def views_of(mesh: Mesh) -> list[Rigid]:
    """Return camera_from_part from outside, and from inside, where faces pass the camera's plane."""
    low, high = mesh.bounds
    middle, size = (low + high) / 2, high - low
    return [
        Rigid.look_at(middle + size * [1.1, 0.9, 1.3], middle),
        Rigid.look_at(middle + size * [0.2, 0.1, 0.05], middle - size * [0.3, 0.4, 0.1]),
    ]
