"""The hand-eye file: JSON, versioned, units in its key names, with all the data that the calibration came from.

{"format": "cadcam hand-eye", "version": 1, "mounting": "eye-in-hand", "flange_from_camera": {...}, ...}. The rows of
"covariance_mm_rad" are xi (mm, rad) of the two motions that "covariance_of" names, in X @ exp(xi). Sigmas and the rms
of held-out errors are written for people and other programs, and not read.
"""

from __future__ import annotations

import os
from typing import Any

import numpy as np

from cadcam.arrays import Array
from cadcam.calibrate.handeye.estimate import MOUNTINGS, HandEyeEstimate, HeldOut, Mounting, RobotNoise
from cadcam.camera.observations import Observations
from cadcam.errors import UnknownName
from cadcam.files.camera import bare_camera_as_json, camera_at
from cadcam.files.jsontext import Place, as_json, head_as_json, or_null, or_nulls, parsed
from cadcam.files.matrix import pose_as_json, pose_at
from cadcam.files.text import read_text
from cadcam.geometry.rigid import Rigid
from cadcam.kinds import expect, expect_path
from cadcam.whole import write_whole

FORMAT, VERSION = "cadcam hand-eye", 1
NAMES: dict[Mounting, tuple[str, str]] = {  # of the pose of the camera, and of that of the target
    "eye-in-hand": ("flange_from_camera", "base_from_target"),
    "eye-to-hand": ("base_from_camera", "flange_from_target"),
}


def write_hand_eye(path: str | os.PathLike[str], estimate: HandEyeEstimate) -> None:
    """Write a hand-eye calibration with all that belongs to it, whole or not at all; floats keep every bit."""
    expect_path(path)
    expect(estimate, "estimate", HandEyeEstimate)
    write_whole(path, as_json(hand_eye_as_json(estimate)))


def read_hand_eye(path: str | os.PathLike[str]) -> HandEyeEstimate:
    """Return the calibration in a file that `write_hand_eye` or `cadcam handeye` wrote.

    Raises `UnreadableFile` naming the key: files of cadcam before it wrote camera_from_target have to be made again.
    """
    place = parsed(read_text(path, max_bytes=256_000_000))
    place.check_head(FORMAT, VERSION, remedy=f"only {FORMAT!r} is read here: a file of `cadcam handeye`")
    mounting = _mounting_at(place.at("mounting"))
    poses = place.at("poses").items()
    held, fixed = place.at("covariance_of").texts()
    noise, by_pixels = place.at("robot_noise"), place.at("noise_px").value is not None
    return place.build(
        lambda: HandEyeEstimate(
            mounting=mounting,
            names=tuple(p.at("name").text() for p in poses),
            base_from_flange=Rigid.stack(pose_at(p.at("base_from_flange")) for p in poses),
            camera_from_target=Rigid.stack(pose_at(p.at("camera_from_target")) for p in poses),
            flange_from_held=pose_at(place.at(held)),
            base_from_fixed=pose_at(place.at(fixed)),
            covariance=place.at("covariance_mm_rad").covariance(12),
            degrees_of_freedom=np.array([_or(v, np.inf) for v in place.at("degrees_of_freedom").items()]),
            robot_noise=RobotNoise(
                noise.at("translation_mm").number(),
                noise.at("rotation_rad").number(),
                noise.at("translation_sigma_mm").number(),
                noise.at("rotation_sigma_rad").number(),
            ),
            offsets=np.array([p.at("offset_mm_rad").array((6,)) for p in poses]),
            held_out=_held_out_at(poses, by_pixels=by_pixels),
            scale=place.at("scale").at("value").number(),
            scale_sigma=_or(place.at("scale").at("sigma"), np.inf),
            **(_by_pixels_at(place, poses) if by_pixels else {}),
        )
    )


