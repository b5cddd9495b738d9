"""Whether the surface beside an edge is evenly lit, or shows what may lead it astray: a shadow's border, dirt.

Brightness is sampled on both sides of a measured edge, as far as the model shows a single surface there, and averaged
along the edge. Away from it, the mean may change only by noise, by the slow variation of light along a surface, and by
a small share of the edge's own step. What runs along all of an edge moves it, the farther the larger its change is
beside the step; a texture, or a shadow that crosses the edge, does not: it differs from place to place.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Array, Longs, Mask
from cadcam.image.profile import noise_of
from cadcam.locate.photo import Photo
from cadcam.verify.edges.shown import ShownFaces
from cadcam.verify.edges.survey import Survey

_ASIDE = np.arange(2.0, 8.5)  # px from the edge at which brightness is sampled: beyond its blur
_ROOM_PX = 1.5  # beyond each sample, the width that must show the same surface
_FEW = 6  # places, with whose noise a change has to be compared even where more are averaged
_SIGMAS, _LEAST = 6.0, 0.006  # largest change of brightness: sds of noise, and beside it
# ... and as a share of the edge's step. Of edges with larger changes 16 % are over 0.25 px off, of others 2 to 3 %,
# with textures and with shadows alike (503 and 227 edges; docs/benchmarks/verify-tried.md).
_OF_STEP = 0.2
_SIDES = 2
_FEWEST, _HALF = 2, 0.5  # places that must show the surface near the edge, and share of these farther away
_NOTHING = 1 << 62  # the number of all that is not a surface of the part: it may be uneven as well


def uneven_edges(survey: Survey, photos: Sequence[Photo]) -> dict[int, bool]:
    """Return for each measured edge whether it lies beside uneven ground; edges for which this is unknown are left out.

    One uneven side suffices; that ground is even must be visible on both sides.
    """
    uneven_sides: dict[int, list[bool]] = {}
    offset = survey.matched.offset - np.einsum("ni,ni->n", survey.lines.by_point, survey.by[survey.lines.part])
    for i, photo in enumerate(photos):
        rows = np.flatnonzero((survey.lines.photo == i) & survey.matched.measured)
        rows = rows[np.lexsort((survey.lines.along[rows], survey.lines.edge[rows]))]
        noise = noise_of(photo.gray)
        edge, step = survey.lines.edge[rows], np.abs(survey.matched.step[rows])
        for side in (-1.0, 1.0):
            gray, surface = _beside(survey, photo, survey.shown[i], rows, offset[rows], side)
            for e in np.unique(edge):
                mine = edge == e
                uneven = _uneven(gray[:, mine], surface[:, mine] >= 0, float(np.nanmedian(step[mine])), noise)
                if uneven is not None:
                    uneven_sides.setdefault(int(e), []).append(uneven)
    return {e: any(sides) for e, sides in uneven_sides.items() if any(sides) or len(sides) == _SIDES}


def _beside(
    survey: Survey, photo: Photo, shown: ShownFaces, rows: Longs, offset: Array, side: float
) -> tuple[Array, Longs]:
    """Return the brightness (d, n) at each distance on one side of places, and its surface, -1 where that ends."""
    from scipy.ndimage import map_coordinates

    normal = side * survey.lines.normal[rows]
    q = survey.lines.q[rows] + side * offset[:, None] * normal
    at = q + _ASIDE[:, None, None] * normal
    gray = map_coordinates(photo.gray, (at[..., 1], at[..., 0]), order=1, mode="nearest")
    number = np.where(shown.part >= 0, shown.surface * (len(survey.by) + 1) + shown.part, _NOTHING)
    surface, beyond = (number[_face(shown, p)] for p in (at, at + _ROOM_PX * normal))
    inside = photo.camera.sees(at + _ROOM_PX * normal)
    same = (surface == surface[0]) & (beyond == surface[0]) & inside
    return gray.astype(np.float64), np.where(same, surface, -1).astype(np.int64)


def _face(shown: ShownFaces, q: Array) -> npt.NDArray[np.int32]:
    height, width = shown.face.shape
    x, y = (np.clip(np.rint(q[..., i]).astype(np.int64), 0, n - 1) for i, n in ((0, width), (1, height)))
    return np.asarray(shown.face[y, x])


def _uneven(gray: Array, same: Mask, step: float, noise: float) -> bool | None:
    """Return whether one side of an edge is uneven; None where that is not visible.

    gray (d, n): brightness at each distance; same (d, n): whether that is of the surface that begins at the edge; step:
    the edge's own change of brightness.
    """
    places = same[:2].all(axis=0)
    if places.sum() < _FEWEST:
        return None
    gray, same = gray[:, places], same[:, places]
    far = same.mean(axis=1) >= _HALF
    change = np.where(same, gray - gray[0], 0.0).sum(axis=1)[far] / same.sum(axis=1)[far]
    return bool(np.ptp(change) > max(_SIGMAS * noise / np.sqrt(_FEW) + _LEAST, _OF_STEP * step))
