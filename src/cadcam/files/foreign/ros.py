"""ROS camera_info: the YAML of camera_calibration_parsers, and a printed sensor_msgs/CameraInfo message.

Pixels and axes as OpenCV. plumb_bob k1 k2 t1 t2 k3; rational_polynomial eight numbers; equidistant k1..k4 (the
fisheye). Rectification and projection matrices describe a rectified picture, not this camera. Size and K of a message
are those of the calibration, also where its own picture was binned or is a region of interest.
Source: `sensor_msgs/msg/CameraInfo.msg` (ros2/common_interfaces), `camera_calibration_parsers/src/parse_yml.cpp`.
"""

from __future__ import annotations

import json
import re
from collections.abc import Sequence

import numpy as np

from cadcam.arrays import Array
from cadcam.camera.camera import Camera
from cadcam.camera.lens import BrownConrady, Fisheye, Lens, lens_from_opencv
from cadcam.files.foreign.model import Files, Foreign, Format, Holds, NamedCamera, WriteOptions
from cadcam.files.foreign.opencv import coefficients
from cadcam.files.foreign.pose import numbers
from cadcam.files.foreign.source import ForeignFile
from cadcam.files.jsontext import Place
from cadcam.files.yamltext import parsed_yaml, yaml_number

_FISHEYE = ("equidistant", "fisheye")
_BROWN = ("plumb_bob", "rational_polynomial", "")


def recognises(source: ForeignFile) -> bool:
    """Return whether this names a distortion model and holds a camera matrix."""
    head = source.head()
    named = re.search(r"^[ \t]*distortion_model\s*:", head, re.MULTILINE)
    return bool(named) and bool(re.search(r"^[ \t]*(camera_matrix|[kK])\s*:", head, re.MULTILINE))


def read(source: ForeignFile) -> Foreign:
    """Return the camera."""
    root = parsed_yaml(source.text())
    matrix, distortion = (
        ("camera_matrix", "distortion_coefficients") if "camera_matrix" in root.object else _short(root)
    )
    prefix = "image_" if "image_width" in root.object else ""
    size = root.at(f"{prefix}width").whole(), root.at(f"{prefix}height").whole()
    model = root.at("distortion_model").text() if root.object.get("distortion_model") is not None else ""
    K = _row(root.at(matrix), 9).reshape(3, 3)
    if not K.any():
        raise root.error(f"{matrix} is all zeros", "the camera is not calibrated, by ROS' own rule")
    camera = Camera(
        size, K, _lens(root, model, _row(root.at(distortion)) if distortion in root.object else np.zeros(0))
    )
    name = root.object.get("camera_name")
    return Foreign("ros", (NamedCamera(name if isinstance(name, str) else "camera", camera),), _notes(root, K, size))


def write(cameras: Sequence[NamedCamera], target: WriteOptions) -> Files:
    """Write one camera; the rectification is the identity and the projection matrix K itself."""
    named = cameras[0]
    camera = named.camera
    c = coefficients(camera.lens)
    fisheye = isinstance(camera.lens, Fisheye)
    model = "equidistant" if fisheye else "plumb_bob" if c.size == 5 else "rational_polynomial"
    P = np.concatenate([camera.K, np.zeros((3, 1))], axis=1)
    lines = [
        f"image_width: {camera.width}",
        f"image_height: {camera.height}",
        f"camera_name: {json.dumps(named.name, ensure_ascii=False)}",
        *_matrix_lines("camera_matrix", camera.K),
        f"distortion_model: {model}",
        *_matrix_lines("distortion_coefficients", c[None]),
        *_matrix_lines("rectification_matrix", np.eye(3)),
        *_matrix_lines("projection_matrix", P),
    ]
    return {"": ("\n".join(lines) + "\n").encode()}


def _short(root: Place) -> tuple[str, str]:
    """Return the names that a printed message has: K and D, in ROS 2 k and d."""
    return ("K", "D") if "K" in root.object else ("k", "d")


def _row(place: Place, count: int | None = None) -> Array:
    data = (place.at("data") if isinstance(place.value, dict) else place).array((None,))
    if count is not None and data.size != count:
        raise place.error(f"has {data.size} numbers", f"{count} are expected")
    return data


def _lens(root: Place, model: str, c: Array) -> Lens:
    if model in _FISHEYE:
        if c.size != 4:
            raise root.error(f"distortion_coefficients has {c.size} numbers", f"{model} has 4")
        return Fisheye(*c.tolist())
    if model not in _BROWN:
        known = ", ".join(name for name in (*_BROWN, *_FISHEYE) if name)
        raise root.error(f"has the distortion_model {model[:40]!r}", f"known: {known}")
    return root.build(lambda: lens_from_opencv(c))


def _notes(root: Place, K: Array, size: tuple[int, int]) -> tuple[str, ...]:
    R, P = (root.object.get(name) for name in ("rectification_matrix", "projection_matrix"))
    plain = np.concatenate([K, np.zeros((3, 1))], axis=1)
    notes = []
    if R is not None and not np.array_equal(_row(root.at("rectification_matrix"), 9), np.eye(3).ravel()):
        notes.append("the rectification matrix is not kept: this is the camera before rectification")
    if P is not None and not np.array_equal(_row(root.at("projection_matrix"), 12), plain.ravel()):
        notes.append("the projection matrix is not kept: it is that of the rectified picture")
    if K[0, 1]:
        notes.append(f"K01 = {K[0, 1]:g} px is read as skew; image_proc ignores it")
    return (*notes, *_other_picture(root, size))


def _other_picture(root: Place, size: tuple[int, int]) -> tuple[str, ...]:
    """Return what makes the message's own picture another than the calibration's; zeros mean the whole, unbinned."""
    options = []
    if isinstance(root.object.get("roi"), dict):
        roi = root.at("roi")
        x, y, width, height = (
            roi.at(name).whole() if name in roi.object else 0 for name in ("x_offset", "y_offset", "width", "height")
        )
        cut = x, y, width or size[0], height or size[1]
        if cut != (0, 0, *size):
            options.append("--crop {},{},{}x{}".format(*cut))
    by = [root.at(name).whole() or 1 for name in ("binning_x", "binning_y") if name in root.object]
    if any(n != 1 for n in by):
        options.append(f"--binning {'x'.join(map(str, by))}")
    what = "the message's own picture is a part of this camera's, or binned: cadcam convert it with"
    return (f"{what} {', then with '.join(options)}",) if options else ()


def _matrix_lines(name: str, values: Array) -> list[str]:
    data = ", ".join(map(yaml_number, numbers(values)))
    return [f"{name}:", f"  rows: {values.shape[0]}", f"  cols: {values.shape[1]}", f"  data: [{data}]"]


FORMAT = Format(
    name="ros",
    title="ROS camera_info",
    suffixes=(".yaml", ".yml"),
    holds=Holds(
        {
            "ideal": (),
            "brown-conrady": tuple(BrownConrady().parameters)[:8],
            "fisheye": tuple(Fisheye().parameters),
        },
        skew="ignored",
    ),
    recognises=recognises,
    read=read,
    write=write,
)
