"""Meshes of other packages (trimesh, pyvista, Open3D) as ours, recognised by their attributes, without imports."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import numpy.typing as npt

from cadcam.cad.mend import mend
from cadcam.cad.mesh import Mesh, merge
from cadcam.cad.units import MM, unit_name
from cadcam.errors import BadValue

_KNOWN = "a mesh of trimesh (Trimesh, Scene), pyvista (PolyData or what has extract_surface) or Open3D (TriangleMesh)"


def mesh_of(thing: Any, *, unit: str | None = None, name: str = "part") -> Mesh:
    """Return the mesh in mm, mended as a loaded one is; each object of a trimesh Scene becomes a part.

    unit: that of the object's numbers (mm, m, in ...); required unless the object states its own (trimesh' `units`).
    Raises `BadValue` where the unit is missing or contradictory, or the object is not a known kind of mesh.
    """
    found = _parts(thing, name)
    factor = MM[_unit(thing, unit)]
    meshes = [Mesh.single(np.asarray(v, np.float64) * factor, f, name=part, color=c) for part, v, f, c in found]
    if not any(mesh.n_faces for mesh in meshes):
        raise BadValue("mesh", f"a {_type(thing)} without triangles", "a surface, not points or lines")
    return mend(merge([mesh for mesh in meshes if mesh.n_faces]))[0]


_Part = tuple[str, npt.ArrayLike, npt.NDArray[np.integer], npt.ArrayLike | None]  # name, vertices, faces, colour


def _unit(thing: Any, said: str | None) -> str:
    stated = getattr(thing, "units", None)
    units = {unit_name(unit) for unit in (said, stated) if isinstance(unit, str)}
    if not units:
        raise BadValue(f"unit of a {_type(thing)}", "not said", 'unit="mm" (or m, in ...): the object has none')
    if len(units) > 1:
        raise BadValue("unit", said, f"{unit_name(str(stated))}, which the object states itself; leave it out")
    return units.pop()


def _parts(thing: Any, name: str) -> list[_Part]:
    if hasattr(thing, "geometry") and hasattr(thing, "graph"):
        return _scene(thing)
    if hasattr(thing, "vertices") and hasattr(thing, "faces"):
        return [(name, thing.vertices, _whole(thing.faces), _main_color(thing))]
    if hasattr(thing, "vertices") and hasattr(thing, "triangles"):
        return [(name, np.asarray(thing.vertices), _whole(thing.triangles), None)]
    if hasattr(thing, "vertex") and hasattr(thing, "triangle"):  # Open3D's tensor mesh
        return [(name, thing.vertex["positions"].numpy(), _whole(thing.triangle["indices"].numpy()), None)]
    if hasattr(thing, "extract_surface") and hasattr(thing, "points"):
        return [(name, *_polydata(thing), None)]
    raise BadValue("mesh", f"a {_type(thing)}", _KNOWN)


def _scene(scene: Any) -> list[_Part]:
    """Return the objects of a trimesh Scene where its graph places them; paths and points have no faces."""
    out: list[_Part] = []
    for node in scene.graph.nodes_geometry:
        matrix, key = scene.graph[node]
        mesh = scene.geometry[key]
        if hasattr(mesh, "faces"):
            turn, shift = np.asarray(matrix)[:3, :3], np.asarray(matrix)[:3, 3]
            faces = _whole(mesh.faces)
            # a mirrored open sheet would show its back: nothing but its winding says which side is its front
            faces = faces[:, ::-1] if np.linalg.det(turn) < 0 else faces
            out.append((str(node), np.asarray(mesh.vertices) @ turn.T + shift, faces, _main_color(mesh)))
    if not out:
        raise BadValue("scene", "without a mesh", _KNOWN)
    return out


def _polydata(thing: Any) -> tuple[npt.ArrayLike, npt.NDArray[np.integer]]:
    """Return points and triangles of a pyvista data set: its faces are a flat list (n, i, j, k, n, ...)."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # pyvista announces a changed default: any surface will do
        surface = thing if hasattr(thing, "faces") else thing.extract_surface()
    surface = surface.triangulate() if not getattr(surface, "is_all_triangles", False) else surface
    flat = np.asarray(surface.faces)
    if flat.size % 4 or (flat.size and not (flat.reshape(-1, 4)[:, 0] == 3).all()):
        raise BadValue("faces", "not all triangles", "a surface that triangulate() can handle")
    return np.asarray(surface.points), flat.reshape(-1, 4)[:, 1:]


def _main_color(mesh: Any) -> npt.ArrayLike | None:
    """Return a trimesh's main colour, RGB in [0, 1], if it has one."""
    visual = getattr(mesh, "visual", None)
    if visual is None or not getattr(visual, "defined", False) or not hasattr(visual, "main_color"):
        return None
    return np.asarray(visual.main_color, np.float64)[:3] / 255


def _whole(values: Any) -> npt.NDArray[np.integer]:
    array = np.asarray(values)
    if array.ndim != 2 or array.shape[1] != 3:
        raise BadValue("faces", f"of shape {array.shape}", "triangles, shape (N, 3)")
    return array


def _type(thing: Any) -> str:
    return f"{type(thing).__module__.split('.')[0]} {type(thing).__name__}"
