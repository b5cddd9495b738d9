"""BOP data sets: camera.json beside scene_camera.json in a folder.

Pixels and axes as here unless a data set states otherwise (rendered training pictures may have cx = W/2); millimetres.
camera.json has fx, fy, cx, cy and the size; scene_camera.json, one camera per image, the whole 3x3 cam_K and the pose
cam_R_w2c, cam_t_w2c. Source: bop_toolkit `docs/bop_datasets_format.md`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from cadcam.camera.camera import Camera
from cadcam.errors import BadValue
from cadcam.files.foreign.model import Files, Foreign, Format, Holds, NamedCamera, WriteOptions
from cadcam.files.foreign.pose import numbers, rigid
from cadcam.files.foreign.source import ForeignFile
from cadcam.files.jsontext import Place, as_json, parsed
from cadcam.geometry.rigid import Rigid

_ONE, _SCENE = "camera.json", "scene_camera.json"


def recognises(source: ForeignFile) -> bool:
    """Return whether this is one of the two files, or a folder with one."""
    if source.is_folder:
        return source.has(_SCENE) or (source.has(_ONE) and '"depth_scale"' in source.head(_ONE))
    head = source.head()
    return '"cam_K"' in head or ('"depth_scale"' in head and '"fx"' in head)


def read(source: ForeignFile) -> Foreign:
    """Return the cameras of scene_camera.json if it is there, else that of camera.json."""
    one, scene = _places(source)
    if scene is None:
        if one is None:
            raise Place(source.path, (), {}).error("holds neither camera.json nor scene_camera.json")
        fx, fy, cx, cy = (one.at(name).number() for name in ("fx", "fy", "cx", "cy"))
        K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
        return Foreign("bop", (NamedCamera("camera", one.build(lambda: Camera(_size(one), K))),))
    size = source.needed_size("scene_camera.json without camera.json beside it") if one is None else _size(one)
    names = [name for name, value in scene.object.items() if isinstance(value, dict)]
    if not names:
        raise scene.error("holds no camera", "is it the right file?")
    return Foreign("bop", tuple(_of_image(name, scene.at(name), size) for name in names))


def _places(source: ForeignFile) -> tuple[Place | None, Place | None]:
    """Return the content of camera.json and of scene_camera.json, each None where it is not there."""
    if source.is_folder:
        one, scene = (parsed(source.text(name)) if source.has(name) else None for name in (_ONE, _SCENE))
        return one, scene
    root = parsed(source.text())
    if "fx" in root.object:
        return root, None
    return parsed(source.text(_ONE)) if source.has(_ONE) else None, root


def _size(one: Place) -> tuple[int, int]:
    return one.at("width").whole(), one.at("height").whole()


def write(cameras: Sequence[NamedCamera], target: WriteOptions) -> Files:
    """Write both files; images are numbered 0, 1 ... as BOP requires."""
    first = cameras[0].camera
    for named in cameras:
        if named.camera.size != first.size:
            raise BadValue("size of camera " + named.name, named.camera.size, f"{first.size}: BOP has one for all")
    one = {"cx": first.K[0, 2], "cy": first.K[1, 2], "depth_scale": 1.0, "fx": first.fx, "fy": first.fy}
    one = {name: float(value) for name, value in one.items()} | {"height": first.height, "width": first.width}
    scene: dict[str, Any] = {}
    for i, named in enumerate(cameras):
        entry: dict[str, Any] = {"cam_K": numbers(named.camera.K), "depth_scale": 1.0}
        if named.camera_from_world is not None:
            entry["cam_R_w2c"] = numbers(named.camera_from_world.rotation)
            entry["cam_t_w2c"] = numbers(named.camera_from_world.translation)
        scene[str(i)] = entry
    return {_ONE: as_json(one), _SCENE: as_json(scene)}


def _of_image(name: str, place: Place, size: tuple[int, int]) -> NamedCamera:
    K = place.at("cam_K").array((9,)).reshape(3, 3)
    camera = place.build(lambda: Camera(size, K))
    return NamedCamera(name, camera, _pose(place) if "cam_R_w2c" in place.object else None)


def _pose(place: Place) -> Rigid:
    rotation = place.at("cam_R_w2c").array((9,)).reshape(3, 3)
    return rigid(rotation, place.at("cam_t_w2c").array((3,)), place.error)


FORMAT = Format(
    name="bop",
    title="BOP data set",
    suffixes=(),
    holds=Holds({"ideal": ()}, skew="yes", pose="yes", several=True),
    recognises=recognises,
    read=read,
    write=write,
    unit="mm",
    folder=True,
)
