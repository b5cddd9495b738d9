"""Write a mesh as STL, OBJ, PLY or GLB: the whole file or none, and the same bytes every time."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable, Iterator
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from cadcam.cad.formats.gltf import SURFACES
from cadcam.cad.mesh import Mesh, compacted
from cadcam.cad.topology import SEAM_SHARE
from cadcam.errors import BadValue
from cadcam.kinds import expect, expect_known, expect_path
from cadcam.whole import write_whole


def write_model(path: str | PathLike[str], mesh: Mesh) -> None:
    """Write the mesh to `path` in the format of its suffix; whole or not at all; missing folders are made.

    STL (binary) and PLY (binary) hold one nameless part; OBJ keeps parts as groups; GLB, in metres, keeps names,
    colours and, where the mesh has them, surfaces and their normals. STL, PLY and OBJ are in mm. Raises
    `UnknownName` for another suffix, `BadValue` for a mesh so far from the origin that the 24 bits of STL and GLB
    would bend it, and `UnwritableFile`.
    """
    expect_path(path)
    expect(mesh, "mesh", Mesh)
    suffix = Path(path).suffix.lower()
    expect_known(suffix, "format to write", _WRITERS)
    mesh = compacted(mesh)
    if suffix in _SINGLE and mesh.n_faces:
        _refuse_coarse(suffix, mesh)
    write_whole(path, _WRITERS[suffix](mesh))


def _refuse_coarse(suffix: str, mesh: Mesh) -> None:
    """Raise `BadValue` where the float32 of a format rounds corners farther than `SEAM_SHARE` of the mesh."""
    far, size = float(np.abs(mesh.vertices).max()), float(np.linalg.norm(mesh.size_mm))
    step = float(np.spacing(np.float32(far)))
    if step > SEAM_SHARE * size > 0:
        what = f"{size:.4g} mm large and {far:.4g} mm from the origin"
        remedy = f"one nearer to it, as {suffix} has steps of {step:.2g} mm out there; .ply and .obj keep it"
        raise BadValue("mesh", what, remedy)


def _stl(mesh: Mesh) -> bytes:
    record = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    table = np.zeros(mesh.n_faces, record)
    table["normal"], table["corners"] = mesh.face_normals, mesh.vertices[mesh.faces]
    return b"cadcam, millimetres".ljust(80, b"\0") + struct.pack("<I", mesh.n_faces) + table.tobytes()


def _ply(mesh: Mesh) -> bytes:
    header = (
        "ply\nformat binary_little_endian 1.0\ncomment cadcam, millimetres\n"
        f"element vertex {len(mesh.vertices)}\nproperty double x\nproperty double y\nproperty double z\n"
        f"element face {mesh.n_faces}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    table = np.zeros(mesh.n_faces, np.dtype([("count", "u1"), ("corners", "<i4", 3)]))
    table["count"], table["corners"] = 3, mesh.faces
    return header.encode() + mesh.vertices.astype("<f8").tobytes() + table.tobytes()


def _obj(mesh: Mesh) -> bytes:
    lines = ["# cadcam, millimetres"]
    n = _digits(mesh)
    lines += [f"v {x:.{n}g} {y:.{n}g} {z:.{n}g}" for x, y, z in (mesh.vertices + 0.0).tolist()]
    for number, name in enumerate(mesh.part_names):
        lines.append(f"g {' '.join(name.splitlines())}")
        lines += [f"f {a} {b} {c}" for a, b, c in (mesh.faces[mesh.part == number] + 1).tolist()]
    return ("\n".join(lines) + "\n").encode()


def _digits(mesh: Mesh) -> int:
    """Return the digits of coordinates: nine, and more for a mesh that is small beside its distance from the origin."""
    if not mesh.n_faces:
        return 9
    far, size = float(np.abs(mesh.vertices).max()), float(mesh.size_mm.max())
    return 17 if far > _FAR * size else 9


def _glb(mesh: Mesh) -> bytes:
    """Return one node for each part; a primitive for each colour, and for each surface if all are known."""
    keep = bool((mesh.surface >= 0).all())
    buffer, materials = _Buffer(), _Materials()
    nodes, meshes = [], []
    colors = mesh.colors_of_faces
    for number, name in enumerate(mesh.part_names):
        groups = _groups(mesh, np.flatnonzero(mesh.part == number), colors, by_surface=keep)
        primitives = [{**buffer.primitive(mesh, faces), **materials.of(colors[faces[0]])} for faces in groups]
        meshes.append({"name": name, "primitives": primitives})
        nodes.append({"name": name, "mesh": number})
    asset: dict[str, Any] = {"version": "2.0", "generator": "cadcam"}
    if keep:
        asset["extras"] = {SURFACES: "primitives"}
    content: dict[str, Any] = {
        "asset": asset,
        "scene": 0,
        "scenes": [{"nodes": list(range(len(nodes)))}],
        "nodes": nodes,
        "meshes": meshes,
        "accessors": buffer.accessors,
        "bufferViews": buffer.views,
        "buffers": [{"byteLength": len(buffer.data)}],
    }
    if materials.all:
        content["materials"] = materials.all
    text = json.dumps(content, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(buffer.data), b"BIN\0")
    chunks += bytes(buffer.data)
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def _groups(
    mesh: Mesh, faces: npt.NDArray[np.int64], colors: npt.NDArray[np.float32], *, by_surface: bool
) -> Iterator[npt.NDArray[np.int64]]:
    """Yield the faces by surface and colour."""
    surface = mesh.surface[faces] if by_surface else np.zeros(len(faces))
    key = np.column_stack([surface, np.nan_to_num(colors[faces], nan=-1)])
    order = np.lexsort(key.T[::-1])
    yield from np.split(faces[order], np.flatnonzero(np.diff(key[order], axis=0).any(axis=1)) + 1)


class _Materials:
    """The materials of a GLB under construction."""

    def __init__(self) -> None:
        self.all: list[dict[str, Any]] = []
        self._number: dict[bytes, int] = {}

    def of(self, color: npt.NDArray[np.float32]) -> dict[str, int]:
        """Return the material index of a primitive of an sRGB colour; nothing where the colour is not known."""
        if np.isnan(color).any():
            return {}
        if color.tobytes() not in self._number:
            srgb = color.astype(float)
            linear = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
            factor = [round(x, 6) for x in [*linear.tolist(), 1.0]]
            self._number[color.tobytes()] = len(self.all)
            self.all.append({"pbrMetallicRoughness": {"baseColorFactor": factor, "metallicFactor": 0.0}})
        return {"material": self._number[color.tobytes()]}


class _Buffer:
    """The binary chunk of a GLB under construction."""

    def __init__(self) -> None:
        self.data = bytearray()
        self.views: list[dict[str, int]] = []
        self.accessors: list[dict[str, Any]] = []

    def primitive(self, mesh: Mesh, faces: npt.NDArray[np.int64]) -> dict[str, Any]:
        """Add some faces; vertices with several normals are repeated."""
        corners = mesh.faces[faces].ravel()
        if mesh.corner_normals is None:
            vertices, index = np.unique(corners, return_inverse=True)
            attributes = {}
        else:
            normals = mesh.corner_normals[faces].reshape(-1, 3)
            rows = np.column_stack([corners.astype(np.float64), normals])
            _, first, index = np.unique(rows, axis=0, return_index=True, return_inverse=True)
            vertices = corners[first]
            attributes = {"NORMAL": self._add(normals[first].astype("<f4"), "VEC3", 5126)}
        points = (mesh.vertices[vertices] / 1e3).astype("<f4")
        attributes["POSITION"] = self._add(points, "VEC3", 5126)
        span = {"min": points.min(axis=0).tolist(), "max": points.max(axis=0).tolist()}
        self.accessors[attributes["POSITION"]].update(span)
        small = len(vertices) < 65536
        index = index.ravel().astype("<u2" if small else "<u4")
        return {"attributes": attributes, "indices": self._add(index, "SCALAR", 5123 if small else 5125)}

    def _add(self, values: npt.NDArray[Any], kind: str, component: int) -> int:
        self.data += bytes(-len(self.data) % 4)
        raw = values.tobytes()
        self.views.append({"buffer": 0, "byteOffset": len(self.data), "byteLength": len(raw)})
        self.data += raw + bytes(-len(raw) % 4)
        view = {"bufferView": len(self.views) - 1, "componentType": component, "count": len(values), "type": kind}
        self.accessors.append(view)
        return len(self.accessors) - 1


_WRITERS: dict[str, Callable[[Mesh], bytes]] = {".stl": _stl, ".ply": _ply, ".obj": _obj, ".glb": _glb}
_SINGLE = (".stl", ".glb")  # of float32
_FAR = 100.0  # times its size from the origin: nine digits are a ten-millionth of the mesh there, and less beyond
