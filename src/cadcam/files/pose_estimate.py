"""A located pose in JSON: world_from_part with its covariance, which can be read back to the last bit.

{"world_from_part": {"rotation": 3x3, "translation_mm": 3}, "sigma_mm": 3, "sigma_deg": 3, "from_noise": 6x6,
"from_calibration": 6x6, "freedom": 6xk, "degrees_of_freedom": number or null}. The covariances are those of xi =
(translation mm, rotation rad) in world_from_part @ exp(xi), in the part's axes; sigmas are written for people and other
programs. degrees_of_freedom null means that the noise is known.
"""

from __future__ import annotations

import os
from typing import Any

import numpy as np

from cadcam.camera.pose_estimate import PoseEstimate
from cadcam.files.jsontext import Place, as_json, or_null, parsed
from cadcam.files.matrix import pose_as_json, pose_at, pose_in, rigid_in
from cadcam.files.text import read_text
from cadcam.geometry.rigid import Rigid
from cadcam.whole import write_whole

_OF_PART = ("world_from_part", "part_from_world")
_OF_CAMERA = ("camera_from_world", "world_from_camera")  # of a camera whose world is the part
_DIRECTIONS = (_OF_PART, ("camera_from_part", "part_from_camera"), _OF_CAMERA)
_KEYS = ("world_from_part", "sigma_mm", "sigma_deg", "from_noise", "from_calibration", "freedom", "degrees_of_freedom")


def pose_estimate_as_json(pose: PoseEstimate) -> dict[str, Any]:
    """Return the JSON object that `pose_estimate_at` reads."""
    sigma = np.sqrt(np.diag(pose.covariance))
    return {
        "world_from_part": pose_as_json(pose.world_from_part),
        "sigma_mm": sigma[:3].tolist(),
        "sigma_deg": np.degrees(sigma[3:]).tolist(),
        "from_noise": pose.from_noise.tolist(),
        "from_calibration": pose.from_calibration.tolist(),
        "freedom": pose.freedom.tolist(),
        "degrees_of_freedom": or_null(pose.dof),
    }


def pose_estimate_at(place: Place) -> PoseEstimate:
    """Return the pose estimate at a place of a JSON file."""
    place.only(*_KEYS)
    dof = place.object.get("degrees_of_freedom")
    return place.build(
        lambda: PoseEstimate(
            pose_at(place.at("world_from_part")),
            place.at("from_noise").covariance(6),
            place.at("from_calibration").covariance(6),
            place.at("freedom").array((6, None)),
            np.inf if dof is None else place.at("degrees_of_freedom").number(),
        )
    )


def write_part_pose(path: str | os.PathLike[str], pose: PoseEstimate) -> None:
    """Write the located pose of a part, whole or not at all; floats keep every bit."""
    write_whole(path, as_json(pose_estimate_as_json(pose)))


def read_part_pose(path: str | os.PathLike[str], *, camera_from_world: Rigid | None = None) -> Rigid:
    """Return world_from_part (mm) of a file that holds the pose of a part: written here, or by hand.

    A pose file as for `read_pose`, text or JSON, with world_from_part or camera_from_part (or part_from_world,
    part_from_camera); or camera_from_world, where the world is the part, as for an overlay. Poses relative to the
    camera require `camera_from_world`; by default the world is the camera. A result of `cadcam locate --json` is
    accepted, too. Raises `UnreadableFile` naming line or key.
    """
    said, pose = _said(path, _OF_PART)
    return pose if said is _OF_PART or camera_from_world is None else camera_from_world.inv @ pose


def read_view_pose(path: str | os.PathLike[str], *, camera_from_world: Rigid | None = None) -> Rigid:
    """Return camera_from_world (mm) of a camera whose world is the part: for an overlay, as `read_part_pose`.

    world_from_part requires `camera_from_world` of its world; by default that world is the camera.
    """
    said, pose = _said(path, _OF_CAMERA)
    return camera_from_world @ pose if said is _OF_PART and camera_from_world is not None else pose


def _said(path: str | os.PathLike[str], usual: tuple[str, str]) -> tuple[tuple[str, str], Rigid]:
    """Return the motion of a pose file with its direction, or its inverse; usual: the direction if none is stated."""
    file = read_text(path)
    said = next((pair for pair in _DIRECTIONS if any(name in file.text for name in pair)), usual)
    if not file.text.lstrip().startswith("{"):
        return said, rigid_in(file, said)
    place = parsed(file)
    return said, pose_in(place.at("pose") if isinstance(place.object.get("pose"), dict) else place, said)
