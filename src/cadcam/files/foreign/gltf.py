"""glTF 2.0 perspective cameras, .gltf and .glb.

The picture spans the field of view edge to edge: yfov = 2 atan(H / (2 fy)), aspectRatio = (W/fx) / (H/fy). No principal
point, skew or lens. glTF has no picture size either; "extras": {"size_px": [W, H]}, the place that the specification
leaves to programs, keeps it here. A camera looks along its node's -z with y up; nodes in metres.
Source: KhronosGroup/glTF `specification/2.0/Specification.adoc`, sections on cameras and extras.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Sequence
from typing import Any

import numpy as np

from cadcam.arrays import Array
from cadcam.camera.camera import Camera
from cadcam.errors import UnreadableFile
from cadcam.files.foreign.model import Files, Foreign, Format, Holds, NamedCamera, WriteOptions
from cadcam.files.foreign.pose import camera_from_world_of_eye, numbers, world_from_eye
from cadcam.files.foreign.source import ForeignFile
from cadcam.files.jsontext import Place, as_json, parsed
from cadcam.files.text import text_of
from cadcam.geometry import rotation as so3

_MM = 1000.0
_MAGIC, _JSON = b"glTF", 0x4E4F534A
_DEEPEST = 1000


def recognises(source: ForeignFile) -> bool:
    """Return whether this is glTF with cameras."""
    if not source.is_folder and source.data()[:4] == _MAGIC:
        return b'"cameras"' in source.data()
    head = source.head()
    return '"asset"' in head and '"cameras"' in source.text().text


def read(source: ForeignFile) -> Foreign:
    """Return a camera for each node that has one; cameras without a node have no pose."""
    root = _document(source)
    version = root.at("asset").at("version").text()
    if not version.startswith("2."):
        raise root.error(f"is glTF {version[:20]}", "version 2 is read here")
    cameras = root.at("cameras")
    if not isinstance(cameras.value, list) or not cameras.value:
        raise cameras.error("is no list of cameras", "export with cameras")
    places = [Place(root.path, ("cameras", str(i)), value) for i, value in enumerate(cameras.value)]
    models = [_camera(place, source) for place in places]
    notes = dict.fromkeys(_squeezed(place, model) for place, model in zip(places, models, strict=True))
    named = []
    for name, number, matrix, place in _placed(root):
        if not 0 <= number < len(models):
            raise place.error(f"names camera {number}", f"there are {len(models)}")
        named.append(NamedCamera(name, models[number], camera_from_world_of_eye(matrix, _MM, place.error)))
    found = tuple(named or (NamedCamera(f"camera {i}", c) for i, c in enumerate(models)))
    return Foreign("gltf", found, tuple(note for note in notes if note))


def write(cameras: Sequence[NamedCamera], target: WriteOptions) -> Files:
    """Write a camera and a node for each; near is 1 mm, and there is no far plane."""
    models, nodes = [], []
    for i, named in enumerate(cameras):
        camera = named.camera
        yfov = 2 * np.arctan2(camera.height / 2, camera.fy)
        aspect = (camera.width / camera.fx) / (camera.height / camera.fy)
        lens = {"aspectRatio": float(aspect), "yfov": float(yfov), "znear": 0.001}
        extras = {"size_px": list(camera.size)}
        models.append({"type": "perspective", "name": named.name, "perspective": lens, "extras": extras})
        if named.camera_from_world is not None:
            matrix = world_from_eye(named.camera_from_world, _MM)
            nodes.append({"name": named.name, "camera": i, "matrix": numbers(matrix.T)})
    document: dict[str, Any] = {"asset": {"version": "2.0", "generator": "cadcam"}, "cameras": models}
    if nodes:
        document |= {"scene": 0, "scenes": [{"nodes": list(range(len(nodes)))}], "nodes": nodes}
    return {"": as_json(document)}


def _document(source: ForeignFile) -> Place:
    data = source.data()
    if data[:4] != _MAGIC:
        return parsed(source.text())
    if len(data) < 20:
        raise UnreadableFile(source.path, f"ends after {len(data)} bytes", "is it cut off?")
    version, _, length, kind = struct.unpack_from("<IIII", data, 4)
    if version != 2 or kind != _JSON or 20 + length > len(data):
        raise UnreadableFile(source.path, "is no complete binary glTF 2.0", "is it cut off? or of version 1?")
    return parsed(text_of(source.path, data[20 : 20 + length]))


def _camera(place: Place, source: ForeignFile) -> Camera:
    if place.object.get("type") != "perspective":
        raise place.error(f"is of type {json.dumps(place.object.get('type'))}", "only perspective cameras are read")
    lens = place.at("perspective")
    extras = place.object.get("extras")
    if isinstance(extras, dict) and "size_px" in extras:
        size = place.at("extras").at("size_px")
        width, height = (Place(place.path, size.keys, v).whole() for v in size.array((2,)).tolist())
    else:
        width, height = source.needed_size("a glTF camera")
    yfov = lens.at("yfov").number()
    if not 0 < yfov < np.pi:
        raise lens.error(f"has yfov {yfov:g}", "between 0 and pi, rad")
    fy = height / 2 / np.tan(yfov / 2)
    aspect = lens.at("aspectRatio").number() if "aspectRatio" in lens.object else width / height
    if not aspect > 0:
        raise lens.error(f"has aspectRatio {aspect:g}", "a positive number")
    fx = width * fy / (aspect * height)
    return place.build(lambda: Camera.from_focal((width, height), float(fx), fy=float(fy)))


def _squeezed(place: Place, camera: Camera) -> str:
    """Return what is to be said of a size given with another ratio of its sides than the camera's, by over a pixel."""
    (width, height), aspect = camera.size, camera.width * camera.fy / (camera.height * camera.fx)
    extras = place.object.get("extras")
    if (isinstance(extras, dict) and "size_px" in extras) or abs(aspect * height - width) <= 1:
        return ""
    return (
        f"aspectRatio {aspect:.6g} spans the {width} x {height} px of the picture, with pixels that are not square; "
        f"of square ones {round(aspect * height)} x {height} px have that ratio"
    )


