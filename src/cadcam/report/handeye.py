"""A hand-eye calibration as tables: mm and degrees, sigmas, suspicious poses marked."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from cadcam.arrays import Array
from cadcam.calibrate.handeye.conventions import ConventionFit
from cadcam.calibrate.handeye.document import NAMES
from cadcam.calibrate.handeye.estimate import HandEyeEstimate
from cadcam.geometry import rotation as so3
from cadcam.geometry.rigid import Rigid
from cadcam.report.table import Table, matrix_rows, with_sigma

_FEW_FREEDOM = 2.1  # coverage factor: 20 degrees of freedom


def hand_eye_tables(estimate: HandEyeEstimate) -> list[Table]:
    """Return all results of a hand-eye calibration: both motions with sigmas, noise and held-out error, every pose."""
    camera, target = NAMES[estimate.mounting]
    return [
        _motion_table(
            camera, estimate.pose_of_camera, estimate.covariance_of_camera, "camera", quality_notes(estimate)
        ),
        Table(f"{camera} (last column mm)", ("",) * 4, matrix_rows(estimate.pose_of_camera.matrix[:3])),
        _motion_table(target, estimate.pose_of_target, estimate.covariance_of_target, "target", ()),
        pose_table(estimate),
    ]


def quality_notes(estimate: HandEyeEstimate) -> tuple[str, ...]:
    """Return noise of robot and pixels, held-out error and doubts, one sentence each."""
    noise, (held_px, held_mm, held_rad) = estimate.robot_noise, estimate.held_out.rms
    pixels = (
        (
            f"pixel noise {estimate.noise_px:.3g} px a coordinate; left over with every pose free within the robot's "
            f"noise: {np.sqrt(np.mean(np.square(estimate.residuals_px))):.3g} px",
        )
        if estimate.noise_px is not None
        else ()
    )
    px = "" if estimate.noise_px is None else f"{held_px:.3g} px, "
    held = "held out: without any one pose the others do not determine the solution, so none is predicted"
    if np.isfinite(held_mm):
        held = (
            f"held out, each pose predicted by the others: {px}{held_mm:.3g} mm, {np.degrees(held_rad):.2g} deg (rms)"
        )
    factor = float(estimate.coverage_factor(0.95).max())
    few = (f"for 95 % multiply the sigmas by {factor:.3g}: the robot's noise is known from few poses",)
    return (
        f"robot's noise: position {_noise(noise.translation, noise.translation_sigma)} mm, orientation "
        f"{_noise(float(np.degrees(noise.rotation)), float(np.degrees(noise.rotation_sigma)))} deg a coordinate",
        *pixels,
        held,
        *(few if factor > _FEW_FREEDOM else ()),
        *estimate.doubts,
    )


def pose_table(estimate: HandEyeEstimate) -> Table:
    """Return one row per pose: the flange's offset, the picture's residual, the held-out error, a mark."""
    held, pixels = estimate.held_out, estimate.noise_px is not None
    rows = []
    for i, name in enumerate(estimate.names):
        shift, turn = np.linalg.norm(estimate.offsets[i, :3]), np.degrees(np.linalg.norm(estimate.offsets[i, 3:]))
        in_pixels = (f"{estimate.residuals_px[i]:.2f}", _or_blank(held.px[i], 2)) if pixels else ()
        mark = "suspicious" if estimate.suspicious[i] else ""
        second = "second pose" if pixels and estimate.second_pose[i] else ""
        numbers = (_or_blank(held.mm[i], 3), _or_blank(np.degrees(held.rotation[i]), 3), f"{held.chance[i]:.2g}")
        rows.append(
            (name, f"{shift:.3f}", f"{turn:.4f}", *in_pixels, *numbers, ", ".join(t for t in (mark, second) if t))
        )
    columns = ("left px", "held-out px") if pixels else ()
    return Table(
        "Poses: how far the flange seems off its stated pose, and how the other poses predict this one",
        ("pose", "off mm", "off deg", *columns, "held-out mm", "held-out deg", "chance", ""),
        tuple(rows),
        ("pose", ""),
        ("chance: that a pose without a mistake is this far off; below 0.01 over all poses it is marked",),
    )


def convention_table(fits: Sequence[ConventionFit], units: Mapping[str, str]) -> Table:
    """Return how every reading of a robot's numbers agrees with the camera's motion; units: of lengths, "" for mm."""
    rows = tuple(
        (
            f.convention,
            units[f.convention] or "mm?",
            "flange_from_base" if f.inverted else "base_from_flange",
            f"{np.degrees(f.rotation):.3g}",
            f"{f.translation:.3g}",
            f"{f.scale:.3f}",
            "fits" if f.fits else "",
        )
        for f in fits
    )
    notes = [
        "scale: the robot's lengths, read in this unit, by the camera's; 1 where they agree",
        "mm?: neither the file nor the convention says a unit",
    ]
    return Table(
        "Readings of the robot's numbers, against what the camera saw (medians over all motions)",
        ("convention", "unit", "poses are", "rotation off deg", "position off mm", "scale", ""),
        rows,
        ("convention", "unit", "poses are", ""),
        tuple(notes if "" in {units[f.convention] for f in fits} else notes[:1]),
    )


def _motion_table(name: str, pose: Rigid, covariance: Array, axes: str, notes: tuple[str, ...]) -> Table:
    """Return position in the outer frame and rotation vector with sigmas, both sigmas in the outer frame's axes."""
    R = pose.rotation
    place = np.sqrt(np.diag(R @ covariance[:3, :3] @ R.T))
    turn = np.degrees(np.sqrt(np.diag(R @ covariance[3:, 3:] @ R.T)))
    w = np.degrees(so3.log(R))
    outer = name.partition("_from_")[0]
    rows = [(axis, *_shown(v, s), "mm") for axis, v, s in zip("xyz", pose.translation.tolist(), place, strict=True)]
    rows += [(f"r{a}", *_shown(v, s), "deg") for a, v, s in zip("xyz", w.tolist(), turn, strict=True)]
    own = f"where the {axes} is in the {outer}'s axes, and its rotation vector (sigmas about the {outer}'s axes)"
    return Table(name, ("", "value", "sigma", "unit"), tuple(rows), ("", "sigma", "unit"), (own, *notes))


def _shown(value: float, sigma: float) -> tuple[str, str]:
    shown, spread = with_sigma(value, float(sigma))
    return shown, f"+- {spread}"


def _or_blank(value: float, decimals: int) -> str:
    return f"{value:.{decimals}f}" if np.isfinite(value) else ""


def _noise(sigma: float, own: float) -> str:
    """Return a noise with its sigma, or its bound where it is not significant."""
    return f"{sigma:.2g} +- {own:.1g}" if sigma > own else f"not seen (below {2 * max(own, sigma):.1g})"
