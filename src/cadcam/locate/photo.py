"""A photo with the camera that took it and the camera's pose."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Locked, Mask, Picture, frozen
from cadcam.camera.camera import Camera
from cadcam.camera.estimate import CameraEstimate
from cadcam.camera.resampled import PictureMap
from cadcam.camera.viewpoint import Viewpoint
from cadcam.errors import SizeMismatch
from cadcam.geometry.rigid import Rigid, expect_motion
from cadcam.image.chroma import chroma_of
from cadcam.image.direction_field import DirectionField, direction_fields
from cadcam.image.picture import checked, to_gray
from cadcam.image.profile import calming, noise_of
from cadcam.kinds import expect

EDGE_PX = 0.1  # sigma of a photo's viewpoint; not used for edges, whose noise is measured


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Photo(Locked):
    """A grey picture (H, W) float32 in [0, 1] taken from `viewpoint` (camera, pose in the world, error sources).

    chroma: its colour (H, W, 2) (`image.chroma`), or None; computed from the picture where that is in colour. calm: the
    picture smoothed by a Gaussian of sd `spread` px, used for finding lines where noise hides them, or None. explained
    (H, W): pixels in which searches see no lines, as those there are what was found before; or None.
    """

    gray: Picture
    viewpoint: Viewpoint
    chroma: Picture | None = None
    calm: Picture | None = None
    spread: float = 0.0
    explained: Mask | None = None

    def __post_init__(self) -> None:
        expect(self.viewpoint, "viewpoint", Viewpoint)
        if self.chroma is None and np.ndim(self.gray) == 3:
            object.__setattr__(self, "chroma", chroma_of(self.gray))
        gray = frozen(to_gray(self.gray), f"photo {self.viewpoint.name!r}", (None, None), "float32")
        size, expected = (gray.shape[1], gray.shape[0]), self.viewpoint.camera.size
        if size != expected:
            raise SizeMismatch(f"photo {self.viewpoint.name!r}", size, expected)
        object.__setattr__(self, "gray", gray)
        if self.chroma is not None:
            chroma = frozen(self.chroma, f"chroma of {self.viewpoint.name!r}", (*gray.shape, 2), "float32")
            object.__setattr__(self, "chroma", chroma)

    @classmethod
    def of(
        cls,
        picture: npt.ArrayLike,
        camera: Camera | CameraEstimate,
        camera_from_world: Rigid | None = None,
        *,
        name: str = "photo",
    ) -> Photo:
        """Return the photo, grey or in colour, of a camera whose frame is, by default, the world.

        A `Camera` counts as exactly known; with a `CameraEstimate` (`CameraFile.calibrated`) the errors of internals
        and lens reach every pose and deviation that the photo gives. The pose of the estimate is not used.
        Of bytes white is 255, of 16-bit numbers 65535; divide 12 bits in 16, as cameras give them, by 4095 first.
        """
        expect(camera, "camera", Camera, CameraEstimate)
        expect_motion(camera_from_world, "camera_from_world", optional=True)
        pose = Rigid() if camera_from_world is None else camera_from_world
        if isinstance(camera, CameraEstimate):
            return cls(checked(picture), Viewpoint.placed(name, camera, pose, sigma_px=EDGE_PX))
        return cls(checked(picture), Viewpoint.exact(name, camera, pose, sigma_px=EDGE_PX))

    def calmed(self) -> Photo:
        """Return the photo with a smoothed picture in which noise hides fewer lines, if it hides any; else itself."""
        from scipy.ndimage import gaussian_filter

        spread = calming(noise_of(self.gray))
        if spread == 0:
            return self
        calm = np.asarray(gaussian_filter(self.gray, spread, truncate=3.0, mode="nearest"), np.float32)
        return replace(self, calm=calm, spread=spread)

    def reduced(self, times: int) -> Photo:
        """Return the photo as a camera of so many times fewer pixels each way takes it; what is left over is cut off.

        Each pixel is the mean of those in its place. Raises `BadValue` for more times than the photo has pixels.
        """
        if times == 1:
            return self
        view = PictureMap.binned(self.camera.size, (times, times)).viewpoint(self.viewpoint)
        width, height = view.camera.size

        def coarser(picture: Picture) -> Picture:
            cells = picture[: height * times, : width * times].reshape(height, times, width, times, -1)
            return np.asarray(cells.mean(axis=(1, 3)).reshape(height, width, *picture.shape[2:]), np.float32)

        return Photo(coarser(self.gray), view, None if self.chroma is None else coarser(self.chroma))

    def fields(
        self, *, reduction: int, levels: int, region: tuple[int, int, int, int] | None = None
    ) -> tuple[DirectionField, ...]:
        """Return the direction fields in which the part is searched for (`image.direction_field`), finest first."""
        return direction_fields(
            self.lines, self.camera, reduction=reduction, levels=levels, region=region, explained=self.explained
        )

    @property
    def lines(self) -> Picture:
        """Return the picture (H, W) in which lines are searched for."""
        return self.gray if self.calm is None else self.calm

    @property
    def camera(self) -> Camera:
        """Return the camera that took it."""
        return self.viewpoint.camera

    @property
    def camera_from_world(self) -> Rigid:
        """Return the pose of the camera that took it."""
        return self.viewpoint.camera_from_world

    def __repr__(self) -> str:
        return f"Photo({self.viewpoint.name!r}, {self.camera})"