def hand_eye_as_json(estimate: HandEyeEstimate) -> dict[str, Any]:
    """Return the JSON document that `write_hand_eye` writes."""
    camera, target = NAMES[estimate.mounting]
    noise, (px, mm, rotation) = estimate.robot_noise, estimate.held_out.rms
    return {
        **head_as_json(FORMAT, VERSION),
        "mounting": estimate.mounting,
        camera: pose_as_json(estimate.pose_of_camera),
        f"{camera}_sigma": _sigmas(estimate.covariance_of_camera),
        target: pose_as_json(estimate.pose_of_target),
        f"{target}_sigma": _sigmas(estimate.covariance_of_target),
        "covariance_of": [camera, target] if estimate.in_hand else [target, camera],
        "covariance_mm_rad": estimate.covariance.tolist(),
        "degrees_of_freedom": or_nulls(estimate.degrees_of_freedom),
        "robot_noise": {
            "translation_mm": noise.translation,
            "translation_sigma_mm": noise.translation_sigma,
            "rotation_rad": noise.rotation,
            "rotation_sigma_rad": noise.rotation_sigma,
        },
        "noise_px": estimate.noise_px,
        "camera": None if estimate.camera is None else bare_camera_as_json(estimate.camera),
        "held_out_rms": {
            "px": or_null(px),
            "mm": or_null(mm),
            "rotation_rad": or_null(rotation),
        },
        "scale": {"value": estimate.scale, "sigma": or_null(estimate.scale_sigma)},
        "poses": [_pose_json(estimate, i) for i in range(len(estimate.names))],
    }


def _pose_json(estimate: HandEyeEstimate, i: int) -> dict[str, Any]:
    held, pixels = estimate.held_out, estimate.noise_px is not None
    out: dict[str, Any] = {
        "name": estimate.names[i],
        "base_from_flange": pose_as_json(estimate.base_from_flange[i]),
        "camera_from_target": pose_as_json(estimate.camera_from_target[i]),
        "offset_mm_rad": estimate.offsets[i].tolist(),
        "held_out_mm": or_null(held.mm[i]),
        "held_out_rotation_rad": or_null(held.rotation[i]),
        "chance": float(held.chance[i]),
        "suspicious": bool(estimate.suspicious[i]),
    }
    if pixels:
        seen = estimate.observations[i]
        out |= {
            "residual_px": float(estimate.residuals_px[i]),
            "held_out_px": or_null(held.px[i]),
            "second_pose": bool(estimate.second_pose[i]),
            "source": seen.source,
            "sha256": seen.sha256,
            "sigma_px": seen.sigma_px,
            "names": list(seen.names),
            "p_target_mm": seen.p_world.tolist(),
            "q_px": seen.q.tolist(),
        }
    return out


def _by_pixels_at(place: Place, poses: list[Place]) -> dict[str, Any]:
    """Return what only a calibration from pixels has."""
    return {
        "noise_px": place.at("noise_px").number(),
        "camera": camera_at(place.at("camera")),
        "residuals_px": np.array([p.at("residual_px").number() for p in poses]),
        "second_pose": np.array([p.at("second_pose").flag() for p in poses]),
        "observations": tuple(_observations_at(p) for p in poses),
    }


def _observations_at(place: Place) -> Observations:
    sigma = place.at("sigma_px")
    return Observations(
        place.at("p_target_mm").array((None, 3)),
        place.at("q_px").array((None, 2)),
        place.at("names").texts(),
        None if sigma.value is None else sigma.number(),
        place.at("source").text(),
        place.at("sha256").text(),
    )


def _held_out_at(poses: list[Place], *, by_pixels: bool) -> HeldOut:
    return HeldOut(
        px=np.array([_or(p.at("held_out_px"), np.nan) if by_pixels else np.nan for p in poses]),
        mm=np.array([_or(p.at("held_out_mm"), np.nan) for p in poses]),
        rotation=np.array([_or(p.at("held_out_rotation_rad"), np.nan) for p in poses]),
        chance=np.array([p.at("chance").number() for p in poses]),
    )


def _mounting_at(place: Place) -> Mounting:
    said = next((m for m in MOUNTINGS if m == place.text()), None)
    if said is None:
        raise place.error(f"is {UnknownName('mounting', place.text(), MOUNTINGS)}")
    return said


def _or(place: Place, unknown: float) -> float:
    return unknown if place.value is None else place.number()


def _sigmas(covariance: Array) -> dict[str, list[float]]:
    sigma = np.sqrt(np.diag(covariance))
    return {"translation_mm": sigma[:3].tolist(), "rotation_rad": sigma[3:].tolist()}
