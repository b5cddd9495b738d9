"""A photo and the camera that took it, where it stood."""

from __future__ import annotations

from dataclasses import dataclass

import numpy.typing as npt

from cadcam.arrays import Picture, frozen
from cadcam.camera.camera import Camera
from cadcam.camera.viewpoint import Viewpoint
from cadcam.errors import SizeMismatch
from cadcam.geometry.rigid import Rigid
from cadcam.image.picture import to_gray

_EDGE_PX = 0.1  # sigma of a stated viewpoint; edges bring their own noise, this one is not used for them


@dataclass(frozen=True, slots=True, eq=False)
class Photo:
    """A grey picture (H, W) float32 in [0, 1] taken from `viewpoint` (camera, place in the world, what errs there)."""

    gray: Picture
    viewpoint: Viewpoint

    def __post_init__(self) -> None:
        gray = frozen(to_gray(self.gray), f"photo {self.viewpoint.name!r}", (None, None), "float32")
        size, expected = (gray.shape[1], gray.shape[0]), self.viewpoint.camera.size
        if size != expected:
            raise SizeMismatch(f"photo {self.viewpoint.name!r}", size, expected, "give the camera that took it")
        object.__setattr__(self, "gray", gray)

    @classmethod
    def of(
        cls, gray: npt.ArrayLike, camera: Camera, camera_from_world: Rigid | None = None, *, name: str = "photo"
    ) -> Photo:
        """Return the photo of an exactly known camera; by default the world is the camera's frame."""
        pose = Rigid() if camera_from_world is None else camera_from_world
        return cls(to_gray(gray), Viewpoint.exact(name, camera, pose, sigma_px=_EDGE_PX))

    @property
    def camera(self) -> Camera:
        """Return the camera that took it."""
        return self.viewpoint.camera
