"""COLMAP: a folder with cameras and images, text or binary.

COLMAP's pixels count from the corner of the picture: its principal point is ours plus 1/2 in x and y. An image's pose
is cam_from_world, a Hamilton quaternion (w, x, y, z) and a translation in the reconstruction's unit; axes as here.
Source: colmap `doc/format.rst`, `src/colmap/sensor/models.h`, `src/colmap/scene/reconstruction_io_binary.cc`.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array
from cadcam.camera.camera import Camera
from cadcam.camera.lens import BrownConrady, Division, ExtendedUnified, FieldOfView, Fisheye, Ideal, Lens
from cadcam.errors import BadValue, UnknownName, UnreadableFile
from cadcam.files.foreign.model import Files, Foreign, Format, Holds, NamedCamera, WriteOptions
from cadcam.files.foreign.pose import numbers
from cadcam.files.foreign.source import ForeignFile
from cadcam.files.text import TextFile, number_in
from cadcam.geometry import rotation as so3
from cadcam.geometry.rigid import Rigid

CORNER = 0.5  # COLMAP's (0, 0) is the corner of the top-left pixel, ours its centre


@dataclass(frozen=True, slots=True)
class _CameraModel:
    number: int
    name: str
    focals: int  # 1: f, 2: fx, fy; then cx, cy
    terms: int
    lens: Callable[..., Lens]


_MODELS = (
    _CameraModel(0, "SIMPLE_PINHOLE", 1, 0, Ideal),
    _CameraModel(1, "PINHOLE", 2, 0, Ideal),
    _CameraModel(2, "SIMPLE_RADIAL", 1, 1, BrownConrady),
    _CameraModel(3, "RADIAL", 1, 2, BrownConrady),
    _CameraModel(4, "OPENCV", 2, 4, BrownConrady),
    _CameraModel(5, "OPENCV_FISHEYE", 2, 4, Fisheye),
    _CameraModel(6, "FULL_OPENCV", 2, 8, BrownConrady),
    _CameraModel(7, "FOV", 2, 1, FieldOfView),
    _CameraModel(8, "SIMPLE_RADIAL_FISHEYE", 1, 1, Fisheye),
    _CameraModel(9, "RADIAL_FISHEYE", 1, 2, Fisheye),
    _CameraModel(12, "SIMPLE_DIVISION", 1, 1, Division),
    _CameraModel(13, "DIVISION", 2, 1, Division),
    _CameraModel(14, "SIMPLE_FISHEYE", 1, 0, Fisheye),
    _CameraModel(15, "FISHEYE", 2, 0, Fisheye),
    _CameraModel(16, "EUCM", 2, 2, ExtendedUnified),
)
_WRITTEN = ("PINHOLE", "OPENCV", "OPENCV_FISHEYE", "FULL_OPENCV", "FOV", "DIVISION", "EUCM")  # with two focal lengths
_BY_NAME = {model.name: model for model in _MODELS}
_BY_NUMBER = {model.number: model for model in _MODELS}


def recognises_text(source: ForeignFile) -> bool:
    """Return whether this is cameras.txt, or a folder with it."""
    if source.is_folder:
        return source.has("cameras.txt")
    lines = [line.split() for line in source.head().splitlines() if line.strip() and not line.startswith("#")]
    return bool(lines) and len(lines[0]) > 6 and lines[0][0].isdigit() and lines[0][1].isupper()


def recognises_binary(source: ForeignFile) -> bool:
    """Return whether this is cameras.bin, or a folder with it."""
    if source.is_folder:
        return source.has("cameras.bin")
    data = source.data()
    if len(data) < 32:
        return False
    count, _, model = struct.unpack_from("<QIi", data)
    return 0 < count < 1 << 20 and model in range(18) and b"\0\0\0\0" in data[:8]


def read_text(source: ForeignFile) -> Foreign:
    """Return the cameras of images.txt if it is there, else those of cameras.txt."""
    file = source.text("cameras.txt" if source.is_folder else "")
    cameras = dict(_camera_lines(file))
    poses = list(_image_lines(source.text("images.txt"))) if source.has("images.txt") else []
    return _joined("colmap", source, cameras, poses)


def read_binary(source: ForeignFile) -> Foreign:
    """Return the cameras of images.bin if it is there, else those of cameras.bin."""
    name = "cameras.bin" if source.is_folder else ""
    cameras = dict(_RecordReader(source.at(name), source.data(name)).cameras())
    poses = []
    if source.has("images.bin"):
        poses = list(_RecordReader(source.at("images.bin"), source.data("images.bin")).images())
    return _joined("colmap-bin", source, cameras, poses)


def write_text(cameras: Sequence[NamedCamera], target: WriteOptions) -> Files:
    """Write cameras.txt, images.txt and an empty points3D.txt."""
    camera_lines, image_lines = ["# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]"], ["# IMAGE_ID, QW, QX, QY, QZ, TX, TY,"]
    image_lines[0] += " TZ, CAMERA_ID, NAME; the next line would hold POINTS2D[]"
    for i, named in enumerate(cameras, start=1):
        model, parameters = _parameters(named.camera)
        size = f"{named.camera.width} {named.camera.height}"
        camera_lines.append(f"{i} {model.name} {size} {' '.join(map(repr, parameters))}")
        if named.camera_from_world is not None:
            pose = " ".join(map(repr, _pose_numbers(named.camera_from_world, target.mm)))
            image_lines += [f"{i} {pose} {i} {named.name.replace(' ', '_')}", ""]
    return {
        "cameras.txt": ("\n".join(camera_lines) + "\n").encode(),
        "images.txt": ("\n".join(image_lines) + "\n").encode(),
        "points3D.txt": b"# POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[]\n",
    }


def write_binary(cameras: Sequence[NamedCamera], target: WriteOptions) -> Files:
    """Write cameras.bin, images.bin and an empty points3D.bin, little-endian."""
    camera_data, image_data = struct.pack("<Q", len(cameras)), b""
    posed = 0
    for i, named in enumerate(cameras, start=1):
        model, parameters = _parameters(named.camera)
        camera_data += struct.pack("<IiQQ", i, model.number, *named.camera.size)
        camera_data += struct.pack(f"<{len(parameters)}d", *parameters)
        if named.camera_from_world is not None:
            posed += 1
            image_data += struct.pack("<I7dI", i, *_pose_numbers(named.camera_from_world, target.mm), i)
            image_data += named.name.encode() + b"\0" + struct.pack("<Q", 0)
    empty = struct.pack("<Q", 0)
    return {"cameras.bin": camera_data, "images.bin": struct.pack("<Q", posed) + image_data, "points3D.bin": empty}


def _parameters(camera: Camera) -> tuple[_CameraModel, list[float]]:
    """Return the smallest model that holds the camera, and its parameters."""
    c = list(camera.lens.parameters.values())
    for name in _WRITTEN:
        model = _BY_NAME[name]
        if model.lens is type(camera.lens) and not any(c[model.terms :]):
            cx, cy = camera.principal_point + CORNER
            return model, numbers(np.array([camera.fx, camera.fy, cx, cy, *c[: model.terms]]))
    raise BadValue("lens", camera.lens, "one that COLMAP has a model for")


def _camera_of(model: _CameraModel, size: tuple[int, int], values: Array) -> Camera:
    fx, fy = values[0], values[model.focals - 1]
    cx, cy = values[model.focals : model.focals + 2] - CORNER
    lens = model.lens(*values[model.focals + 2 :].tolist())
    return Camera(size, np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]), lens)


def _count(model: _CameraModel) -> int:
    return model.focals + 2 + model.terms


def _pose_numbers(camera_from_world: Rigid, mm: float) -> list[float]:
    q = so3.quaternion(camera_from_world.rotation)
    return numbers(np.concatenate([q, camera_from_world.translation / mm]))


_Pose = tuple[str, int, Array]  # name, camera, quaternion and translation


def _joined(name: str, source: ForeignFile, cameras: dict[int, Camera], poses: list[_Pose]) -> Foreign:
    if not cameras:
        raise UnreadableFile(source.path, "holds no camera", "is it cut off?")
    if not poses:
        return Foreign(name, tuple(NamedCamera(f"camera {i}", camera) for i, camera in cameras.items()))
    named = []
    for image, number, values in poses:
        if number not in cameras:
            raise UnreadableFile(source.path, f"image {image[:40]!r} names camera {number}, which is not there")
        pose = Rigid(so3.from_quaternion(values[:4]), values[4:] * source.mm)
        named.append(NamedCamera(image, cameras[number], pose))
    return Foreign(name, tuple(named))


def _camera_lines(file: TextFile) -> Iterator[tuple[int, Camera]]:
    for at, line in enumerate(file.text.splitlines(), start=1):
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        if len(words) < 5:
            raise UnreadableFile(file.path, f"line {at} has {len(words)} words", "is it cut off?")
        if words[1] not in _BY_NAME:
            raise UnreadableFile(file.path, f"line {at} names an {UnknownName('camera model', words[1], _BY_NAME)}")
        model = _BY_NAME[words[1]]
        number, width, height = (_whole(file, at, word) for word in (words[0], *words[2:4]))
        values = np.array([number_in(file, at, f"parameter {i}", word) for i, word in enumerate(words[4:], start=1)])
        if values.size != _count(model):
            raise UnreadableFile(
                file.path, f"line {at} has {values.size} parameters", f"{model.name} has {_count(model)}"
            )
        yield number, _camera_of(model, (width, height), values)


def _image_lines(file: TextFile) -> Iterator[_Pose]:
    """Yield the poses: every other line is the image's points, which may be empty."""
    lines = [(at, line) for at, line in enumerate(file.text.splitlines(), start=1) if not line.startswith("#")]
    for at, line in lines[::2]:
        words = line.split(maxsplit=9)
        if not words:
            continue
        if len(words) < 10:
            raise UnreadableFile(file.path, f"line {at} has {len(words)} words, not 10", "is it cut off?")
        values = np.array([number_in(file, at, f"number {i}", word) for i, word in enumerate(words[1:8], start=1)])
        yield words[9], _whole(file, at, words[8]), values


