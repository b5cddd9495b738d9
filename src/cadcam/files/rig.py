"""The rig file: JSON, versioned, units in its key names, with all the data that the rig was estimated from.

{"format": "cadcam rig", "version": 1, "cameras": [...], "frames": [...], "covariance": [[...]], ...}. A camera has its
"name", size_px, K_px and lens as in a camera file, "camera_from_rig" and what was estimated of it; a frame its "name",
"rig_from_world" and the observations of each camera, null where it saw nothing. The rows of "covariance" are named by
"covariance_of"; tx ty tz (mm) rx ry rz (rad) of a camera are xi in camera_from_rig @ exp(xi). Sigmas, baselines and
residuals are written for people and other programs; reading checks that the residual still is that of the rig.
"""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any

import numpy as np

from cadcam.camera.observations import Observations
from cadcam.camera.rig_estimate import MOUNT, RigEstimate
from cadcam.files.camera import (
    bare_camera_as_json,
    camera_at,
    check_residual,
    key_of,
    observations_as_json,
    observations_at,
)
from cadcam.files.jsontext import Place, as_json, head_as_json, or_null, parsed
from cadcam.files.matrix import pose_as_json, pose_at
from cadcam.files.text import read_text
from cadcam.geometry.rigid import Rigid
from cadcam.kinds import expect, expect_path
from cadcam.whole import write_whole

FORMAT, VERSION = "cadcam rig", 1
_KEYS = (
    "format",
    "version",
    "written_by",
    "method",
    "residual_px",
    "degrees_of_freedom",
    "outlier_frames",
    "cameras",
    "covariance_of",
    "covariance",
    "covariance_by_frame",
    "frames",
)
_CAMERA_KEYS = ("size_px", "K_px", "lens")
_HEAD = 4096  # bytes in which a file says what it is
_MOUNT_UNITS = ("mm",) * 3 + ("rad",) * 3


def write_rig(path: str | os.PathLike[str], estimate: RigEstimate) -> None:
    """Write a rig with all that belongs to it, whole or not at all; floats keep every bit."""
    expect_path(path)
    expect(estimate, "estimate", RigEstimate)
    write_whole(path, as_json(rig_as_json(estimate)))


def read_rig(path: str | os.PathLike[str]) -> RigEstimate:
    """Return the rig in a file that `write_rig` wrote. Raises `UnreadableFile` naming the key."""
    place = parsed(read_text(path, max_bytes=256_000_000))
    place.check_head(FORMAT, VERSION, remedy=f"only {FORMAT!r} is read here: a file of `cadcam rig`")
    place.only(*_KEYS)
    cameras, frames = place.at("cameras").items(), place.at("frames").items()
    views = tuple(tuple(_view_at(frame, c, len(cameras)) for frame in frames) for c in range(len(cameras)))
    by_frame = place.at("covariance_by_frame")
    estimate = place.build(
        lambda: RigEstimate(
            names=tuple(c.at("name").text() for c in cameras),
            cameras=tuple(camera_at(Place(c.path, c.keys, _only_camera(c))) for c in cameras),
            camera_from_rig=Rigid.stack([pose_at(c.at("camera_from_rig")) for c in cameras]),
            frames=tuple(f.at("name").text() for f in frames),
            rig_from_world=Rigid.stack([pose_at(f.at("rig_from_world")) for f in frames]),
            views=views,
            free=tuple(c.at("free").texts() for c in cameras),
            covariance=place.at("covariance").covariance(),
            by_frame=None if by_frame.value is None else by_frame.covariance(),
            pose_covariance=np.array([f.at("pose_covariance").covariance(6) for f in frames]),
            noise_px=np.array([c.at("noise_px").number() for c in cameras]),
            dof=int(place.at("degrees_of_freedom").number()),
            method=place.at("method").text(),
        )
    )
    check_residual(place, estimate.residual, estimate.cameras[0].size, "rig")
    return estimate


def is_rig(path: str | os.PathLike[str]) -> bool:
    """Return whether a file says that it is a rig; False where there is none."""
    file = Path(path)
    if not file.is_file():
        return False
    with file.open("rb") as stream:
        head = stream.read(_HEAD)
    return re.search(rb'"format"\s*:\s*"' + FORMAT.encode() + b'"', head) is not None


def rig_as_json(estimate: RigEstimate) -> dict[str, Any]:
    """Return the JSON document that `write_rig` writes."""
    return {
        **head_as_json(FORMAT, VERSION),
        "method": estimate.method,
        "residual_px": estimate.residual,
        "degrees_of_freedom": estimate.dof,
        "outlier_frames": [estimate.frames[j] for j in estimate.outlier_frames()],
        "cameras": [_camera_json(estimate, c) for c in range(len(estimate.names))],
        "covariance_of": [_key(p) for p in estimate.parameters],
        "covariance": estimate.covariance.tolist(),
        "covariance_by_frame": None if estimate.by_frame is None else estimate.by_frame.tolist(),
        "frames": [_frame_json(estimate, j) for j in range(len(estimate.frames))],
    }


def _camera_json(estimate: RigEstimate, c: int) -> dict[str, Any]:
    name = estimate.names[c]
    out: dict[str, Any] = {
        "name": name,
        **bare_camera_as_json(estimate.cameras[c]),
        "camera_from_rig": pose_as_json(estimate.mount(name)),
        "free": list(estimate.free[c]),
        "noise_px": float(estimate.noise_px[c]),
        "residual_px": float(estimate.camera_residuals[c]),
        "parameters": {
            key_of(p): {"value": value, **_sigmas(estimate, name, p)}
            for p, value in estimate.values(name).items()
            if value or p in estimate.free[c]
        },
    }
    if c:
        base = estimate.relative(estimate.names[0], name)
        by_frame = base.baseline_sigma(by_frame=True)
        out["baseline_mm"] = {
            "value": base.baseline,
            "sigma": base.baseline_sigma(),
            "sigma_by_frame": or_null(by_frame),
        }
    return out


def _sigmas(estimate: RigEstimate, name: str, parameter: str) -> dict[str, float | None]:
    by_frame = estimate.sigma(name, parameter, by_frame=True)
    return {
        "sigma": estimate.sigma(name, parameter),
        "sigma_by_frame": or_null(by_frame),
    }


def _frame_json(estimate: RigEstimate, j: int) -> dict[str, Any]:
    return {
        "name": estimate.frames[j],
        "rig_from_world": pose_as_json(estimate.frame(j)),
        "pose_covariance": estimate.pose_covariance[j].tolist(),
        "residual_px": float(estimate.frame_residuals[j]),
        "seen": [None if (view := v[j]) is None else observations_as_json(view) for v in estimate.views],
    }


def _key(parameter: str) -> str:
    camera, _, name = parameter.rpartition(".")
    if name in MOUNT:
        return f"{camera}.{name}_{_MOUNT_UNITS[MOUNT.index(name)]}"
    return f"{camera}.{key_of(name)}"


def _view_at(frame: Place, c: int, count: int) -> Observations | None:
    seen = frame.at("seen").items()
    if len(seen) != count:
        raise frame.error(
            f"has observations of {len(seen)} cameras", f"one for each of {count}, null where it saw nothing"
        )
    return None if seen[c].value is None else observations_at(seen[c])


def _only_camera(place: Place) -> dict[str, Any]:
    return {key: place.at(key).value for key in _CAMERA_KEYS}
