"""Whether the surface beside an edge is evenly lit, or shows something else: a shadow's border, dirt.

Brightness is sampled on both sides of a measured edge, as far as the model shows a single surface there, and averaged
over runs of neighbouring places, whose mean has little noise. Away from the edge, and from one run to the next, it may
change only by noise and by the slow variation of light along a surface.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Array, Longs
from cadcam.image.profile import noise_of
from cadcam.locate.photo import Photo
from cadcam.verify.edges.shown import ShownFaces
from cadcam.verify.edges.survey import Survey

_ASIDE = np.arange(2.0, 8.5)  # px from the edge at which brightness is sampled: beyond its blur
_ROOM_PX = 1.5  # beyond each sample, the width that must show the same surface
_RUN = 6  # places per run
_SIGMAS, _LEAST = 6.0, 0.006  # largest change of brightness: sds of noise, and beside it
_SIDES = 2
_NOTHING = 1 << 62  # the number of all that is not a surface of the part: it may be uneven as well
_SHARE = 0.25  # share of an edge's runs that must be uneven away from it


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
        edge = survey.lines.edge[rows]
        for side in (-1.0, 1.0):
            gray, surface = _beside(survey, photo, survey.shown[i], rows, offset[rows], side)
            for e in np.unique(edge):
                uneven = _uneven(gray[:, edge == e], surface[:, edge == e], noise)
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


def _uneven(gray: Array, surface: Longs, noise: float) -> bool | None:
    """Return whether one side of an edge is uneven, from brightness and surface (d, n); None where not visible."""
    most = _SIGMAS * noise / np.sqrt(_RUN) + _LEAST
    changes: list[float] = []
    levels: dict[int, list[float]] = {}
    for start in range(0, gray.shape[1], _RUN):
        g, number = gray[:, start : start + _RUN], surface[:, start : start + _RUN]
        its = int(np.median(number[0]))
        ok = (number == its) & (number >= 0)
        enough = ok.sum(axis=1) >= max(2, g.shape[1] / 2)
        if enough[:2].all():
            mean = np.where(ok, g, 0.0).sum(axis=1)[enough] / ok.sum(axis=1)[enough]
            changes.append(float(np.ptp(mean)))
            levels.setdefault(its, []).append(float(mean[0]))
    if not changes:
        return None
    jump = max(float(np.abs(np.diff(level)).max(initial=0.0)) for level in levels.values())
    return bool(np.mean(np.array(changes) > most) > _SHARE or jump > 2 * most)
