"""ViSP camera XML.

Pixel centres at integers. kud takes the ideal point to the measured one, u = u0 + px x (1 + kud r^2); kdu is ViSP's own
approximate inverse, which no exact camera needs: it is fitted when written and only compared when read. The
Kannala-Brandt model has k1..k4 of the fisheye and k5, which ViSP does not use. No pose.
Source: visp `modules/core/src/camera/vpXmlParserCamera.cpp`, `vpMeterPixelConversion.h`, `vpPixelMeterConversion.h`.
"""

from __future__ import annotations

from collections.abc import Sequence
from xml.sax.saxutils import escape

import numpy as np

from cadcam.camera.camera import Camera
from cadcam.camera.difference import picture_grid
from cadcam.camera.lens import BrownConrady, Fisheye, Ideal, Lens
from cadcam.files.foreign.model import ConversionLoss, Files, Foreign, Format, Holds, NamedCamera, WriteOptions
from cadcam.files.foreign.source import ForeignFile
from cadcam.files.foreign.xmltext import Node, parsed_xml

_PLAIN, _RADIAL = "perspectiveProjWithoutDistortion", "perspectiveProjWithDistortion"
_FISHEYE = "ProjWithKannalaBrandtDistortion"


def recognises(source: ForeignFile) -> bool:
    """Return whether one of ViSP's models is named, or this is a tracker's configuration with its camera."""
    head = source.head()
    named = any(f"<type>{model}</type>" in head for model in (_PLAIN, _RADIAL, _FISHEYE))
    return named or ("<conf>" in head and "<u0>" in head and "<px>" in head)


def read(source: ForeignFile) -> Foreign:
    """Return a camera for each model in the file: ViSP files often have one with and one without distortion."""
    root = parsed_xml(source.text())
    cameras, notes = [], []
    for node in root.all("camera"):
        name = node.maybe("name")
        if root.tag == "conf":  # a tracker's: the four numbers alone
            cameras.append(NamedCamera("camera", _camera(node, source.needed_size("a tracker's configuration"))))
            continue
        size = (node.number("image_width"), node.number("image_height"))
        for model in node.all("model"):
            camera = _camera(model, size)
            label = (name.text() if name is not None else "") or "camera"
            kind = "" if len(list(node.all("model"))) == 1 else f", {_kind(camera.lens)}"
            cameras.append(NamedCamera(label + kind, camera))
            if isinstance(camera.lens, BrownConrady):
                px = _inverse_error(camera, model.number("kdu", 0.0))
                notes.append(f"kud is read; ViSP's own inverse with kdu is off by up to {px:.3g} px")
    if not cameras:
        raise root.error("has no camera model", "is it the right file?")
    return Foreign("visp", tuple(cameras), tuple(notes))


def write(cameras: Sequence[NamedCamera], target: WriteOptions) -> Files:
    """Write a camera element for each camera."""
    lines = ['<?xml version="1.0"?>', "<root>"]
    for named in cameras:
        camera = named.camera
        model, terms = _model(camera)
        cx, cy = camera.principal_point
        values = {"px": camera.fx, "py": camera.fy, "u0": cx, "v0": cy, **terms}
        lines += [
            "  <camera>",
            f"    <name>{escape(named.name)}</name>",
            f"    <image_width>{camera.width}</image_width>",
            f"    <image_height>{camera.height}</image_height>",
            "    <model>",
            f"      <type>{model}</type>",
            *(f"      <{name}>{float(value)!r}</{name}>" for name, value in values.items()),
            "    </model>",
            "  </camera>",
        ]
    return {"": "\n".join([*lines, "</root>", ""]).encode()}


def _camera(model: Node, size: tuple[float, float]) -> Camera:
    kind = model.at("type").text() if model.tag == "model" else _PLAIN
    px, py, u0, v0 = (model.number(name) for name in ("px", "py", "u0", "v0"))
    lens: Lens = Ideal()
    if kind == _RADIAL and model.number("kud"):
        lens = BrownConrady(model.number("kud"))
    elif kind == _FISHEYE:
        if model.number("k5", 0.0):
            raise model.error("has k5, which ViSP does not use either", "set it to 0")
        lens = Fisheye(*(model.number(name, 0.0) for name in ("k1", "k2", "k3", "k4")))
    elif kind not in (_PLAIN, _RADIAL):
        raise model.error(f"is of type {kind[:40]!r}", f"known: {_PLAIN}, {_RADIAL}, {_FISHEYE}")
    K = np.array([[px, 0, u0], [0, py, v0], [0, 0, 1]])
    return Camera(size, K, lens)  # type: ignore[arg-type]  # Camera refuses sizes that are not whole


def _kind(lens: Lens) -> str:
    return {"ideal": "without distortion", "brown-conrady": "with distortion"}.get(lens.name, "Kannala-Brandt")


def _model(camera: Camera) -> tuple[str, dict[str, float]]:
    lens = camera.lens
    if isinstance(lens, Fisheye):
        return _FISHEYE, {**lens.parameters, "k5": 0.0}
    if isinstance(lens, BrownConrady):
        return _RADIAL, {"kud": lens.k1, "kdu": _fitted_kdu(camera)}
    return _PLAIN, {}


def _fitted_kdu(camera: Camera) -> float:
    """Return the kdu for which m (1 + kdu |m|^2) is nearest to the ideal point, over the picture."""
    m, u = _planes(camera)
    cubed = m * np.sum(m * m, axis=-1, keepdims=True)
    return float(np.sum(cubed * (u - m)) / np.sum(cubed * cubed))


def _inverse_error(camera: Camera, kdu: float) -> float:
    """Return the largest error, in px of the ideal picture, of ViSP's inverse."""
    m, u = _planes(camera)
    off = m * (1 + kdu * np.sum(m * m, axis=-1, keepdims=True)) - u
    return float(np.abs(off * [camera.fx, camera.fy]).max(initial=0.0))


def _planes(camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Return measured and ideal points of the normalised plane over the picture, where there are any."""
    q = picture_grid(camera.size, 17, 17).reshape(-1, 2)
    d = camera.unproject(q)
    seen = ~np.isnan(d).any(axis=-1)
    return camera.normalized(q[seen]), d[seen, :2] / d[seen, 2:]


def _losses(named: NamedCamera) -> list[ConversionLoss]:
    if not isinstance(named.camera.lens, BrownConrady):
        return []
    px = _inverse_error(named.camera, _fitted_kdu(named.camera))
    return [
        ConversionLoss(
            "inverse", f"ViSP's pixel-to-metre conversion (kdu) will be off by up to {px:.3g} px; forward is exact"
        )
    ]


FORMAT = Format(
    name="visp",
    title="ViSP XML",
    suffixes=(".xml",),
    holds=Holds({"ideal": (), "brown-conrady": ("k1",), "fisheye": tuple(Fisheye().parameters)}, several=True),
    recognises=recognises,
    read=read,
    write=write,
    unit="m",
    extra_losses=_losses,
)
