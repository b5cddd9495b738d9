"""The pixels that marks are fitted to: windows about them, subsampled where ground and ink are uniform."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from cadcam.arrays import Array, Ids, Index, Mask, Picture
from cadcam.target.boards.photometric import WindowPixels, patches
from cadcam.target.marks.mark import Mark

MARGIN = 0.7  # of the radius: width of ground in the window; it separates varying light from a shift of the mark
_LEAST_MARGIN, _MOST_MARGIN = 5.0, 12.0  # px: its limits
_PLAIN = 4.0  # px from all borders, beyond which ground and ink are uniform
_ALIKE = 1.5  # marks whose sizes are within this ratio are processed together
_LARGE = 30.0  # px of radius, from which every second pixel near borders is enough
_HUGE = 120.0  # px of radius, from which the number of pixels away from borders does not increase further
_FURTHEST = 600.0  # px from the centre: larger windows take every second row and column, or fewer
_TOGETHER = 2_000_000  # pixels of the squares about windows processed at a time, which bounds the memory


@dataclass(frozen=True, slots=True, eq=False)
class Window(WindowPixels):
    """The pixels of B marks, the share (B,) of each window outside the picture, and the marks' sizes (B,) px."""

    outside: Array
    size: Array

    @classmethod
    def around(
        cls, gray: Picture, q: Array, image_from_mark: Array, mark: Mark, margin: float, step: int = 1
    ) -> Window:
        """Return the windows about marks at q (B, 2) px of shapes (B, 2, 2) px per mm.

        step: of rows and columns; with 1 they are taken as the marks' sizes allow.
        """
        radius = mark.radius
        A = np.linalg.inv(image_from_mark)
        major, minor, reach = _sizes(mark, image_from_mark, margin)
        furthest = np.maximum(reach * major, 2.0)
        taken = max(step, _step(furthest))
        values, pixels, there = patches(gray, q, furthest, taken)
        p = pixels @ np.swapaxes(A, 1, 2) / radius
        rho = np.sqrt(np.sum(p**2, axis=-1))
        wanted = rho <= reach[:, None]
        if step == 1:
            wanted &= _telling(mark, rho, pixels, q, minor, taken)
        weight = (wanted & there).astype(np.float64)
        outside = 1 - weight.sum(axis=1) / np.maximum(wanted.sum(axis=1), 1)
        if len(q):  # only as many pixels as the largest window has
            kept = np.argsort(~wanted, axis=1, kind="stable")[:, : wanted.sum(axis=1).max()]
            values, weight = (np.take_along_axis(a, kept, axis=1) for a in (values, weight))
            pixels = np.take_along_axis(pixels, kept[..., None], axis=1)
        return cls(values, pixels, weight, outside, minor)

    def subset(self, which: Index) -> Window:
        """Return the windows that `which` selects."""
        return Window(*(getattr(self, f.name)[which] for f in fields(self)))

    def thinned(self, pixels: int) -> Window:
        """Return the windows with at most about `pixels` of their pixels, evenly spread."""
        step = max(1, round(self.values.shape[1] / pixels))
        kept = slice(None, None, step)
        return Window(self.values[:, kept], self.pixels[:, kept], self.weight[:, kept], self.outside, self.size)

    def only(self, i: int) -> tuple[Window, Mask]:
        """Return the i-th window alone, without padding, and which of all pixels (P,) those are."""
        there = self.weight[i] > 0
        one = self.subset(np.array([i]))
        return Window(one.values[:, there], one.pixels[:, there], one.weight[:, there], one.outside, one.size), there


def by_size(size: Array) -> list[Ids]:
    """Return the indices of windows of similar size, group by group, so that their pixel counts are similar."""
    octave = np.floor(np.log(np.maximum(size, 1.0)) / np.log(_ALIKE))
    return [np.flatnonzero(octave == k).astype(np.int32) for k in np.unique(octave)]


def batches(mark: Mark, image_from_mark: Array, margin: float) -> list[Ids]:
    """Return the indices of windows to process together: of similar size, and as many as the memory allows."""
    major, _, reach = _sizes(mark, image_from_mark, margin)
    parts: list[Ids] = []
    for group in by_size(major):
        furthest = (reach * major)[group]
        count = max(1, int(_TOGETHER / (2 * furthest.max() / _step(furthest) + 3) ** 2))
        parts += [group[i : i + count] for i in range(0, len(group), count)]
    return parts


def _sizes(mark: Mark, image_from_mark: Array, margin: float) -> tuple[Array, Array, Array]:
    """Return the semi-axes (B,) of marks, px, and how far (B,) their windows reach, in units of the mark."""
    major, minor = mark.radius * np.linalg.svd(image_from_mark, compute_uv=False).T
    width = np.clip(margin * minor, _LEAST_MARGIN * min(margin / MARGIN, 1.0), _MOST_MARGIN)
    return major, minor, 1 + width / minor


def _step(furthest: Array) -> int:
    """Return every how many rows and columns windows are taken that reach `furthest` (B,) px."""
    return max(1, int(np.ceil(furthest.max(initial=0.0) / _FURTHEST)))


def _telling(mark: Mark, rho: Array, pixels: Array, q: Array, minor: Array, step: int) -> Mask:
    """Return which pixels are near a border, and every fifth of the others: enough for level and light.

    Of a huge mark fewer of the others: level and light do not need more of them. A mark with a direction has borders
    all over, and all its pixels count alike.
    """
    x, y = (np.rint(pixels[..., i] + q[:, None, i]).astype(int) // step for i in (0, 1))
    apart = np.maximum((minor[:, None] / (step * _HUGE)) ** 2, 1.0).astype(int)
    if not mark.concentric or not len(q) or minor.min() < 3 * _PLAIN:
        return np.asarray((x + 2 * y) % apart == 0)
    borders = np.unique(mark.sectors[:, :2]) / mark.radius
    near = np.zeros(rho.shape, bool)
    for r in borders[borders > 0]:
        near |= np.abs(rho - r) * minor[:, None] < _PLAIN
    near &= (minor[:, None] < _LARGE) | ((x + y) % 2 == 0)
    return np.asarray(near | ((x + 2 * y) % (5 * apart) == 0))
