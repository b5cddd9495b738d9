"""Blender: a Python snippet that sets up the camera, its values in one dict literal that is read back (never run).

With sensor_fit HORIZONTAL: fx = lens W / sensor_width, fy = fx pixel_aspect_x / pixel_aspect_y, and for our pixels
shift_x = -(cx - (W - 1)/2) / W, shift_y = (cy - (H - 1)/2) / W pixel_aspect_y / pixel_aspect_x. matrix_world is world
from eye (x right, y up, z back), in metres. No skew, no lens.
Source: Blender `source/blender/blenkernel/intern/camera.cc`; BlenderProc `python/camera/CameraUtility.py`.
"""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from typing import Any

import numpy as np

from cadcam.camera.camera import Camera
from cadcam.errors import UnreadableFile
from cadcam.files.foreign.model import Files, Foreign, Format, Holds, NamedCamera, WriteOptions
from cadcam.files.foreign.mrcal import literal
from cadcam.files.foreign.pose import camera_from_world_of_eye, world_from_eye
from cadcam.files.foreign.source import ForeignFile
from cadcam.files.jsontext import Place
from cadcam.files.text import TextFile
from cadcam.geometry.rigid import Rigid

_MM = 1000.0
_SENSOR_MM = 36.0  # Blender's own default, written where no pixel pitch is known
_DICT = re.compile(r"^CAMERA\s*=\s*(?=\{)", re.MULTILINE)

_SNIPPET = """\
# Blender: run in the Scripting tab, or blender scene.blend --python THIS_FILE
CAMERA = {values}

import bpy
from mathutils import Matrix

scene = bpy.context.scene
data = bpy.data.cameras.new(CAMERA["name"])
camera = bpy.data.objects.new(CAMERA["name"], data)
scene.collection.objects.link(camera)
scene.camera = camera
data.type, data.sensor_fit = "PERSP", "HORIZONTAL"
data.sensor_width, data.lens = CAMERA["sensor_width"], CAMERA["lens"]
data.shift_x, data.shift_y = CAMERA["shift_x"], CAMERA["shift_y"]
scene.render.resolution_x, scene.render.resolution_y = CAMERA["resolution"]
scene.render.resolution_percentage = 100
scene.render.pixel_aspect_x, scene.render.pixel_aspect_y = CAMERA["pixel_aspect"]
if CAMERA["matrix_world"] is not None:
    camera.matrix_world = Matrix(CAMERA["matrix_world"])
"""


def recognises(source: ForeignFile) -> bool:
    """Return whether this is such a snippet."""
    head = source.head()
    return bool(re.search(r"^CAMERA\s*=\s*\{", head, re.MULTILINE)) and "sensor_width" in head


def read(source: ForeignFile) -> Foreign:
    """Return the camera of the dict CAMERA in a snippet."""
    file = source.text()
    found = _DICT.search(file.text)
    end = file.text.find("\n}", found.end()) if found else -1
    if found is None or end < 0:
        raise UnreadableFile(file.path, "has no complete CAMERA = {...}", "is it cut off?")
    root = Place(file.path, ("CAMERA",), literal(TextFile(file.path, file.text[found.end() : end + 2], file.sha256)))
    size = root.at("resolution")
    width, height = (Place(root.path, size.keys, v).whole() for v in size.array((2,)).tolist())
    lens, sensor, shift_x, shift_y = (root.at(n).number() for n in ("lens", "sensor_width", "shift_x", "shift_y"))
    aspect_x, aspect_y = root.at("pixel_aspect").array((2,)).tolist()
    if not (sensor > 0 and aspect_x > 0 and aspect_y > 0):
        raise root.error("has a sensor_width or pixel_aspect that is not positive")
    fx, ratio = lens * width / sensor, aspect_y / aspect_x
    cx, cy = (width - 1) / 2 - shift_x * width, (height - 1) / 2 + shift_y * width / ratio
    camera = root.build(lambda: Camera((width, height), np.array([[fx, 0, cx], [0, fx / ratio, cy], [0, 0, 1]])))
    name = root.object.get("name")
    return Foreign("blender", (NamedCamera(name if isinstance(name, str) else "camera", camera, _pose(root)),))


def write(cameras: Sequence[NamedCamera], target: WriteOptions) -> Files:
    """Write the snippet of one camera."""
    named = cameras[0]
    sensor = named.camera.width * target.pixel_mm if target.pixel_mm else _SENSOR_MM
    values = {"name": named.name, **blender_values(named.camera, named.camera_from_world, sensor_mm=sensor)}
    body = "".join(f"    {json.dumps(key)}: {value!r},\n" for key, value in values.items())
    return {"": _SNIPPET.replace("{values}", "{\n" + body + "}").encode()}


def blender_values(camera: Camera, camera_from_world: Rigid | None, *, sensor_mm: float = _SENSOR_MM) -> dict[str, Any]:
    """Return lens and sensor_width (mm), shifts, pixel aspects, resolution and matrix_world (m) for Blender."""
    (W, H), (cx, cy) = camera.size, camera.principal_point.tolist()
    ratio = camera.fx / camera.fy
    return {
        "lens": camera.fx * sensor_mm / W,
        "sensor_width": float(sensor_mm),
        "shift_x": -(cx - (W - 1) / 2) / W,
        "shift_y": (cy - (H - 1) / 2) / W * ratio,
        "pixel_aspect": (1.0, ratio) if ratio >= 1 else (1 / ratio, 1.0),  # Blender accepts none below 1
        "resolution": (W, H),
        "matrix_world": None if camera_from_world is None else world_from_eye(camera_from_world, _MM).tolist(),
    }


def _pose(root: Place) -> Rigid | None:
    if root.object.get("matrix_world") is None:
        return None
    place = root.at("matrix_world")
    return camera_from_world_of_eye(place.array((4, 4)), _MM, place.error)


FORMAT = Format(
    name="blender",
    title="Blender script",
    suffixes=(".py",),
    holds=Holds({"ideal": ()}, pose="yes"),
    recognises=recognises,
    read=read,
    write=write,
    unit="m",
)
