"""A located pose in JSON: world_from_part with its covariance, which can be read back to the last bit.

{"world_from_part": {"rotation": 3x3, "translation_mm": 3}, "sigma_mm": 3, "sigma_deg": 3, "from_noise": 6x6,
"from_calibration": 6x6, "freedom": 6xk, "degrees_of_freedom": number or null, "undetermined": {"in_words": text,
"twists": 6xj} or null}. The covariances are those of xi = (translation mm, rotation rad) in world_from_part @ exp(xi),
in the part's axes; sigmas are written for people and other programs. degrees_of_freedom null means that the noise is
known; undetermined, which no photo can show: sigmas and covariances hold it as unknown as an angle can be.

A file of its own (`write_part_pose`) says all that another program must know to use it: which frames these are, by
which rule a point goes from one to the other, the same pose as a 4x4 matrix and as a quaternion, and where each camera
stood and sees the part. The pose that is read is world_from_part; where one of the others contradicts it, the file is
refused.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from cadcam.camera.pose_estimate import PoseEstimate
from cadcam.camera.viewpoint import Viewpoint
from cadcam.errors import UnreadableFile, listed
from cadcam.files.jsontext import Place, as_json, head_as_json, or_null, parsed
from cadcam.files.matrix import pose_as_json, pose_at, pose_in, rigid_in
from cadcam.files.text import read_text
from cadcam.geometry import rotation as so3
from cadcam.geometry.rigid import Rigid
from cadcam.image.suffixes import READABLE
from cadcam.kinds import expect, expect_by_name, expect_each, expect_path
from cadcam.whole import write_whole

FORMAT, VERSION = "cadcam pose", 1
_OF_PART = ("world_from_part", "part_from_world")
_OF_CAMERA = ("camera_from_world", "world_from_camera")  # of a camera whose world is the part
_DIRECTIONS = (_OF_PART, ("camera_from_part", "part_from_camera"), _OF_CAMERA)
_KEYS = (
    "world_from_part",
    "sigma_mm",
    "sigma_deg",
    "from_noise",
    "from_calibration",
    "freedom",
    "degrees_of_freedom",
    "undetermined",
)
_SAID = ("format", "version", "written_by", "model", "frames", "convention", "matrix", "quaternion_wxyz", "cameras")
_CONVENTION = {
    "pose": "p_world = rotation @ p_part + translation_mm; right-handed frames, lengths in mm",
    "matrix": "the same, 4x4 by rows: [p_world, 1] = matrix @ [p_part, 1]",
    "quaternion_wxyz": "of the rotation, the real part first",
    "cameras": "p_camera = rotation @ p_part + translation_mm; camera axes x right, y down, z forward (as OpenCV's)",
    "covariance": "from_noise + from_calibration, 6x6: of (translation mm, rotation rad) along and about the part's "
    "axes, on the part's side of the pose",
}
_SAME = 1e-6  # largest difference, relative to the size, between a pose and its repetition in a file


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
        "undetermined": undetermined_as_json(pose),
    }


def pose_estimate_at(place: Place) -> PoseEstimate:
    """Return the pose estimate at a place of a JSON file."""
    place.only(*_KEYS, *_SAID)
    _refuse_contradiction(place)
    dof, undetermined = place.object.get("degrees_of_freedom"), place.object.get("undetermined")
    return place.build(
        lambda: PoseEstimate(
            pose_at(place.at("world_from_part")),
            place.at("from_noise").covariance(6),
            place.at("from_calibration").covariance(6),
            place.at("freedom").array((6, None)),
            np.inf if dof is None else place.at("degrees_of_freedom").number(),
            np.zeros((6, 0)) if undetermined is None else place.at("undetermined").at("twists").array((6, None)),
        )
    )


def undetermined_as_json(pose: PoseEstimate) -> dict[str, Any] | None:
    """Return what no photo can determine of a pose, in words and as twists; None if there is nothing of the kind."""
    words = pose.undetermined_words
    return {"in_words": words, "twists": pose.undetermined.tolist()} if words else None


def write_part_pose(
    path: str | os.PathLike[str],
    pose: PoseEstimate,
    *,
    viewpoints: Sequence[Viewpoint] = (),
    model: Mapping[str, str] | None = None,
) -> None:
    """Write the located pose of a part, whole or not at all; floats keep every bit.

    viewpoints: the cameras by which it was located, which name the world; model: what is known of the CAD file whose
    axes are the part's, such as its path and sha256.
    """
    expect_path(path)
    expect(pose, "pose", PoseEstimate)
    viewpoints = expect_each(viewpoints, "viewpoints", Viewpoint)
    if model is not None:
        expect_by_name(model, "model", str)
    write_whole(path, as_json(part_pose_as_json(pose, viewpoints=viewpoints, model=model)))


def part_pose_as_json(
    pose: PoseEstimate, *, viewpoints: Sequence[Viewpoint] = (), model: Mapping[str, str] | None = None
) -> dict[str, Any]:
    """Return the JSON document that `write_part_pose` writes."""
    cameras = [
        {
            "name": view.name,
            "camera_from_part": pose_as_json(view.camera_from_world @ pose.world_from_part),
            "camera_from_world": pose_as_json(view.camera_from_world),
        }
        for view in viewpoints
    ]
    return {
        **head_as_json(FORMAT, VERSION),
        **({} if model is None else {"model": dict(model)}),
        "frames": frames_as_json(viewpoints),
        "convention": _CONVENTION,
        **pose_estimate_as_json(pose),
        "matrix": pose.world_from_part.matrix.tolist(),
        "quaternion_wxyz": so3.quaternion(pose.world_from_part.rotation).tolist(),
        **({"cameras": cameras} if cameras else {}),
    }


def frames_as_json(viewpoints: Sequence[Viewpoint]) -> dict[str, str]:
    """Return in words which frames "part" and "world" are for poses that these cameras gave."""
    part = "the CAD model's own axes, as in its file, in mm"
    own = [view.name for view in viewpoints if np.array_equal(view.camera_from_world.matrix, np.eye(4))]
    if own:
        axes = "origin at its projection centre, x right, y down, z forward"
        return {"part": part, "world": f"the camera that took {own[0]!r}: {axes}; not the world of its calibration"}
    return {"part": part, "world": "that in which the cameras were placed, by their files or by the caller"}


def read_part_pose(path: str | os.PathLike[str], *, camera_from_world: Rigid | None = None) -> Rigid:
    """Return world_from_part (mm) of a file that holds the pose of a part: written here, or by hand.

    A pose file as for `read_pose`, text or JSON, with world_from_part or camera_from_part (or part_from_world,
    part_from_camera); or camera_from_world, where the world is the part, as for an overlay. Poses relative to the
    camera require `camera_from_world`; by default the world is the camera. A result of `cadcam locate --json` is
    accepted, too. Raises `UnreadableFile` naming line or key.
    """
    said, pose, _ = _said(path, _OF_PART)
    return pose if said is _OF_PART or camera_from_world is None else camera_from_world.inv @ pose


def read_pose_by_one(path: str | os.PathLike[str], name: str, *, camera_from_world: Rigid | None = None) -> Rigid:
    """Return camera_from_part (mm), as `read_part_pose`, for a camera alone that took the photo `name`.

    A file that says where several cameras stood is in their world. Where this camera stood there, the file tells of one
    of its name; else it is camera_from_world. Raises `UnreadableFile` where neither does.
    """
    said, pose, seen = _said(path, _OF_PART)
    if said is not _OF_PART or not seen:
        return pose
    known = seen[0].camera_from_part if len(seen) == 1 else _namesake(seen, name)
    if known is not None:
        return known
    if camera_from_world is None:
        raise _placeless(path, seen, f"the camera of {name}")
    return camera_from_world @ pose


def read_pose_by_several(path: str | os.PathLike[str], viewpoints: Sequence[Viewpoint]) -> Rigid:
    """Return world_from_part (mm), as `read_part_pose`, in the world in which these cameras are placed.

    The world of a file by one photo is the camera that took it. It is the one of that name here, else that at the
    world's origin. Raises `UnreadableFile` where it is none of these.
    """
    said, pose, seen = _said(path, _OF_PART)
    if said is not _OF_PART:
        return viewpoints[0].camera_from_world.inv @ pose
    if len(seen) != 1 or seen[0].camera_from_part is None or not _same(seen[0].camera_from_part, pose):
        return pose
    for view in viewpoints:
        if _bare(view.name) == _bare(seen[0].name):
            return view.camera_from_world.inv @ pose
    if any(_same(view.camera_from_world, Rigid()) for view in viewpoints):
        return pose
    names = listed([view.name for view in viewpoints], 3)
    where = f"is a pose in the frame of the camera that took {seen[0].name}, which is none of {names}"
    raise UnreadableFile(path, where, "give world_from_part in the world in which these are placed")


def read_pose_estimate(path: str | os.PathLike[str]) -> PoseEstimate:
    """Return the pose of a part with its covariance, as `write_part_pose` or `cadcam locate --pose-out` wrote it.

    Raises `UnreadableFile` naming the key, also for a pose without its covariance: `read_part_pose` reads those.
    """
    place = parsed(read_text(path))
    place.check_head(FORMAT, VERSION, remedy="read_part_pose reads poses without a covariance")
    return pose_estimate_at(place)


def read_view_pose(path: str | os.PathLike[str], *, camera_from_world: Rigid | None = None) -> Rigid:
    """Return camera_from_world (mm) of a camera whose world is the part: for an overlay, as `read_part_pose`.

    world_from_part requires `camera_from_world` of its world; by default that world is the camera. Where one camera
    located the part, the file says where that stood: by one photo it is the world itself, whatever its own file says.
    Where several did, camera_from_world is required.
    """
    said, pose, seen = _said(path, _OF_CAMERA)
    if len(seen) == 1 and seen[0].camera_from_part is not None:
        return seen[0].camera_from_part
    if camera_from_world is None and len(seen) > 1:
        raise _placeless(path, seen, "this camera")
    return camera_from_world @ pose if said is _OF_PART and camera_from_world is not None else pose


class _Seen(NamedTuple):
    """A camera by which a part was located: its name, and how it sees the part where the file tells that."""

    name: str
    camera_from_part: Rigid | None


def _said(path: str | os.PathLike[str], usual: tuple[str, str]) -> tuple[tuple[str, str], Rigid, list[_Seen]]:
    """Return the motion of a pose file with its direction, or its inverse, and the cameras that located the part.

    usual: the direction if none is stated. There are no cameras where the file does not tell of them.
    """
    file = read_text(path)
    said = next((pair for pair in _DIRECTIONS if any(name in file.text for name in pair)), usual)
    if not file.text.lstrip().startswith("{"):
        return said, rigid_in(file, said), []
    place = parsed(file)
    if place.object.get("format") == FORMAT:
        place.check_head(FORMAT, VERSION)
        _refuse_contradiction(place)
    pose = pose_in(place.at("pose") if isinstance(place.object.get("pose"), dict) else place, said)
    return said, pose, _cameras(place) if said is _OF_PART else []


def _cameras(place: Place) -> list[_Seen]:
    """Return the cameras that a file of `--pose-out` or `--json` tells of; the latter says what the first one sees."""
    cameras, photos = place.object.get("cameras"), place.object.get("photos")
    if isinstance(cameras, list):
        each = place.at("cameras").items()
        return [_Seen(str(one.object.get("name", "")), pose_at(one.at("camera_from_part"))) for one in each]
    if isinstance(photos, list) and photos and "camera_from_part" in place.object:
        first, *more = [Path(str(one.object.get("path", ""))).name for one in place.at("photos").items()]
        return [_Seen(first, pose_at(place.at("camera_from_part"))), *(_Seen(name, None) for name in more)]
    return []


def _namesake(seen: Sequence[_Seen], name: str) -> Rigid | None:
    """Return how the camera of a name sees the part; None if there is none, or there are two."""
    found = [one.camera_from_part for one in seen if _bare(one.name) == _bare(name)]
    return found[0] if len(found) == 1 else None


def _placeless(path: str | os.PathLike[str], seen: Sequence[_Seen], camera: str) -> UnreadableFile:
    """Return the error for a pose in the world of several cameras, in which another one's place is not known."""
    where = f"is a pose in the world in which {listed([one.name for one in seen], 3)} were placed"
    remedy = "give a camera file with camera_from_world in that world, or the pose as camera_from_part"
    return UnreadableFile(path, f"{where}, where {camera} has no known place", remedy)


