"""Agisoft Metashape: camera export (document/chunk) and single calibrations, XML.

x = X/Z, y = Y/Z; u = W/2 + cx + x' f + x' b1 + y' b2, v = H/2 + cy + y' f, counted from the picture's corner: so
fx = f + b1, skew = b2, fy = f, and our principal point is W/2 + cx - 1/2. p1 and p2 are OpenCV's p2 and p1. A fisheye
is Kannala-Brandt with the same radial terms. Camera transforms are chunk from camera; the chunk's own transform
(rotation, translation, scale) leads to the world. Source: Metashape manual, "Camera models"; Agisoft forum topic 6437;
nerfstudio#3714 on p1, p2.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from xml.sax.saxutils import quoteattr

import numpy as np

from cadcam.arrays import Array
from cadcam.camera.camera import Camera
from cadcam.camera.lens import BrownConrady, Fisheye, Ideal, Lens
from cadcam.files.foreign.model import Files, Foreign, Format, Holds, NamedCamera, WriteOptions
from cadcam.files.foreign.pose import numbers, rigid_of_matrix
from cadcam.files.foreign.source import ForeignFile
from cadcam.files.foreign.xmltext import Node, parsed_xml
from cadcam.geometry.rigid import Rigid

CORNER = 0.5  # Metashape's (0, 0) is the corner of the top-left pixel, ours its centre
_UNKNOWN = {"frame": ("k4", "p3", "p4"), "fisheye": ("p1", "p2", "p3", "p4")}


def recognises(source: ForeignFile) -> bool:
    """Return whether this is a document with sensors, or one calibration."""
    head = source.head()
    return bool(re.search(r"<calibration\b", head)) and ("<sensor" in head or "<projection>" in head)


def read(source: ForeignFile) -> Foreign:
    """Return the cameras that are aligned, or where there are none the sensors."""
    root = parsed_xml(source.text())
    version = root.element.get("version", "2")
    if root.tag == "document" and version.split(".")[0] not in ("0", "1", "2"):
        raise root.error(
            f"is of version {version[:20]!r}", "versions 1 and 2 are read here: a newer one may mean others"
        )
    if root.tag == "calibration":
        return Foreign("metashape", (NamedCamera("camera", _calibrated(root, _size(root))),))
    chunk = root.maybe("chunk") or root
    sensors = {node.element.get("id", ""): _sensor(node) for node in chunk.all("sensors/sensor")}
    if not any(sensors.values()):
        raise root.error("has no calibrated sensor", "align the cameras, then export them again")
    cameras = [named for node in _cameras(chunk) if (named := _aligned(node, sensors, chunk, source.mm)) is not None]
    left = len(_cameras(chunk)) - len(cameras)
    notes = (f"{left} cameras are not aligned and left out",) if cameras and left else ()
    only = [named for named in sensors.values() if named is not None]
    return Foreign("metashape", tuple(cameras or only), notes)


def write(cameras: Sequence[NamedCamera], target: WriteOptions) -> Files:
    """Write a document with a sensor for each camera, and its transform where it has a pose."""
    sensors, placed = [], []
    for i, named in enumerate(cameras):
        sensors += [*_sensor_lines(i, named)]
        transform = ""
        if named.camera_from_world is not None:
            matrix = named.camera_from_world.inv.matrix
            matrix[:3, 3] /= target.mm
            transform = f"<transform>{' '.join(map(repr, numbers(matrix)))}</transform>"
        placed.append(f'<camera id="{i}" sensor_id="{i}" label={quoteattr(named.name)}>{transform}</camera>')
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        '<document version="2.0.0">',
        '<chunk label="Chunk 1" enabled="true">',
    ]
    lines += [f'<sensors next_id="{len(cameras)}">', *sensors, "</sensors>"]
    lines += [
        f'<cameras next_id="{len(cameras)}" next_group_id="0">',
        *placed,
        "</cameras>",
        "</chunk>",
        "</document>",
        "",
    ]
    return {"": "\n".join(lines).encode()}


def _sensor_lines(i: int, named: NamedCamera) -> list[str]:
    camera, lens = named.camera, named.camera.lens
    kind = "fisheye" if isinstance(lens, Fisheye) else "frame"
    size = f'<resolution width="{camera.width}" height="{camera.height}"/>'
    cx, cy = camera.principal_point + CORNER - np.array(camera.size) / 2
    values = {"f": camera.fy, "cx": cx, "cy": cy, "b1": camera.fx - camera.fy, "b2": camera.skew, **_terms(lens)}
    # b1 = fx - fy loses the last bits of fx where the two differ much; written so that fy + b1 is fx to rounding
    body = "".join(f"<{name}>{float(value)!r}</{name}>" for name, value in values.items() if value or name == "f")
    return [
        f'<sensor id="{i}" label={quoteattr(named.name)} type="{kind}">',
        size,
        f'<calibration type="{kind}" class="adjusted">{size}{body}</calibration>',
        "</sensor>",
    ]


def _terms(lens: Lens) -> dict[str, float]:
    if isinstance(lens, BrownConrady):
        return {"k1": lens.k1, "k2": lens.k2, "k3": lens.k3, "p1": lens.p2, "p2": lens.p1}
    return lens.parameters


def _cameras(chunk: Node) -> list[Node]:
    """Return the cameras, those in groups too."""
    return [*chunk.all("cameras/camera"), *chunk.all("cameras/group/camera")]


def _sensor(node: Node) -> NamedCamera | None:
    adjusted = [c for c in node.all("calibration") if c.element.get("class", "adjusted") == "adjusted"]
    if not adjusted:
        return None
    resolution = adjusted[0].maybe("resolution") or node.at("resolution")
    width, height = (resolution.whole(name, resolution.attribute(name)) for name in ("width", "height"))
    return NamedCamera(node.element.get("label", "camera"), _calibrated(adjusted[0], (width, height)))


def _size(calibration: Node) -> tuple[int, int]:
    width, height = (calibration.whole(name, calibration.number(name)) for name in ("width", "height"))
    return width, height


def _calibrated(node: Node, size: tuple[int, int]) -> Camera:
    projection = node.maybe("projection")
    kind = node.element.get("type") or (projection.text() if projection is not None else "frame")
    if kind not in _UNKNOWN:
        raise node.error(f"is of type {kind[:40]!r}", f"read here: {', '.join(_UNKNOWN)}")
    unknown = [name for name in _UNKNOWN[kind] if node.number(name, 0.0)]
    if unknown:
        raise node.error(f"has {', '.join(unknown)}, which no lens here has", "adjust without them and export again")
    f, b1, b2 = node.number("f"), node.number("b1", 0.0), node.number("b2", 0.0)
    cx, cy = (node.number(name, 0.0) + extent / 2 - CORNER for name, extent in zip(("cx", "cy"), size, strict=True))
    k1, k2, k3, k4, p1, p2 = (node.number(name, 0.0) for name in ("k1", "k2", "k3", "k4", "p1", "p2"))
    lens: Lens = Fisheye(k1, k2, k3, k4) if kind == "fisheye" else BrownConrady(k1, k2, p2, p1, k3)
    if kind == "frame" and not any(lens.parameters.values()):
        lens = Ideal()
    return Camera(size, np.array([[f + b1, b2, cx], [0, f, cy], [0, 0, 1]]), lens)


def _aligned(node: Node, sensors: dict[str, NamedCamera | None], chunk: Node, mm: float) -> NamedCamera | None:
    sensor, transform = sensors.get(node.element.get("sensor_id", "")), node.maybe("transform")
    if sensor is None or transform is None:
        return None
    rotation, translation, scale = _chunk_transform(chunk)
    chunk_from_camera = transform.numbers(16).reshape(4, 4)
    world_from_camera = np.eye(4)
    world_from_camera[:3, :3] = rotation @ chunk_from_camera[:3, :3]
    world_from_camera[:3, 3] = scale * rotation @ chunk_from_camera[:3, 3] + translation
    pose: Rigid = rigid_of_matrix(world_from_camera, mm, transform.error)
    return NamedCamera(node.element.get("label", "camera"), sensor.camera, pose.inv)


def _chunk_transform(chunk: Node) -> tuple[Array, Array, float]:
    node = chunk.maybe("transform")
    if node is None:
        return np.eye(3), np.zeros(3), 1.0
    rotation, translation = node.maybe("rotation"), node.maybe("translation")
    R = np.eye(3) if rotation is None else rotation.numbers(9).reshape(3, 3)
    t = np.zeros(3) if translation is None else translation.numbers(3)
    return R, t, node.number("scale", 1.0)


FORMAT = Format(
    name="metashape",
    title="Metashape XML",
    suffixes=(".xml",),
    holds=Holds(
        {"ideal": (), "brown-conrady": ("k1", "k2", "p1", "p2", "k3"), "fisheye": tuple(Fisheye().parameters)},
        skew="yes",
        pose="yes",
        several=True,
    ),
    recognises=recognises,
    read=read,
    write=write,
)
