"""Salient windows of a part's drawing: those worth searching for in a photo.

A window is salient where the drawing fixes both coordinates (both eigenvalues of its structure tensor are large: J. Shi
and C. Tomasi, Good features to track, 1994) and where nothing near it in the drawing looks the same: a large gap
between its own correlation, 1, and that of the next peak within reach.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Array, Mask, Picture, frozen
from cadcam.errors import BadValue
from cadcam.geometry.rigid import Rigid
from cadcam.image.correlate import CorrelateOptions, correlate
from cadcam.image.template import LEAST_POINTS, Template
from cadcam.kinds import expect_count, expect_numbers, expect_positive
from cadcam.render.view import View

_LEAST_STRENGTH = 0.05  # relative to the strongest window
_LEAST_COUNTED = 0.2  # least share of a window that the model determines
_OFF_OUTLINE = 6.0  # px: how far outside the part the corner strength may peak
_TRIED = 2  # windows tried per window asked for: some turn out to be repetitions


@dataclass(frozen=True, slots=True)
class SalientOptions:
    """How windows are chosen.

    side: of a square window, px. count: the most windows. spacing: least distance of two centres, px. least_gap:
    between a window's correlation with itself and the next peak within `reach` px in the drawing; reach 0: not checked.
    """

    side: int = 49
    count: int = 40
    spacing: float = 20.0
    least_gap: float = 0.05
    reach: float = 30.0

    def __post_init__(self) -> None:
        expect_numbers(self)
        expect_count(self.side, "side", least=9, expected="a whole number of px from 9 on")
        expect_count(self.count, "count")
        expect_positive(self.spacing, "spacing", "a positive number of px")
        expect_positive(self.reach, "reach", "a number of px from 0 on", zero=True)
        if not 0 <= self.least_gap <= 1:
            raise BadValue("least_gap", self.least_gap, "a difference of correlations, from 0 to 1")


PLAIN_SALIENT = SalientOptions()


@dataclass(frozen=True, slots=True, eq=False)
class Windows:
    """N windows of a drawing: centre q (N, 2) px, whole pixels; p_part (N, 3) mm, the visible point of the part there.

    right (N, 3) mm: the point one px to its right at the same depth, from which a window's rotation is predicted.
    strength (N,): the smaller eigenvalue of the structure tensor, mean square slope of the appearance per px^2; gap
    (N,): see `SalientOptions.least_gap`; templates: the windows themselves.
    """

    q: Array
    p_part: Array
    right: Array
    strength: Array
    gap: Array
    templates: tuple[Template, ...]

    def __post_init__(self) -> None:
        n = len(self.templates)
        for name, shape in (("q", (n, 2)), ("p_part", (n, 3)), ("right", (n, 3)), ("strength", (n,)), ("gap", (n,))):
            object.__setattr__(self, name, frozen(getattr(self, name), f"windows' {name}", shape))

    def __len__(self) -> int:
        return len(self.templates)


def salient_windows(
    appearance: Picture, counts: Mask, view: View, camera_from_part: Rigid, *, options: SalientOptions = PLAIN_SALIENT
) -> Windows:
    """Return the salient windows of a drawing (H, W), strongest first; perhaps none.

    counts (H, W): pixels that the model determines. view: of the part from the same viewpoint, with DEPTH.
    """
    about = _surroundings(view.depth, options)
    top, left = about[0].start, about[1].start
    centres = _centres(corner_strength(appearance[about], options.side), view.depth[about], options)
    chosen: list[tuple[float, float, float, float, Template]] = []
    for x, y, strong in ((left + column, top + row, strong) for column, row, strong in centres):
        template = window(appearance, counts, x, y, options.side)
        if template is None:
            continue
        gap = _gap(appearance, template, x, y, options)
        if gap >= options.least_gap:
            chosen.append((float(x), float(y), strong, gap, template))
        if len(chosen) == options.count:
            break
    table = np.array([row[:4] for row in chosen]).reshape(-1, 4)
    p_part, right = (camera_from_part.inv @ _points(view, table[:, :2], px) for px in (0.0, 1.0))
    return Windows(table[:, :2], p_part, right, table[:, 2], table[:, 3], tuple(row[4] for row in chosen))


def _surroundings(depth: Picture, options: SalientOptions) -> tuple[slice, slice]:
    """Return the rows and columns of the part and as far round it as what is chosen depends on: all else is background.

    A part may be a small share of a large picture. Without a part: one pixel.
    """
    far = math.ceil(options.side + options.spacing + _OFF_OUTLINE)
    rows, columns = (np.flatnonzero(np.isfinite(depth).any(axis=axis)) for axis in (1, 0))
    if not len(rows):
        return slice(0, 1), slice(0, 1)
    (top, bottom), (left, right) = ((max(int(at[0]) - far, 0), int(at[-1]) + far + 1) for at in (rows, columns))
    return slice(top, bottom), slice(left, right)


def corner_strength(appearance: Picture, side: int) -> Picture:
    """Return the smaller eigenvalue (H, W) of the structure tensor of a picture, summed over half a window."""
    from scipy.ndimage import sobel, uniform_filter

    def twice(product: npt.NDArray[np.floating]) -> Picture:
        # two box filters make a pyramid: without a plateau its maximum is one pixel
        return np.asarray(uniform_filter(uniform_filter(product, side // 4 + 1), side // 4 + 1))

    gx, gy = sobel(appearance, axis=1) / 8, sobel(appearance, axis=0) / 8
    xx, yy, xy = (twice(product) for product in (gx * gx, gy * gy, gx * gy))
    return np.asarray(0.5 * (xx + yy) - np.sqrt(0.25 * (xx - yy) ** 2 + xy * xy), np.float32)


def window(appearance: Picture, counts: Mask, x: int, y: int, side: int) -> Template | None:
    """Return the template about a pixel; None where it leaves the picture or the model determines too little of it."""
    h = side // 2
    if min(x, y) < h or x + h >= appearance.shape[1] or y + h >= appearance.shape[0]:
        return None
    part = (slice(y - h, y + h + 1), slice(x - h, x + h + 1))
    mask = counts[part]
    if mask.mean() < _LEAST_COUNTED or mask.sum() < LEAST_POINTS or np.std(appearance[part][mask]) < 1e-3:
        return None
    return Template(appearance[part], mask=mask)


def _centres(strength: Picture, depth: Picture, options: SalientOptions) -> list[tuple[int, int, float]]:
    """Return x, y and strength of the part's pixels that are strongest within the spacing, strongest first.

    At a corner of the outline the strength peaks just outside of the part: the part's nearest pixel is taken.
    """
    from scipy.ndimage import distance_transform_edt, maximum_filter

    away, nearest = distance_transform_edt(~np.isfinite(depth), return_indices=True)
    size = 2 * round(options.spacing / 2) + 1
    peak = (strength == maximum_filter(strength, size)) & (away < _OFF_OUTLINE)
    peak &= strength > _LEAST_STRENGTH * float(strength[away < _OFF_OUTLINE].max(initial=0.0))
    y, x = np.nonzero(peak)
    chosen: list[tuple[int, int, float]] = []
    for k in np.argsort(-strength[y, x], kind="stable"):
        row, column = (int(i) for i in nearest[:, y[k], x[k]])
        if all(math.hypot(column - x0, row - y0) >= options.spacing for x0, y0, _ in chosen):
            chosen.append((column, row, float(strength[y[k], x[k]])))
        if len(chosen) == _TRIED * options.count:
            break
    return chosen


def _gap(appearance: Picture, template: Template, x: int, y: int, options: SalientOptions) -> float:
    """Return 1 minus the best correlation of a window with the drawing near it, its own place excepted."""
    if options.reach == 0:
        return 1.0
    far = int(options.reach) + template.size[0] // 2
    crop = appearance[max(y - far, 0) : y + far + 1, max(x - far, 0) : x + far + 1]
    found = correlate(crop, template, options=CorrelateOptions(angles=(0.0, 0.0), count=2, least_score=0.3))
    return 1.0 - float(found.score[1]) if len(found) > 1 else 0.7


def _points(view: View, q: Array, right: float) -> Array:
    """Return the points (N, 3) mm, camera frame, `right` px beside pixels q (N, 2), at the depth seen by these."""
    rays = view.camera.unproject(q + np.array([right, 0.0]))
    depth = view.depth[q[:, 1].astype(int), q[:, 0].astype(int)].astype(np.float64)
    return np.asarray(rays * (depth / rays[:, 2])[:, None])