def _bare(name: str) -> str:
    """Return the name of a camera, which may be that of its photo, without the photo's suffix."""
    return str(Path(name).with_suffix("")) if name.lower().endswith(READABLE) else name


def _same(one: Rigid, other: Rigid) -> bool:
    return bool(np.abs(one.matrix - other.matrix).max() <= _SAME * max(1.0, float(np.abs(other.matrix).max())))


def _refuse_contradiction(place: Place) -> None:
    """Refuse a pose whose matrix, quaternion or cameras have another one, as after an edit of one of them."""
    if not {"matrix", "quaternion_wxyz", "cameras"} & set(place.object):
        return
    pose = pose_at(place.at("world_from_part"))
    repeated = {}
    if "matrix" in place.object:
        repeated["matrix"] = (place.at("matrix").array((4, 4)), pose.matrix)
    if "quaternion_wxyz" in place.object:
        q, own = place.at("quaternion_wxyz").array((4,)), so3.quaternion(pose.rotation)
        repeated["quaternion_wxyz"] = (q * (np.sign(q @ own) or 1.0), own)  # q and -q are one rotation
    for camera in place.at("cameras").items() if "cameras" in place.object else []:
        if "camera_from_world" in camera.object:  # not in files of before
            seen = pose_at(camera.at("camera_from_world")) @ pose
            repeated["cameras"] = (pose_at(camera.at("camera_from_part")).matrix, seen.matrix)
    for name, (given, expected) in repeated.items():
        if np.abs(given - expected).max() > _SAME * max(1.0, float(np.abs(expected).max())):
            raise place.at(name).error("contradicts world_from_part", "change both, or leave it out")
