"""A joint calibration as a JSON document, for other programs; each view alone is a camera file (`files.camera`)."""

from __future__ import annotations

from typing import Any

import numpy as np

from cadcam.camera.joint_estimate import JointEstimate
from cadcam.files.camera import key_of
from cadcam.files.jsontext import head_as_json, or_null
from cadcam.files.matrix import pose_as_json

FORMAT, VERSION = "cadcam joint calibration", 1


def joint_as_json(estimate: JointEstimate) -> dict[str, Any]:
    """Return the camera, its shared parameters with both kinds of sigma and their covariance, and every view."""
    camera = estimate.camera
    return {
        **head_as_json(FORMAT, VERSION),
        "method": estimate.method,
        "size_px": list(camera.size),
        "K_px": camera.K.tolist(),
        "lens": {"model": camera.lens.name, **camera.lens.parameters},
        "parameters": {
            key_of(name): _parameter(estimate, name) for name in estimate.parameters if _worth(estimate, name)
        },
        "free": list(estimate.free),
        "covariance": estimate.covariance.tolist(),
        "covariance_by_view": None if estimate.by_view is None else estimate.by_view.tolist(),
        "noise_px": or_null(estimate.noise_px),
        "degrees_of_freedom": estimate.dof,
        "residual_px": estimate.residual,
        "outlier_views": [estimate.names[j] for j in estimate.outlier_views()],
        "views": [_view(estimate, j) for j in range(len(estimate.views))],
    }


def _worth(estimate: JointEstimate, name: str) -> bool:
    return name in estimate.free or bool(estimate.value(name)) or name == "skew"


def _parameter(estimate: JointEstimate, name: str) -> dict[str, Any]:
    return {
        "value": estimate.value(name),
        "sigma": or_null(estimate.sigma(name)),
        "sigma_by_view": or_null(estimate.sigma(name, by_view=True)),
        "free": name in estimate.free,
    }


def _view(estimate: JointEstimate, j: int) -> dict[str, Any]:
    view = estimate.views[j]
    sd = np.sqrt(np.diag(estimate.pose_covariance[j]))
    return {
        "name": estimate.names[j],
        "source": view.source,
        "sha256": view.sha256,
        "points": len(view),
        "residual_px": float(estimate.view_residuals[j]),
        "camera_from_world": pose_as_json(estimate.pose(j)),
        "position_mm": estimate.pose(j).origin.tolist(),
        "position_sigma_mm": sd[:3].tolist(),
        "rotation_sigma_rad": sd[3:].tolist(),
    }
