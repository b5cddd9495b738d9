"""The background of the part: an even grey, noise of all scales, a photo. RGB (H, W, 3) float32 in [0, 1]."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Picture
from cadcam.dataset.plan import NOISE, PLAIN
from cadcam.dataset.shot import Backdrop

_CELLS_PX = (128, 32, 8)  # of the noise; each octave half as strong as the one before
_COLOR = 0.35  # largest difference of the noise between red, green and blue


def backdrop_picture(backdrop: Backdrop, size: tuple[int, int], photo: bytes | None) -> Picture:
    """Return the background of a view of `size` px; `photo` is the file's content where it is one."""
    width, height = size
    if backdrop.kind == PLAIN:
        return np.full((height, width, 3), backdrop.level, np.float32)
    if backdrop.kind == NOISE:
        return _noise(backdrop, size)
    return _photo(backdrop, size, photo or b"")


def _noise(backdrop: Backdrop, size: tuple[int, int]) -> Picture:
    rng = np.random.default_rng(backdrop.seed)
    out = np.full((size[1], size[0], 3), backdrop.level, np.float32)
    for octave, cell in enumerate(_CELLS_PX):
        shape = (size[1] // cell + 2, size[0] // cell + 2)
        grid = rng.uniform(-0.4, 0.4, (*shape, 1)) + _COLOR * rng.uniform(-0.4, 0.4, (*shape, 3))
        rows = _between(grid.astype(np.float32), np.arange(size[1]) / cell)
        out += _between(rows.transpose(1, 0, 2), np.arange(size[0]) / cell).transpose(1, 0, 2) / np.float32(2**octave)
    return np.asarray(np.clip(out, 0, 1), np.float32)


def _between(values: Picture, at: npt.NDArray[np.float64]) -> Picture:
    """Return values at places along the first axis, linearly between their neighbours."""
    below = at.astype(np.int64)
    share = (at - below).astype(np.float32)[:, None, None]
    return np.asarray(values[below] * (1 - share) + values[below + 1] * share, np.float32)


def _photo(backdrop: Backdrop, size: tuple[int, int], data: bytes) -> Picture:
    from cadcam.image.camera_picture import camera_picture_in
    from cadcam.image.picture import covering

    return covering(camera_picture_in(data, str(backdrop.kind)), size, backdrop.place)
