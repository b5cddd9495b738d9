"""Cameras of pictures that were scaled, binned or cut after the calibration: with their covariance, if it is known.

A camera's lens and pose stay; its internals in px, the pixels that it was calibrated from and their noise follow, so
that what is measured with it is as uncertain, in mm and rad, as before. The same holds for the cameras of a rig.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from cadcam.arrays import Array
from cadcam.camera.camera import Camera
from cadcam.camera.estimate import CameraEstimate
from cadcam.camera.observations import Observations
from cadcam.camera.rig_estimate import RigEstimate
from cadcam.camera.viewpoint import Viewpoint
from cadcam.errors import BadValue
from cadcam.kinds import expect_known


@dataclass(frozen=True, slots=True)
class PictureMap:
    """How a new picture lies in the one that a camera was calibrated with: q_new = scale (q + 1/2) - 1/2 - origin.

    size: (width, height) of the new picture, px; scale: along x and y; origin: px of the scaled picture.
    """

    size: tuple[int, int]
    scale: tuple[float, float] = (1.0, 1.0)
    origin: tuple[int, int] = (0, 0)

    @classmethod
    def resized(cls, old: tuple[int, int], new: tuple[int, int], *, stretched: bool = False) -> PictureMap:
        """Return the map of a whole picture resampled to a new size, outline to outline.

        Sizes rounded to whole pixels are understood. Raises `BadValue` for sides in another ratio, unless `stretched`.
        """
        scale = new[0] / old[0], new[1] / old[1]
        least = min(abs(scale[0] * old[1] - new[1]), abs(scale[1] * old[0] - new[0]))
        if least >= 1 and not stretched:
            likely = f"{new[0]} x {round(scale[0] * old[1])} or {round(scale[1] * old[0])} x {new[1]}"
            raise BadValue(
                "size of the resized picture",
                f"{new[0]} x {new[1]} px, in another ratio than the camera's {old[0]} x {old[1]}",
                f"{likely}; --crop if it was cut out of the whole, --stretched if its sides were scaled each by itself",
            )
        return cls(new, scale)

    @classmethod
    def binned(cls, old: tuple[int, int], by: tuple[int, int]) -> PictureMap:
        """Return the map of a picture whose pixels were taken together, `by` (x, y) at a time, as a sensor does.

        Columns and rows that are left over at the right and below are dropped.
        """
        if not (1 <= by[0] <= old[0] and 1 <= by[1] <= old[1]):
            raise BadValue("binning", f"{by[0]} x {by[1]}", f"1 or more, within the camera's {old[0]} x {old[1]} px")
        return cls((old[0] // by[0], old[1] // by[1]), (1 / by[0], 1 / by[1]))

    @classmethod
    def cut(cls, old: tuple[int, int], origin: tuple[int, int], size: tuple[int, int]) -> PictureMap:
        """Return the map of a picture cut out of the whole: pixel `origin` (x, y) becomes (0, 0)."""
        (x, y), (width, height) = origin, size
        if min(x, y) < 0 or x + width > old[0] or y + height > old[1]:
            said = f"{width} x {height} px from ({x}, {y}) on"
            raise BadValue("cut", said, f"a part of the camera's {old[0]} x {old[1]} px")
        return cls(size, origin=origin)

    def camera(self, camera: Camera) -> Camera:
        """Return the camera of the new picture: the lens is the same, in normalised coordinates."""
        (sx, sy), (x, y) = self.scale, self.origin
        H = np.array([[sx, 0.0, (sx - 1) / 2 - x], [0.0, sy, (sy - 1) / 2 - y], [0.0, 0.0, 1.0]])
        return replace(camera, size=self.size, K=H @ camera.K)

    def estimate(self, estimate: CameraEstimate) -> CameraEstimate:
        """Return the estimate of the new picture's camera: as if the points had been measured in it.

        Covariances of what is measured with it are the same in mm and rad, and in px scaled as the pixels are.
        """
        other = None if estimate.alternative is None else self.estimate(estimate.alternative)
        seen = self.observations(estimate.observations)
        moved = replace(estimate, camera=self.camera(estimate.camera), observations=seen, alternative=other)
        D = self.factors(estimate.parameters)
        noise = estimate.noise_px / moved.noise_px if np.isfinite(moved.noise_px) else 1 / self.noise
        errors = tuple((source, D[:, None] * effect) for source, effect in estimate.errors)
        return replace(moved, cofactor=noise**2 * D[:, None] * estimate.cofactor * D, errors=errors)

    def viewpoint(self, viewpoint: Viewpoint) -> Viewpoint:
        """Return the viewpoint of the new picture's camera: what errors do in px is scaled as the pixels are."""
        D = np.ones(11 + len(viewpoint.camera.lens.parameters))  # of the coordinates of `cadcam.camera.sensitivity`
        D[6:11] = self.factors(("aspect", "focal", "skew", "U0", "V0"))
        errors = tuple((source, D[:, None] * effect) for source, effect in viewpoint.errors)
        camera, sigma_px = self.camera(viewpoint.camera), viewpoint.sigma_px * self.noise
        return replace(viewpoint, camera=camera, sigma_px=sigma_px, errors=errors)

    def observations(self, old: Observations) -> Observations:
        """Return what was measured in the old picture as it lies in the new one."""
        q = (old.q + 0.5) * np.array(self.scale) - 0.5 - np.array(self.origin)
        sigma_px = None if old.sigma_px is None else old.sigma_px * self.noise
        return Observations(old.p_world, q, old.names, sigma_px, old.source, old.sha256)

    @property
    def noise(self) -> float:
        """Return the factor of a pixel coordinate's noise: the mean of both axes, whose scales may differ."""
        return float(np.sqrt(np.prod(self.scale)))

    def factors(self, parameters: Sequence[str]) -> Array:
        """Return by how much each of these parameters of a camera is multiplied, apart from a shift of the origin."""
        sx, sy = self.scale
        by = {"aspect": sx / sy, "focal": sy, "U0": sy, "V0": sx}
        return np.array([by.get(name, 1.0) for name in parameters])


def resampled_rig(rig: RigEstimate, maps: Mapping[str, PictureMap]) -> RigEstimate:
    """Return the rig for pictures that were scaled, binned or cut: those of the named cameras; the others stay.

    Mounts, poses and their covariances stay, too; what is measured with the rig is as uncertain as before. Raises
    `UnknownName`.
    """
    for name in maps:
        expect_known(name, "camera of the rig", rig.names)
    by = {name: maps.get(name, PictureMap(rig.camera(name).size)) for name in rig.names}
    D = np.concatenate([by[name].factors(_of_camera(rig, name)) for name in rig.names])
    views = tuple(
        tuple(None if view is None else by[name].observations(view) for view in seen)
        for name, seen in zip(rig.names, rig.views, strict=True)
    )
    return replace(
        rig,
        cameras=tuple(by[name].camera(rig.camera(name)) for name in rig.names),
        views=views,
        covariance=D[:, None] * rig.covariance * D,
        by_frame=None if rig.by_frame is None else D[:, None] * rig.by_frame * D,
        noise_px=rig.noise_px * [by[name].noise for name in rig.names],
    )


def _of_camera(rig: RigEstimate, name: str) -> list[str]:
    """Return the rig's parameters of one camera, in order, without its name."""
    return [parameter.removeprefix(f"{name}.") for parameter in rig.parameters if parameter.rpartition(".")[0] == name]
