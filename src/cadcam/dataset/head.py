"""The head of a data set: everything its bytes depend on, so that a run continues its own data set and no other."""

from __future__ import annotations

import json
from dataclasses import asdict
from hashlib import sha256
from pathlib import Path
from typing import Any

import cadcam
from cadcam.dataset.layout import DATASET, OBJECT, DatasetFiles
from cadcam.dataset.plan import DatasetPlan
from cadcam.dataset.view_renderer import ViewInputs
from cadcam.errors import BadValue, UnreadableFile
from cadcam.files.camera import bare_camera_as_json
from cadcam.files.jsontext import as_json, shortened
from cadcam.files.sensor import sensor_as_json
from cadcam.geometry.rigid import Rigid
from cadcam.whole import write_whole

FORMAT, VERSION = "cadcam data set", 1
_DIGITS = 8  # of a hash, enough to tell two apart
_WORDS = {
    "part.sha256": "part, unit, crease angle or colour",
    "part.name": "part",
    "plan.poses_sha256": "set of poses",
    "made_by": "version",
}


def head_of(
    plan: DatasetPlan, inputs: ViewInputs, layout: DatasetFiles, *, name: str, key_point_names: tuple[str, ...]
) -> dict[str, Any]:
    """Return the document that `dataset.json` holds."""
    mesh = inputs.scene.mesh
    return {
        "format": FORMAT,
        "version": VERSION,
        "made_by": f"cadcam {cadcam.__version__}",
        "views": plan.views,
        "split": layout.split,
        "part": {"obj_id": OBJECT, "name": name, "sha256": inputs.scene.sha256, "parts": list(mesh.part_names)},
        "key_points": {"names": list(key_point_names), "p_mm": inputs.key_points.tolist()},
        "plan": _plan(plan),
        "depth_scale": inputs.depth_step,
        "props": [{"name": prop.name, "sha256": prop.scene.sha256} for prop in inputs.props],
    }


def begin(folder: Path, head: dict[str, Any]) -> None:
    """Write the head, or check that the folder holds this data set already, with as many views or fewer.

    Raises `BadValue` naming the first thing that differs.
    """
    path = folder / DATASET
    if path.exists():
        old = _read(path)
        if isinstance(old.get("views"), int) and old["views"] > head["views"]:
            raise BadValue(
                "views", head["views"], f"at least {old['views']}, for which {folder} was begun, or another folder"
            )
        was = _flat(old)
        for key, value in _flat(head).items():
            if key != "views" and was.get(key) != value:
                difference = (
                    f"begun with another {_WORDS.get(key, key.removeprefix('plan.'))} ({_brief(was, key)}, now "
                )
                difference += f"{_brief(_flat(head), key)})"
                raise BadValue(f"the data set in {folder}", difference, "the same as at first, or another folder")
    elif folder.is_dir() and any(folder.iterdir()):
        raise BadValue(f"folder {folder}", "not empty, and no data set", "an empty folder, or one that is not there")
    write_whole(path, as_json(head))


def _brief(document: dict[str, Any], key: str) -> str:
    """Return a leaf of a head in a few characters."""
    value = document.get(key)
    return str(value)[:_DIGITS] if key.endswith("sha256") and value is not None else shortened(value)


def _read(path: Path) -> dict[str, Any]:
    try:
        old = json.loads(path.read_bytes())
    except (OSError, ValueError) as error:
        raise UnreadableFile(path, f"cannot be read ({error})", "choose another folder") from None
    if not isinstance(old, dict) or old.get("format") != FORMAT:
        raise UnreadableFile(path, "is no data set of cadcam", "choose another folder")
    return old


def _plan(plan: DatasetPlan) -> dict[str, Any]:
    """Return the plan as JSON; photos by name and size."""
    around = plan.around
    return {
        "seed": plan.seed,
        "camera": bare_camera_as_json(plan.camera),
        "focal_jitter": plan.focal_jitter,
        "center_jitter_px": plan.center_jitter_px,
        "poses_sha256": _hash_of_poses(plan.poses),
        "around": {
            "axis": around.axis.tolist(),
            "half_angle_deg": around.half_angle_deg,
            "up": around.up.tolist(),
            "roll_deg": around.roll_deg,
            "distance_mm": None if around.distance_mm is None else list(around.distance_mm),
        },
        "fill": list(plan.fill),
        "off_center": plan.off_center,
        "lights": {key: list(span) for key, span in asdict(plan.lights).items()},
        "backgrounds": list(map(_background, plan.backgrounds)),
        "occluders": {"count": list(plan.occluders.count), "size": list(plan.occluders.size)},
        "sensor": None if plan.sensor is None else sensor_as_json(plan.sensor),
        "samples": plan.samples,
        "gray": plan.gray,
    }


def _background(one: str | Path) -> str:
    if isinstance(one, str):
        return one
    try:
        return f"{one.name}, {one.stat().st_size} bytes"
    except OSError as error:
        raise UnreadableFile(one, error.strerror or str(error), "check the path of this background") from None


def _hash_of_poses(poses: tuple[Rigid, ...]) -> str | None:
    return sha256(b"".join(pose.matrix.tobytes() for pose in poses)).hexdigest() if poses else None


def _flat(value: Any, name: str = "") -> dict[str, Any]:
    """Return the leaves of a document by their dotted names."""
    if not isinstance(value, dict):
        return {name: value}
    return {k: v for key, inner in value.items() for k, v in _flat(inner, f"{name}.{key}" if name else key).items()}
