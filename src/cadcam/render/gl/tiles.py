"""Pictures cut into tiles that fit a GPU's buffers, and the direction of each pixel of a tile."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Picture
from cadcam.camera.camera import Camera
from cadcam.cores import blocks, on_cores

NOWHERE = np.float32(3e38)  # u of a pixel without a direction: NaN is not safe from a compiler's optimisation
_PIXELS = 1 << 14


@dataclass(frozen=True, slots=True)
class Tile:
    """A rectangle of a picture: first column and row, width and height in px."""

    x: int
    y: int
    width: int
    height: int

    @property
    def rows(self) -> slice:
        """Return its rows of the picture."""
        return slice(self.y, self.y + self.height)

    @property
    def columns(self) -> slice:
        """Return its columns of the picture."""
        return slice(self.x, self.x + self.width)

    def camera(self, whole: Camera, samples: int) -> Camera:
        """Return the camera of this part of the picture with samples x samples pixels for each one."""
        part = whole.crop(self.x, self.y, (self.width, self.height))
        return part.resize((self.width * samples, self.height * samples)) if samples > 1 else part


def tiles(size: tuple[int, int], *, side: int, pixels: int) -> Iterator[Tile]:
    """Yield tiles that cover a picture, none with more px per side than `side` nor more than `pixels` in all."""
    width, height = size
    w = min(width, side, max(1, pixels))
    h = max(1, min(height, side, pixels // w))
    for y in range(0, height, h):
        for x in range(0, width, w):
            yield Tile(x, y, min(w, width - x), min(h, height - y))


def plane_table(camera: Camera) -> Picture:
    """Return the undistorted plane's point (H, W, 4) float32 of each pixel: high parts of x, y, then the remainders."""
    table = np.zeros((camera.height, camera.width, 4), np.float32)
    x = np.arange(camera.width, dtype=np.float64)

    def fill(rows: slice) -> None:
        ray = camera.unproject(np.stack(np.meshgrid(x, np.arange(rows.start, rows.stop, dtype=np.float64)), axis=-1))
        sees = np.isfinite(ray[..., 2]) & (ray[..., 2] > 0)
        u = ray[..., :2] / np.where(sees, ray[..., 2], 1.0)[..., None]
        high: npt.NDArray[np.float32] = u.astype(np.float32)
        table[rows, :, :2] = np.where(sees[..., None], high, NOWHERE)
        table[rows, :, 2:] = np.where(sees[..., None], u - high, 0.0)

    on_cores(fill, blocks(camera.height, max(1, _PIXELS // camera.width)))
    return table
