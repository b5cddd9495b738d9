"""Cameras of pictures that were scaled, binned or cut after the calibration: with their covariance, if it is known."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from cadcam.camera.camera import Camera
from cadcam.camera.estimate import CameraEstimate
from cadcam.camera.extended_pinhole import INTERNALS
from cadcam.camera.observations import Observations
from cadcam.errors import BadValue


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
        old, scale = estimate.observations, np.array(self.scale)
        seen = Observations(
            old.p_world,
            (old.q + 0.5) * scale - 0.5 - np.array(self.origin),
            old.names,
            None if old.sigma_px is None else old.sigma_px * float(np.sqrt(scale.prod())),
            old.source,
            old.sha256,
        )
        other = None if estimate.alternative is None else self.estimate(estimate.alternative)
        moved = replace(estimate, camera=self.camera(estimate.camera), observations=seen, alternative=other)
        D = np.ones(len(estimate.parameters))
        by = {"aspect": scale[0] / scale[1], "focal": scale[1], "U0": scale[1], "V0": scale[0]}
        for name in INTERNALS:
            D[estimate.parameters.index(name)] = by.get(name, 1.0)
        noise = estimate.noise_px / moved.noise_px if np.isfinite(moved.noise_px) else 1 / np.sqrt(scale.prod())
        return replace(moved, cofactor=noise**2 * D[:, None] * estimate.cofactor * D)