def _whole(file: TextFile, line: int, word: str) -> int:
    value = number_in(file, line, "a count", word)
    if value != int(value):
        raise UnreadableFile(file.path, f"line {line}: {word[:40]} is no whole number")
    return int(value)


class _RecordReader:
    """Little-endian records, each read checked against the end of the file."""

    def __init__(self, path: str, data: bytes) -> None:
        self.path, self.data, self.at = path, data, 0

    def take(self, layout: str) -> tuple[float, ...]:
        size = struct.calcsize(layout)
        if self.at + size > len(self.data):
            raise UnreadableFile(self.path, f"ends at byte {len(self.data)} within a record", "is it cut off?")
        values = struct.unpack_from(layout, self.data, self.at)
        self.at += size
        return values

    def cameras(self) -> Iterator[tuple[int, Camera]]:
        (count,) = self.take("<Q")
        for _ in range(int(count)):
            number, code, width, height = (int(v) for v in self.take("<IiQQ"))
            if code not in _BY_NUMBER:
                raise UnreadableFile(
                    self.path,
                    f"has a camera of model {code}",
                    f"known: {', '.join(f'{m.number} {m.name}' for m in _MODELS)}",
                )
            model = _BY_NUMBER[code]
            values = np.array(self.take(f"<{_count(model)}d"))
            if not np.isfinite(values).all():
                raise UnreadableFile(self.path, f"camera {number} has a number that is not finite")
            yield number, _camera_of(model, (width, height), values)
        self.finish()

    def images(self) -> Iterator[_Pose]:
        (count,) = self.take("<Q")
        for _ in range(int(count)):
            record = self.take("<I7dI")
            end = self.data.find(b"\0", self.at)
            if end < 0:
                raise UnreadableFile(self.path, "ends within an image's name", "is it cut off?")
            name = self.data[self.at : end].decode("utf-8", "replace")
            self.at = end + 1
            (points,) = self.take("<Q")
            self.at += 24 * int(points)
            if self.at > len(self.data):
                raise UnreadableFile(self.path, f"ends within the points of image {name[:40]!r}", "is it cut off?")
            values = np.array(record[1:8])
            if not np.isfinite(values).all():
                raise UnreadableFile(self.path, f"image {name[:40]!r} has a number that is not finite")
            yield name, int(record[8]), values
        self.finish()

    def finish(self) -> None:
        if self.at != len(self.data):
            raise UnreadableFile(
                self.path, f"has {len(self.data) - self.at} bytes after its last record", "copy it again"
            )


_HOLDS = Holds(
    {
        "ideal": (),
        "brown-conrady": tuple(BrownConrady().parameters)[:8],
        "fisheye": tuple(Fisheye().parameters),
        "field-of-view": ("w",),
        "division": ("k",),
        "extended-unified": ("alpha", "beta"),
    },
    pose="yes",
    several=True,
)
TEXT = Format(
    name="colmap",
    title="COLMAP text",
    suffixes=(),
    holds=_HOLDS,
    recognises=recognises_text,
    read=read_text,
    write=write_text,
    folder=True,
)
BINARY = Format(
    name="colmap-bin",
    title="COLMAP binary",
    suffixes=(),
    holds=_HOLDS,
    recognises=recognises_binary,
    read=read_binary,
    write=write_binary,
    folder=True,
)
