"""mrcal's .cameramodel: a Python dict in a text file, read as a literal and never run.

Pixel centres at integers; lens terms as OpenCV's; rt_cam_ref (before 2.5: extrinsics) is a rotation vector and a
translation taking reference points to the camera, in the user's unit. The stereographic lens is the extended unified
model with alpha 1/2, beta 1. Source: mrcal `doc/cameramodels.org`, `doc/lensmodels.org`, `doc/conventions.org`.
"""

from __future__ import annotations

import ast
import re
import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np

from cadcam.arrays import Array
from cadcam.camera.camera import Camera
from cadcam.camera.lens import BrownConrady, ExtendedUnified, Ideal, Lens
from cadcam.errors import UnreadableFile
from cadcam.files.foreign.model import Files, Foreign, Format, Holds, NamedCamera, WriteOptions
from cadcam.files.foreign.pose import numbers
from cadcam.files.foreign.source import ForeignFile
from cadcam.files.jsontext import Place
from cadcam.files.text import TextFile
from cadcam.geometry import rotation as so3
from cadcam.geometry.rigid import Rigid

_TERMS = {"PINHOLE": 0, "STEREOGRAPHIC": 0, "OPENCV4": 4, "OPENCV5": 5, "OPENCV8": 8, "OPENCV12": 12}
_STEREOGRAPHIC = ExtendedUnified(0.5, 1.0)
_POSES = ("rt_cam_ref", "extrinsics")


def recognises(source: ForeignFile) -> bool:
    """Return whether this names a LENSMODEL."""
    return bool(re.search(r"""['"]lens_?model['"]\s*:\s*b?['"]LENSMODEL_""", source.head()))


def read(source: ForeignFile) -> Foreign:
    """Return the camera."""
    root = Place(source.path, (), literal(source.text()))
    name = next((n for n in ("lensmodel", "lens_model") if n in root.object), "lensmodel")
    model = root.at(name).text().removeprefix("LENSMODEL_")
    if model not in _TERMS:
        raise root.error(
            f"has the lens model {model[:40]!r}", f"read here: {', '.join(_TERMS)}; mrcal-convert-lensmodel helps"
        )
    values = root.at("intrinsics").array((None,))
    if values.size != 4 + _TERMS[model]:
        raise root.at("intrinsics").error(f"has {values.size} numbers", f"{model} has {4 + _TERMS[model]}")
    fx, fy, cx, cy, *terms = values.tolist()
    size = root.at("imagersize").array((2,))
    lens: Lens = _STEREOGRAPHIC if model == "STEREOGRAPHIC" else BrownConrady(*terms) if any(terms) else Ideal()
    camera = Camera((size[0], size[1]), np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]), lens)
    notes: tuple[str, ...] = ()
    if "optimization_inputs" in root.object:
        notes = ("optimization_inputs (mrcal's observations and uncertainty) are not kept",)
    return Foreign("mrcal", (NamedCamera("camera", camera, _pose(root, source.mm)),), notes)


def write(cameras: Sequence[NamedCamera], target: WriteOptions) -> Files:
    """Write one camera; without a pose it is at the reference."""
    named = cameras[0]
    camera = named.camera
    model, terms = _model(camera.lens)
    pose = named.camera_from_world or Rigid()
    rt = _listed(np.concatenate([so3.log(pose.rotation), pose.translation / target.mm]))
    intrinsics = _listed(np.array([camera.fx, camera.fy, *camera.principal_point, *terms]))
    lines = [
        "{",
        f"    'lensmodel':  'LENSMODEL_{model}',",
        "    # intrinsics are fx,fy,cx,cy,distortion0,distortion1,....",
        f"    'intrinsics': {intrinsics},",
        "    # rt_cam_ref (extrinsics before mrcal 2.5): rotation vector, translation, reference to camera",
        f"    'rt_cam_ref': {rt},",
        f"    'extrinsics': {rt},",
        f"    'imagersize': [ {camera.width}, {camera.height},]",
        "}",
    ]
    return {"": ("\n".join(lines) + "\n").encode()}


def literal(file: TextFile) -> Any:
    """Return the dict literal in a file, its tuples as lists; `UnreadableFile` without one. Nothing is executed."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # odd escapes in a string do not concern the reader
            value = ast.literal_eval(file.text.strip())
    except SyntaxError as error:
        raise UnreadableFile(
            file.path, f"is not a Python dict: {error.msg} at line {error.lineno}", "is it cut off?"
        ) from None
    except (ValueError, TypeError, MemoryError, RecursionError):
        raise UnreadableFile(file.path, "is not a Python dict of plain values", "is it the right file?") from None
    return plain(value)


def plain(value: Any) -> Any:
    """Return a literal in JSON's types; values without such a type become text."""
    if isinstance(value, dict):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(v) for v in value]
    return value if value is None or isinstance(value, (bool, int, float, str)) else repr(value)


def _pose(root: Place, mm: float) -> Rigid | None:
    name = next((n for n in _POSES if n in root.object), None)
    if name is None:
        return None
    rt = root.at(name).array((6,))
    return Rigid(so3.exp(rt[:3]), rt[3:] * mm)


def _model(lens: Lens) -> tuple[str, Array]:
    if isinstance(lens, Ideal):
        return "PINHOLE", np.zeros(0)
    c = np.array(list(lens.parameters.values()))
    count = next(n for n in (4, 5, 8, 12) if not c[n:].any())
    return f"OPENCV{count}", c[:count]


def _listed(values: Array) -> str:
    return f"[ {', '.join(map(repr, numbers(values)))},]"


FORMAT = Format(
    name="mrcal",
    title="mrcal cameramodel",
    suffixes=(".cameramodel",),
    holds=Holds({"ideal": (), "brown-conrady": tuple(BrownConrady().parameters)}, pose="yes"),
    recognises=recognises,
    read=read,
    write=write,
)
