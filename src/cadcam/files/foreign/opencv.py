"""OpenCV's FileStorage: YAML, XML or JSON as written by its calibration samples.

Pixel centres at integers, x right, y down, z forward: as here. Distortion k1 k2 p1 p2 [k3 [k4 k5 k6 [s1..s4 [tx ty]]]],
or k1..k4 of cv::fisheye where fisheye_model is set. extrinsic_parameters: one row (rotation vector, translation) a
view, camera from object, in the user's unit. cv::projectPoints reads fx, fy, cx, cy of the matrix and ignores K01.
Source: opencv `samples/cpp/calibration.cpp`, `doc/tutorials/calib3d/camera_calibration`.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from cadcam.arrays import Array
from cadcam.camera.camera import Camera
from cadcam.camera.lens import BrownConrady, Fisheye, Ideal, Lens, TiltedBrownConrady, lens_from_opencv
from cadcam.files.foreign.model import Files, Foreign, Format, Holds, NamedCamera, WriteOptions
from cadcam.files.foreign.pose import numbers
from cadcam.files.foreign.source import ForeignFile
from cadcam.files.foreign.xmltext import Node, parsed_xml
from cadcam.files.jsontext import Place, parsed
from cadcam.files.yamltext import parsed_yaml, yaml_number
from cadcam.geometry import rotation as so3
from cadcam.geometry.rigid import Rigid

# names of the matrix and of the distortion in samples and common programs; one pair per camera
_NAMES = (
    ("camera_matrix", "distortion_coefficients"),
    ("Camera_Matrix", "Distortion_Coefficients"),
    ("camera_matrix", "dist_coeffs"),
    ("cameraMatrix", "distCoeffs"),
    ("camera_matrix", "distortion"),
    ("K", "D"),
    ("M1", "D1"),
    ("M2", "D2"),
    ("K1", "D1"),
    ("K2", "D2"),
)
_WIDTH, _HEIGHT = ("image_width", "image_Width", "width"), ("image_height", "image_Height", "height")
_VIEWS = ("extrinsic_parameters", "Extrinsic_Parameters")
_READ = {*(name for pair in _NAMES for name in pair), *_WIDTH, *_HEIGHT, *_VIEWS, "fisheye_model"}


def recognises(source: ForeignFile) -> bool:
    """Return whether this is FileStorage with a camera matrix."""
    head = source.head()
    storage = re.match(r"\s*%YAML:1\.\d", head) or "opencv-matrix" in head or "<opencv_storage>" in head
    return bool(storage) and any(re.search(rf"\b{matrix}\b", head) for matrix, _ in _NAMES)


def read(source: ForeignFile) -> Foreign:
    """Return the cameras; one for each view where the file has extrinsic parameters."""
    root = _storage(source)
    size = _size(source, root)
    cameras, notes = [], []
    for matrix, distortion in _NAMES:
        if matrix in root.object and (distortion in root.object or distortion == "distortion_coefficients"):
            camera = Camera(size, _matrix(root.at(matrix), (3, 3)), _lens(root, distortion))
            cameras.append(NamedCamera(matrix if matrix[-1] in "12" else "camera", camera))
            if camera.skew:
                notes.append(f"K01 = {camera.skew:g} px is read as skew; OpenCV itself ignores it")
    if not cameras:
        raise root.error("has no camera matrix", f"known names: {', '.join(dict.fromkeys(m for m, _ in _NAMES))}")
    views = next((name for name in _VIEWS if name in root.object), None)
    if views and len(cameras) == 1:
        cameras = _posed(cameras[0], _matrix(root.at(views), (None, 6)), source.mm)
    return Foreign("opencv", tuple(cameras), tuple(notes))


def write(cameras: Sequence[NamedCamera], target: WriteOptions) -> Files:
    """Write one camera, YAML or (by the name's suffix) XML; its pose as the one view."""
    named = cameras[0]
    camera = named.camera
    values: dict[str, Any] = {"image_width": camera.width, "image_height": camera.height}
    if isinstance(camera.lens, Fisheye):
        values["fisheye_model"] = 1
    values["camera_matrix"] = camera.K
    values["distortion_coefficients"] = coefficients(camera.lens)[:, None]
    if named.camera_from_world is not None:
        pose = named.camera_from_world
        values["extrinsic_parameters"] = np.concatenate([so3.log(pose.rotation), pose.translation / target.mm])[None]
    text = _as_xml(values) if target.name.lower().endswith(".xml") else _as_yaml(values)
    return {"": text.encode()}


def coefficients(lens: Lens) -> Array:
    """Return OpenCV's shortest distortion vector of a lens: 5, 8, 12 or 14 numbers; 4 of a fisheye."""
    c = np.array(list(lens.parameters.values()))
    if isinstance(lens, Ideal):
        return np.zeros(5)
    return c if isinstance(lens, Fisheye) else next(c[:n] for n in (5, 8, 12, 14) if not c[n:].any())


def _storage(source: ForeignFile) -> Place:
    head = source.head().lstrip()
    if head.startswith("<"):
        root = parsed_xml(source.text())
        if root.tag != "opencv_storage":
            raise root.error("is not <opencv_storage>", "name the format: --from (format_name=)")
        # what is beside the camera may be anything: NaN as a view's error, arrays of one dimension
        return Place(source.path, (), {child.tag: _xml_value(child) for child in root.all("*") if child.tag in _READ})
    return parsed(source.text()) if head.startswith("{") else parsed_yaml(source.text())


def _xml_value(node: Node) -> Any:
    if node.element.get("type_id") in ("opencv-matrix", "opencv-nd-matrix"):
        shape = {name: node.number(name) for name in ("rows", "cols") if node.maybe(name) is not None}
        return {**shape, "data": node.at("data").numbers().tolist()}
    words = node.text().split()
    try:
        return float(words[0]) if len(words) == 1 else node.text()
    except ValueError:
        return node.text()


def _size(source: ForeignFile, root: Place) -> tuple[int, int]:
    for width, height in zip(_WIDTH, _HEIGHT, strict=True):
        if width in root.object and height in root.object:
            return root.at(width).whole(), root.at(height).whole()
    return source.needed_size("this file")


def _matrix(place: Place, shape: tuple[int | None, int]) -> Array:
    """Return an opencv-matrix, or a list of rows, as an array of this shape."""
    if not isinstance(place.value, dict):
        return place.array(shape)
    rows, columns = place.at("rows").whole(), place.at("cols").whole()
    data = place.at("data").array((None,))
    if rows * columns != data.size or columns != shape[1] or shape[0] not in (None, rows):
        raise place.error(f"is {rows} x {columns} with {data.size} numbers", f"expected shape {shape}")
    return data.reshape(rows, columns)


def _lens(root: Place, name: str) -> Lens:
    if name not in root.object or root.object[name] is None:
        return Ideal()
    place = root.at(name)
    values = place.at("data") if isinstance(place.value, dict) else place
    nested = isinstance(values.value, list) and any(isinstance(v, list) for v in values.value)
    c = values.array((None, None) if nested else (None,)).ravel()
    if "fisheye_model" in root.object and root.at("fisheye_model").number():
        if c.size != 4:
            raise place.error(f"has {c.size} numbers", "a fisheye has 4")
        return Fisheye(*c.tolist())
    return place.build(lambda: lens_from_opencv(c))


def _posed(named: NamedCamera, views: Array, mm: float) -> list[NamedCamera]:
    poses = [Rigid(so3.exp(view[:3]), view[3:] * mm) for view in views]
    names = [named.name] if len(poses) == 1 else [f"{i:04d}" for i in range(len(poses))]
    return [NamedCamera(name, named.camera, pose) for name, pose in zip(names, poses, strict=True)] or [named]


def _as_yaml(values: dict[str, Any]) -> str:
    lines = ["%YAML:1.0", "---"]
    for name, value in values.items():
        if isinstance(value, int):
            lines.append(f"{name}: {value}")
            continue
        rows, columns = value.shape
        lines += [f"{name}: !!opencv-matrix", f"   rows: {rows}", f"   cols: {columns}", "   dt: d"]
        lines.append(f"   data: [ {', '.join(map(yaml_number, numbers(value)))} ]")
    return "\n".join(lines) + "\n"


def _as_xml(values: dict[str, Any]) -> str:
    lines = ['<?xml version="1.0"?>', "<opencv_storage>"]
    for name, value in values.items():
        if isinstance(value, int):
            lines.append(f"<{name}>{value}</{name}>")
            continue
        rows, columns = value.shape
        lines.append(f'<{name} type_id="opencv-matrix">')
        lines.append(f"  <rows>{rows}</rows><cols>{columns}</cols><dt>d</dt>")
        lines += [f"  <data>{' '.join(map(repr, numbers(value)))}</data>", f"</{name}>"]
    return "\n".join([*lines, "</opencv_storage>", ""])


OPENCV_LENSES: Mapping[str, tuple[str, ...]] = {
    "ideal": (),
    "brown-conrady": tuple(BrownConrady().parameters),
    "tilted-brown-conrady": tuple(TiltedBrownConrady().parameters),
    "fisheye": tuple(Fisheye().parameters),
}
FORMAT = Format(
    name="opencv",
    title="OpenCV FileStorage",
    suffixes=(".yml", ".yaml", ".xml"),
    holds=Holds(OPENCV_LENSES, skew="ignored", pose="yes"),
    recognises=recognises,
    read=read,
    write=write,
)