def _placed(root: Place) -> list[tuple[str, int, Array, Place]]:
    """Return (name, camera, 4x4 world_from_node, place) of all nodes with a camera, parents applied."""
    value = root.object.get("nodes", [])
    if not isinstance(value, list):
        raise root.at("nodes").error("is no list")
    nodes = [Place(root.path, ("nodes", str(i)), v) for i, v in enumerate(value)]
    parent: dict[int, int] = {}
    for i, node in enumerate(nodes):
        for child in node.at("children").array((None,)).tolist() if "children" in node.object else ():
            parent[int(child)] = i
    out = []
    for i, node in enumerate(nodes):
        if "camera" in node.object:
            matrix, at, steps = _local(node), i, 0
            while at in parent:
                at, steps = parent[at], steps + 1
                if steps > min(len(nodes), _DEEPEST):
                    raise node.error("is its own ancestor", "export it again")
                matrix = _local(nodes[at]) @ matrix
            name = node.object.get("name")
            out.append((name if isinstance(name, str) else f"camera {i}", node.at("camera").whole(), matrix, node))
    return out


def _local(node: Place) -> Array:
    if "matrix" in node.object:
        return node.at("matrix").array((16,)).reshape(4, 4).T
    out = np.eye(4)
    if "scale" in node.object and not np.allclose(node.at("scale").array((3,)), 1, rtol=0, atol=1e-9):
        raise node.error("is scaled", "apply the scale and export again: a camera's place has none")
    if "rotation" in node.object:
        x, y, z, w = node.at("rotation").array((4,)).tolist()
        out[:3, :3] = node.build(lambda: so3.from_quaternion([w, x, y, z]))
    if "translation" in node.object:
        out[:3, 3] = node.at("translation").array((3,))
    return out


FORMAT = Format(
    name="gltf",
    title="glTF 2.0",
    suffixes=(".gltf",),
    holds=Holds({"ideal": ()}, principal_point=False, pose="yes", several=True),
    recognises=recognises,
    read=read,
    write=write,
    unit="m",
)
