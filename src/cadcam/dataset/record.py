"""A labelled view as files: pictures and labels as bytes, and a record of everything else about the view.

Where formats differ, each is followed as in its own tools: BOP's boxes are (x, y, last - first), COCO's (x, y, number
of pixels); both count pixels from (0, 0), the top-left one; as a point this is the pixel's centre, as ours.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Array, Mask
from cadcam.camera.camera import Camera
from cadcam.dataset.layout import OBJECT, DatasetFiles
from cadcam.dataset.npz import arrays_file
from cadcam.dataset.shot import PlacedOccluder, Shot
from cadcam.dataset.view_renderer import LabelledView, ViewInputs
from cadcam.files.camera import bare_camera_as_json
from cadcam.files.matrix import pose_as_json
from cadcam.image.png import packed, packed_depth, packed_normals
from cadcam.native.layers import Box, mask_changes
from cadcam.render.lines.wireframe import Polylines

_PX = 4  # decimals of pixels in records: far below what any measurement resolves


def files_of(view: LabelledView, inputs: ViewInputs, layout: DatasetFiles) -> dict[str, bytes]:
    """Return the content of a view's files by their paths, the record last."""
    mask = packed(_white(view.mask))
    content = {
        layout.picture: packed(view.picture),
        "depth": packed_depth(view.depth, inputs.depth_step),
        "normal": packed_normals(view.depth, view.normal),
        "mask": mask,
        "mask_visib": packed(_white(view.visible)) if view.shot.occluders else mask,
        "edges": edges_file(view.edges, inputs),
        "view": json.dumps(record_of(view, inputs, layout), separators=(",", ":")).encode() + b"\n",
    }
    return {layout.path(kind, view.shot.index): content[kind] for kind in layout.kinds()}


def record_of(view: LabelledView, inputs: ViewInputs, layout: DatasetFiles) -> dict[str, Any]:
    """Return the record of a view: its BOP and COCO entries as in those files, and how it was made."""
    shot = view.shot
    return {
        "view": shot.index,
        "bop": {"camera": _bop_camera(shot.camera, inputs), "gt": _bop_pose(shot), "info": _bop_info(view)},
        "coco": _coco(view),
        "key_points": {"q": [_pixel(q) for q in view.q], "seen": view.seen.tolist()},
        "camera": bare_camera_as_json(shot.camera, None),
        "camera_from_part": pose_as_json(shot.camera_from_part),
        "made": _made(shot, inputs),
    }


def _bop_camera(camera: Camera, inputs: ViewInputs) -> dict[str, Any]:
    return {"cam_K": camera.K.ravel().tolist(), "depth_scale": inputs.depth_step}


def _bop_pose(shot: Shot) -> dict[str, Any]:
    pose = shot.camera_from_part
    return {
        "cam_R_m2c": pose.rotation.ravel().tolist(),
        "cam_t_m2c": pose.translation.tolist(),
        "obj_id": OBJECT,
    }


def _bop_info(view: LabelledView) -> dict[str, Any]:
    """Return BOP's counts and boxes; an invisible part has no boxes, as in BOP's own tool."""
    nothing, seen = [-1, -1, -1, -1], view.visible_count
    return {
        "bbox_obj": _spanned(view.whole_box) if seen else nothing,
        "bbox_visib": _spanned(view.visible_box) if seen else nothing,
        "px_count_all": view.whole_count,
        "px_count_valid": view.count,
        "px_count_visib": seen,
        "visib_fract": seen / view.whole_count if view.whole_count else 0.0,
    }


def _spanned(box: Box) -> list[int]:
    x0, y0, x1, y1 = box
    return [x0, y0, x1 - x0, y1 - y0]


def _coco(view: LabelledView) -> dict[str, Any] | None:
    """Return the annotation without its ids; None where nothing of the part is visible."""
    if not view.visible_count:
        return None
    x0, y0, x1, y1 = view.visible_box
    flat: list[float] = []
    for (x, y), seen in zip(np.nan_to_num(view.q).tolist(), view.seen.tolist(), strict=True):
        flat += [round(x, _PX), round(y, _PX), seen] if seen else [0, 0, 0]
    return {
        "area": view.visible_count,
        "bbox": [x0, y0, x1 - x0 + 1, y1 - y0 + 1],
        "iscrowd": 0,
        "keypoints": flat,
        "num_keypoints": int((view.seen > 0).sum()),
        "segmentation": {"counts": run_lengths(view.visible), "size": list(view.visible.shape)},
    }


def run_lengths(mask: Mask) -> list[int]:
    """Return COCO's run lengths of a mask (H, W): column by column, beginning with those not set."""
    runs: list[int] = np.diff(mask_changes(mask), prepend=0, append=mask.size).tolist()
    return runs


def edges_file(lines: Polylines, inputs: ViewInputs) -> bytes:
    """Return visible edges: q (N, 2) px, start (M + 1,), and for each polyline its edge (-1: a contour), kind, part."""
    last = int(inputs.scene.edges.chain.max(initial=-1))
    edge = np.where(lines.chain > last, -1, lines.chain).astype(np.int32)
    return arrays_file(q=lines.q.astype(np.float32), start=lines.start, edge=edge, kind=lines.kind, part=lines.part)


def _white(mask: Mask) -> npt.NDArray[np.uint8]:
    return mask.view(np.uint8) * np.uint8(255)


def _pixel(q: Array) -> list[float] | None:
    """Return a key point's pixel, None where it is behind the camera or beyond its lens."""
    return [round(x, _PX) for x in q.tolist()] if np.isfinite(q).all() else None


def _made(shot: Shot, inputs: ViewInputs) -> dict[str, Any]:
    """Return how the view was made: light, background, occluders."""
    names = ("head", "fill", "back", "ambient", "fill_from", "back_from")
    behind = shot.backdrop
    return {
        "light": {name: getattr(shot.look, name) for name in names},
        "background": {"kind": Path(behind.kind).name, "level": behind.level, "place": list(behind.place)},
        "occluders": [_occluder(inputs.props[at.prop].name, at) for at in shot.occluders],
        "sensor": None if inputs.sensor is None else inputs.sensor.name,
    }


def _occluder(name: str, at: PlacedOccluder) -> dict[str, Any]:
    return {"name": name, "prop": at.prop, "camera_from_occluder": pose_as_json(at.camera_from_occluder)}
