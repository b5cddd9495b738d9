"""Our camera file: JSON, versioned, units in its key names, with all the data that the camera was estimated from.

The minimum that is accepted, written by hand:
    {"size_px": [768, 576], "fx_px": 805.9, "fy_px": 805.9, "cx_px": 383.5, "cy_px": 287.5}
or "K_px": [[fx, skew, cx], [0, fy, cy], [0, 0, 1]] instead of the four numbers. Optional: "skew_px"; "lens": {"model":
"brown-conrady", "k1": -0.2, ...}; "camera_from_world": {"rotation": 3x3, "translation_mm": 3}. Pixels are (column, row)
with (0, 0) at the centre of the top-left pixel.

`write_camera` adds "convention", a sentence for people and authors of other programs, and "estimate": the free
parameters, the cofactor matrix and the observations, from which everything else follows. Parameters with sigmas,
covariance and residuals are written too, for people and other programs; the reader checks that the residual is still
that of the camera, so that a file edited by hand cannot keep a stale covariance.
"""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from typing import Any

import numpy as np

from cadcam.arrays import Array, Brief
from cadcam.camera.camera import Camera
from cadcam.camera.estimate import CameraEstimate
from cadcam.camera.extended_pinhole import NAMES, ExtendedPinhole
from cadcam.camera.extended_pinhole import UNITS as PINHOLE_UNITS
from cadcam.camera.lens import LENSES, Ideal, Lens
from cadcam.camera.observations import Observations
from cadcam.errors import BadValue, UnknownName, UnreadableFile
from cadcam.files.jsontext import Place, as_json, head_as_json, or_null, parsed
from cadcam.files.matrix import pose_as_json, pose_at
from cadcam.files.text import TextFile, read_text
from cadcam.geometry.rigid import Rigid, expect_motion
from cadcam.kinds import expect, expect_path
from cadcam.whole import write_whole

FORMAT, VERSION = "cadcam camera", 1
UNITS = PINHOLE_UNITS | {"bend_x": "mm", "bend_y": "mm"}  # aspect and the lens' coefficients have none

_FOCAL = ("fx_px", "fy_px", "cx_px", "cy_px", "skew_px")
_CONVENTION = (
    "pixels (column, row), (0, 0) the centre of the top-left one, as OpenCV counts; p_camera = rotation @ p_world + "
    "translation_mm, mm; camera axes x right, y down, z forward; the world is the frame of the points it was posed by"
)
_OF_OTHERS = "cadcam.read_cameras reads those of OpenCV, Kalibr, ROS and other programs"
_JSON = re.compile(r"\s*($|\{|\[\s*[^\sA-Za-z])")  # begins so, or is empty; sections of an INI file do not
_KEYS = (
    "format",
    "version",
    "written_by",
    "convention",
    "size_px",
    "K_px",
    *_FOCAL,
    "lens",
    "camera_from_world",
    "estimate",
)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class CameraFile(Brief):
    """The contents of a camera file: the camera, its pose and its estimate, as far as they are known."""

    camera: Camera
    camera_from_world: Rigid | None = None
    estimate: CameraEstimate | None = None

    @property
    def calibrated(self) -> Camera | CameraEstimate:
        """Return the estimate if the file has one, so that its covariance counts; else the camera."""
        return self.camera if self.estimate is None else self.estimate


def read_camera(path: str | os.PathLike[str]) -> CameraFile:
    """Return the contents of a camera file (layout: see this module).

    Raises `UnreadableFile` naming the key: unknown keys, models and versions are refused with the nearest known one.
    Files of other programs are read by `read_cameras`.
    """
    return camera_file_of(read_text(path, max_bytes=256_000_000))


