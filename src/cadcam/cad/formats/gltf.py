"""glTF 2.0, as .gltf or .glb: a tree of named nodes, in metres by the specification."""

from __future__ import annotations

import base64
import binascii
import json
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Array
from cadcam.cad.formats.model import Model, assembled
from cadcam.cad.formats.polygons import fan, strip
from cadcam.cad.mesh import Mesh
from cadcam.errors import UnreadableFile

_AGAIN = "export it again"
_COMPRESSED = ("KHR_draco_mesh_compression", "EXT_meshopt_compression")
_INSTANCED = "EXT_mesh_gpu_instancing"
_QUANTIZED = "KHR_mesh_quantization"  # no more than other component types, which are read
_OF_LOOKS = ("KHR_materials_", "KHR_texture_", "EXT_texture_", "MSFT_texture_", "KHR_lights_", "EXT_lights_")
_TYPE = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTH = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
_TRIANGLES, _STRIP, _FAN = 4, 5, 6
SURFACES = "cadcam:surfaces"


def read_gltf(path: Path, data: bytes) -> Model:
    """Return the triangles of the default scene; every node with a mesh is a part, points and lines are ignored.

    The colour of a face is the base colour of its material times the mean of its vertices' colours, converted from
    linear light to sRGB; textures are ignored. Files that this package wrote with surfaces are marked, and keep them.
    """
    scene = GltfDocument(path, data)
    extras = scene.json["asset"].get("extras")  # of any type
    brep = isinstance(extras, dict) and extras.get(SURFACES) == "primitives"
    return Model(collected(path, list(scene.shapes()), brep=brep), unit="m")


@dataclass(frozen=True, slots=True, eq=False)
class Primitive:
    """Triangles of one material, in the frame of their node."""

    points: Array
    faces: npt.NDArray[np.int64]
    normals: Array | None
    colors: Array  # of the faces: sRGB, NaN where there is none


@dataclass(frozen=True, slots=True, eq=False)
class Shape:
    """A node with a mesh: the names from the root down, world_from_node (4, 4), and its triangle primitives."""

    names: tuple[str, ...]
    world: Array
    mesh_name: str
    primitives: list[Primitive]


@np.errstate(over="ignore", invalid="ignore")  # coordinates that are no numbers are refused with their place
def collected(path: Path, shapes: list[Shape], *, brep: bool) -> Mesh:
    """Return one mesh of all shapes, in the world frame and the unit of the file.

    With `brep`, each primitive is one surface of a solid: it gets its own surface number and its normals are kept.
    """
    points, faces, part, surface, normals, names, colors = [], [], [], [], [], [], []
    at, n_surfaces = 0, 0
    for number, shape in enumerate(shapes):
        turn, shift = shape.world[:3, :3], shape.world[:3, 3]
        mirrored = np.linalg.det(turn) < 0
        for primitive in shape.primitives:
            triangles = primitive.faces[:, ::-1] if mirrored else primitive.faces
            points.append(primitive.points @ turn.T + shift)
            faces.append(triangles + at)
            part.append(np.full(len(triangles), number))
            surface.append(np.full(len(triangles), n_surfaces if brep else -1))
            colors.append(primitive.colors)
            if brep and primitive.normals is not None and len(primitive.normals) == len(primitive.points):
                normals.append(_corner_normals(primitive.normals, triangles, turn))
            n_surfaces += 1
            at += len(primitive.points)
        names.append(_label(shape, path.stem))
    return assembled(
        path,
        np.concatenate([np.zeros((0, 3)), *points]),
        np.concatenate([np.zeros((0, 3), np.int64), *faces]),
        part=np.concatenate([np.zeros(0, np.int64), *part]),
        names=names,
        face_colors=np.concatenate([np.zeros((0, 3)), *colors]),
        surface=np.concatenate([np.zeros(0, np.int64), *surface]),
        corner_normals=np.concatenate(normals) if len(normals) == n_surfaces > 0 else None,
    )


