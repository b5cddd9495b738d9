"""Is what lies beside an edge as even as a surface in even light, or is there more: a shadow's border, dirt.

Brightness is looked at on both sides of where an edge is measured, as far as the model shows one surface there, in runs
of neighbouring places, whose mean has little noise. It may rise away from the edge, or change from one run to the next,
by no more than noise and the slow change of light along a surface make of it.
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

_ASIDE = np.arange(2.0, 8.5)  # px from the edge at which brightness is looked at: farther than blur reaches
_ROOM_PX = 1.5  # beyond each of them that must show the same surface
_RUN = 6  # places
_SIGMAS, _LEAST = 6.0, 0.006  # of noise, and beside it, that brightness may change by
_SIDES = 2
_NOTHING = 1 << 62  # the number of what is none of the part's surfaces: it may be uneven too
_SHARE = 0.25  # of the runs of an edge that must be uneven away from it


def uneven_edges(survey: Survey, photos: Sequence[Photo]) -> dict[int, bool]:
    """Return of each measured edge whether it lies beside uneven ground; left out where that is not seen.

    On one side uneven ground is enough; that it is even has to be seen on both.
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
    """Return whether an edge's side is uneven, by brightness (d, n) and surface (d, n); None where it is not seen."""
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