def camera_file_of(file: TextFile) -> CameraFile:
    """Return the contents of a camera file's text, as `read_camera`."""
    if not _JSON.match(file.text):
        raise UnreadableFile(file.path, "is not JSON, as cadcam's camera files are", _OF_OTHERS)
    place = parsed(file)
    place.check_head(FORMAT, VERSION, stated=False)  # first: a newer version may well have other keys
    if place.object and not set(_KEYS) & set(place.object):
        least = '{"size_px": [W, H], "fx_px": ..., "fy_px": ..., "cx_px": ..., "cy_px": ...}'
        keys = ", ".join(list(place.object)[:3])
        raise place.error(
            f"is JSON, but no camera file (it has {keys})", f"{_OF_OTHERS}; the least read here is {least}"
        )
    place.only(*_KEYS)
    camera = camera_at(place)
    posed = "camera_from_world" in place.object
    pose = pose_at(place.at("camera_from_world")) if posed else None
    if "estimate" not in place.object:
        return CameraFile(camera, pose)
    if pose is None:
        raise place.error("has an estimate but no camera_from_world", "remove the estimate")
    observations = observations_at(place.at("estimate").at("observations"))
    return CameraFile(camera, pose, _estimate_at(place, camera, pose, observations))


def write_camera(
    path: str | os.PathLike[str], camera: Camera | CameraEstimate, *, camera_from_world: Rigid | None = None
) -> None:
    """Write a camera (with its pose if given), or an estimate with all that belongs to it, whole or not at all.

    Floats keep every bit: `read_camera` returns the same values. An estimate has its own pose.
    """
    expect_path(path)
    if isinstance(camera, CameraEstimate) and camera_from_world is not None:
        raise BadValue("camera_from_world", "given beside an estimate", "none: the estimate has its own")
    write_whole(path, as_json(camera_as_json(camera, camera_from_world=camera_from_world)))


def camera_as_json(camera: Camera | CameraEstimate, *, camera_from_world: Rigid | None = None) -> dict[str, Any]:
    """Return the JSON document that `write_camera` writes."""
    expect(camera, "camera", Camera, CameraEstimate)
    expect_motion(camera_from_world, "camera_from_world", optional=True)
    head = head_as_json(FORMAT, VERSION) | {"convention": _CONVENTION}
    if isinstance(camera, Camera):
        return head | bare_camera_as_json(camera, camera_from_world)
    estimate = _estimate_json(camera) | {"observations": observations_as_json(camera.observations)}
    return head | bare_camera_as_json(camera.camera, camera.camera_from_world) | {"estimate": estimate}


def parameters_as_json(estimate: CameraEstimate) -> dict[str, Any]:
    """Return {"X_mm": {"value": ..., "sigma": ..., "free": ...}, ...}; sigma is null where it is not known."""
    out: dict[str, Any] = {}
    for name, value in zip(estimate.parameters, estimate.values.tolist(), strict=True):
        sigma = estimate.sigma(name)
        out[key_of(name)] = {
            "value": value,
            "sigma": or_null(sigma),
            "free": name in estimate.free,
        }
    return out


def pinhole_as_json(camera: Camera, camera_from_world: Rigid) -> dict[str, float]:
    """Return the eleven parameters {"X_mm": ..., "a_rad": ..., ...} of a camera and its pose."""
    values = ExtendedPinhole.from_camera(camera, camera_from_world).vector.tolist()
    return {key_of(name): value for name, value in zip(NAMES, values, strict=True)}


def key_of(name: str) -> str:
    """Return a parameter's key in JSON: its name with its unit, if it has one."""
    return f"{name}_{UNITS[name]}" if name in UNITS else name


def bare_camera_as_json(camera: Camera, camera_from_world: Rigid | None = None) -> dict[str, Any]:
    """Return size, camera matrix and lens, and the pose if given, without a document's head; read by `camera_at`."""
    lens = {"model": camera.lens.name, **camera.lens.parameters}
    out: dict[str, Any] = {"size_px": list(camera.size), "K_px": camera.K.tolist(), "lens": lens}
    return out if camera_from_world is None else out | {"camera_from_world": pose_as_json(camera_from_world)}


