"""The channels of a view as files: arrays as they are (.npy), or as pictures."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from cadcam.image.picture import write_picture
from cadcam.render.view import Channel, Look, Renderer, nothing_in_view
from cadcam.whole import write_whole

if TYPE_CHECKING:
    from cadcam.camera.camera import Camera
    from cadcam.geometry.rigid import Rigid
    from cadcam.render.view import View

_DEPTH_STEPS_MM = (0.01, 0.1, 1.0, 10.0, 100.0)
_WHITE = (1.0, 1.0, 1.0)


def write_shaded(path: str, renderer: Renderer, camera: Camera, pose: Rigid) -> dict[str, Any]:
    """Write the shaded picture, anti-aliased."""
    view = renderer.render(camera, pose, channels=Channel.IMAGE, look=Look(supersampling=3))
    _refuse_empty(view, renderer)
    write_picture(path, view.image)
    return {"seen_pixels": int(np.count_nonzero(view.coverage))}


def write_depth(path: str, renderer: Renderer, camera: Camera, pose: Rigid) -> dict[str, Any]:
    """Write the z-depth: float32 mm (.npy), or 16-bit steps of a stated size (.png)."""
    view = renderer.render(camera, pose, channels=Channel.DEPTH)
    _refuse_empty(view, renderer)
    seen = view.depth[view.mask]
    said: dict[str, Any] = {"seen_pixels": int(view.mask.sum()), "depth_mm": [float(seen.min()), float(seen.max())]}
    if path.lower().endswith(".npy"):
        _write_npy(path, view.depth)
        return said
    step = next((s for s in _DEPTH_STEPS_MM if seen.max() / s <= 65535), _DEPTH_STEPS_MM[-1])
    stored = np.where(view.mask, np.clip(view.depth / step, 1, 65535), 0) / 65535
    write_picture(path, stored.astype(np.float32), bits=16)
    return said | {"depth_mm_per_step": step}


def write_normals(path: str, renderer: Renderer, camera: Camera, pose: Rigid) -> dict[str, Any]:
    """Write the unit normals in the camera frame: float32 (.npy), or colours (n + 1)/2 (.png)."""
    view = renderer.render(camera, pose, channels=Channel.NORMAL)
    _refuse_empty(view, renderer)
    if path.lower().endswith(".npy"):
        _write_npy(path, view.normal)
    else:
        write_picture(path, np.where(view.mask[..., None], (view.normal + 1) / 2, np.float32(1)))
    return {"seen_pixels": int(view.mask.sum())}


def write_parts(path: str, renderer: Renderer, camera: Camera, pose: Rigid) -> dict[str, Any]:
    """Write the part numbers: int32, -1 for the background (.npy), or each part in its colour (.png)."""
    view = renderer.render(camera, pose, channels=Channel.PART)
    _refuse_empty(view, renderer)
    names = renderer.scene.mesh.part_names
    if path.lower().endswith(".npy"):
        _write_npy(path, view.part)
    else:
        write_picture(path, np.concatenate([renderer.scene.colors, np.array([_WHITE], np.float32)])[view.part])
    numbers, counts = np.unique(view.part[view.mask], return_counts=True)
    seen = {names[i]: {"number": int(i), "pixels": int(n)} for i, n in zip(numbers, counts, strict=True)}
    return {"seen_pixels": int(view.mask.sum()), "seen_parts": seen}


def write_faces(path: str, renderer: Renderer, camera: Camera, pose: Rigid) -> dict[str, Any]:
    """Write the face numbers: int32, -1 for the background (.npy)."""
    view = renderer.render(camera, pose, channels=Channel.FACE)
    _refuse_empty(view, renderer)
    _write_npy(path, view.face)
    return {"seen_pixels": int(view.mask.sum())}


WRITERS = {
    "shaded": write_shaded,
    "depth": write_depth,
    "normals": write_normals,
    "parts": write_parts,
    "faces": write_faces,
}


def _refuse_empty(view: View, renderer: Renderer) -> None:
    if not view.mask.any():
        raise nothing_in_view(renderer.scene.mesh, view.camera, view.camera_from_world)


def _write_npy(path: str, array: npt.NDArray[Any]) -> None:
    file = io.BytesIO()
    np.save(file, array)
    write_whole(path, file.getvalue())