def _label(shape: Shape, fallback: str) -> str:
    """Return the name of the node, or of its nearest named ancestor."""
    for name in (shape.names[-1], shape.mesh_name, *reversed(shape.names)):
        if name and not name.startswith("=>[") and name not in ("SOLID", "COMPOUND", "SHELL", "COMPSOLID", "FACE"):
            return name
    return fallback


def _corner_normals(normals: Array, triangles: npt.NDArray[np.int64], turn: Array) -> Array:
    """Return the normals at the corners of triangles, transformed as planes: by cofactors, which exist for scale 0."""
    turned = normals @ (np.cross(turn[[1, 2, 0]], turn[[2, 0, 1]]).T * np.copysign(1.0, np.linalg.det(turn)))
    length = np.linalg.norm(turned, axis=1, keepdims=True)
    return np.asarray((turned / np.where(length > 0, length, 1))[triangles])


class GltfDocument:
    """The JSON of a file and the bytes it refers to; every reference is checked before it is followed."""

    def __init__(self, path: Path, data: bytes) -> None:
        self.path = path
        self.binary: bytes | None = None
        text = self._chunks(data) if data[:4] == b"glTF" else data
        try:
            self.json: dict[str, Any] = json.loads(text)
            version = str(self.json["asset"]["version"])
        except (ValueError, KeyError, TypeError, RecursionError) as error:
            raise UnreadableFile(path, f"holds no valid glTF JSON ({error})", _AGAIN) from None
        if not version.startswith("2"):
            raise UnreadableFile(path, f"is glTF {version}", "only glTF 2 is read")
        required = self.json.get("extensionsRequired")
        for name in required if isinstance(required, list) else ():
            if name in _COMPRESSED:
                raise UnreadableFile(path, f"is compressed with {name}", "export it without mesh compression")
            if not str(name).startswith(_OF_LOOKS) and name != _QUANTIZED:
                raise UnreadableFile(path, f"needs the extension {name}, which is not read here", "export it without")
        self.buffers: dict[int, bytes] = {}

    def _chunks(self, data: bytes) -> bytes:
        """Return the JSON chunk of a GLB; keep its binary chunk."""
        if len(data) < 20:
            raise UnreadableFile(self.path, f"is only {len(data)} bytes long: truncated", _AGAIN)
        version, length = struct.unpack_from("<II", data, 4)
        if version != 2:
            raise UnreadableFile(self.path, f"is GLB version {version}", "only version 2 is read")
        if length > len(data):
            raise UnreadableFile(
                self.path, f"its header (byte 8) claims {length} bytes but the file has {len(data)}: truncated", _AGAIN
            )
        text, at = b"", 12
        while at + 8 <= length:
            size, kind = struct.unpack_from("<I4s", data, at)
            if at + 8 + size > length:
                raise UnreadableFile(self.path, f"the chunk at byte {at} claims {size} bytes: truncated", _AGAIN)
            chunk = data[at + 8 : at + 8 + size]
            if kind == b"JSON":
                text = chunk
            elif kind == b"BIN\0" and self.binary is None:
                self.binary = chunk
            at += 8 + size
        return text

    def shapes(self) -> Iterator[Shape]:
        """Yield every node that has triangles, with its pose in the world."""
        try:
            for node, world, names in self._nodes():
                if _INSTANCED in (node.get("extensions") or ()):
                    what = f"node {names[-1]!r} places its mesh many times ({_INSTANCED})"
                    raise UnreadableFile(self.path, what, "export it with a node for each")
                if "mesh" in node:
                    mesh = self._entry("meshes", node["mesh"])
                    primitives = [p for raw in mesh["primitives"] if (p := self._primitive(raw)) is not None]
                    if primitives:
                        yield Shape(names, world, str(mesh.get("name", "")), primitives)
        except (KeyError, IndexError, TypeError, ValueError, AttributeError, OverflowError) as error:
            raise UnreadableFile(
                self.path, f"its JSON is inconsistent ({type(error).__name__}: {error})", _AGAIN
            ) from None

    def _nodes(self) -> Iterator[tuple[dict[str, Any], Array, tuple[str, ...]]]:
        """Yield the nodes of the tree, each with its pose in the world, its own name and those above it."""
        stack: list[tuple[int, Array, tuple[str, ...]]] = [(root, np.eye(4), ()) for root in reversed(self._roots())]
        visited: set[int] = set()
        while stack:
            number, world, names = stack.pop()
            if number in visited:
                raise UnreadableFile(self.path, f"node {number} stands twice in the tree", _AGAIN)
            visited.add(number)
            node = self._entry("nodes", number)
            world = world @ _placement(node)
            names = (*names, str(node.get("name", "")))
            stack.extend((child, world, names) for child in reversed(node.get("children", [])))
            yield node, world, names

    def _roots(self) -> list[int]:
        """Return the nodes of the default scene, or those that no other node has as a child."""
        if self.json.get("scenes"):
            roots: list[int] = self._entry("scenes", self.json.get("scene", 0)).get("nodes", [])
            return roots
        nodes = self.json.get("nodes", [])
        below = {child for node in nodes for child in node.get("children", [])}
        return [i for i in range(len(nodes)) if i not in below]

    def _primitive(self, raw: dict[str, Any]) -> Primitive | None:
        mode = raw.get("mode", _TRIANGLES)
        if mode not in (_TRIANGLES, _STRIP, _FAN):
            return None
        points = self._vectors(raw["attributes"]["POSITION"])
        index = self._accessor(raw["indices"]).ravel().astype(np.int64) if "indices" in raw else np.arange(len(points))
        missing = (index < 0) | (index >= len(points))
        if missing.any():
            at = int(np.argmax(missing))
            raise UnreadableFile(
                self.path,
                f"accessor {raw['indices']}, entry {at} refers to vertex {int(index[at])} of {len(points)}",
                _AGAIN,
            )
        normals = raw["attributes"].get("NORMAL")
        triangles = _triangles(index, mode)
        return Primitive(
            points,
            triangles,
            None if normals is None else self._vectors(normals),
            self._colors(raw, triangles, len(points)),
        )

    def _colors(self, raw: dict[str, Any], triangles: npt.NDArray[np.int64], n_points: int) -> Array:
        """Return the sRGB of each triangle of a primitive, NaN where neither material nor vertices have a colour."""
        material = raw.get("material")
        surface = {} if material is None else self._entry("materials", material).get("pbrMetallicRoughness", {})
        factor, number = surface.get("baseColorFactor"), raw["attributes"].get("COLOR_0")
        if factor is None and number is None:
            return np.full((len(triangles), 3), np.nan)
        linear = np.ones((len(triangles), 3)) * np.array([1, 1, 1] if factor is None else factor[:3], float)
        if number is not None:
            of_vertices = self._accessor(number).astype(np.float64)[:, :3]
            if len(of_vertices) != n_points:
                what = f"accessor {number} has {len(of_vertices)} colours for {n_points} vertices"
                raise UnreadableFile(self.path, what, _AGAIN)
            linear *= of_vertices[triangles].mean(axis=1)
        linear = np.clip(linear, 0, 1)
        curved = 1.055 * linear ** (1 / 2.4) - 0.055
        return np.asarray(np.where(linear <= 0.0031308, 12.92 * linear, curved))  # IEC 61966-2-1

    def _vectors(self, number: int) -> Array:
        rows = self._accessor(number)
        if rows.shape[1] != 3:
            raise UnreadableFile(self.path, f"accessor {number} has {rows.shape[1]} numbers a vertex, not 3", _AGAIN)
        return rows.astype(np.float64)

    def _accessor(self, number: int) -> npt.NDArray[Any]:
        """Return the rows (count, width) of an accessor, sparse ones with their replacements."""
        accessor = self._entry("accessors", number)
        if "bufferView" not in accessor:
            raise UnreadableFile(self.path, f"accessor {number} has no data", _AGAIN)
        kind, width = np.dtype(_TYPE[accessor["componentType"]]), _WIDTH[accessor["type"]]
        rows = self._rows(number, accessor, int(accessor["count"]), kind, width)
        if sparse := accessor.get("sparse"):
            count, places = int(sparse["count"]), sparse["indices"]
            at = self._rows(number, places, count, np.dtype(_TYPE[places["componentType"]]), 1)[:, 0]
            if at.size and not 0 <= int(at.min()) <= int(at.max()) < len(rows):
                what = f"accessor {number} replaces entries {at.min()} to {at.max()} of {len(rows)}"
                raise UnreadableFile(self.path, what, _AGAIN)
            rows = rows.copy()
            rows[at] = self._rows(number, sparse["values"], count, kind, width)
        if accessor.get("normalized") and kind.kind in "iu":
            return np.maximum(rows / np.iinfo(kind).max, -1.0)
        return rows

    def _rows(
        self, number: int, place: dict[str, Any], count: int, kind: np.dtype[Any], width: int
    ) -> npt.NDArray[Any]:
        """Return rows (count, width) of accessor `number` from the view that `place` names, none beyond its end."""
        view = self._entry("bufferViews", place["bufferView"])
        data = self._buffer(view["buffer"])
        stride = int(view.get("byteStride", kind.itemsize * width))
        offset, inner = int(view.get("byteOffset", 0)), int(place.get("byteOffset", 0))
        end = min(len(data), offset + int(view.get("byteLength", len(data))))
        need = offset + inner + (stride * (count - 1) + kind.itemsize * width if count else 0)
        if min(count, offset, inner) < 0 or stride < kind.itemsize * width or need > end:
            what = f"accessor {number} claims {count} entries up to byte {need} of a buffer view that ends at {end}"
            raise UnreadableFile(self.path, f"{what}: truncated", _AGAIN)
        return np.ndarray((count, width), kind, data, offset + inner, (stride, kind.itemsize))

    def _entry(self, kind: str, number: int) -> dict[str, Any]:
        """Return one of the file's objects; a negative number would be counted from the end."""
        if number < 0:
            raise IndexError(f"{kind} {number}")
        entry: dict[str, Any] = self.json[kind][number]
        return entry

    def _buffer(self, number: int) -> bytes:
        if number not in self.buffers:
            uri = self._entry("buffers", number).get("uri")
            if uri is None:
                if self.binary is None:
                    raise UnreadableFile(self.path, "has no binary chunk: truncated", _AGAIN)
                self.buffers[number] = self.binary
            else:
                self.buffers[number] = self._fetched(uri)
        return self.buffers[number]

    def _fetched(self, uri: str) -> bytes:
        if uri.startswith("data:"):
            try:
                return base64.b64decode(uri.partition(",")[2], validate=True)
            except binascii.Error:
                raise UnreadableFile(self.path, "holds a damaged base64 buffer", _AGAIN) from None
        name = unquote(uri)
        target = self.path.parent / name
        if "://" in uri or Path(name).is_absolute() or ".." in Path(name).parts:
            raise UnreadableFile(self.path, f"refers to {uri!r}, outside its own folder", "export it as one .glb file")
        try:
            return target.read_bytes()
        except OSError as error:
            raise UnreadableFile(target, f"cannot be read ({error.strerror})", f"{self.path.name} needs it") from None


def _placement(node: dict[str, Any]) -> Array:
    """Return parent_from_node (4, 4)."""
    if "matrix" in node:
        return np.array(node["matrix"], float).reshape(4, 4).T
    place = np.eye(4)
    x, y, z, w = (float(q) for q in node.get("rotation", (0, 0, 0, 1)))
    n = x * x + y * y + z * z + w * w
    s = 2 / n if n > 0 else 0.0
    turn = np.eye(3) - s * np.array(
        [
            [y * y + z * z, z * w - x * y, -x * z - y * w],
            [-x * y - z * w, x * x + z * z, x * w - y * z],
            [y * w - x * z, -x * w - y * z, x * x + y * y],
        ]
    )
    place[:3, :3] = turn * np.array(node.get("scale", (1, 1, 1)), float)
    place[:3, 3] = node.get("translation", (0, 0, 0))
    return place


def _triangles(index: npt.NDArray[np.int64], mode: int) -> npt.NDArray[np.int64]:
    if mode == _TRIANGLES:
        return index[: len(index) // 3 * 3].reshape(-1, 3)
    return fan(index) if mode == _FAN else strip(index)