def _estimate_json(estimate: CameraEstimate) -> dict[str, Any]:
    known = np.isfinite(estimate.noise_px)
    free = [i for i, name in enumerate(estimate.parameters) if name in estimate.free]
    out: dict[str, Any] = {
        "method": estimate.method,
        "residual_px": estimate.thesis_residual,
        "rms_px": estimate.rms_px,
        "degrees_of_freedom": estimate.dof,
        "noise_px": estimate.noise_px if known else None,
        "parameters": parameters_as_json(estimate),
        "free": list(estimate.free),
        "covariance_of": [estimate.parameters[i] for i in free],
        "covariance": estimate.covariance[np.ix_(free, free)].tolist() if known else None,
        "residuals_px": estimate.residuals.tolist(),
        "cofactor": estimate.cofactor.tolist(),
    }
    other = estimate.alternative
    if other is not None:
        out["alternative"] = bare_camera_as_json(other.camera, other.camera_from_world) | {
            "estimate": _estimate_json(other)
        }
    return out


def observations_as_json(observations: Observations) -> dict[str, Any]:
    """Return the JSON object that `observations_at` reads."""
    return {
        "source": observations.source,
        "sha256": observations.sha256,
        "sigma_px": observations.sigma_px,
        "names": list(observations.names),
        "p_world_mm": observations.p_world.tolist(),
        "q_px": observations.q.tolist(),
    }


def camera_at(place: Place) -> Camera:
    """Return the camera at a place of a JSON file."""
    size = place.at("size_px").array((2,)).tolist()
    single = [key for key in _FOCAL if key in place.object]
    if "K_px" in place.object and single:
        raise place.error(f"has K_px and {single[0]}", "leave one of them")
    if "K_px" in place.object:
        K = place.at("K_px").array((3, 3))
    elif single:
        K = _matrix_of(place)
    else:
        raise place.error("has no camera matrix", "give K_px, or fx_px, fy_px, cx_px, cy_px")
    lens = _lens_at(place.at("lens")) if "lens" in place.object else Ideal()
    return place.build(lambda: Camera((size[0], size[1]), K, lens))


def _matrix_of(place: Place) -> Array:
    fx, fy, cx, cy = (place.at(key).number() for key in _FOCAL[:4])
    skew = place.at("skew_px").number() if "skew_px" in place.object else 0.0
    return np.array([[fx, skew, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


def _lens_at(place: Place) -> Lens:
    model = place.at("model").text()
    if model not in LENSES:
        raise place.error(f"names an {UnknownName('lens model', model, LENSES)}")
    names = LENSES[model]().parameters
    place.only("model", *names)
    given = {name: place.at(name).number() for name in names if name in place.object}
    return place.build(lambda: LENSES[model](**given))


def observations_at(place: Place) -> Observations:
    """Return the observations at a place of a JSON file."""
    place.only("source", "sha256", "sigma_px", "names", "p_world_mm", "q_px")
    sigma = place.object.get("sigma_px")
    return place.build(
        lambda: Observations(
            place.at("p_world_mm").array((None, 3)),
            place.at("q_px").array((None, 2)),
            place.at("names").texts(),
            sigma_px=None if sigma is None else place.at("sigma_px").number(),
            source=place.at("source").text(),
            sha256=place.at("sha256").text(),
        )
    )


def check_residual(place: Place, actual: float, size: tuple[int, int], what: str) -> None:
    """Refuse a stated residual that does not follow from the file's contents: the file was edited by hand."""
    stated = place.at("residual_px").number()
    scale = 1e-9 * max(size)  # px: rounding of pixels and of the projection, with a margin
    if not abs(stated - actual) <= max(scale, 1e-6 * stated):
        raise place.error(
            f"states a residual of {stated:.6g} px but its {what} and points give {actual:.6g} px",
            "the file was edited: calibrate again, or leave the camera alone without its estimate",
        )


def _estimate_at(place: Place, camera: Camera, pose: Rigid, observations: Observations) -> CameraEstimate:
    at = place.at("estimate")
    other = at.at("alternative") if "alternative" in at.object else None
    estimate = at.build(
        lambda: CameraEstimate(
            camera,
            pose,
            observations,
            at.at("free").texts(),
            at.at("cofactor").covariance(),
            at.at("method").text(),
            None
            if other is None
            else _estimate_at(other, camera_at(other), pose_at(other.at("camera_from_world")), observations),
        )
    )
    check_residual(at, estimate.thesis_residual, camera.size, "camera")
    return estimate
