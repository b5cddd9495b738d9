"""Kalibr's camchain: cam0, cam1 ... with intrinsics, distortion and the relative poses of the cameras.

Pixel centres at integers; metres. T_cn_cnm1 takes points of camera n-1 to camera n; T_cam_imu points of the IMU frame
to the camera. Models: pinhole with radtan, equidistant, fov or none; omni, eucm and ds with none.
Source: kalibr `kalibr_common/ConfigReader.py`; the pixel origin: colmap `doc/faq.rst`, kalibr#115.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array
from cadcam.camera.camera import Camera
from cadcam.camera.lens import BrownConrady, DoubleSphere, ExtendedUnified, FieldOfView, Fisheye, Ideal, Lens
from cadcam.errors import UnknownName
from cadcam.files.foreign.model import Files, Foreign, Format, Holds, NamedCamera, WriteOptions
from cadcam.files.foreign.pose import numbers, rigid_of_matrix
from cadcam.files.foreign.source import ForeignFile
from cadcam.files.jsontext import Place
from cadcam.files.yamltext import parsed_yaml, yaml_number
from cadcam.geometry.rigid import Rigid

_MM = 1000.0
_OWN = {"pinhole": 0, "omni": 1, "eucm": 2, "ds": 2}  # numbers before fu, fv, pu, pv
_TERMS = {"radtan": 4, "equidistant": 4, "fov": 1, "none": 0}


def recognises(source: ForeignFile) -> bool:
    """Return whether there is a cam0 with a camera_model."""
    head = source.head()
    return bool(re.search(r"^cam0\s*:", head, re.MULTILINE)) and "camera_model" in head


def read(source: ForeignFile) -> Foreign:
    """Return the cameras; the world is the IMU frame where every camera has T_cam_imu, else the first camera."""
    root = parsed_yaml(source.text())
    # by number, as each pose is from the one before: Kalibr sorts its keys as text, cam10 before cam2
    found = sorted(int(name[3:]) for name in root.object if re.fullmatch(r"cam(0|[1-9]\d{0,3})", name))
    missing = next((i for i, number in enumerate(found) if number != i), None)
    if not found or missing is not None:
        raise root.error(f"has no cam{missing or 0}", "is it a whole camchain? its cameras are cam0, cam1 ...")
    places = [root.at(f"cam{number}") for number in found]
    poses, notes = _poses(places)
    cameras = [NamedCamera(place.keys[-1], _camera(place), pose) for place, pose in zip(places, poses, strict=True)]
    return Foreign("kalibr", tuple(cameras), notes)


def write(cameras: Sequence[NamedCamera], target: WriteOptions) -> Files:
    """Write the chain; names become cam0, cam1 ... as Kalibr requires."""
    lines: list[str] = []
    for i, named in enumerate(cameras):
        model = _written(named.camera)
        lines += [
            f"cam{i}:",
            f"  camera_model: {model.camera_model}",
            f"  intrinsics: {_listed(model.intrinsics)}",
            f"  distortion_model: {model.distortion_model}",
            f"  distortion_coeffs: {_listed(model.distortion)}",
            f"  resolution: [{named.camera.width}, {named.camera.height}]",
            f"  rostopic: /cam{i}/image_raw",
        ]
        before = cameras[i - 1].camera_from_world if i else None
        if before is not None and named.camera_from_world is not None:
            matrix = (named.camera_from_world @ before.inv).matrix
            matrix[:3, 3] /= _MM
            lines += ["  T_cn_cnm1:", *(f"  - {_listed(row)}" for row in matrix)]
    return {"": ("\n".join(lines) + "\n").encode()}


@dataclass(frozen=True, slots=True, eq=False)
class _KalibrModel:
    camera_model: str
    intrinsics: Array
    distortion_model: str
    distortion: Array


def _written(camera: Camera) -> _KalibrModel:
    lens, K = camera.lens, np.array([camera.fx, camera.fy, *camera.principal_point])
    c = np.array(list(lens.parameters.values()))
    if isinstance(lens, (ExtendedUnified, DoubleSphere)):
        name = "eucm" if isinstance(lens, ExtendedUnified) else "ds"
        return _KalibrModel(name, np.concatenate([c, K]), "none", np.zeros(0))
    if isinstance(lens, Fisheye):
        return _KalibrModel("pinhole", K, "equidistant", c)
    if isinstance(lens, FieldOfView):
        return _KalibrModel("pinhole", K, "fov", c)
    if isinstance(lens, BrownConrady):
        return _KalibrModel("pinhole", K, "radtan", c[:4])
    return _KalibrModel("pinhole", K, "none", np.zeros(0))


def _camera(place: Place) -> Camera:
    model, distortion = place.at("camera_model").text(), place.at("distortion_model").text()
    for kind, name, known in (("camera_model", model, _OWN), ("distortion_model", distortion, _TERMS)):
        if name not in known:
            raise place.error(f"names an {UnknownName(kind, name, known)}")
    values = place.at("intrinsics").array((None,))
    own = _OWN[model]
    if values.size != own + 4:
        raise place.at("intrinsics").error(f"has {values.size} numbers", f"{model} has {own + 4}")
    given = place.object.get("distortion_coeffs")
    c = place.at("distortion_coeffs").array((None,)) if given is not None else np.zeros(0)
    if c.size != _TERMS[distortion]:
        raise place.error(f"has {c.size} distortion_coeffs", f"{distortion} has {_TERMS[distortion]}")
    if own and distortion != "none":
        raise place.error(f"combines {model} with {distortion}", "read here with distortion_model none only")
    resolution = place.at("resolution")
    size = resolution.array((2,))
    fu, fv, pu, pv = values[own:].tolist()
    lens, scale = place.build(lambda: _lens(model, values[:own], distortion, c))
    K = np.array([[fu * scale, 0, pu], [0, fv * scale, pv], [0, 0, 1]])
    return place.build(lambda: Camera((size[0], size[1]), K, lens))


def _lens(model: str, own: Array, distortion: str, c: Array) -> tuple[Lens, float]:
    """Return the lens, and the factor of the focal lengths (omni is the unified model in another scale)."""
    if model == "omni":
        alpha = float(own[0] / (1 + own[0]))
        return ExtendedUnified(alpha, 1.0), 1 - alpha
    if model in ("eucm", "ds"):
        return (ExtendedUnified if model == "eucm" else DoubleSphere)(*own.tolist()), 1.0
    lens = {"radtan": BrownConrady, "equidistant": Fisheye, "fov": FieldOfView, "none": Ideal}[distortion]
    return lens(*c.tolist()), 1.0


def _poses(places: list[Place]) -> tuple[list[Rigid | None], tuple[str, ...]]:
    if all("T_cam_imu" in place.object for place in places):
        return [_motion(place.at("T_cam_imu")) for place in places], ("the world is the IMU frame (T_cam_imu)",)
    if len(places) == 1 or not all("T_cn_cnm1" in place.object for place in places[1:]):
        return [None] * len(places), ()
    poses = [Rigid()]
    for place in places[1:]:
        poses.append(_motion(place.at("T_cn_cnm1")) @ poses[-1])
    return list(poses), ("the world is the first camera's frame (T_cn_cnm1)",)


def _motion(place: Place) -> Rigid:
    return rigid_of_matrix(place.array((4, 4)), _MM, place.error)


def _listed(values: Array) -> str:
    return f"[{', '.join(map(yaml_number, numbers(values)))}]"


FORMAT = Format(
    name="kalibr",
    title="Kalibr camchain",
    suffixes=(".yaml", ".yml"),
    holds=Holds(
        {
            "ideal": (),
            "brown-conrady": ("k1", "k2", "p1", "p2"),
            "fisheye": tuple(Fisheye().parameters),
            "field-of-view": ("w",),
            "extended-unified": ("alpha", "beta"),
            "double-sphere": ("xi", "alpha"),
        },
        pose="relative",
        several=True,
    ),
    recognises=recognises,
    read=read,
    write=write,
    unit="m",
)
