"""nerfstudio's transforms.json, and the older ones of NeRF with camera_angle_x.

Pixels count from the corner: its principal point is ours plus 1/2. transform_matrix is world from camera with OpenGL's
eye axes (x right, y up, z back), in the scene's unit. OPENCV has k1, k2, k3, p1, p2; OPENCV_FISHEYE k1..k4. Files of
instant-ngp name no model: "is_fisheye" tells which of the two theirs is.
Source: nerfstudio `docs/quickstart/data_conventions.md`, `cameras/camera_utils.py`, nerfstudio#2255, #3048; instant-ngp
`scripts/colmap2nerf.py`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from cadcam.camera.camera import Camera
from cadcam.camera.lens import BrownConrady, Fisheye, Ideal, Lens
from cadcam.errors import BadValue
from cadcam.files.foreign.model import Files, Foreign, Format, Holds, NamedCamera, WriteOptions
from cadcam.files.foreign.pose import camera_from_world_of_eye, world_from_eye
from cadcam.files.foreign.source import ForeignFile
from cadcam.files.jsontext import Place, as_json, parsed

CORNER = 0.5  # nerfstudio's (0, 0) is the corner of the top-left pixel, ours its centre
_FISHEYE = ("k1", "k2", "k3", "k4")
_BROWN = ("k1", "k2", "p1", "p2", "k3")


def recognises(source: ForeignFile) -> bool:
    """Return whether this is JSON with frames and transform matrices."""
    head = source.head()
    return '"frames"' in head and ('"fl_x"' in head or '"camera_angle_x"' in head or '"transform_matrix"' in head)


def read(source: ForeignFile) -> Foreign:
    """Return a camera for each frame; values missing in a frame are those of the file."""
    root = parsed(source.text())
    frames = root.at("frames")
    if not isinstance(frames.value, list):
        raise frames.error("is no list", "is it the right file?")
    cameras = []
    shared: dict[str, Camera] = {}
    for i, value in enumerate(frames.value):
        frame = Place(root.path, ("frames", str(i)), value)
        own = {key: v for key, v in frame.object.items() if key in _KEYS}
        merged = Place(root.path, frame.keys, {**root.object, **own})
        text = repr(sorted(own.items(), key=lambda item: item[0]))
        if text not in shared:
            shared[text] = _camera(merged, source)
        pose = camera_from_world_of_eye(frame.at("transform_matrix").array((4, 4)), source.mm, frame.error)
        name = frame.object.get("file_path")
        cameras.append(NamedCamera(name if isinstance(name, str) else f"{i:04d}", shared[text], pose))
    if not cameras:
        cameras = [NamedCamera("camera", _camera(root, source))]
    notes = (
        ("applied_transform is not undone: poses are in nerfstudio's world",)
        if "applied_transform" in root.object
        else ()
    )
    return Foreign("nerfstudio", tuple(cameras), notes)


def write(cameras: Sequence[NamedCamera], target: WriteOptions) -> Files:
    """Write a frame for each camera that has a pose, each with its own intrinsics; a single camera's are at the top."""
    same = all(named.camera is cameras[0].camera for named in cameras)
    for named in cameras:
        if named.camera_from_world is None and len(cameras) > 1:
            raise BadValue(f"pose of camera {named.name}", "missing", "one for each of several cameras: a frame has it")
    frames: list[dict[str, Any]] = []
    for named in cameras:
        own = {} if same else _values(named.camera)
        if named.camera_from_world is not None:
            matrix = world_from_eye(named.camera_from_world, target.mm).tolist()
            frames.append({"file_path": named.name, **own, "transform_matrix": matrix})
    model = {"camera_model": _MODEL[type(cameras[0].camera.lens)]}
    return {"": as_json({**(_values(cameras[0].camera) if same else model), "frames": frames})}


_MODEL: dict[type[Lens], str] = {Ideal: "PINHOLE", BrownConrady: "OPENCV", Fisheye: "OPENCV_FISHEYE"}
_KEYS = (
    "camera_model",
    "is_fisheye",
    "w",
    "h",
    "fl_x",
    "fl_y",
    "cx",
    "cy",
    "camera_angle_x",
    "camera_angle_y",
    *_FISHEYE,
    "p1",
    "p2",
)


def _values(camera: Camera) -> dict[str, Any]:
    cx, cy = (camera.principal_point + CORNER).tolist()
    lens = camera.lens
    names = _FISHEYE if isinstance(lens, Fisheye) else _BROWN if isinstance(lens, BrownConrady) else ()
    terms = {name: getattr(lens, name) for name in names if getattr(lens, name) or name != "k3" or "k4" in names}
    head = {"camera_model": _MODEL[type(lens)], "w": camera.width, "h": camera.height}
    return {**head, "fl_x": camera.fx, "fl_y": camera.fy, "cx": cx, "cy": cy, **terms}


def _camera(place: Place, source: ForeignFile) -> Camera:
    size = (place.at("w").whole(), place.at("h").whole()) if "w" in place.object else source.needed_size("this file")
    fx = _focal(place, "fl_x", "camera_angle_x", size[0])
    fy = _focal(place, "fl_y", "camera_angle_y", size[1]) if {"fl_y", "camera_angle_y"} & set(place.object) else fx
    cx, cy = (
        place.at(name).number() if name in place.object else extent / 2
        for name, extent in zip(("cx", "cy"), size, strict=True)
    )
    K = np.array([[fx, 0, cx - CORNER], [0, fy, cy - CORNER], [0, 0, 1]])
    return place.build(lambda: Camera(size, K, _lens(place)))


def _focal(place: Place, name: str, angle: str, extent: int) -> float:
    if name in place.object:
        return place.at(name).number()
    if angle not in place.object:
        raise place.error(f"has neither {name} nor {angle}", "is it the right file?")
    return float(extent / 2 / np.tan(place.at(angle).number() / 2))


def _lens(place: Place) -> Lens:
    fisheye = "is_fisheye" in place.object and place.at("is_fisheye").flag()
    model = place.object.get("camera_model", "OPENCV_FISHEYE" if fisheye else "OPENCV")
    if model not in _MODEL.values():
        raise place.error(f"has the camera_model {str(model)[:40]!r}", f"read here: {', '.join(_MODEL.values())}")
    if fisheye and model != "OPENCV_FISHEYE":
        raise place.error(f"has the camera_model {model!r} and is_fisheye", "remove the one that is wrong")
    names = _FISHEYE if model == "OPENCV_FISHEYE" else _BROWN
    terms = {name: place.at(name).number() for name in names if name in place.object}
    if model == "OPENCV_FISHEYE":
        return Fisheye(**terms)
    if "k4" in place.object and place.at("k4").number():
        raise place.error("has k4, the eighth power of the radius", "no lens here has it: undistort the pictures first")
    return BrownConrady(**terms) if any(terms.values()) and model == "OPENCV" else Ideal()


FORMAT = Format(
    name="nerfstudio",
    title="nerfstudio transforms.json",
    suffixes=(".json",),
    holds=Holds({"ideal": (), "brown-conrady": _BROWN, "fisheye": _FISHEYE}, pose="yes", several=True),
    recognises=recognises,
    read=read,
    write=write,
)
